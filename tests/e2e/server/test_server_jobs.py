"""The life of a capture as clients see it: busy, queue, cancel, a client that leaves, events."""

from __future__ import annotations

import asyncio
import os
import pwd
import threading
from itertools import pairwise
from typing import Any

import pytest

from pdcd.protocol.events import Emit, Progress
from pdcd.protocol.views import OwnerView
from tests.e2e.server._server_harness import PATIENCE_S, Daemon, Wire, served


async def begin(wire: Wire, **params: object) -> str:
    """Start a capture; returns its job."""
    job: str = (await wire.result("capture.start", **{"goal": "white", **params}))["job"]
    return job


async def until_open(running: Daemon) -> None:
    while not running.engine.shutter_open:
        await asyncio.sleep(0.002)


async def states(wire: Wire) -> list[str]:
    return [job["state"] for job in (await wire.result("capture.list"))["jobs"]]


@served
async def test_a_capture_from_start_to_result(running: Daemon, wire: Wire) -> None:
    await wire.result("events.subscribe", jobs="own")
    job = await begin(wire, codes=8)
    result = await wire.result("capture.wait", job=job)
    assert result["state"] == "done" and result["files"] == ["raw/s1.dng"]
    assert [event["type"] for event in wire.events if event["type"] != "progress"] == [
        *("queued", "armed", "shutter_open", "shutter_closed", "done"),
    ]
    assert [event["seq"] for event in wire.events] == list(range(len(wire.events)))
    assert all(a["t_mono_ns"] <= b["t_mono_ns"] for a, b in pairwise(wire.events))
    last = wire.events[-1]
    assert {key: last[key] for key in result} == result
    progress = [event for event in wire.events if event["type"] == "progress"]
    assert progress[-1]["frame"] == progress[-1]["frames"] == 20
    assert await wire.result("capture.wait", job=job) == result
    me = pwd.getpwuid(os.getuid()).pw_name
    owner = OwnerView(uid=os.getuid(), pid=os.getpid(), user=me)
    assert running.engine.owners == [owner]


@served
async def test_a_second_capture_is_refused_while_the_rig_is_busy(
    running: Daemon, wire: Wire, other: Wire
) -> None:
    # `rig.describe` above cannot have waited for the capture, which only ends with its client.
    job = await begin(wire, note="slow")
    for method, params in (
        ("capture.start", {"goal": "white"}),
        ("capture.plan", {"goal": "white"}),
        ("display.show", {"pattern": "white"}),
        ("preview.grab", {}),
    ):
        error = await other.error(method, **params)
        assert error["data"]["kind"] == "busy", method
        assert job in error["message"] and f"uid {os.getuid()}" in error["message"]
    status = await other.result("rig.status")
    assert status["state"] == "busy" and status["running"]["job"] == job
    assert (await other.result("rig.describe"))["schema"]["kinds"]


@served
async def test_queued_captures_run_one_after_the_other(running: Daemon, wire: Wire) -> None:
    await wire.result("events.subscribe", jobs="all")
    jobs = [await begin(wire, queue=True) for _ in range(3)]
    results = [await wire.result("capture.wait", job=job) for job in jobs]
    assert [result["state"] for result in results] == ["done"] * 3
    assert running.engine.calls == ["start", "describe", *["capture", "closed"] * 3]
    ahead = [event["ahead"] for event in wire.events if event["type"] == "queued"]
    assert ahead == [0, 1, 2]


@served
async def test_cancel_in_every_state(running: Daemon, wire: Wire) -> None:
    first = await begin(wire)
    await wire.result("capture.wait", job=first)
    slow = await begin(wire, note="slow", queue=True)
    waiting = await begin(wire, note="never", queue=True)
    await until_open(running)

    kept = await wire.result("capture.cancel", job=waiting)
    assert kept["state"] == "cancelled" and kept["files"] == []
    assert kept["error"]["kind"] == "cancelled"
    assert await states(wire) == ["done", "running", "cancelled"]

    kept = await wire.result("capture.cancel", job=slow)
    assert not running.engine.shutter_open
    assert kept["state"] == "cancelled" and kept["files"] == ["raw/s1.dng"]

    assert (await wire.result("capture.cancel", job=first))["state"] == "done"
    assert (await wire.result("capture.cancel", job=slow)) == kept
    assert running.engine.calls.count("capture") == 2


@served
async def test_a_client_that_leaves_takes_its_captures_along(running: Daemon, other: Wire) -> None:
    await other.result("events.subscribe", jobs="all")
    async with running.wire() as wire:
        job = await begin(wire, note="slow")
        waiting = await begin(wire, queue=True)
        await until_open(running)
    ended = await other.event("cancelled", job)
    assert ended["files"] == ["raw/s1.dng"]
    await other.event("cancelled", waiting)
    assert not running.engine.shutter_open
    await other.result("capture.wait", job=await begin(other))


