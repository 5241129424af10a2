"""A daemon in this process, and a client that speaks raw lines, for the tests of the server."""

from __future__ import annotations

import asyncio
import functools
import inspect
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any, overload

import msgspec

from pdcd.bench.tables import Config, LimitsConfig, ServerConfig
from pdcd.server.daemon import serve_daemon
from tests.coroutines import Scene, sign_test
from tests.e2e.server._fake_engine import FakeEngine

PATIENCE_S = 60.0


class Wire:
    """One raw connection: lines out, messages in; events are set aside while an answer is due."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer
        self.events: list[dict[str, Any]] = []
        self.hello: dict[str, Any] = {}
        self._last_id = 0

    async def send(self, line: bytes | dict[str, Any]) -> None:
        data = line if isinstance(line, bytes) else msgspec.json.encode(line)
        self.writer.write(data + b"\n")
        await self.writer.drain()

    async def receive(self) -> dict[str, Any]:
        line = await asyncio.wait_for(self.reader.readline(), PATIENCE_S)
        if not line:
            raise EOFError
        message: dict[str, Any] = msgspec.json.decode(line, type=dict)
        return message

    async def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """The whole answer to a request: with `result` or `error`."""
        self._last_id += 1
        request = {"jsonrpc": "2.0", "id": self._last_id, "method": method, "params": params}
        await self.send(request)
        return await self.answer(self._last_id)

    async def answer(self, request_id: int | str | None) -> dict[str, Any]:
        while True:
            message = await self.receive()
            if message.get("method") == "event":
                self.events.append(message["params"])
            elif message["id"] == request_id:
                return message

    async def result(self, method: str, **params: Any) -> Any:
        answer = await self.ask(method, **params)
        assert "result" in answer, answer
        return answer["result"]

    async def error(self, method: str, **params: Any) -> dict[str, Any]:
        answer = await self.ask(method, **params)
        error: dict[str, Any] = answer["error"]
        return error

    async def event(self, kind: str, job: str | None = None) -> dict[str, Any]:
        """The next event of a type, of those set aside or to come."""
        while True:
            for event in self.events:
                if event["type"] == kind and job in (None, event["job"]):
                    self.events.remove(event)
                    return event
            message = await self.receive()
            if message.get("method") == "event":
                self.events.append(message["params"])

    async def ended(self) -> bool:
        """Whether the server closes the connection, whatever it says before."""
        try:
            while True:
                await self.receive()
        except (EOFError, ConnectionError):
            return True

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            pass  # the server was first


class Daemon:
    """What a test sees of a running daemon: its socket, its engine, its end."""

    def __init__(self, path: Path, engine: FakeEngine, stop: asyncio.Event) -> None:
        self.path = path
        self.engine = engine
        self.stop = stop

    @asynccontextmanager
    async def wire(self) -> AsyncIterator[Wire]:
        reader, writer = await asyncio.open_unix_connection(str(self.path), limit=2**22)
        wire = Wire(reader, writer)
        try:
            wire.hello = await wire.receive()
            yield wire
        finally:
            await wire.close()


@asynccontextmanager
async def daemon(
    folder: Path, *, limits: LimitsConfig | None = None, server: ServerConfig | None = None
) -> AsyncIterator[Daemon]:
    """Serve a fake engine below `folder`; checks at the end that nothing is left over."""
    path = folder / "pdcd.sock"
    state = folder / "state"
    state.mkdir(exist_ok=True)
    config = Config(
        limits=limits or LimitsConfig(),
        server=msgspec.structs.replace(server or ServerConfig(), state_dir=str(state)),
    )
    engine = FakeEngine(config)
    stop = asyncio.Event()
    task = asyncio.create_task(
        serve_daemon(config, socket=path, engine_factory=lambda _: engine, stop=stop)
    )
    try:
        while "start" not in engine.calls:
            await asyncio.sleep(0.002)
        yield Daemon(path, engine, stop)
    finally:
        stop.set()
        await asyncio.wait_for(task, PATIENCE_S)
    assert not [*folder.glob("pdcd.sock*"), *state.glob("daemon.lock")]
    assert asyncio.all_tasks() == {asyncio.current_task()}
    assert engine.calls[-1] == "stop"
    assert not engine.shutter_open
    assert engine.lit is None
    assert len(engine.threads) == 1
    assert threading.get_ident() not in engine.threads


@overload
def served(body: Scene, /) -> Callable[..., None]: ...


@overload
def served(
    *, limits: LimitsConfig | None = None, server: ServerConfig | None = None
) -> Callable[[Scene], Callable[..., None]]: ...


def served(body: Scene | None = None, /, **tables: Any) -> Any:
    """Run a coroutine as a test with a daemon of its own.

    Its parameter `running` is the daemon, those of type `Wire` are connections to it, made in
    their order; all others are fixtures.
    """
    if body is None:
        return functools.partial(_serve_test, **tables)
    return _serve_test(body)


def _serve_test(body: Scene, **tables: Any) -> Callable[..., None]:
    wanted = inspect.signature(body).parameters
    wires = [name for name, one in wanted.items() if one.annotation == "Wire"]
    fixtures = [one for name, one in wanted.items() if name not in ("running", *wires)]

    @functools.wraps(body)
    def test(_own_folder: Path, **given: Any) -> None:
        async def scene() -> None:
            async with AsyncExitStack() as stack:
                running = await stack.enter_async_context(daemon(_own_folder, **tables))
                mine: dict[str, Any] = {}
                for name in wires:
                    mine[name] = await stack.enter_async_context(running.wire())
                if "running" in wanted:
                    mine["running"] = running
                await body(**mine, **given)

        asyncio.run(scene())

    folder = inspect.Parameter("_own_folder", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    sign_test(test, [folder, *fixtures])
    return test


@contextmanager
def threaded_daemon(
    folder: Path, *, limits: LimitsConfig | None = None, server: ServerConfig | None = None
) -> Iterator[Daemon]:
    """The same in a thread of its own, for blocking clients."""
    ready = threading.Event()
    box: list[tuple[Daemon, asyncio.AbstractEventLoop]] = []

    async def body() -> None:
        async with daemon(folder, limits=limits, server=server) as running:
            box.append((running, asyncio.get_running_loop()))
            ready.set()
            await running.stop.wait()

    thread = threading.Thread(target=asyncio.run, args=(body(),))
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        yield box[0][0]
    finally:
        if box:
            box[0][1].call_soon_threadsafe(box[0][0].stop.set)
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


@contextmanager
def nothing_left() -> Iterator[None]:
    """Fails when the body leaves a thread or an open file behind."""

    def held() -> tuple[set[threading.Thread], int]:
        return set(threading.enumerate()), len(list(Path("/proc/self/fd").iterdir()))

    before = held()
    yield
    assert held() == before
