"""Every use of the rig is a job: plans, pictures on the panels and previews, like captures."""

from __future__ import annotations

import asyncio
import os
import time
from typing import Any

import pytest

from tests.e2e.server._server_harness import Daemon, Wire, served


async def called(running: Daemon, call: str) -> None:
    while call not in running.engine.calls:
        await asyncio.sleep(0.002)


async def running_job(wire: Wire) -> dict[str, Any]:
    job: dict[str, Any] = (await wire.result("rig.status"))["running"]
    return job


async def idle(wire: Wire) -> None:
    while (await wire.result("rig.status"))["state"] != "idle":
        await asyncio.sleep(0.002)


async def ask(wire: Wire, method: str, **params: Any) -> asyncio.Task[dict[str, Any]]:
    """Ask without waiting for the answer."""
    task = asyncio.create_task(wire.ask(method, **params))
    await asyncio.sleep(0)
    return task


@served
async def test_a_plan_is_a_job_with_owner_events_and_end(
    running: Daemon, wire: Wire, other: Wire
) -> None:
    async def wire_status(running: Daemon) -> dict[str, Any]:
        async with running.wire() as wire:
            found: dict[str, Any] = await wire.result("rig.status")
            return found

    await other.result("events.subscribe", jobs="all")
    answer = await ask(wire, "capture.plan", goal="direct", note="slow")
    await called(running, "plan")
    job = await running_job(other)
    assert (job["kind"], job["state"], job["goal"]) == ("plan", "running", "direct")
    assert job["owner"]["uid"] == os.getuid()
    error = await other.error("capture.plan", goal="white")
    assert error["data"]["kind"] == "busy" and job["job"] in error["message"]

    queued = await ask(other, "capture.plan", goal="white", queue=True)
    while not (waiting := (await wire_status(running))["queued"]):
        await asyncio.sleep(0.002)
    assert waiting[0]["kind"] == "plan"
    started = time.monotonic()
    async with running.wire() as third:
        ended = await third.result("capture.cancel", job=job["job"])
    assert time.monotonic() - started < 2.0
    assert ended["state"] == "cancelled"
    assert (await answer)["error"]["data"]["kind"] == "cancelled"
    assert (await queued)["result"]["goal"] == "white"
    told = [e["type"] for e in other.events if e["job"] == job["job"]]
    assert (told[0], told[-1]) == ("queued", "cancelled")
    listed = (await wire.result("capture.list"))["jobs"]
    assert [(j["kind"], j["state"]) for j in listed] == [
        ("plan", "cancelled"),
        ("plan", "done"),
    ]


@served
async def test_a_plan_ends_with_its_client(running: Daemon, other: Wire) -> None:
    await other.result("events.subscribe", jobs="all")
    async with running.wire() as wire:
        await ask(wire, "capture.plan", goal="white", note="slow")
        await called(running, "plan")
    await other.event("cancelled")
    await other.result("capture.plan", goal="white")


@pytest.mark.parametrize(
    ("note", "kind"), [("fail:no_space", "no_space"), ("fail:request", "request"), ("raise", None)]
)
@served
async def test_a_plan_that_fails_says_how(wire: Wire, note: str, kind: str | None) -> None:
    error = await wire.error("capture.plan", goal="white", note=note)
    assert error["data"]["kind"] == (kind or "internal")
    if kind is not None:
        assert error["data"]["device"] == "camera" and error["data"]["hint"] == "mend it"
    (job,) = (await wire.result("capture.list"))["jobs"]
    assert job["state"] == "failed"


@served
async def test_a_picture_stays_until_its_job_is_cancelled(
    running: Daemon, wire: Wire, other: Wire
) -> None:
    shown = await wire.result("display.show", pattern="grid")
    assert running.engine.lit == "grid"
    status = await other.result("rig.status")
    assert status["state"] == "busy"
    job = status["running"]
    assert (job["job"], job["kind"], job["goal"]) == (shown["job"], "show", "grid")
    ended = await other.result("capture.cancel", job=shown["job"])
    assert ended["state"] == "cancelled"
    assert running.engine.lit is None
    await idle(other)


@served
async def test_a_picture_ends_with_its_connection_unless_detached(
    running: Daemon, other: Wire
) -> None:
    # and the daemon's end puts it out, which the harness looks for

    async with running.wire() as wire:
        await wire.result("display.show", pattern="white")
    await idle(other)
    assert running.engine.lit is None
    async with running.wire() as wire:
        await wire.result("display.show", pattern="white", detach=True)
    for _ in range(5):
        await other.result("ping")
    assert running.engine.lit == "white"


@served
async def test_the_next_thing_of_its_owner_takes_the_place_of_a_picture(
    running: Daemon, wire: Wire
) -> None:
    await wire.result("events.subscribe", jobs="all")
    first = await wire.result("display.show", pattern="white", detach=True)
    second = await wire.result("display.show", pattern="checker", detach=True)
    assert running.engine.lit == "checker" and first["job"] != second["job"]
    assert (await wire.result("capture.wait", job=first["job"]))["state"] == "done"
    await wire.result("capture.plan", goal="white")
    assert running.engine.lit is None  # it does not come back
    await wire.result("display.show", pattern="grid")
    job = (await wire.result("capture.start", goal="white"))["job"]
    # The engine fails where a picture is still on the panels.
    assert (await wire.result("capture.wait", job=job))["state"] == "done"
    await wire.result("display.show", pattern="grid")
    assert (await wire.result("preview.grab"))["shape"] == [4, 6, 3]
    await wire.result("display.show", pattern="grid")
    black = await wire.result("display.show", pattern="black")
    assert running.engine.lit is None
    assert (await wire.result("capture.wait", job=black["job"]))["state"] == "done"
    await idle(wire)


@served
async def test_a_picture_that_cannot_be_shown_leaves_the_panels_black(
    running: Daemon, wire: Wire
) -> None:
    error = await wire.error("display.show", pattern="code", index=100)
    assert error["data"]["kind"] == "request" and error["data"]["hint"] == "0 to 99"
    await idle(wire)
    assert running.engine.calls[-2:] == ["show code 100", "show black 0"]


@served
async def test_a_preview_is_busy_has_an_owner_and_can_be_cancelled(
    running: Daemon, wire: Wire, other: Wire
) -> None:
    running.engine.slow_previews = True
    answer = await ask(wire, "preview.grab")
    while not running.engine.shutter_open:
        await asyncio.sleep(0.002)
    status = await other.result("rig.status")
    assert status["state"] == "busy"
    assert status["running"]["kind"] == "preview"
    assert status["running"]["owner"]["uid"] == os.getuid()
    assert (await other.error("capture.start", goal="white"))["data"]["kind"] == "busy"
    await other.result("capture.cancel", job=status["running"]["job"])
    assert not running.engine.shutter_open
    assert (await answer)["error"]["data"]["kind"] == "cancelled"