@served
async def test_a_start_followed_at_once_by_the_end_of_the_stream_is_cancelled(
    running: Daemon, other: Wire
) -> None:
    await other.result("events.subscribe", jobs="all")
    async with running.wire() as wire:
        await wire.send(
            b'{"jsonrpc":"2.0","id":1,"method":"capture.start",'
            b'"params":{"goal":"white","note":"slow"}}'
        )
        wire.writer.write_eof()
        job = (await wire.answer(1))["result"]["job"]
        assert await wire.ended()
    assert (await other.result("capture.wait", job=job))["state"] == "cancelled"


@served
async def test_requests_before_the_end_of_the_stream_are_answered(wire: Wire) -> None:
    status = b'{"jsonrpc":"2.0","id":1,"method":"rig.status"}\n'
    plan = (
        b'{"jsonrpc":"2.0","id":2,"method":"capture.plan","params":{"goal":"white","note":"slow"}}'
    )
    await wire.send(status + plan)
    wire.writer.write_eof()
    assert "result" in await wire.answer(1)
    # A plan ends with its client, too, and says so.
    assert (await wire.answer(2))["error"]["data"]["kind"] == "cancelled"
    assert await wire.ended()


@served
async def test_a_detached_capture_outlives_its_client(running: Daemon) -> None:
    async with running.wire() as wire:
        job = await begin(wire, note="slow", detach=True)
        await until_open(running)
    async with running.wire() as other:
        await asyncio.sleep(0.05)
        assert await states(other) == ["running"]
        assert (await other.result("capture.cancel", job=job))["state"] == "cancelled"


@pytest.mark.parametrize("kind", ["device_lost", "sync", "no_space"])
@served
async def test_a_failed_capture_tells_kind_device_and_hint(wire: Wire, kind: str) -> None:
    await wire.result("events.subscribe")
    job = await begin(wire, note=f"fail:{kind}")
    result = await wire.result("capture.wait", job=job)
    assert result["state"] == "failed"
    wanted = {"kind": kind, "message": "it broke", "device": "camera", "hint": "mend it"}
    assert result["error"] == wanted
    assert (await wire.event("failed"))["error"] == wanted


@served
async def test_a_text_that_is_none_ends_its_job_and_not_the_daemon(
    running: Daemon, wire: Wire
) -> None:
    """As names of files are that are no UTF-8: the next job runs, a cancel is answered."""
    await wire.result("events.subscribe", jobs="own")
    job = await begin(wire, note="fail:\\udce9")
    following = await begin(wire, queue=True)
    result = await wire.result("capture.wait", job=job)
    assert result["error"]["kind"] == "\\udce9"
    assert (await wire.event("failed", job))["error"] == result["error"]
    assert (await wire.result("capture.wait", job=following))["state"] == "done"
    job = await begin(wire, note="slow")
    assert (await wire.result("capture.cancel", job=job))["state"] == "cancelled"


@served
async def test_events_reach_those_who_asked_for_them(
    starter: Wire, everything: Wire, own: Wire, silent: Wire
) -> None:
    await everything.result("events.subscribe", jobs="all")
    await own.result("events.subscribe", jobs="own")
    await silent.result("events.subscribe", jobs="all")
    await silent.result("events.unsubscribe")
    job = await begin(starter)
    await everything.event("done", job)
    for wire in (starter, own, silent):
        await wire.result("ping")
        assert wire.events == []


@served
async def test_stopping_ends_what_runs_and_what_waits(running: Daemon, wire: Wire) -> None:
    await wire.result("events.subscribe")
    jobs = [await begin(wire, note="slow", queue=True) for _ in range(2)]
    await until_open(running)
    running.stop.set()
    for job in jobs:
        assert (await wire.event("cancelled", job))["state"] == "cancelled"
    assert await wire.ended()
    assert not running.engine.shutter_open


@served
async def test_progress_that_is_held_back_is_told_where_nothing_follows(
    running: Daemon, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig that hangs after its first code: who waits for that code must learn of it."""
    real, seen = running.engine.capture, threading.Event()

    def capture(*args: Any, emit: Emit, **more: Any) -> Any:
        for frame in (0, 1):
            emit(Progress(shot="s1", frame=frame, frames=22, missed=0))
        assert seen.wait(PATIENCE_S)
        return real(*args, emit=emit, **more)

    monkeypatch.setattr(running.engine, "capture", capture)
    await wire.result("events.subscribe", jobs="own")
    job = (await wire.result("capture.start", goal="white"))["job"]
    async with asyncio.timeout(PATIENCE_S):
        while (await wire.event("progress", job))["frame"] != 1:
            pass
    seen.set()
    await wire.event("done", job)
