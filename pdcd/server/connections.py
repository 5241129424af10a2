"""The socket layer: accept, check who it is, read requests (`reading`), deliver events.

Nothing here knows what a method does, and nothing here blocks: a client that does not read, or does
nothing at all, is cut off, and never holds up another one or the panels.
"""

from __future__ import annotations

import asyncio
import dataclasses
import logging
import socket
from collections import Counter
from typing import Any

from pdcd.bench.tables import LimitsConfig
from pdcd.errors import BusyError, DeniedError, PdcdError, ProtocolError
from pdcd.protocol.events import THINNED, Event
from pdcd.protocol.views import ClientRole
from pdcd.server.access import Access, Names, Peer, peer_of
from pdcd.server.callers import Caller
from pdcd.server.descriptors import Descriptors
from pdcd.server.jobs import Job
from pdcd.server.protocol import encode_error, encode_notification
from pdcd.server.reading import FairShares, RequestReader, Service
from pdcd.server.stream import Stream

logger = logging.getLogger(__name__)

LINGER_S = 2.0
"""How long requests made before the end of a stream may take to be answered, in seconds."""

KEPT_PLACES = 4
"""Places kept for root, and as many for the daemon's own user, when all others are taken."""

_ACCEPTS = 16
"""Most clients that are accepted in one turn of the loop."""

NO_ACCEPT_S = 1.0
"""Pause in seconds when the system has no resources left to accept a client."""


