"""Arrays that come with a request: FIFOs, devices and disks that hang hold up nobody."""

from __future__ import annotations

import asyncio
import base64
import gc
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import RigConfig, ServerConfig
from pdcd.errors import BusyError, PdcdError, RequestError
from pdcd.files import reading
from pdcd.files.arrays import read_array
from pdcd.files.opening import Sendable
from pdcd.protocol.request import CaptureRequest, SentArray
from pdcd.runs.folder import read_manifest
from pdcd.runs.patterns import read_patterns
from pdcd.server.access import Peer
from pdcd.server.intake import Intake
from pdcd.server.readers import Readers
from tests import bench_rig
from tests.e2e.server._server_harness import Daemon, Wire, nothing_left, served
from tests.hostile import files
from tests.hostile.trial import trial
from tests.real_daemon import connect
from tests.real_daemon import daemon as real_daemon

pytestmark = pytest.mark.whole

GRID = (4, 6)
LIGHT = np.round(np.random.default_rng(3).random(GRID), 3)
SELF = Peer(os.getpid(), os.getuid(), os.getgid(), "me")
NOBODY = Peer(os.getpid(), 65534, 65534, "nobody")


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield
        for thread in threading.enumerate():  # they tell their result, and then end
            if thread.name == "pdcd-reader":
                thread.join(60.0)


def taken(intake: Intake, value: Any, *fds: int, peer: Peer = SELF) -> Any:
    """The recorded value and the array of an illumination that a client gives."""

    async def scenario() -> Any:
        request = CaptureRequest(goal="illuminated", illumination=value)
        kept, given = await intake.take(request, fds, peer)
        return kept.illumination, given["illumination"]

    try:
        return asyncio.run(scenario())
    finally:
        for descriptor in fds:
            os.close(descriptor)


def descriptor_of(path: Path, flags: int = os.O_RDONLY) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def test_an_array_comes_by_descriptor_within_the_line_and_by_name(tmp_path: Path) -> None:
    path = tmp_path / "light.npy"
    np.save(path, LIGHT)
    intake = Intake(tmp_path, GRID)
    text = base64.b64encode(path.read_bytes()).decode()
    for value, fds, file in (
        (SentArray(fd=0, file="light.npy"), [descriptor_of(path)], "light.npy"),
        (SentArray(fd=1), [descriptor_of(path), descriptor_of(path)], None),
        (SentArray(npy=text), [], None),
        ("light.npy", [], "light.npy"),
    ):
        kept, array = taken(intake, value, *fds)
        np.testing.assert_array_equal(array, LIGHT)
        assert kept == SentArray(file=file, sha256=kept.sha256) and len(kept.sha256) == 64


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (SentArray(fd=0), "0 came with the line"),
        (SentArray(), "neither"),
        (SentArray(fd=0, npy="AA=="), "neither"),
        (SentArray(sha256="0" * 64), "neither"),
        (SentArray(npy="no base64!"), "not base64"),
        (SentArray(npy="AAAA", file="a\nb"), "no name of a file"),
        ("a\nb", "no name of a file"),
        ("../light.npy", "no name below"),
        ("none.npy", "No such file"),
        ("secret", "may not read"),
        ("fifo", "a FIFO"),
    ],
)
def test_what_cannot_be_taken_says_why(value: Any, what: str) -> None:
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)  # others may enter, unlike folders of pytest
        files.kinds(Path(place) / "arrays")
        with pytest.raises(RequestError, match=what) as caught:
            taken(Intake(Path(place) / "arrays", GRID), value, peer=NOBODY)
    assert caught.value.kind == "request"


def test_without_a_folder_of_arrays_every_name_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "light.npy", LIGHT)
    for name in ("light.npy", str(tmp_path / "light.npy")):
        with pytest.raises(RequestError, match="no folder of arrays") as caught:
            taken(Intake(None, GRID), name)
        assert "[server] arrays" in str(caught.value.hint)


@pytest.mark.timeout(180)
@pytest.mark.parametrize("name", ["fifo", "zero", "folder", "sparse"])
def test_descriptors_of_fifos_devices_and_giants_are_refused_at_once(
    tmp_path: Path, name: str
) -> None:
    found = files.kinds(tmp_path)[name]
    begun_s = time.monotonic()
    with pytest.raises(RequestError, match=r"not a regular file|bytes, more than"):
        taken(Intake(None, GRID), SentArray(fd=0), descriptor_of(found))
    assert time.monotonic() - begun_s < 2.0


