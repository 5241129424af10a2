"""The blocking client against a daemon, and against things that are none."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pdcd.client import Client
from pdcd.errors import BusyError, DeviceLost, PdcdError, ProtocolError, RequestError
from pdcd.protocol.events import Event
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.messages import MAX_LINE, PROTOCOL
from pdcd.protocol.request import CaptureRequest
from tests.e2e.server._server_harness import threaded_daemon

WHITE = CaptureRequest(goal="white")
SLOW = CaptureRequest(goal="white", note="slow")


@contextmanager
def scripted(path: Path, serve: Callable[[socket.socket], None]) -> Iterator[Path]:
    """A socket where `serve` talks to the one client that comes, in a thread."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        thread = threading.Thread(target=lambda: serve(listener.accept()[0]))
        thread.start()
        try:
            yield path
        finally:
            thread.join(10.0)


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
        with pytest.raises(RequestError, match="codes") as config:
            client.call("capture.start", {"goal": "white", "codes": 0})
        assert config.value.hint
        with pytest.raises(ProtocolError, match="nonsense"):
            client.call("nonsense")
        with pytest.raises(ProtocolError, match="bytes"):
            client.call("ping", {"x": "y" * 2**20})
        with pytest.raises(RequestError, match=r"capture.wait: 'b\\udcff' is not UTF-8"):
            client.wait(os.fsdecode(b"b\xff"))  # as the command line has bytes of another encoding
        with pytest.raises(PdcdError) as internal:
            client.call("preview.grab", {"x": 1})
        assert internal.value.kind == "request"
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


@pytest.mark.parametrize("drawn_out", [False, True])
def test_an_interrupt_before_the_answer_that_names_the_job_cancels_it_too(
    tmp_path: Path, drawn_out: bool
) -> None:
    """The shutter may open before the answer to capture.start is out; a device may take long to be
    made safe, and then the end is waited for."""
    asked: list[tuple[str, Any]] = []

    def serve(connection: socket.socket) -> None:
        clock = {"mono_ns": 0, "utc": ""}
        hello = {"server": "pdcd", "version": "0", "protocol": PROTOCOL, "max_line": MAX_LINE}
        hello |= {"drivers": {}, "state": "idle", "clock": clock}
        event = {"job": "j", "seq": 0, "type": "shutter_open", "t_mono_ns": 1, "shot": "s1"}
        answers: dict[str, Any] = {
            "events.subscribe": {},
            "capture.start": {"job": "j", "state": "running"},
            "capture.cancel": {"job": "j", "state": "running" if drawn_out else "cancelled"},
            "capture.wait": {"job": "j", "state": "cancelled"},
        }
        with connection, connection.makefile("rwb") as lines:

            def say(**message: Any) -> None:
                lines.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")
                lines.flush()

            say(method="hello", params=hello)
            for line in lines:
                request = json.loads(line)
                asked.append((request["method"], request["params"].get("job")))
                if request["method"] == "capture.start":
                    say(method="event", params=event)
                say(id=request["id"], result=answers[request["method"]])

    def interrupt(_: Event) -> None:
        raise KeyboardInterrupt

    with scripted(tmp_path / "s", serve) as path, Client(path) as client:
        assert client.capture(WHITE, on_event=interrupt).state == "cancelled"
    assert asked == [
        ("events.subscribe", None),
        ("capture.start", None),
        ("capture.cancel", "j"),
        *[("capture.wait", "j")] * drawn_out,
    ]


@pytest.mark.parametrize("at", ["queued", "armed", "progress"])
def test_a_listener_that_raises_ends_its_job_first(tmp_path: Path, at: str) -> None:
    def listen(event: Event) -> None:
        if event.type == at:
            raise ZeroDivisionError("of the listener")

    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        slow = CaptureRequest(goal="indirect", codes=8, note="slow")
        with pytest.raises(ZeroDivisionError, match="of the listener"):
            client.capture(slow, on_event=listen)
        assert not running.engine.shutter_open
        assert [job.state for job in client.list()] == ["cancelled"]
        assert client.capture(WHITE).state == "done"


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
    with pytest.raises(UnreachableError, match="pdcd serve"):
        Client(tmp_path / "nobody")
    assert issubclass(UnreachableError, ConnectionError)


@pytest.mark.parametrize(
    ("said", "error"),
    [
        (b"", UnreachableError),
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
    def serve(connection: socket.socket) -> None:
        with connection:
            connection.sendall(said)

    with scripted(tmp_path / "s", serve) as path, pytest.raises(error):
        Client(path)


def test_a_silent_server_is_given_up(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        with pytest.raises(UnreachableError, match=r"0\.1 s"):
            Client(path, timeout_s=0.1)