class Server:
    """Serves a listening socket, which it finally closes.

    `access` decides who may be a client, `limits` how many there may be.
    """

    def __init__(self, sock: socket.socket, access: Access, limits: LimitsConfig) -> None:
        self._sock = sock
        self._access = access
        self._limits = limits
        self._names = Names()
        self._callers: dict[int, Caller] = {}
        self._places: Counter[int] = Counter()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._accepted = 0
        self._shares = FairShares()

    @property
    def connections(self) -> int:
        """The number of clients."""
        return len(self._callers)

    def open(self, service: Service) -> None:
        """Begin to accept; called from the event loop."""
        self._sock.setblocking(False)
        asyncio.get_running_loop().add_reader(self._sock, self._accept, service)

    async def close(self) -> None:
        """Stop accepting, deliver what is queued for up to a second, and close all connections."""
        asyncio.get_running_loop().remove_reader(self._sock)
        self._sock.close()
        for caller in self._callers.values():
            caller.finish()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=1.0)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._names.close()

    def publish(self, job: Job, event: Event) -> None:
        """Send an event to its subscribers. Never blocks."""
        try:
            line = encode_notification("event", event)
        except ProtocolError:
            logger.exception("event not sent job=%s type=%s", job.name, event.type)
            return
        for caller in list(self._callers.values()):
            own = caller.interest == "own" and job.owner.connection == caller.number
            if own or caller.interest == "all":
                caller.send(line, droppable=isinstance(event, THINNED))

    def _accept(self, service: Service) -> None:
        """Accept waiting clients; each is served by a task of its own."""
        for _ in range(_ACCEPTS):
            try:
                sock, _ = self._sock.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as err:
                logger.error("no client can be accepted: %s", err)
                loop = asyncio.get_running_loop()
                loop.remove_reader(self._sock)
                loop.call_later(NO_ACCEPT_S, self._accept_again, service)
                return
            task = asyncio.create_task(self._serve(service, sock))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def _accept_again(self, service: Service) -> None:
        if self._sock.fileno() >= 0:  # not closed meanwhile
            self.open(service)

    async def _serve(self, service: Service, sock: socket.socket) -> None:
        """One connection, from accept to close."""
        stream = Stream(sock)
        self._accepted += 1
        number = self._accepted
        try:
            peer = peer_of(sock)
            role = self._access.role(peer)
            if role is None:
                await _refuse(stream, number, peer, _stranger(peer))
                return
            full = self._full(peer)
            if full is not None:
                await _refuse(stream, number, peer, full)
                return
            self._places[peer.uid] += 1
            try:
                await self._admit(service, stream, number, peer, role)
            finally:
                self._places[peer.uid] -= 1
        finally:
            # By now the kernel has all lines, or the client is cut off: nothing is left to flush.
            stream.close()

    async def _admit(
        self, service: Service, stream: Stream, number: int, peer: Peer, role: ClientRole
    ) -> None:
        """Serve an admitted client, and close all descriptors that came with it."""
        peer = dataclasses.replace(peer, user=await self._names.of(peer.uid))
        logger.info(
            "accepted connection=%d pid=%d uid=%d gid=%d user=%s role=%s",
            *(number, peer.pid, peer.uid, peer.gid, peer.user, role.name.lower()),
        )
        descriptors = Descriptors()
        try:
            await self._converse(service, Caller(number, peer, role, stream), stream, descriptors)
        finally:
            stream.cut()
            logger.info("closed connection=%d", number)
            # A client that passes something that cannot be closed keeps its place taken, so it can
            # do that only so often.
            await descriptors.end()

    async def _converse(
        self, service: Service, caller: Caller, stream: Stream, descriptors: Descriptors
    ) -> None:
        """Hello, then requests and answers until either side ends the connection."""
        self._callers[caller.number] = caller
        caller.send(encode_notification("hello", service.hello()))
        reader = RequestReader(service, caller, stream, descriptors, self._shares)
        pump = asyncio.create_task(caller.pump())
        read = asyncio.create_task(reader.read())
        idle = asyncio.create_task(self._idle(service, caller, reader.open))
        try:
            await asyncio.wait({pump, read, idle}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._callers[caller.number]
            service.gone(caller)
            read.cancel()
            idle.cancel()
            if reader.open and not pump.done():
                await asyncio.wait(reader.open, timeout=LINGER_S)
            caller.finish()
            for request in reader.open:
                request.cancel()
            await asyncio.gather(read, idle, pump, *reader.open, return_exceptions=True)
            if not read.cancelled() and (fault := read.exception()) is not None:
                logger.error("reading failed connection=%d", caller.number, exc_info=fault)

    async def _idle(
        self, service: Service, caller: Caller, open_requests: set[asyncio.Task[None]]
    ) -> None:
        """Return when the client has asked for nothing for `idle_s`, after telling it so.

        Time is counted in steps: when the daemon itself was held up, no client is blamed for that
        time.
        """
        limit_s = self._limits.idle_s
        step_s = limit_s / 8.0
        while caller.idle_s <= limit_s:
            await asyncio.sleep(step_s)
            wanted = open_requests or caller.interest != "none" or service.engaged(caller)
            caller.idle_s = 0.0 if wanted else caller.idle_s + step_s
        error = BusyError(
            f"this connection asked for nothing for {limit_s:g} s",
            hint="connect again; events.subscribe keeps a connection, [limits] idle_s is the time",
        )
        logger.info("idle connection=%d", caller.number)
        caller.send(encode_error(None, error))

    def _full(self, peer: Peer) -> PdcdError | None:
        """Why there is no place for this peer, or None."""
        limits, held, own = self._limits, self._places[peer.uid], self._access.own
        if peer.uid in own:
            if held < KEPT_PLACES:
                return None
        elif held >= limits.connections_per_user:
            return BusyError(
                f"{held} clients of uid {peer.uid} are connected already",
                hint="close one, or raise [limits] connections_per_user",
            )
        kept = sum(min(self._places[uid], KEPT_PLACES) for uid in own)
        if self._places.total() - kept < limits.connections:
            return None
        return BusyError(
            f"{limits.connections} clients are connected already",
            hint="close one, or raise [limits] connections",
        )


def _stranger(peer: Peer) -> DeniedError:
    return DeniedError(
        f"uid {peer.uid} may not use this rig",
        hint="join the group of the socket, or be listed in [server] allow_uids or a role's table",
    )


async def _refuse(stream: Stream, number: int, peer: Peer, error: PdcdError) -> None:
    """Tell a refused client why; it is one short line, for which there is always room."""
    logger.info(
        "refused connection=%d pid=%d uid=%d gid=%d error=%s",
        *(number, peer.pid, peer.uid, peer.gid, error),
    )
    try:
        async with asyncio.timeout(LINGER_S):
            await stream.send(encode_error(None, error))
    except (OSError, TimeoutError):
        pass  # it did not wait to be told
