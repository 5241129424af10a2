"""Too many, too slow, not allowed, already there: how the socket defends the rig."""

from __future__ import annotations

import asyncio
import contextlib
import grp
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest

from pdcd.bench.tables import Config, RoleConfig, ServerConfig
from pdcd.errors import ConfigError
from pdcd.protocol.views import ClientRole
from pdcd.server import callers
from pdcd.server import daemon as server_daemon
from pdcd.server.access import Peer
from pdcd.server.callers import QUEUE_LINES, Caller
from pdcd.server.daemon import serve_daemon
from pdcd.server.stream import Stream
from tests.e2e.server._fake_engine import FakeEngine
from tests.e2e.server._server_harness import daemon, nothing_left

ME = Peer(os.getpid(), os.getuid(), os.getgid(), "me")


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


class SlowStream:
    """Stands for a stream whose reader takes one line each time `taken` is set."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.taken = asyncio.Event()
        self.is_cut = False

    async def send(self, line: bytes) -> None:
        self.lines.append(line)
        await self.taken.wait()

    def cut(self) -> None:
        self.is_cut = True


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
        stream = SlowStream()
        client = Caller(1, ME, ClientRole.SHOOT, cast(Stream, stream))
        pump = asyncio.create_task(client.pump())
        client.send(b"first\n")
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert stream.lines == [b"first\n"]
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
        stream.taken.set()
        client.finish()
        await pump
        assert not stream.is_cut
        sent = stream.lines[1:]
        assert [line for line in sent if not line.startswith(b"progress")] == kept
        assert len(sent) == QUEUE_LINES
        assert b"progress too late\n" not in sent

    asyncio.run(scenario())


def test_a_queue_full_of_what_must_not_be_dropped_ends_the_client() -> None:
    async def scenario() -> None:
        stream = SlowStream()
        client = Caller(1, ME, ClientRole.SHOOT, cast(Stream, stream))
        for _ in range(QUEUE_LINES):
            client.send(b"done\n")
        assert not stream.is_cut
        client.send(b"done\n")
        assert stream.is_cut
        await client.pump()
        assert stream.lines == []

    asyncio.run(scenario())


def refused(path: Path) -> ConfigError:
    """The error of a daemon that cannot have this socket; its engine is never made."""

    def never(config: Config) -> FakeEngine:
        raise AssertionError("the engine was made before the socket was had")

    async def scenario() -> None:
        await serve_daemon(Config(), socket=path, engine_factory=never, stop=asyncio.Event())

    with pytest.raises(ConfigError) as caught:
        asyncio.run(scenario())
    assert caught.value.hint
    return caught.value


def test_groups_that_cannot_be_looked_up_end_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = threading.Event()
    monkeypatch.setattr(grp, "getgrnam", lambda name: gate.wait(20.0))
    monkeypatch.setattr(server_daemon, "GROUPS_S", 0.1)
    tables = ServerConfig(state_dir=str(tmp_path), look=RoleConfig(groups=("far away",)))
    before = set(threading.enumerate())

    async def scenario() -> None:
        path, stop = tmp_path / "s", asyncio.Event()
        await serve_daemon(Config(server=tables), socket=path, engine_factory=FakeEngine, stop=stop)

    with pytest.raises(ConfigError, match="could not be looked up"):
        asyncio.run(scenario())
    gate.set()
    for thread in set(threading.enumerate()) - before:
        thread.join(20.0)


def test_a_state_folder_that_cannot_be_made_ends_the_start(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    tables = ServerConfig(state_dir=str(tmp_path / "file" / "state"))

    async def scenario() -> None:
        path, stop = tmp_path / "s", asyncio.Event()
        await serve_daemon(Config(server=tables), socket=path, engine_factory=FakeEngine, stop=stop)

    with pytest.raises(ConfigError, match="state folder"):
        asyncio.run(scenario())
    assert not (tmp_path / "s").exists()


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
        task = asyncio.create_task(
            serve_daemon(config, socket=path, engine_factory=FakeEngine, stop=stop)
        )
        while not path.exists():
            await asyncio.sleep(0.002)
        mode = path.stat().st_mode & 0o777
        stop.set()
        await task
        return mode

    assert asyncio.run(scenario()) == 0o666
