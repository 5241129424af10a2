"""The daemon as a process: signals, exit codes, readiness, watchdog, passed sockets."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.tables import Config, ServerConfig
from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.protocol.messages import METHODS
from pdcd.protocol.request import CaptureRequest
from pdcd.server.daemon import serve_daemon
from tests.e2e.server._fake_engine import FakeEngine
from tests.e2e.server._server_harness import PATIENCE_S, Wire
from tests.places import ROOT
from tests.processes import soon
from tests.real_daemon import connect
from tests.tools import needs, program

pytestmark = pytest.mark.whole

SLOW = CaptureRequest(goal="white", note="slow")


class Manager:
    """A service manager that listens for notifications."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.sock.bind(self.address)
        self.sock.settimeout(PATIENCE_S)

    def next(self) -> list[str]:
        """The lines of the next notification."""
        return self.sock.recv(4096).decode().splitlines()

    def until(self, line: str) -> list[str]:
        """All lines up to and with this one."""
        heard: list[str] = []
        while line not in heard:
            heard += self.next()
        return heard

    def waiting(self) -> list[str]:
        """All lines that have come in, without waiting."""
        heard: list[str] = []
        self.sock.setblocking(False)
        try:
            while True:
                heard += self.next()
        except BlockingIOError:
            self.sock.settimeout(PATIENCE_S)
            return heard


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    made = Manager(tmp_path)
    yield made
    made.sock.close()


