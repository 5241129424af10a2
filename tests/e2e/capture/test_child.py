"""The work process is killed, stopped, crashed and starved; jobs fail, and the next one works."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, LimitsConfig
from pdcd.capture.engine import Engine
from pdcd.capture.worker import spawned
from pdcd.capture.worker.calls import start_worker
from pdcd.capture.worker.spawned import SpawnedWorker
from pdcd.capture.worker.worker import Worker
from pdcd.errors import Cancelled, PdcdError, PlanError
from pdcd.protocol.events import Event, PlanningProgress
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.runs.manifest import MANIFEST
from pdcd.runs.patterns import read_patterns
from pdcd.runs.place import HeldFolder
from pdcd.watch import Watch
from tests import bench_rig

pytestmark = pytest.mark.whole

REQUEST = CaptureRequest(goal="indirect", codes=4, white=False)
FAULTY = Path(__file__).with_name("_faulty.py")
FOREVER = (sys.executable, "-S", "-c", "import time; time.sleep(3600)")
"""Stands for a work process where only its life and death matter."""


def child_of(engine: Engine) -> SpawnedWorker:
    worker = engine._worker
    assert isinstance(worker, SpawnedWorker)
    return worker


def started(folder: Path, worker: Callable[..., Any] = SpawnedWorker, **tables: Any) -> Engine:
    camera = CameraConfig(noise="none", f_number=8.0)
    config = bench_rig.config(folder, **{"grid": (8, 8), "camera": camera, **tables})
    engine = Engine(config, worker)
    engine.start()
    return engine


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    """One engine for all tests that leave it as good as they found it."""
    made = started(tmp_path_factory.mktemp("rig"))
    yield made
    made.stop()


@pytest.fixture
def run(engine: Engine, tmp_path: Path) -> Callable[..., CaptureResult]:
    """Take a photo with that engine into this test's folder."""

    def capture(job: str = "job", **given: Any) -> CaptureResult:
        told: dict[str, Any] = {"emit": lambda _: None, "cancelled": lambda: False, **given}
        with HeldFolder.at(tmp_path) as parent:
            return engine.capture(REQUEST, job=job, parent=parent, **told)

    return capture


class Beats:
    """Stands for the watchdog's `cancelled`: notes when it is asked, and acts at one such time."""

    def __init__(self, at: int, act: Callable[[], object]) -> None:
        self.times_s: list[float] = []
        self._at, self._act = at, act

    def __call__(self) -> bool:
        self.times_s.append(time.monotonic())
        return bool(self._act()) if len(self.times_s) == self._at else False

    @property
    def longest_s(self) -> float:
        """Longest time between two of them."""
        return float(np.diff(self.times_s).max())


def send(engine: Engine, number: signal.Signals) -> None:
    pid = child_of(engine).pid
    assert pid is not None
    os.kill(pid, number)


def assert_failed_safely(engine: Engine, result: CaptureResult, folder: Path) -> None:
    """The job failed by decoding, its RAW file is there, and the devices are safe."""
    assert result.state == "failed" and result.error is not None
    assert result.error["kind"] == "decode"
    assert "the RAW files are kept" in str(result.error["hint"])
    assert (folder / "job.partial" / "raw" / "coded.dng").stat().st_size > 0
    assert not list(folder.rglob(MANIFEST))
    bench = bench_rig.bench_of(engine)
    assert bench_rig.are_panels_black(bench) and not bench.shutter_open


def test_a_killed_process_fails_its_job_and_the_next_one_works(
    engine: Engine, run: Callable[..., CaptureResult], tmp_path: Path
) -> None:
    def kill(event: Event) -> None:
        if event.type == "decoding":
            send(engine, signal.SIGKILL)

    before = child_of(engine).pid
    result = run(emit=kill)
    assert_failed_safely(engine, result, tmp_path)
    assert result.error is not None
    assert "the decoding process was ended by signal 9 (SIGKILL)" in str(result.error["message"])
    assert child_of(engine).pid not in (None, before)
    assert run("next").state == "done"


