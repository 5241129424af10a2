"""Every type of event once, from a real daemon to a client; and the recorder that hears them."""

from __future__ import annotations

import json
import socket
import threading
from pathlib import Path

import msgspec
import pytest

from pdcd.bench.tables import CameraConfig, DisplayConfig, FaultsConfig, RigConfig
from pdcd.client import Client
from pdcd.errors import ProtocolError
from pdcd.protocol.events import (
    ENDS,
    THINNED,
    TYPES,
    Event,
    JobQueued,
    UnknownEvent,
    decode_event,
    encode_event,
)
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.runs.folder import read_manifest
from tests.heard import Heard
from tests.real_daemon import connect, daemon, wait_for_codes

REQUESTS = {
    # The very first exposure is spoilt, hence discarded.
    "converging": CaptureRequest(goal="indirect", codes=64, parts=4, until_error=0.9, white=False),
    "learning": CaptureRequest(goal="indirect", codes=64, pilot=8),
    "failed": CaptureRequest(goal="illuminated", illumination=((1.0,),)),
}


@pytest.mark.whole
def test_every_type_of_the_schema_is_heard_and_no_other(tmp_path: Path, heard: Heard) -> None:
    faults = DisplayConfig(faults=FaultsConfig(dropped=(4,), exposures=2))
    events: list[Event] = []
    camera = CameraConfig(noise="none")  # its lens can be set
    with (
        daemon(tmp_path, grid=(8, 8), display=faults, camera=camera) as (process, path),
        connect(path) as client,
    ):
        schema = client.call("rig.describe")["schema"]
        named = set(schema["notifications"]["event"]["discriminator"]["mapping"])
        for name, request in REQUESTS.items():
            result = client.capture(request, on_event=events.append)
            assert result.state == ("failed" if name == "failed" else "done"), result.error
            folder = Path(str(result.folder))
            if name == "converging":
                assert read_manifest(folder).job == result.job
                lines = (folder / "log.jsonl").read_text().splitlines()
                logged = [json.loads(line) for line in lines]
        asked: list[str] = []
        calibration = CalibrateRequest(steps=("timing",), attended=True)
        measured = client.calibrate(calibration, on_event=events.append, answer=asked.append)
        assert measured.error is not None and measured.error["kind"] == "calibration"
        assert len(asked) == 1 and "card" in asked[0]
        process.terminate()
    with daemon(tmp_path, rig=RigConfig(clock="real")) as (process, path), connect(path) as client:
        job = wait_for_codes(client)
        assert client.cancel(job).state == "cancelled"
        process.terminate()
    assert named == set(TYPES) == set(heard.types)
    assert not any(isinstance(event, UnknownEvent) for event in events)

    (first,) = {event.job for event in events[:1]}
    own = [event for event in events if event.job == first]
    assert isinstance(own[0], JobQueued) and isinstance(own[-1], ENDS)
    assert [event.seq for event in own] == list(range(len(own)))
    kept = [event for event in own[1:-1] if not isinstance(event, THINNED)]
    assert [line["event"] for line in logged] == [event.type for event in kept]
    for line, event in zip(logged, kept, strict=True):
        told = encode_event(event)
        assert {**told, **line, "t_mono_ns": 0, "event": 0} == {**told, "t_mono_ns": 0, "event": 0}


@pytest.mark.parametrize("kind", TYPES)
def test_what_was_sent_is_what_is_read(kind: str) -> None:
    words = {"goal": "white", "cause": "late", "name": "x-1", "shot": "x", "stage": "codes"}
    words |= {"step": "light", "text": "do it", "verdict": "good"}
    fields: dict[str, object] = {**words, "rms_sigma": None, "figures": [], "advice": []}
    counted = "ahead photos frames frame missed part target shots done number steps seconds"
    numbers = dict.fromkeys(counted.split(), 1)
    wanted = set(TYPES[kind].__struct_fields__)
    given = {k: v for k, v in {**fields, **numbers, "total": 2}.items() if k in wanted}
    event = decode_event(
        {"job": "j", "seq": 3, "type": kind, "t_mono_ns": 5, **given, "of 2040": [1]}
    )
    assert (event.job, event.seq, event.type, event.t_mono_ns) == ("j", 3, kind, 5)
    assert decode_event(json.loads(msgspec.json.encode(event))) == event
    assert list(encode_event(event))[:4] == ["job", "seq", "type", "t_mono_ns"]
    assert json.loads(json.dumps(encode_event(event))) == json.loads(msgspec.json.encode(event))


def answer_with(path: Path, events: list[dict[str, object]]) -> threading.Thread:
    """A daemon of the future: says hello, answers one request, tells these events."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    hello = {
        "server": "pdcd", "version": "9", "protocol": [1, 7], "max_line": 1, "drivers": {},
        "state": "idle", "clock": {"mono_ns": 1, "utc": ""}, "mood": "sunny",
    }  # fmt: skip

    def answer() -> None:
        with listener, listener.accept()[0] as connection:
            lines: list[object] = [{"method": "hello", "params": hello}]
            lines += [{"id": 1, "result": {"jobs": "all"}}]
            lines += [{"method": "event", "params": event} for event in events]
            connection.sendall(b"".join(msgspec.json.encode(line) + b"\n" for line in lines))
            while connection.recv(4096):
                pass

    thread = threading.Thread(target=answer)
    thread.start()
    return thread


def test_a_client_bears_what_it_does_not_know(tmp_path: Path, heard: Heard) -> None:
    """And the recorder does not: it speaks of this version."""
    common = {"job": "j", "seq": 0, "t_mono_ns": 1}
    told: list[dict[str, object]] = [
        {**common, "type": "focussed", "shot": "coded", "sharpness": [1, {"of": 2}]},
        {**common, "type": "learning", "photos": 8, "mood": "sunny"},
    ]
    thread = answer_with(tmp_path / "s", told)
    with Client(tmp_path / "s") as client:
        events = client.events()
        new, known = next(events), next(events)
    thread.join()
    assert isinstance(new, UnknownEvent) and new.type == "focussed"
    assert encode_event(new) == told[0]
    assert known == TYPES["learning"](job="j", seq=0, t_mono_ns=1, photos=8)  # type: ignore[call-arg]
    assert client.hello.protocol == (1, 7)
    assert len(heard.faults) == 2
    assert "focussed is not in the schema" in heard.faults[0] and "mood" in heard.faults[1]
    heard.faults.clear()


def test_an_event_that_breaks_the_schema_is_told_apart(tmp_path: Path, heard: Heard) -> None:
    thread = answer_with(tmp_path / "s", [{"job": "j", "type": "learning", "photos": "many"}])
    with Client(tmp_path / "s") as client, pytest.raises(ProtocolError, match="photos"):
        next(client.events())
    thread.join()
    assert any("photos" in fault for fault in heard.faults)
    heard.faults.clear()
