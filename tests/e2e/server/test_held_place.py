"""Where a run is to go is fixed when its job is admitted: what happens to the name while it waits
does not lead it elsewhere. With the real engine, whose first capture holds the rig for a while."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.verify import verify_run
from pdcd.server.daemon import serve_daemon
from tests import bench_rig
from tests.e2e.server._server_harness import PATIENCE_S, Wire


class Patient(Engine):
    """An engine that begins its captures when it is told to."""

    go = threading.Event()

    def capture(self, request: CaptureRequest, *args: Any, **given: Any) -> CaptureResult:
        assert self.go.wait(PATIENCE_S)
        return super().capture(request, *args, **given)


@asynccontextmanager
async def patient(folder: Path) -> AsyncIterator[Wire]:
    """A client of a daemon whose engine waits."""
    Patient.go.clear()
    socket, stop = folder / "s", asyncio.Event()
    config = bench_rig.config(folder)
    task = asyncio.create_task(
        serve_daemon(config, socket=socket, engine_factory=Patient.from_config, stop=stop)
    )
    while not socket.exists():
        await asyncio.sleep(0.005)
    reader, writer = await asyncio.open_unix_connection(str(socket), limit=2**22)
    wire = Wire(reader, writer)
    try:
        await wire.receive()
        yield wire
    finally:
        Patient.go.set()
        await wire.close()
        stop.set()
        await asyncio.wait_for(task, PATIENCE_S)


def swap(state: Path, outside: Path) -> None:
    (state / "mine").rename(state / "aside")
    (state / "mine").symlink_to(outside)


def remove(state: Path, outside: Path) -> None:
    (state / "mine").rmdir()
    (state / "mine").symlink_to(outside)


def move_out(state: Path, outside: Path) -> None:
    (state / "mine").rename(outside / "mine")


Attack = Callable[[Path, Path], object]


def attacked(folder: Path, attack: Attack, *, cancel: bool = False) -> dict[str, Any]:
    """Result of a job into state/mine that waited while that was attacked."""
    state, outside = folder / "state", folder / "outside"
    outside.mkdir()

    async def scenario() -> dict[str, Any]:
        async with patient(folder) as wire:
            wanted = {"goal": "indirect", "codes": 4, "queue": True}
            first = await wire.result("capture.start", **wanted)
            waiting = await wire.result("capture.start", **wanted, out="mine")
            assert (first["state"], waiting["state"]) == ("running", "queued")
            attack(state, outside)
            if cancel:
                await wire.result("capture.cancel", job=waiting["job"])
            Patient.go.set()
            done = await wire.result("capture.wait", job=first["job"])
            assert done["state"] == "done", done
            result: dict[str, Any] = await wire.result("capture.wait", job=waiting["job"])
            return result

    return asyncio.run(scenario())


def test_a_folder_swapped_for_a_link_leads_nowhere(tmp_path: Path) -> None:
    result = attacked(tmp_path, swap)
    assert result["state"] == "done", result["error"]
    assert list((tmp_path / "outside").iterdir()) == []
    folder = Path(result["folder"])
    assert folder == tmp_path / "state" / "aside" / result["job"]
    assert verify_run(folder, manifest_sha256=result["manifest_sha256"]).whole


@pytest.mark.parametrize("attack", [remove, move_out])
def test_a_folder_that_is_gone_fails_the_job(tmp_path: Path, attack: Attack) -> None:
    result = attacked(tmp_path, attack)
    assert result["state"] == "failed" and result["error"]["kind"] == "request"
    assert result["folder"] is None and result["files"] == []
    assert not [path for path in (tmp_path / "outside").rglob("*") if path.name != "mine"]


def test_a_job_that_is_cancelled_while_it_waits_lets_go(tmp_path: Path) -> None:
    """That no descriptor is left is seen at the end of every test of this file."""
    assert attacked(tmp_path, swap, cancel=True)["state"] == "cancelled"
    assert list((tmp_path / "outside").iterdir()) == []


async def test_a_job_that_is_refused_lets_go(tmp_path: Path) -> None:
    async with patient(tmp_path) as wire:
        await wire.result("capture.start", goal="indirect", codes=4)
        for _ in range(5):
            error = await wire.error("capture.start", goal="indirect", out="mine")
            assert error["data"]["kind"] == "busy"
        Patient.go.set()
