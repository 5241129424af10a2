"""Requests of one connection: read line by line, begun in turn, answered by tasks of their own.

One line is parsed in each turn of the loop, and users take turns: a client that sends thousands, or
long ones, slows down only its own user.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple, Protocol

import msgspec

from pdcd.errors import BusyError, PdcdError, to_typed_error
from pdcd.protocol.messages import MAX_LINE, Hello
from pdcd.server.callers import Caller
from pdcd.server.descriptors import Descriptors
from pdcd.server.protocol import Connection, RpcFault, RpcRequest, encode_error, encode_reply
from pdcd.server.stream import Stream
from pdcd.server.turns import UserTurns

logger = logging.getLogger(__name__)

OPEN_REQUESTS = 64
"""Requests of one client that may be unanswered at the same time."""
OPEN_BYTES = 2 * MAX_LINE
"""Bytes of all unanswered requests of one user."""

_SHORT_BYTES = 2**16
"""After a longer line its user must pause."""
_REST_S = 0.1
"""The pause after the longest line, in seconds; it is shorter after others."""
_CLOSE_S = 1.0
"""How long to wait for descriptors of answered requests to be closed, before new ones are taken, in
seconds."""


class ReplyWithMemory(NamedTuple):
    """An answer, and a descriptor that is sent with it, and closed then."""

    reply: msgspec.Struct
    fd: int


class Service(Protocol):
    """What the methods do; see `pdcd.server.methods`."""

    def hello(self) -> Hello:
        """The first words to a new client."""
        ...

    def permit(self, caller: Caller, method: str) -> None:
        """Raise DeniedError for a method that this client may not call, whatever its parameters."""
        ...

    async def handle(self, caller: Caller, request: RpcRequest) -> msgspec.Struct | ReplyWithMemory:
        """Do what is asked and return the result. Raises PdcdError."""
        ...

    def engaged(self, caller: Caller) -> bool:
        """Whether the client has a job that ends with it."""
        ...

    def gone(self, caller: Caller) -> None:
        """The client has left."""
        ...


@dataclass
class FairShares:
    """What all connections of a server share: whose line is next, and the bytes of unanswered
    requests by user."""

    lines: UserTurns = field(default_factory=UserTurns)
    open_bytes: Counter[int] = field(default_factory=Counter)


class RequestReader:
    """Takes the requests of one client until the end of its stream."""

    def __init__(
        self,
        service: Service,
        caller: Caller,
        stream: Stream,
        descriptors: Descriptors,
        shares: FairShares,
    ) -> None:
        self._service, self._caller, self._stream = service, caller, stream
        self._descriptors, self._shares = descriptors, shares
        self._machine = Connection(descriptors=descriptors, permit=partial(service.permit, caller))
        self.open: set[asyncio.Task[None]] = set()
        """Requests that are not answered yet."""

    async def read(self) -> None:
        """Take requests until the end of the stream."""
        try:
            while not self._machine.closed:
                came = await self._stream.receive()
                self._descriptors.receive(came.fds)
                if not came.data:
                    return
                if came.fds:  # a client that has waited for an answer may send as many again
                    await self._descriptors.settle(_CLOSE_S)
                items = self._machine.receive(came.data, lost=came.lost)
                while await self._take_line(items):
                    pass
        except ConnectionError:
            logger.info("reset connection=%d", self._caller.number)

    async def _take_line(self, items: Iterator[RpcRequest | RpcFault]) -> bool:
        """Parse the next line when it is this user's turn, and begin its request; false where there
        is none."""
        uid = self._caller.peer.uid
        await self._caller.room()
        await self._shares.lines.take(uid)
        size = 0
        try:
            item = next(items, None)
            if item is None:
                return False
            size = self._machine.line_bytes
            self._begin(item, size)
            del item  # so that it is not kept while this user waits for its next turn
            # Its first steps are made before the next line is parsed: requests that need not wait
            # are done and answered in their order.
            await asyncio.sleep(0)
            return True
        finally:
            rest_s = _REST_S * size / MAX_LINE if size > _SHORT_BYTES else 0.0
            self._shares.lines.give_back(uid, rest_s)

    def _begin(self, item: RpcRequest | RpcFault, size: int) -> None:
        caller = self._caller
        if isinstance(item, RpcFault):
            logger.info("fault connection=%d error=%s", caller.number, item.error)
            if item.line is not None:
                caller.send(item.line)
            return
        caller.idle_s = 0.0
        full = self._full(size)
        if full is not None:
            if item.id is not None:
                caller.send(encode_error(item.id, full))
            self._descriptors.release(item.fds)
            return
        uid = caller.peer.uid
        self._shares.open_bytes[uid] += size

        def answered(task: asyncio.Task[None]) -> None:
            self.open.discard(task)
            self._shares.open_bytes[uid] -= size
            if not self._shares.open_bytes[uid]:
                del self._shares.open_bytes[uid]

        task = asyncio.create_task(answer_request(self._service, caller, item, self._descriptors))
        self.open.add(task)
        task.add_done_callback(answered)

    def _full(self, size: int) -> BusyError | None:
        """Why no more may be asked for now, or None."""
        if len(self.open) >= OPEN_REQUESTS:
            what = f"{OPEN_REQUESTS} requests of this connection"
        elif 0 < self._shares.open_bytes[self._caller.peer.uid] > OPEN_BYTES - size:
            what = f"more than {OPEN_BYTES} bytes of requests of this user"
        else:
            return None
        return BusyError(f"{what} are unanswered", hint="wait for answers before asking more")


async def answer_request(
    service: Service, caller: Caller, request: RpcRequest, descriptors: Descriptors
) -> None:
    """Do one request and queue its answer, if it wants one."""
    fd: int | None = None
    try:
        result = await service.handle(caller, request)
        if isinstance(result, ReplyWithMemory):
            result, fd = result
        fds = 0 if fd is None else 1
        line = b"" if request.id is None else encode_reply(request.id, result, fds=fds)
    except asyncio.CancelledError:
        raise
    # A fault of the daemon must not leave the client without an answer.
    except BaseException as err:
        if isinstance(err, PdcdError):
            logger.info("refused method=%s error=%s", request.method, err)
        else:
            logger.exception("method failed method=%s", request.method)
        # No name but `err`: any other would keep error and frames, and so the request, alive in a
        # cycle.
        line = b"" if request.id is None else encode_error(request.id, to_typed_error(err))
    if line:
        caller.send(line, fd=fd)
    elif fd is not None:
        os.close(fd)
    descriptors.release(request.fds)
