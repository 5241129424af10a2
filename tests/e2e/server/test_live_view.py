"""A live view over the socket: its pictures, who may have them, and how it ends."""

from __future__ import annotations

import asyncio
import base64
from typing import Any

from tests.e2e.server._server_harness import Daemon, Wire, served


async def begun(wire: Wire, **params: Any) -> str:
    """Begin one, and wait for its first picture; returns its job."""
    job: str = (await wire.result("preview.live", **params))["job"]
    await wire.result("preview.frame", job=job)
    return job


async def is_dark(running: Daemon, wire: Wire) -> bool:
    while (await wire.result("rig.status"))["state"] != "idle":
        await asyncio.sleep(0.002)
    return running.engine.lit is None


@served
async def test_each_picture_is_newer_than_the_last_and_may_come_without_itself(
    running: Daemon, wire: Wire
) -> None:
    job = await begun(wire, pattern="checker")
    assert running.engine.lit == "checker"
    (view,) = (await wire.result("capture.list"))["jobs"]
    assert (view["kind"], view["goal"], view["state"]) == ("live", "checker", "running")
    number = 0
    for _ in range(3):
        frame = await wire.result("preview.frame", job=job, after=number)
        assert frame["number"] > number and base64.b64decode(frame["jpeg"]) == b"picture"
        number = frame["number"]
    bare = await wire.result("preview.frame", job=job, after=number, picture=False)
    assert bare["jpeg"] == "" and bare["focus"] == frame["focus"] == 0.5
    waits = asyncio.create_task(wire.ask("preview.frame", job=job, after=2**40))
    async with running.wire() as other:
        assert (await other.result("capture.cancel", job=job))["state"] == "cancelled"
    error = (await waits)["error"]
    assert error["data"]["kind"] == "cancelled"
    assert await is_dark(running, wire)
    # Nor has it pictures afterwards, and other jobs never had.
    assert (await wire.error("preview.frame", job=job))["data"]["kind"] == "cancelled"
    shown = await wire.result("display.show", pattern="black")
    assert (await wire.error("preview.frame", job=shown["job"]))["data"]["kind"] == "request"
    assert (await wire.error("preview.live", pattern="flash"))["data"]["kind"] == "request"


@served
async def test_it_gives_way_to_what_its_owner_asks_for(
    running: Daemon, wire: Wire, other: Wire
) -> None:
    job = await begun(wire)
    photo = await other.result("capture.start", goal="white")
    assert (await other.result("capture.wait", job=photo["job"]))["state"] == "done"
    assert (await wire.result("capture.wait", job=job))["state"] == "done"
    error = await wire.error("preview.frame", job=job)
    assert "gave way" in error["message"]
    # And the other way round: a photo is waited for by nobody's finder.
    photo = await other.result("capture.start", goal="white", note="slow")
    assert (await wire.error("preview.live"))["data"]["kind"] == "busy"
    await other.result("capture.cancel", job=photo["job"])
    assert await is_dark(running, wire)


@served
async def test_it_ends_with_its_connection(running: Daemon, wire: Wire) -> None:
    async with running.wire() as other:
        await begun(other)
        assert running.engine.lit == "white"
    assert await is_dark(running, wire)
