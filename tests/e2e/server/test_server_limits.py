"""Too many, too slow, not allowed, already there: how the socket defends the rig."""

from __future__ import annotations

import asyncio
import contextlib
import grp
import socket
import threading
from pathlib import Path

import pytest

from pdcd.bench.tables import Config, RoleConfig, ServerConfig
from pdcd.errors import ConfigError
from pdcd.server import callers
from pdcd.server import daemon as server_daemon
from pdcd.server.daemon import serve_daemon
from pdcd.server.reading import OPEN_REQUESTS
from tests.e2e.server._fake_engine import FakeEngine
from tests.e2e.server._server_harness import Daemon, Wire, served


def deaf(path: Path) -> socket.socket:
    """A client that starts a capture, asks for more than the sockets hold, and never reads."""
    sock = socket.socket(socket.AF_UNIX)
    sock.connect(str(path))
    start = (
        b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":{"goal":"white","note":"slow"}}'
    )
    sock.sendall(start + b"\n" + b'{"jsonrpc":"2.0","id":1,"method":"rig.describe"}\n' * 1000)
    return sock


@served
async def test_a_client_that_does_not_read_is_cut_off_with_its_capture(
    running: Daemon, other: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(callers, "STUCK_S", 0.2)

    await other.result("events.subscribe", jobs="all")
    with deaf(running.path) as sock:
        assert (await other.event("cancelled"))["files"] == ["raw/s1.dng"]
        assert (await other.result("rig.status"))["connections"] == 1
        with contextlib.suppress(ConnectionResetError):
            while sock.recv(2**20):
                pass


@served
async def test_a_client_that_does_not_read_does_not_hold_up_the_end(
    running: Daemon, caplog: pytest.LogCaptureFixture
) -> None:
    with deaf(running.path):
        while not running.engine.shutter_open:
            await asyncio.sleep(0.002)
        running.stop.set()
        before = asyncio.get_running_loop().time()
        while running.engine.calls[-1] != "stop":
            await asyncio.sleep(0.01)
        assert asyncio.get_running_loop().time() - before < callers.STUCK_S
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


@served
async def test_who_asks_too_much_at_a_time_is_told_so(running: Daemon, wire: Wire) -> None:
    job = (await wire.result("capture.start", goal="white", note="slow"))["job"]
    for number in range(OPEN_REQUESTS + 1):
        asks = {"jsonrpc": "2.0", "id": number, "method": "capture.wait", "params": {"job": job}}
        await wire.send(asks)
    error = (await wire.answer(OPEN_REQUESTS))["error"]
    assert error["data"]["kind"] == "busy" and "64 requests" in error["message"]
    async with running.wire() as other:
        await other.result("capture.cancel", job=job)
    for number in range(OPEN_REQUESTS):
        assert (await wire.answer(number))["result"]["state"] == "cancelled"


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