@contextmanager
def process(*words: str, manager: Manager | None = None) -> Iterator[subprocess.Popen[str]]:
    """A command whose stdout is read in the end; killed if the test fails."""
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    if manager is not None:
        environ["NOTIFY_SOCKET"] = manager.address
    with subprocess.Popen(
        words,
        cwd=ROOT,
        env=environ,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as child:
        try:
            yield child
        finally:
            if child.poll() is None:
                child.kill()


def fake_daemon(folder: Path, *more: str) -> list[str]:
    """The command of a daemon with a fake engine; its socket is `folder/s`."""
    words = ["-m", "tests.e2e.server._fake_engine", "--state-dir", str(folder), *more]
    return [sys.executable, *words]


def end(child: subprocess.Popen[str], number: int) -> list[dict[str, Any]]:
    """Send a signal, expect a clean exit, and return what the engines went through."""
    child.send_signal(number)
    out, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0, err
    told: list[dict[str, Any]] = json.loads(out)
    return told


def test_a_signal_in_mid_exposure_closes_the_shutter_and_exits_0(
    tmp_path: Path, manager: Manager
) -> None:
    """SIGTERM; SIGINT is the first of those that come again."""
    path = tmp_path / "s"
    command = fake_daemon(tmp_path, "--socket", str(path))
    with process(*command, manager=manager) as child:
        heard = manager.until("READY=1")
        assert heard[0] == "STATUS=starting the rig"
        with Client(path) as client:
            client.call("events.subscribe", {"jobs": "all"})
            job = client.capture(SLOW, detach=True).job
            events = client.events()
            assert any(event.type == "shutter_open" for event in events)
            manager.until(f"STATUS=capture {job} shutter_open")
            (told,) = end(child, signal.SIGTERM)
            *_, last = events
        assert last.type == "cancelled" and last.job == job
        heard = manager.waiting()
        assert "STOPPING=1" in heard and f"STATUS=idle, last capture {job} cancelled" in heard
        assert told["calls"] == ["start", "describe", "capture", "closed", "stop"]
        assert told["shutter_open"] is False
        assert not path.exists()


def test_signals_that_come_again_change_nothing(tmp_path: Path, manager: Manager) -> None:
    path = tmp_path / "s"
    with process(*fake_daemon(tmp_path, "--socket", str(path)), manager=manager) as child:
        manager.until("READY=1")
        with Client(path) as client:
            client.capture(SLOW, detach=True)
            for _ in range(30):  # spread over its end, which the first of them begins
                child.send_signal(signal.SIGINT)
                time.sleep(0.005)
            (told,) = end(child, signal.SIGTERM)
        assert told["calls"][-2:] == ["closed", "stop"]


def test_exit_codes_tell_a_taken_socket_from_a_broken_rig(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(path))
        other.listen()
        with process(*fake_daemon(tmp_path, "--socket", str(path))) as child:
            out, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 2 and "another daemon" in err
    assert out == "[]\n"
    path.unlink()
    with process(*fake_daemon(tmp_path, "--socket", str(path), "--rig", "broken")) as child:
        out, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 5 and "camera: no such camera (switch it on)" in err
    assert json.loads(out)[0]["calls"] == ["start", "stop"]
    assert not path.exists()


@needs("systemd-socket-activate")
def test_a_passed_socket_is_served_and_left_in_place(tmp_path: Path) -> None:
    path = tmp_path / "s"
    activate = program("systemd-socket-activate")
    command = [activate, "-l", str(path), *fake_daemon(tmp_path)]
    with process(*command) as child:
        # The first connection starts the daemon and waits in the backlog meanwhile. The file is
        # there a moment before that can be.
        with connect(path, timeout_s=PATIENCE_S) as client:
            assert client.capture(CaptureRequest(goal="white")).state == "done"
        (told,) = end(child, signal.SIGTERM)
    assert told["calls"] == ["start", "describe", "capture", "closed", "stop"]
    assert path.exists()


def test_nobody_forges_a_line_of_the_journal(tmp_path: Path) -> None:
    """Whatever a client says, in any place of any request, each line of the log is the daemon's."""
    forged = "x\n<3>pdcd.server.daemon: stopped\r\x1b[2J\x9b31m\u2028\x7f"
    path = tmp_path / f"s{forged[:2]}<3>pdcd: fit"
    log = tmp_path / "log"
    log.touch()
    found = log.stat()
    environ = {**os.environ, "JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
    command = fake_daemon(tmp_path / forged.replace("/", ""), "--socket", str(path))
    with (
        log.open("w") as stderr,
        subprocess.Popen(
            command, cwd=ROOT, env=environ, stdout=subprocess.DEVNULL, stderr=stderr
        ) as child,
    ):
        try:
            assert soon(path.exists)
            with Client(path, timeout_s=PATIENCE_S) as client:
                for method in [*METHODS, forged]:
                    for params in hostile(forged):
                        with contextlib.suppress(PdcdError):
                            client.call(method, params)
                with pytest.raises(PdcdError):
                    client.call(forged, {forged: forged})
                escaped = forged.encode("unicode_escape").decode()
                client.capture(CaptureRequest(goal="white", note=f"fail:{escaped}"), queue=True)
                client._sock.sendall(forged.encode() + b"\n")
            child.terminate()
            assert child.wait(PATIENCE_S) == 0
        finally:
            child.kill()
    lines = log.read_text(encoding="utf-8").split("\n")
    assert lines.pop() == "" and len(lines) > 50
    for line in lines:
        assert line.isprintable() and re.match(r"<[346]>(pdcd\.[a-z.]+: |  )", line), line
    assert sum("stopped" in line for line in lines if line.startswith("<6>")) > 1
    assert [line for line in lines if line.startswith("<3>pdcd.server.daemon")] == []


def hostile(text: str) -> Iterator[dict[str, Any]]:
    """Parameters with that text in every field there is, one at a time and under its name."""
    yield {text: text}
    yield {"job": text[:64]}
    yield {"jobs": text}
    yield {"pattern": text}
    for field in ("goal", "out", "note", "illumination", "kernel", "prior"):
        yield {"goal": "white", field: text}


def serve_here(
    folder: Path, engine: FakeEngine, body: Callable[[Wire], Any], *, greet: bool = True
) -> None:
    """Serve in this thread's loop while `body` talks to it."""

    async def scenario() -> None:
        path = folder / "s"
        stop = asyncio.Event()
        config = Config(server=ServerConfig(state_dir=str(folder)))
        task = asyncio.create_task(
            serve_daemon(config, socket=path, engine_factory=lambda _: engine, stop=stop)
        )
        while not path.exists():
            await asyncio.sleep(0.002)
        wire = Wire(*await asyncio.open_unix_connection(str(path)))
        try:
            if greet:
                wire.hello = await wire.receive()
            await body(wire)
        finally:
            stop.set()
            await task
            await wire.close()

    asyncio.run(scenario())


def test_ready_is_said_when_the_rig_has_started_and_not_before(
    tmp_path: Path, manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
    gate = threading.Event()

    class Slow(FakeEngine):
        def start(self) -> None:
            gate.wait(PATIENCE_S)
            super().start()

    engine = Slow(Config())

    async def body(wire: Wire) -> None:
        await asyncio.sleep(0.1)
        assert manager.waiting() == ["STATUS=starting the rig"]
        assert engine.calls == []
        gate.set()
        wire.hello = await wire.receive()
        assert manager.waiting() == ["READY=1", "STATUS=idle"]
        assert engine.calls[0] == "start"

    serve_here(tmp_path, engine, body, greet=False)
    assert manager.waiting() == ["STOPPING=1", "STATUS=stopping"]


@pytest.fixture
def watched(manager: Manager, monkeypatch: pytest.MonkeyPatch) -> Manager:
    """A manager that wants a sign of life every 0.15 s, and so is sent one every 0.05 s."""
    monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
    monkeypatch.setenv("WATCHDOG_USEC", "150000")
    return manager


def start(note: str) -> bytes:
    params = {"goal": "white", "note": note, "detach": True}
    request = {"jsonrpc": "2.0", "id": 1, "method": "capture.start", "params": params}
    return json.dumps(request).encode()


def test_the_watchdog_is_fed_idle_and_in_a_capture(tmp_path: Path, watched: Manager) -> None:
    async def body(wire: Wire) -> None:
        await asyncio.sleep(0.3)
        assert "WATCHDOG=1" in watched.waiting()
        await wire.send(start("slow"))
        await asyncio.sleep(0.1)
        watched.waiting()
        await asyncio.sleep(0.3)
        assert "WATCHDOG=1" in watched.waiting()

    serve_here(tmp_path, FakeEngine(Config()), body)


def test_the_watchdog_starves_while_the_engines_thread_is_frozen(
    tmp_path: Path, watched: Manager
) -> None:
    async def body(wire: Wire) -> None:
        await wire.send(start("freeze:1.0"))
        await asyncio.sleep(0.4)
        watched.waiting()
        await asyncio.sleep(0.3)
        assert watched.waiting() == []
        await asyncio.sleep(0.7)
        assert "WATCHDOG=1" in watched.waiting()

    serve_here(tmp_path, FakeEngine(Config()), body)
