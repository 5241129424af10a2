"""The runner where time and order matter: what the engine gets, timers, and the ends of jobs."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pdcd.errors import PdcdError
from pdcd.protocol.events import Event, Progress, ShotArmed
from pdcd.protocol.messages import ShowParams
from pdcd.protocol.plan_summary import PlanSummary, ShotSummary
from pdcd.protocol.request import CalibrateRequest
from pdcd.protocol.result import CaptureResult
from pdcd.server import runner as module
from tests.processes import LONG_S
from tests.unit.server.test_runner import ANNA, BERT, PHOTO, WHITE, Desk, play, until_cancelled


def progress(frame: int) -> Progress:
    return Progress(shot="coded", frame=frame, frames=9, missed=0)


def summary(codes: int) -> PlanSummary:
    shot = ShotSummary(name="white", codes=codes, refreshes=8, exposure_s=1.0, light_share=0.25)
    return PlanSummary(
        goal="white", family="hadamard", codes=codes, p=0.0, grid=(4, 6), window="whole",
        guards=True, passes=1, shots=(shot,), refreshes=8, seconds=1.0, light_share=0.25,
        raw_files=1,
    )  # fmt: skip


class Place:
    """Stands for a held folder."""

    def __init__(self) -> None:
        self.closed = 0

    def close(self) -> None:
        self.closed += 1


def test_a_capture_gets_its_arrays_and_its_place_which_is_let_go_of_at_its_end() -> None:
    async def scene(desk: Desk) -> None:
        place, given = Place(), {"kernel": cast(Any, object())}
        job = desk.runner.start(WHITE, given, ANNA, place=cast(Any, place))
        assert not job.detach and job.kind == "capture"
        await desk.runner.wait(job.name)
        (asked,) = desk.engine.asked
        assert asked["given"] is given and asked["parent"] is place and asked["report"] is True
        assert {"emit", "cancelled"} < asked.keys()
        assert place.closed == 1 and not job.given

    play(scene)


def test_a_plan_is_asked_for_with_its_arrays_and_answered() -> None:
    async def scene(desk: Desk) -> None:
        asked: list[Any] = []

        def plan(request: Any, given: Any, *, emit: Any, cancelled: Any) -> PlanSummary:
            asked.append((request, given, cancelled()))
            emit(progress(1))
            return summary(7)

        desk.engine.plan = plan  # type: ignore[attr-defined]
        given = {"kernel": cast(Any, object())}
        job = desk.runner.start(WHITE, given, BERT, kind="plan")
        assert await desk.runner.answer(job.name) == summary(7)
        assert asked == [(WHITE, given, False)]
        assert (await desk.runner.wait(job.name)).state == "done"
        assert desk.of(job) == ["queued", "progress", "done"]

    play(scene)


def test_a_quick_photo_and_a_calibration_get_what_they_need() -> None:
    async def scene(desk: Desk) -> None:
        got: list[dict[str, Any]] = []

        def act(**more: Any) -> Any:
            got.append(more)
            return PHOTO if "owner" in more else desk.engine.done(job=more["job"])

        desk.engine.act = act
        photo = desk.start(BERT, kind="preview")
        await desk.runner.answer(photo.name)
        steps = desk.start(BERT, CalibrateRequest())
        await desk.runner.wait(steps.name)
        assert [set(more) for more in got] == [
            {"job", "owner", "emit", "cancelled"}, {"job", "emit", "cancelled", "proceed"},
        ]  # fmt: skip
        assert (got[0]["owner"], got[0]["job"]) == (BERT.view(), photo.name)
        assert got[1]["job"] == steps.name and steps.goal == "all"

    play(scene)


class Hurried:
    """A loop whose timers come at once, once all is emitted, and a clock that moves by half their
    time each."""

    def __init__(self, patch: pytest.MonkeyPatch, emitted: threading.Event) -> None:
        self.delays: list[float] = []
        self.now_ns = 10**9
        loop = asyncio.get_running_loop()

        def call_later(delay: float, call: Callable[[], object]) -> object:
            assert emitted.wait(LONG_S)
            self.delays.append(delay)

            def due() -> None:
                self.now_ns += 50_000_000
                call()

            return loop.call_soon(due)

        patch.setattr(loop, "call_later", call_later)
        patch.setattr(module, "time", SimpleNamespace(monotonic_ns=lambda: self.now_ns))


def test_what_is_held_back_is_told_in_time_though_nothing_follows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    emitted, told = threading.Event(), threading.Event()
    kept: list[Hurried] = []

    def tell(*, job: str, emit: Callable[[Event], None], **_: Any) -> CaptureResult:
        emit(progress(1))
        emit(progress(2))
        emit(progress(3))
        emitted.set()
        assert told.wait(LONG_S)
        return CaptureResult(job=job, state="done")

    async def scene(desk: Desk) -> None:
        publish = desk._publish

        def heard(job: Any, event: Event) -> None:
            publish(job, event)
            if getattr(event, "frame", 0) == 3:
                told.set()

        monkeypatch.setattr(desk.runner, "_publish", heard)
        with monkeypatch.context() as patch:
            kept.append(Hurried(patch, emitted))
            desk.engine.act = tell
            await desk.runner.wait(desk.start().name)
        assert [getattr(e, "frame", e.type) for e in desk.events] == ["queued", 1, 3, "done"]

    play(scene)
    # One timer at a time: it comes again where it came too early.
    assert kept[0].delays == pytest.approx([0.1, 0.1])


def test_no_timer_runs_on_after_what_it_was_for_has_been_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept: list[Hurried] = []
    emitted = threading.Event()

    async def scene(desk: Desk) -> None:
        def tell(*, job: str, emit: Callable[[Event], None], **_: Any) -> CaptureResult:
            emit(progress(1))
            emit(progress(2))
            emit(ShotArmed(shot="next", frames=9))
            emitted.set()
            return CaptureResult(job=job, state="done")

        with monkeypatch.context() as patch:
            kept.append(Hurried(patch, emitted))
            desk.engine.act = tell
            await desk.runner.wait(desk.start().name)
            for _ in range(10):
                await asyncio.sleep(0)
        told = [getattr(e, "frame", e.type) for e in desk.events]
        assert told == ["queued", 1, 2, "armed", "done"]

    play(scene)
    assert len(kept[0].delays) == 1


def test_a_calibration_that_waits_looks_ten_times_a_second_whether_it_is_to_end() -> None:
    class Flag(threading.Event):
        looks: list[float | None]

        def wait(self, timeout: float | None = None) -> bool:
            self.looks.append(timeout)
            return len(self.looks) > 3

    async def scene(desk: Desk) -> None:
        flag, beats = Flag(), []
        flag.looks = []

        def work(*, job: str, proceed: Callable[[str], None], **_: Any) -> CaptureResult:
            proceed("put up the card")
            beats.append(desk.worker.beats)
            return desk.engine.done(job=job)

        desk.engine.act = work
        job = desk.start(request=CalibrateRequest())
        job.proceed_flag = flag
        await desk.runner.wait(job.name)
        assert flag.looks == [0.1] * 4 and beats == [3]  # each look is a sign of life

    play(scene)


def test_a_job_of_which_nothing_is_known_is_waited_for_in_vain() -> None:
    async def scene(desk: Desk) -> None:
        job = desk.runner.table.admit(WHITE, {}, ANNA, detach=False, queue=False)
        with pytest.raises(PdcdError, match="ended without a result"):
            await desk.runner.wait(job.name)
        with pytest.raises(PdcdError):
            await desk.runner.answer(job.name)
        desk.runner.table.finish(job, CaptureResult(job=job.name, state="done"))

    play(scene)


def test_a_capture_has_no_answer_but_its_result() -> None:
    async def scene(desk: Desk) -> None:
        job = desk.start()
        with pytest.raises(PdcdError):
            await desk.runner.answer(job.name)
        assert (await desk.runner.wait(job.name)).state == "done"

    play(scene)


def test_whoever_waits_hears_of_an_end_once_and_nothing_of_it_is_kept() -> None:
    async def scene(desk: Desk) -> None:
        desk.engine.act = until_cancelled
        runs, waits = desk.start(), desk.start(queue=True)
        waiting = [asyncio.create_task(desk.runner.wait(job.name)) for job in (runs, runs, waits)]
        await asyncio.sleep(0)
        for job in (waits, runs):
            await desk.runner.cancel(job.name)
        results = await asyncio.gather(*waiting)
        assert [result.job for result in results] == [runs.name, runs.name, waits.name]
        for marks in (desk.runner._ended, desk.runner._answered, desk.runner._let_go):
            assert not marks
        assert [kind for kind, _ in desk.told].count("cancelled") == 2

    play(scene)


def test_a_picture_that_ends_for_the_next_job_of_its_owner_is_done_and_black_first() -> None:
    async def scene(desk: Desk) -> None:
        seen: list[list[tuple[str, int]]] = []

        def act(*, job: str, **_: Any) -> CaptureResult:
            seen.append([*desk.engine.shown])
            return desk.engine.done(job=job)

        desk.engine.act = act
        picture = desk.start(request=ShowParams(pattern="checker"))
        await desk.runner.answer(picture.name)
        await desk.runner.wait(desk.start().name)
        assert seen == [[("checker", 0), ("black", 0)]]
        assert picture.given_up and picture.state == "done"

    play(scene)


def test_a_job_that_comes_in_the_turn_in_which_another_ends_is_run_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is the one to run before it has been announced."""

    async def scene(desk: Desk) -> None:
        late: list[Any] = []
        call = desk.worker.call

        async def and_one_more(*args: Any) -> Any:
            result = await call(*args)
            if not late:
                late.append(desk.start(queue=True))
            return result

        monkeypatch.setattr(desk.worker, "call", and_one_more)
        first = desk.start()
        await desk.runner.wait(first.name)
        assert (await desk.runner.wait(late[0].name)).state == "done"
        await desk.runner.drain()
        assert [asked["job"] for asked in desk.engine.asked] == [first.name, late[0].name]
        assert desk.of(late[0]).count("done") == 1

    play(scene)
