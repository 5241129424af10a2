"""How far a job came is told to the end, though progress is thinned."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest

from pdcd.protocol.events import Emit, Progress
from tests.e2e.server._server_harness import daemon

PATIENCE_S = 20.0


def test_progress_that_is_held_back_when_a_job_ends_comes_before_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        async with daemon(tmp_path) as running, running.wire() as wire:
            real = running.engine.capture

            def capture(*args: Any, emit: Emit, **more: Any) -> Any:
                result = real(*args, emit=emit, **more)
                for frame in (21, 22):  # two at once: the second is held back
                    emit(Progress(shot="s1", frame=frame, frames=22, missed=0))
                return result

            monkeypatch.setattr(running.engine, "capture", capture)
            await wire.result("events.subscribe", jobs="own")
            job = (await wire.result("capture.start", goal="white"))["job"]
            await wire.event("done", job)
            told = [event["frame"] for event in wire.events if event["type"] == "progress"]
            assert told[-1] == 22

    asyncio.run(scenario())


def test_progress_that_is_held_back_is_told_where_nothing_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig that hangs after its first code: who waits for that code must learn of it."""

    async def scenario() -> None:
        async with daemon(tmp_path) as running, running.wire() as wire:
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

    asyncio.run(scenario())
