"""Too many, too slow, not allowed, already there: how the socket defends the rig."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, cast

import pytest

from pdcd.bench.tables import Config, ServerConfig
from pdcd.errors import ConfigError
from pdcd.server import callers
from pdcd.server.access import Access, Peer, peer_of
from pdcd.server.callers import QUEUE_LINES, Caller
from pdcd.server.connections import Server, Service
from pdcd.server.daemon import serve
from tests.e2e.server._fake_engine import FakeEngine
from tests.e2e.server._server_harness import Wire, daemon, nothing_left

ME = Peer(os.getpid(), os.getuid(), os.getgid(), "me")


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


class SlowWriter:
    """Stands for a stream whose reader takes one line each time `taken` is set."""

    def __init__(self) -> None:
        self.transport = self
        self.lines: list[bytes] = []
        self.taken = asyncio.Event()
        self.aborted = False

    def set_write_buffer_limits(self, high: int) -> None:
        assert high == 0

    def write(self, line: bytes) -> None:
        self.lines.append(line)

    async def drain(self) -> None:
        await self.taken.wait()

    def abort(self) -> None:
        self.aborted = True

    def is_closing(self) -> bool:
        return self.aborted


def test_the_seventeenth_client_is_refused_and_the_others_stay(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with daemon(tmp_path) as running, AsyncExitStack() as stack:
            wires = [await stack.enter_async_context(running.wire()) for _ in range(16)]
            async with running.wire() as late:
                refusal = late.hello
                assert refusal["id"] is None and refusal["error"]["data"]["kind"] == "busy"
                assert await late.ended()
            for wire in wires:
                await wire.result("ping")
            await wires[0].close()
            while (await wires[1].result("rig.status"))["connections"] == 16:
                await asyncio.sleep(0.002)
            async with running.wire() as welcome:
                assert welcome.hello["method"] == "hello"

    asyncio.run(scenario())


def deaf(path: Path) -> socket.socket:
    """A client that starts a capture, asks for more than the sockets hold, and never reads."""
    sock = socket.socket(socket.AF_UNIX)
    sock.connect(str(path))
    start = (
        b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":{"goal":"white","note":"slow"}}'
    )
    sock.sendall(start + b"\n" + b'{"jsonrpc":"2.0","id":1,"method":"rig.describe"}\n' * 1000)
    return sock


def test_a_client_that_does_not_read_is_cut_off_with_its_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(callers, "STUCK_S", 0.2)

    async def scenario() -> None:
        async with daemon(tmp_path) as running, running.wire() as other:
            await other.result("events.subscribe", jobs="all")
            with deaf(running.path) as sock:
                assert (await other.event("cancelled"))["files"] == ["raw/s1.dng"]
                assert (await other.result("rig.status"))["connections"] == 1
                with contextlib.suppress(ConnectionResetError):
                    while sock.recv(2**20):
                        pass

    asyncio.run(scenario())


def test_a_client_that_does_not_read_does_not_hold_up_the_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        async with daemon(tmp_path) as running:
            with deaf(running.path):
                while not running.engine.shutter_open:
                    await asyncio.sleep(0.002)
                running.stop.set()
                before = asyncio.get_running_loop().time()
                while running.engine.calls[-1] != "stop":
                    await asyncio.sleep(0.01)
                assert asyncio.get_running_loop().time() - before < callers.STUCK_S

    asyncio.run(scenario())
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def test_a_full_queue_drops_progress_and_keeps_the_rest_in_order() -> None:
    async def scenario() -> None:
        writer = SlowWriter()
        client = Caller(1, ME, cast(asyncio.StreamWriter, writer))
        pump = asyncio.create_task(client.pump())
        client.send(b"first\n")
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert writer.lines == [b"first\n"]
        kept = []
        for k in range(QUEUE_LINES):
            if k % 4 == 0:
                kept.append(b"event %d\n" % k)
                client.send(kept[-1])
            else:
                client.send(b"progress %d\n" % k, droppable=True)
        client.send(b"progress too late\n", droppable=True)
        for k in range(100):
            kept.append(b"done %d\n" % k)
            client.send(kept[-1])
        writer.taken.set()
        client.finish()
        await pump
        assert not writer.aborted
        sent = writer.lines[1:]
        assert [line for line in sent if not line.startswith(b"progress")] == kept
        assert len(sent) == QUEUE_LINES
        assert b"progress too late\n" not in sent

    asyncio.run(scenario())


def test_a_queue_full_of_what_must_not_be_dropped_ends_the_client() -> None:
    async def scenario() -> None:
        writer = SlowWriter()
        client = Caller(1, ME, cast(asyncio.StreamWriter, writer))
        for _ in range(QUEUE_LINES):
            client.send(b"done\n")
        assert not writer.aborted
        client.send(b"done\n")
        assert writer.aborted
        await client.pump()
        assert writer.lines == []

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("peer", "permitted"),
    [
        (Peer(1, 1000, 1000, "own"), True),
        (Peer(1, 0, 0, "root"), True),
        (Peer(1, 1001, 1001, "listed"), True),
        (Peer(1, 1002, 4242, "of the group"), True),
        (Peer(1, 1002, 1002, "stranger"), False),
    ],
)
def test_who_may_use_the_rig(peer: Peer, permitted: bool) -> None:
    assert Access(frozenset({1000, 0, 1001}), group=4242).permits(peer) is permitted


def test_other_groups_of_a_user_count_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getgrouplist", lambda name, gid: [gid, 4242])
    someone = Peer(1, os.getuid(), 1, "me")
    assert Access(frozenset(), group=4242).permits(someone)
    assert not Access(frozenset(), group=4243).permits(someone)
    assert not Access(frozenset(), group=None).permits(someone)


@pytest.mark.parametrize(
    ("mode", "open_to_group"), [(0o600, False), (0o660, True), (0o666, True), (0o640, False)]
)
def test_the_mode_of_the_socket_decides_about_its_group(
    tmp_path: Path, mode: int, open_to_group: bool
) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(str(path))
        path.chmod(mode)
        access = Access.to(sock, ServerConfig(allow_uids=(77,)))
    assert access.uids == {0, 77, os.geteuid()}
    assert access.group == (path.stat().st_gid if open_to_group else None)


def test_an_abstract_socket_has_no_group() -> None:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(f"\0pdcd-test-{os.getpid()}")
        assert Access.to(sock, ServerConfig()).group is None


def test_the_kernel_tells_who_connected() -> None:
    left, right = socket.socketpair()
    with left, right:
        peer = peer_of(left)
    assert (peer.pid, peer.uid, peer.gid) == (os.getpid(), os.getuid(), os.getgid())


def test_a_user_who_is_not_permitted_is_told_so_and_gets_no_hello(tmp_path: Path) -> None:
    async def scenario() -> None:
        path = tmp_path / "s"
        sock = socket.socket(socket.AF_UNIX)
        sock.bind(str(path))
        sock.listen()
        server = Server(sock, Access(frozenset({os.getuid() + 1}), None), connections=2)
        await server.open(cast(Service, None))  # nothing of it is used
        reader, writer = await asyncio.open_unix_connection(str(path))
        wire = Wire(reader, writer)
        refusal: dict[str, Any] = await wire.receive()
        assert refusal["error"]["data"]["kind"] == "config"
        assert f"uid {os.getuid()}" in refusal["error"]["message"]
        assert "allow_uids" in refusal["error"]["data"]["hint"]
        assert await wire.ended()
        await wire.close()
        await server.close()

    asyncio.run(scenario())


def refused(path: Path) -> ConfigError:
    """The error of a daemon that cannot have this socket; its engine is never made."""

    def never(config: Config) -> FakeEngine:
        raise AssertionError("the engine was made before the socket was had")

    async def scenario() -> None:
        await serve(Config(), socket=path, engine_factory=never, stop=asyncio.Event())

    with pytest.raises(ConfigError) as caught:
        asyncio.run(scenario())
    assert caught.value.hint
    return caught.value


def test_a_stale_socket_is_replaced(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(str(tmp_path / "pdcd.sock"))
        sock.listen()

    async def scenario() -> None:
        async with daemon(tmp_path) as running, running.wire() as wire:
            await wire.result("ping")
            mode = running.path.stat().st_mode
            assert mode & 0o777 == 0o660

    asyncio.run(scenario())


def test_a_second_daemon_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as first:
        first.bind(str(path))
        first.listen()
        assert "another daemon" in refused(path).message
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))


def test_a_file_that_is_no_socket_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "precious"
    path.write_text("data")
    assert "no socket" in refused(path).message
    assert path.read_text() == "data"


def test_a_path_that_cannot_be_bound_is_named(tmp_path: Path) -> None:
    assert "missing" in refused(tmp_path / "missing" / "s").message
    assert "x" * 120 in refused(tmp_path / ("x" * 120)).message


def test_listed_users_can_reach_the_socket(tmp_path: Path) -> None:
    async def scenario() -> int:
        path = tmp_path / "s"
        stop = asyncio.Event()
        config = Config(server=ServerConfig(state_dir=str(tmp_path), allow_uids=(77,)))
        task = asyncio.create_task(serve(config, socket=path, engine_factory=FakeEngine, stop=stop))
        while not path.exists():
            await asyncio.sleep(0.002)
        mode = path.stat().st_mode & 0o777
        stop.set()
        await task
        return mode

    assert asyncio.run(scenario()) == 0o666
