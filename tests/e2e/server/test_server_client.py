"""The blocking client against a daemon, and against things that are none."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdcd.client import Client, Unreachable
from pdcd.errors import BusyError, ConfigError, DeviceLost, PdcdError, ProtocolError
from pdcd.request import CaptureRequest
from pdcd.runs.events import Event
from tests.e2e.server._server_harness import nothing_left, threaded_daemon

WHITE = CaptureRequest(goal="white")
SLOW = CaptureRequest(goal="white", note="slow")


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


def test_a_capture_with_its_events(tmp_path: Path) -> None:
    events: list[Event] = []
    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        assert client.hello.server == "pdcd"
        result = client.capture(WHITE, on_event=events.append)
        assert result.state == "done" and result.files == ("raw/s1.dng",)
        assert [e.seq for e in events] == list(range(len(events)))
        assert (events[0].type, events[-1].type) == ("queued", "done")
        assert {e.job for e in events} == {result.job}
        assert [job.job for job in client.list()] == [result.job]
        assert client.wait(result.job) == result
        assert client.cancel(result.job) == result
        assert client.status().state == "idle"
        assert client.plan(CaptureRequest(goal="indirect", codes=16)).codes == 16


def test_a_detached_capture_is_waited_for_from_elsewhere(tmp_path: Path) -> None:
    events: list[Event] = []
    with threaded_daemon(tmp_path) as running:
        with Client(running.path) as client:
            started = client.capture(SLOW, detach=True)
            assert started.state == "running"
            assert client.capture(WHITE, detach=True, queue=True).state == "queued"
        with Client(running.path) as client, Client(running.path) as other:
            timer = threading.Timer(0.1, other.cancel, [started.job])
            timer.start()
            assert client.wait(started.job, on_event=events.append).state == "cancelled"
            timer.join()
            assert {e.job for e in events} == {started.job}
            assert events[-1].type == "cancelled"


def test_errors_come_back_as_the_same_errors(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        with pytest.raises(ConfigError, match="codes") as config:
            client.call("capture.start", {"goal": "white", "codes": 0})
        assert config.value.hint
        with pytest.raises(ProtocolError, match="nonsense"):
            client.call("nonsense")
        with pytest.raises(ProtocolError, match="bytes"):
            client.call("ping", {"x": "y" * 2**20})
        with pytest.raises(PdcdError) as internal:
            client.call("preview.grab", {"x": 1})
        assert internal.value.kind == "config"
        client.capture(SLOW, detach=True)
        with pytest.raises(BusyError, match="holds the rig"):
            client.capture(WHITE)


def test_an_interrupt_cancels_the_capture_and_yields_its_result(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        seen: list[str] = []

        def interrupt(event: Event) -> None:
            seen.append(event.type)
            if event.type == "shutter_open":
                # As by Ctrl-C: delivered to the main thread, which is this one.
                os.kill(os.getpid(), signal.SIGINT)

        result = client.capture(SLOW, on_event=interrupt)
        assert result.state == "cancelled" and result.files == ("raw/s1.dng",)
        assert "shutter_closed" in seen
        assert client.status().state == "idle"


def test_events_come_until_the_connection_ends(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        client.call("events.subscribe", {"jobs": "all"})
        job = client.capture(WHITE, detach=True).job
        seen: list[tuple[str, str]] = []
        for event in client.events():
            seen.append((event.job, event.type))
            if event.type == "done":
                break
        assert seen[0] == (job, "queued") and seen[-1] == (job, "done")
        client.capture(SLOW, detach=True)
        for event in client.events():
            if event.type == "shutter_open":
                client._sock.shutdown(socket.SHUT_RDWR)


def test_nobody_there_is_unreachable(tmp_path: Path) -> None:
    with pytest.raises(Unreachable, match="pdcd serve"):
        Client(tmp_path / "nobody")
    assert issubclass(Unreachable, ConnectionError)


@pytest.mark.parametrize(
    ("said", "error"),
    [
        (b"", Unreachable),
        (b"SSH-2.0-OpenSSH\n", ProtocolError),
        (b'{"jsonrpc":"2.0","method":"welcome","params":{}}\n', ProtocolError),
        (b'{"jsonrpc":"2.0","method":"hello","params":{"protocol":[2,0]}}\n', ProtocolError),
        (
            b'{"jsonrpc":"2.0","id":null,"error":{"code":-32001,"message":"full",'
            b'"data":{"kind":"busy","device":null,"hint":null}}}\n',
            BusyError,
        ),
        (b'{"error":{"message":"m","data":{"kind":"device_lost"}}}\n', DeviceLost),
        (b'{"error":{"message":"m","data":{"kind":"of the future"}}}\n', PdcdError),
    ],
)
def test_a_server_that_is_not_ours_is_told_apart(
    tmp_path: Path, said: bytes, error: type[Exception]
) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def answer() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.sendall(said)

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(error):
            Client(path)
        thread.join()


def test_a_silent_server_is_given_up(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        with pytest.raises(Unreachable, match=r"0\.1 s"):
            Client(path, timeout_s=0.1)