def test_a_descriptor_is_read_though_its_sender_closes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server may close its own in the middle of a read; the number may be another file then."""
    np.save(tmp_path / "light.npy", LIGHT)
    descriptor = descriptor_of(tmp_path / "light.npy")
    whole = reading.read_contents

    def closing(mine: int, limits: Any) -> bytes:
        os.close(descriptor)
        np.save(tmp_path / "other.npy", LIGHT + 1.0)
        again = descriptor_of(tmp_path / "other.npy")
        assert again == descriptor
        return whole(mine, limits)

    monkeypatch.setattr("pdcd.planning.given.read_contents", closing)
    _, array = taken(Intake(None, GRID), SentArray(fd=0), descriptor)
    np.testing.assert_array_equal(array, LIGHT)


async def test_arrays_that_wait_are_bounded_and_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdcd.server.intake.HELD_BYTES", 10**6)
    intake = Intake(None, GRID, Readers(limit_s=0.2))
    text = base64.b64encode(files.npy(np.ones((250, 250)))).decode()
    request = CaptureRequest(goal="illuminated", illumination=SentArray(npy=text))

    held = [(await intake.take(request, (), SELF))[1]]
    with pytest.raises(BusyError, match="too many arrays"):
        while len(held) < 5:
            held.append((await intake.take(request, (), SELF))[1])
    assert len(held) == 1  # 0.5 MB are held, and 0.5 MB might come
    held.clear()
    gc.collect()
    await intake.take(request, (), SELF)


@served
async def test_the_engine_gets_the_arrays_and_jobs_let_go_of_them(
    running: Daemon, wire: Wire
) -> None:
    text = base64.b64encode(files.npy(LIGHT)).decode()

    for method in ("capture.plan", "capture.start"):
        answer = await wire.result(
            method, goal="illuminated", illumination={"npy": text, "file": "l.npy"}
        )
        if method == "capture.start":
            await wire.result("capture.wait", job=answer["job"])
        np.testing.assert_array_equal(running.engine.given[-1]["illumination"], LIGHT)
    recorded = running.engine.requests[-1].illumination
    assert isinstance(recorded, SentArray) and recorded.npy is None and recorded.sha256
    bad = await wire.error("capture.start", goal="illuminated", illumination={"npy": "AA=="})
    assert bad["data"]["kind"] == "request" and bad["code"] == -32602


@served
async def test_a_client_that_leaves_while_its_arrays_are_read_starts_nothing(
    running: Daemon, other: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, let = threading.Event(), threading.Event()
    whole = read_array

    def slow(*args: Any) -> Any:
        reading.set()
        let.wait(60.0)
        return whole(*args)

    monkeypatch.setattr("pdcd.planning.given.read_array", slow)
    text = base64.b64encode(files.npy(LIGHT)).decode()

    async with running.wire() as wire:
        params = {"goal": "illuminated", "illumination": {"npy": text}}
        await wire.send({"jsonrpc": "2.0", "id": 1, "method": "capture.start", "params": params})
        while not reading.is_set():
            await asyncio.sleep(0.005)
        await other.result("ping")
        wire.writer.write_eof()
        while (await other.result("rig.status"))["connections"] > 1:
            await asyncio.sleep(0.005)
        let.set()
        error = (await wire.answer(1))["error"]
        assert error["data"]["kind"] == "cancelled"
    assert (await other.result("capture.list"))["jobs"] == []


@pytest.mark.timeout(180)
def test_a_fifo_hangs_neither_ping_nor_cancel_nor_sigterm(tmp_path: Path) -> None:
    found = files.kinds(tmp_path / "arrays")
    server = ServerConfig(state_dir=str(tmp_path / "state"), arrays=str(tmp_path / "arrays"))
    tables: dict[str, Any] = {"server": server, "rig": RigConfig(clock="real")}
    with real_daemon(tmp_path, **tables) as (process, path), connect(path) as client:
        for name in ("fifo", "zero", "sparse", str(found["fifo"]), "/dev/zero"):
            request = CaptureRequest(goal="illuminated", illumination=name)
            for ask in (client.plan, client.capture):
                with pytest.raises(PdcdError) as caught:
                    ask(request)
                assert caught.value.kind == "request"
        client.call("ping")
        job = client.call("capture.start", {"goal": "indirect", "codes": 512, "white": False})
        assert client.cancel(job["job"]).state == "cancelled"
        process.terminate()
        assert process.wait(60.0) == 0


@pytest.mark.timeout(180)
def test_files_and_arrays_of_clients_reach_a_real_daemon_by_descriptor(tmp_path: Path) -> None:
    """A PNG and an `.npy` by path, an array of this process, and the command line."""
    grid = bench_rig.GRID
    light = np.round(np.random.default_rng(3).random(grid), 3)
    levels = np.rint(light * 255.0).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "light.png"), levels)
    np.save(tmp_path / "light.npy", light)
    request = CaptureRequest(goal="illuminated", codes=8)
    with real_daemon(tmp_path) as (process, path), connect(path) as client:
        given: dict[str, tuple[Sendable, NDArray[np.float64]]] = {
            "png": (tmp_path / "light.png", levels / 255.0),
            "npy": (tmp_path / "light.npy", light),
            "array": (light, light),
        }
        for source, expected in given.values():
            result = client.capture(request, arrays={"illumination": source})
            assert result.state == "done" and result.folder is not None, result.error
            kept = read_patterns(Path(result.folder))["goal.illumination"]
            np.testing.assert_array_equal(kept.reshape(grid), expected)
            told = read_manifest(Path(result.folder)).request["illumination"]
            assert len(told["sha256"]) == 64
            assert told.get("file") == (source.name if isinstance(source, Path) else None)
        held = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
        words = ["plan", "illuminated", "--illumination", "light.npy", "--socket", str(path)]
        command = [sys.executable, "-m", "pdcd", *words, "--json"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0 and json.loads(done.stdout)["goal"] == "illuminated"
        client.call("ping")
        assert len(list(Path(f"/proc/{process.pid}/fd").iterdir())) <= held


def test_hostile_requests_get_results_or_refusals_of_a_kind(tmp_path: Path) -> None:
    """A few hundred; ten thousand by ``python -m tests.hostile --count 10000``."""
    count = int(os.environ.get("PDCD_HOSTILE", "150"))
    outcome = trial(tmp_path, 7, count)
    assert not outcome.broken, "\n".join(outcome.broken[:3])
    assert sum(outcome.kinds.values()) == count
    assert outcome.kinds["request"] > count // 3 and outcome.kinds["done"] > count // 20
    assert outcome.slowest_s < 20.0, outcome.slowest
