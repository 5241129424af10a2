"""Calibrations over the socket: asked for, attended, cancelled."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from pdcd.client import Client
from pdcd.request import CalibrateRequest
from pdcd.runs.events import Event
from tests.e2e.server._server_harness import daemon, threaded_daemon
from tests.e2e.server._users import ANNA, BERT, Users
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


def test_while_it_waits_it_can_be_cancelled_and_others_wait(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with daemon(tmp_path) as running, running.wire() as wire, running.wire() as other:
            await wire.result("events.subscribe", jobs="own")
            job = (await wire.result("calibrate.start", steps=["light"], attended=True))["job"]
            await wire.event("attention", job)
            refused = await other.error("capture.start", goal="white")
            assert refused["data"]["kind"] == "busy" and "(calibrate)" in refused["message"]
            await other.result("ping")
            assert (await wire.result("capture.cancel", job=job))["state"] == "cancelled"

    asyncio.run(scenario())


def test_only_its_owner_says_that_it_may_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    users = Users(monkeypatch)

    async def scenario() -> None:
        async with daemon(tmp_path, server=OPEN) as running:
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

    asyncio.run(scenario())


def test_steps_that_are_none_are_refused(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with daemon(tmp_path) as running, running.wire() as wire:
            refused = await wire.error("calibrate.start", steps=["lihgt"])
            assert refused["data"]["kind"] == "request"
            refused = await wire.error("calibrate.proceed", job="none")
            assert refused["data"]["kind"] == "request"

    asyncio.run(scenario())
