"""The socket layer: accept, check who it is, read lines, answer, deliver events.

Nothing here knows what a method does, and nothing here blocks: a client that does not read is
cut off, and never holds up another one or the panels.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from typing import Any, Protocol

import msgspec

from pdcd.errors import BusyError, ConfigError, PdcdError, ProtocolError
from pdcd.runs.events import THINNED, Event
from pdcd.server.access import Access, Peer, peer_of
from pdcd.server.callers import Caller
from pdcd.server.jobs import Job
from pdcd.server.messages import Hello
from pdcd.server.protocol import (
    Connection,
    Fault,
    Request,
    encode_error,
    encode_notification,
    encode_reply,
)

logger = logging.getLogger(__name__)

LINGER_S = 2.0
"""How long requests made before an end of stream may still be answered, in seconds."""

OPEN_REQUESTS = 64
"""Requests of one client that may be unanswered at a time."""


READ_BYTES = 65536
"""Most that is taken from a socket at a time."""


class Service(Protocol):
    """What the methods do; see `pdcd.server.methods`."""

    def hello(self) -> Hello:
        """The first words to a new client."""
        ...

    async def handle(self, caller: Caller, request: Request) -> msgspec.Struct:
        """Do what is asked and return the result. Raises PdcdError."""
        ...

    def gone(self, caller: Caller) -> None:
        """The client has left."""
        ...


class Server:
    """Serves a listening socket, which it closes in the end.

    `connections` is the most clients at a time; `access` decides who may be one.
    """

    def __init__(self, sock: socket.socket, access: Access, *, connections: int) -> None:
        self._sock = sock
        self._access = access
        self._limit = connections
        self._callers: dict[int, Caller] = {}
        self._tasks: set[asyncio.Task[Any]] = set()
        self._accepted = 0
        self._server: asyncio.Server | None = None

    @property
    def connections(self) -> int:
        """How many clients there are."""
        return len(self._callers)

    async def open(self, service: Service) -> None:
        """Begin to accept."""

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            # Only `close` cancels; asyncio's own callback would report that as an error.
            with contextlib.suppress(asyncio.CancelledError):
                await self._serve(service, reader, writer)

        # Not start_unix_server: from Python 3.13 on it removes the socket file when it closes,
        # which is not ours if it was passed to us.
        self._server = await asyncio.start_server(serve, sock=self._sock)

    async def close(self) -> None:
        """Accept no more, deliver what is queued for up to a second, and part from all."""
        if self._server is None:
            self._sock.close()
            return
        self._server.close()
        for caller in self._callers.values():
            caller.finish()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=1.0)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._server.wait_closed()

    def publish(self, job: Job, event: Event) -> None:
        """Send an event to those who listen. Never blocks."""
        try:
            line = encode_notification("event", event)
        except ProtocolError:
            logger.exception("event not sent job=%s type=%s", job.name, event.type)
            return
        for caller in list(self._callers.values()):
            own = caller.interest == "own" and job.owner.connection == caller.number
            if own or caller.interest == "all":
                caller.send(line, droppable=isinstance(event, THINNED))

    async def _serve(
        self, service: Service, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """One connection, from accept to close."""
        task = asyncio.current_task()
        self._tasks |= {task} if task else set()
        peer = peer_of(writer.get_extra_info("socket"))
        self._accepted += 1
        caller = Caller(self._accepted, peer, writer)
        refusal = self._refusal(peer)
        logger.info(
            "accepted connection=%d pid=%d uid=%d gid=%d user=%s refused=%s",
            *(caller.number, peer.pid, peer.uid, peer.gid, peer.user, refusal is not None),
        )
        try:
            if refusal is not None:
                caller.send(encode_error(None, refusal))
                caller.finish()
                await caller.pump()
            else:
                await self._converse(service, caller, reader)
        finally:
            # By now the kernel has all lines, or the client is cut off: nothing is left to flush.
            writer.transport.abort()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
            logger.info("closed connection=%d", caller.number)
            self._tasks -= {task} if task else set()

    async def _converse(
        self, service: Service, caller: Caller, reader: asyncio.StreamReader
    ) -> None:
        """Hello, then requests and answers until either side has had enough."""
        self._callers[caller.number] = caller
        caller.send(encode_notification("hello", service.hello()))
        open_requests: set[asyncio.Task[None]] = set()
        pump = asyncio.create_task(caller.pump())
        read = asyncio.create_task(_read(service, caller, reader, open_requests))
        try:
            await asyncio.wait({pump, read}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._callers[caller.number]
            service.gone(caller)
            read.cancel()
            if open_requests and not pump.done():
                await asyncio.wait(open_requests, timeout=LINGER_S)
            caller.finish()
            for request in open_requests:
                request.cancel()
            await asyncio.gather(read, pump, *open_requests, return_exceptions=True)

    def _refusal(self, peer: Peer) -> PdcdError | None:
        """Why this peer cannot be served, or None."""
        if not self._access.permits(peer):
            return ConfigError(
                f"user {peer.user} (uid {peer.uid}) may not use this rig",
                hint="join the group of the socket, or be listed in [server] allow_uids",
            )
        if len(self._callers) >= self._limit:
            return BusyError(
                f"{self._limit} clients are connected already",
                hint="close one, or raise [limits] connections",
            )
        return None


async def _read(
    service: Service,
    caller: Caller,
    reader: asyncio.StreamReader,
    open_requests: set[asyncio.Task[None]],
) -> None:
    """Take requests until the end of the stream; each is answered by a task of its own."""
    machine = Connection()
    try:
        while not machine.closed and (data := await reader.read(READ_BYTES)):
            for item in machine.receive(data):
                await caller.room()
                if isinstance(item, Fault):
                    logger.info("fault connection=%d error=%s", caller.number, item.error)
                    if item.line is not None:
                        caller.send(item.line)
                elif len(open_requests) >= OPEN_REQUESTS:
                    _refuse_more(caller, item)
                else:
                    task = asyncio.create_task(_answer(service, caller, item))
                    open_requests.add(task)
                    task.add_done_callback(open_requests.discard)
                    # Its first steps come before the next line is looked at: what needs no
                    # waiting is done and answered in the order in which it was asked.
                    await asyncio.sleep(0)
    except ConnectionError:
        logger.info("reset connection=%d", caller.number)


async def _answer(service: Service, caller: Caller, request: Request) -> None:
    """Do one request and queue its answer, if it wants one."""
    try:
        result = await service.handle(caller, request)
        line = b"" if request.id is None else encode_reply(request.id, result)
    except PdcdError as err:
        logger.info("refused method=%s error=%s", request.method, err)
        line = b"" if request.id is None else encode_error(request.id, err)
    # A fault of ours must not leave the client without an answer.
    except Exception as err:
        logger.exception("method failed method=%s", request.method)
        fault = PdcdError(f"{type(err).__name__}: {err}", hint="see the daemon's log")
        line = b"" if request.id is None else encode_error(request.id, fault)
    if line:
        caller.send(line)


def _refuse_more(caller: Caller, request: Request) -> None:
    error = BusyError(
        f"{OPEN_REQUESTS} requests of this connection are unanswered",
        hint="wait for answers before asking more",
    )
    if request.id is not None:
        caller.send(encode_error(request.id, error))
