"""Calibrations over the socket: asked for, attended, cancelled."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest

from pdcd.client import Client
from pdcd.protocol.events import Attention, Event
from pdcd.protocol.messages import PROTOCOL, ClockAnchor, Hello
from pdcd.protocol.request import CalibrateRequest
from pdcd.words import StepName
from tests.e2e.server._server_harness import Daemon, Wire, served, threaded_daemon
from tests.e2e.server._users import ANNA, BERT, Users
from tests.e2e.server.test_server_client import scripted
from tests.e2e.server.test_server_places import OPEN


def test_it_waits_for_somebody_and_goes_on_when_told(tmp_path: Path) -> None:
    asked: list[str] = []
    heard: list[Event] = []
    request = CalibrateRequest(steps=("light", "geometry"), attended=True)
    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        result = client.calibrate(request, on_event=heard.append, answer=asked.append)
        (view,) = client.list()
    assert result.state == "done" and asked == ["put up the card"] * 2
    assert (view.kind, view.goal) == ("calibrate", "light geometry")
    told = [event.type for event in heard]
    assert told == ["queued", *["step_begun", "attention", "step_ended"] * 2, "done"]


ATTENTION = msgspec.to_builtins(
    Attention(job="a", seq=1, text="put up the card", now=None, best=None)
)


def told(peer: socket.socket, *lines: dict[str, Any]) -> None:
    peer.sendall(
        b"".join(json.dumps({"jsonrpc": "2.0", **line}).encode() + b"\n" for line in lines)
    )


def test_events_before_the_answer_that_names_the_job_are_heard(tmp_path: Path) -> None:
    asked: list[str] = []
    heard: list[Event] = []
    methods: list[tuple[str, Any]] = []

    def serve(peer: socket.socket) -> None:
        clock = ClockAnchor(0, "2026-01-01T00:00:00Z")
        hello = Hello(
            server="pdcd", version="0", protocol=PROTOCOL, max_line=2**20, drivers={},
            state="idle", clock=clock,
        )  # fmt: skip
        told(peer, {"method": "hello", "params": msgspec.to_builtins(hello)})
        with peer, peer.makefile("rb") as lines:
            for line in lines:
                asks = json.loads(line)
                methods.append((asks["method"], asks["params"].get("job")))
                answer = {"id": asks["id"], "result": {"job": "a", "state": "queued"}}
                if asks["method"] == "calibrate.start":
                    told(peer, {"method": "event", "params": ATTENTION}, answer)
                elif asks["method"] != "calibrate.proceed":
                    told(peer, answer)

    with scripted(tmp_path / "s", serve) as path, Client(path) as client:
        request = CalibrateRequest(steps=("light",), attended=True)
        assert client.calibrate(request, on_event=heard.append, answer=asked.append).job == "a"
    assert asked == ["put up the card"] and [event.type for event in heard] == ["attention"]
    assert methods[1:] == [
        ("calibrate.start", None), ("calibrate.proceed", "a"), ("capture.wait", "a"),
    ]  # fmt: skip


@served
async def test_while_it_waits_it_can_be_cancelled_and_others_wait(wire: Wire, other: Wire) -> None:
    await wire.result("events.subscribe", jobs="own")
    job = (await wire.result("calibrate.start", steps=["light"], attended=True))["job"]
    await wire.event("attention", job)
    refused = await other.error("capture.start", goal="white")
    assert refused["data"]["kind"] == "busy" and "(calibrate)" in refused["message"]
    await other.result("ping")
    assert (await wire.result("capture.cancel", job=job))["state"] == "cancelled"


@served(server=OPEN)
async def test_only_its_owner_says_that_it_may_go_on(
    running: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    users = Users(monkeypatch)

    users.become(ANNA)
    async with running.wire() as hers:
        await hers.result("events.subscribe", jobs="own")
        job = (await hers.result("calibrate.start", steps=["light"], attended=True))["job"]
        await hers.event("attention", job)
        users.become(BERT)
        async with running.wire() as his:
            refused = await his.error("calibrate.proceed", job=job)
            assert refused["data"]["kind"] == "denied"
        await hers.result("calibrate.proceed", job=job)
        assert (await hers.result("capture.wait", job=job))["state"] == "done"


@served
async def test_no_calibration_is_too_long_to_be_told_of(wire: Wire) -> None:
    """Of a job that names a step a hundred thousand times everybody would be told, as long as it is
    remembered: the answers would be longer than a line."""

    refused = await wire.error("calibrate.start", steps=["registration"] * 60_000)
    assert refused["data"]["kind"] == "request"
    assert "steps: it takes up to 10 words" in refused["message"]
    every = list(get_args(StepName))
    await wire.result("calibrate.start", steps=every, detach=True)
    told = (await wire.result("capture.list"))["jobs"]
    assert [job["goal"] for job in told] == [" ".join(every)]
