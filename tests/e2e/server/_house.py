"""A server whose service only reads the descriptors it is sent, and a client that sends them."""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import msgspec

from pdcd.bench.tables import LimitsConfig
from pdcd.errors import ConfigError
from pdcd.protocol.messages import PROTOCOL, ClockAnchor, Hello
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.views import ClientRole
from pdcd.server.access import Access
from pdcd.server.callers import Caller
from pdcd.server.connections import Server
from pdcd.server.protocol import RpcRequest
from pdcd.server.reading import Service
from tests.e2e.server._server_harness import PATIENCE_S


class Contents(msgspec.Struct):
    """What the descriptors of a request hold, and their numbers."""

    texts: list[str]
    fds: tuple[int, ...]


class Reader:
    """A service that reads its descriptors; a note says what else it does."""

    def __init__(self) -> None:
        self.gate = asyncio.Event()

    def hello(self) -> Hello:
        return Hello(
            server="test",
            version="0",
            protocol=PROTOCOL,
            max_line=2**20,
            drivers={},
            state="idle",
            clock=ClockAnchor(0, ""),
        )

    def permit(self, caller: Caller, method: str) -> None:
        pass

    async def handle(self, caller: Caller, request: RpcRequest) -> Contents:
        for fd in request.fds:
            assert fcntl.fcntl(fd, fcntl.F_GETFD) & fcntl.FD_CLOEXEC
        note = request.params.note if isinstance(request.params, CaptureRequest) else ""
        if note == "wait":
            await self.gate.wait()
        if note == "refuse":
            raise ConfigError("no")
        if note == "break":
            raise RuntimeError("a fault of the program")
        return Contents([os.pread(fd, 100, 0).decode() for fd in request.fds], request.fds)

    def engaged(self, caller: Caller) -> bool:
        return False

    def gone(self, caller: Caller) -> None:
        pass


class Guest:
    """A client that sends descriptors as it likes; it blocks, so it is used from threads."""

    def __init__(self, path: Path) -> None:
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.settimeout(PATIENCE_S)
        self.sock.connect(str(path))
        self.lines = self.sock.makefile("rb")

    def send(self, message: dict[str, Any] | bytes, fds: list[int] | None = None) -> None:
        line = message if isinstance(message, bytes) else json.dumps(message).encode() + b"\n"
        sent = socket.send_fds(self.sock, [line], fds or [])
        if sent < len(line):  # nothing is an error too, where the daemon has hung up by then
            self.sock.sendall(line[sent:])

    def read(self) -> dict[str, Any]:
        line = self.lines.readline()
        return json.loads(line) if line else {}

    def kind(self) -> str:
        """Kind of the next error; "" for the end of the connection."""
        try:
            message = self.read()
        except ConnectionError:
            return ""
        return str(message["error"]["data"]["kind"]) if message else ""

    def close(self) -> None:
        self.lines.close()
        self.sock.close()


class House:
    """A server in this loop, and how many descriptors this process has."""

    def __init__(self, path: Path, service: Reader) -> None:
        self.path = path
        self.service = service
        self.before = held()

    async def visit(self, body: Callable[[Guest], object]) -> None:
        """Run `body` with a guest in a thread; afterwards nothing of it may be left."""
        await self.visit_only(body)
        await self.tidy()

    async def visit_only(self, body: Callable[[Guest], object]) -> None:
        """The same without looking at what is left."""

        def run() -> None:
            guest = Guest(self.path)
            try:
                assert guest.read()["method"] == "hello"
                body(guest)
            finally:
                guest.close()

        await asyncio.to_thread(run)

    async def tidy(self, less: int = 0) -> None:
        """Wait until as many descriptors are open as at first, and `less`."""
        async with asyncio.timeout(PATIENCE_S):
            while held() - less != self.before:
                await asyncio.sleep(0.002)


def held() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@asynccontextmanager
async def house(
    folder: Path, uids: frozenset[int] = frozenset({os.getuid()})
) -> AsyncIterator[House]:
    sock = socket.socket(socket.AF_UNIX)
    sock.bind(str(folder / "s"))
    sock.listen()
    access = Access(dict.fromkeys(uids, ClientRole.SHOOT), {})
    server = Server(sock, access, LimitsConfig())
    service = Reader()
    server.open(cast(Service, service))
    try:
        yield House(folder / "s", service)
    finally:
        await server.close()
        assert asyncio.all_tasks() == {asyncio.current_task()}