@pytest.mark.long
def test_a_frozen_process_is_cancelled_by_force(
    engine: Engine, run: Callable[..., CaptureResult]
) -> None:
    send(engine, signal.SIGSTOP)
    beats = Beats(4, lambda: True)
    before = child_of(engine).pid
    result = run(cancelled=beats)
    ended_s = time.monotonic() - beats.times_s[3]
    assert result.state == "cancelled"
    assert ended_s < 1.5  # by design 0.1 s and the rig's own time; the machine may be busy
    assert child_of(engine).pid != before
    assert run("next").state == "done"


@pytest.mark.long
def test_planning_beats_while_the_process_does_not_and_ends_by_its_death(engine: Engine) -> None:
    send(engine, signal.SIGSTOP)
    beats = Beats(20, lambda: send(engine, signal.SIGKILL))
    with pytest.raises(PlanError, match=r"the planning process was ended by signal 9"):
        engine.plan(REQUEST, cancelled=beats)
    assert len(beats.times_s) >= 20
    assert beats.longest_s < 1.0  # by design 0.05 s
    assert engine.plan(REQUEST).codes == 4


def test_a_plan_is_cancelled_at_once_and_its_process_kept(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine may be busy: what would be ended by force after a tenth of a second may be late
    here."""
    monkeypatch.setattr(spawned, "STOP_S", 30.0)
    engine.plan(REQUEST)  # so that the process is warm
    before = child_of(engine).pid
    told: list[Event] = []
    long = CaptureRequest(goal="indirect", error=0.0005, white=False)
    with pytest.raises(Cancelled):
        engine.plan(long, emit=told.append, cancelled=lambda: bool(told))
    assert child_of(engine).pid == before  # it looks up from its work often enough
    assert engine.plan(REQUEST).codes == 4


def test_a_plan_tells_how_far_it_is(engine: Engine) -> None:
    told: list[Event] = []
    engine.plan(CaptureRequest(goal="indirect", error=0.2, white=False), emit=told.append)
    assert all(isinstance(event, PlanningProgress) for event in told)
    steps = [event for event in told if isinstance(event, PlanningProgress)]
    assert [event.done for event in steps] == sorted(event.done for event in steps)
    assert steps[-1].done == pytest.approx(steps[-1].total)
    assert {event.stage for event in steps} <= {"codes", "pilots"}


def test_errors_keep_their_kind_and_hint_on_the_way(engine: Engine) -> None:
    with pytest.raises(PdcdError) as raised:
        engine.plan(CaptureRequest(goal="white", pilot=4))
    assert raised.value.kind == "request" and "take one of" in str(raised.value.hint)


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("segfault", "was ended by signal 11 (SIGSEGV)"),
        ("exit", "ended with status 3"),
    ],
)
def test_a_crash_in_the_raw_library_is_a_failure_of_the_job(
    fault: str, words: str, tmp_path: Path
) -> None:
    command = (sys.executable, str(FAULTY), fault)
    engine = started(tmp_path, lambda facts: SpawnedWorker(facts, command))
    try:
        with HeldFolder.at(tmp_path) as parent:
            result = engine.capture(
                REQUEST, job="job", emit=lambda _: None, cancelled=lambda: False, parent=parent
            )
        assert_failed_safely(engine, result, tmp_path)
        assert result.error is not None
        assert result.error["message"] == f"the decoding process {words}"
    finally:
        engine.stop()


def test_a_process_that_was_started_before_is_taken(tmp_path: Path) -> None:
    """And bounded as one that the engine starts itself."""
    first = start_worker()
    try:
        engine = started(tmp_path, partial(SpawnedWorker, child=first))
        assert child_of(engine).pid == first.process.pid
        engine.plan(REQUEST)
        assert child_of(engine).pid == first.process.pid
        bound = resource.prlimit(first.process.pid, resource.RLIMIT_DATA)
        assert bound == (LimitsConfig().work_bytes,) * 2
        engine.stop()
        assert first.process.returncode == -signal.SIGKILL
    finally:
        first.kill()


@pytest.mark.long
def test_a_raw_library_that_hangs_is_ended(tmp_path: Path) -> None:
    command = (sys.executable, str(FAULTY), "hang")
    engine = started(tmp_path, lambda facts: SpawnedWorker(facts, command))
    try:
        engine.plan(REQUEST)  # warm, so that only the hang takes long
        child = child_of(engine)
        child._limits = msgspec.structs.replace(child._limits, work_silent_s=0.5)
        result = bench_rig.capture(engine, REQUEST)
        assert_failed_safely(engine, result, tmp_path / "state" / "captures")
        assert result.error is not None
        assert "no sign of life for 0.5 s" in str(result.error["message"])
    finally:
        engine.stop()


@pytest.mark.long
def test_a_job_that_wants_too_much_memory_fails_and_the_next_one_works(tmp_path: Path) -> None:
    limits = LimitsConfig(min_free_bytes=0, work_bytes=2**28, max_exposure_s=1e5)
    engine = started(tmp_path, limits=limits, grid=(24, 32))
    try:
        before = child_of(engine).pid
        big = CaptureRequest(goal="indirect", family="bernoulli", codes=65536, white=False)
        with pytest.raises(PlanError, match="ran out of memory") as raised:
            engine.plan(big)
        assert "limits.work_bytes" in str(raised.value.hint)
        assert child_of(engine).pid != before
        assert engine.plan(REQUEST).codes == 4
    finally:
        engine.stop()


def test_pictures_are_the_same_in_both_places_byte_for_byte(tmp_path: Path) -> None:
    request = CaptureRequest(goal="direct", codes=72, pilot=8, parts=4, until_error=0.9, seed=3)
    folders: dict[str, Path] = {}
    for place in (Engine.from_config, Engine.with_child):
        folder = tmp_path / place.__name__
        folder.mkdir()
        made = place(bench_rig.config(folder, grid=(8, 8), camera=CameraConfig(seed=1)))
        made.start()
        result = bench_rig.capture(made, request)
        assert result.state == "done", result.error
        made.stop()
        folders[place.__name__] = folder / "state" / "captures" / "job"
    here, there = folders.values()
    files = sorted(p.relative_to(here) for p in here.rglob("*") if p.is_file())
    kept = [f for f in files if f.parts[0] in ("linear", "preview", "probe.npz", "frames.csv")]
    assert len(kept) > 4
    for file in kept:
        assert (here / file).read_bytes() == (there / file).read_bytes(), file
    ours, theirs = read_patterns(here), read_patterns(there)
    assert ours.keys() == theirs.keys()
    assert all(np.array_equal(ours[key], theirs[key]) for key in ours)
    one, other = read_manifest(here), read_manifest(there)
    assert one.realised == other.realised and one.plan == other.plan
    assert one.run.cells == other.run.cells
    figures = [{k: v for k, v in m.summary.items() if k != "wall_s"} for m in (one, other)]
    assert figures[0] == figures[1]


def test_a_folder_named_by_a_descriptor_is_the_same_for_the_child(
    engine: Engine, tmp_path: Path
) -> None:
    child = child_of(engine)
    info = engine._rig.camera_info
    assert info is not None
    child.do(Watch(), Worker.plan, REQUEST, {}, info, None)
    held = os.open(tmp_path, os.O_PATH | os.O_DIRECTORY)
    try:
        child.do(Watch(), Worker.begin, Path(f"/proc/self/fd/{held}"))
    finally:
        os.close(held)
    assert "coded.primal" in read_patterns(tmp_path)


def test_ten_deaths_leave_no_descriptor_and_no_process_behind(tmp_path: Path) -> None:
    engine = started(tmp_path, lambda facts: SpawnedWorker(facts, FOREVER))
    child = child_of(engine)
    try:
        fds = len(list(Path("/proc/self/fd").iterdir()))
        for _ in range(10):
            child._replace()
        assert len(list(Path("/proc/self/fd").iterdir())) == fds
    finally:
        engine.stop()
    assert child.pid is None and child._dying == []
    mine = Path("/proc/self/task")
    children = [f.read_text().split() for f in mine.glob("*/children")]
    names = [Path(f"/proc/{pid}/cmdline").read_bytes() for pids in children for pid in pids]
    assert not any(b"time.sleep(3600)" in name for name in names)
