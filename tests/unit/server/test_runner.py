"""The runner and its one thread: who is run when, what is told in which order, and that every job
ends for those who wait for it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest

from pdcd.errors import BusyError, Cancelled, DeviceLost, PdcdError, RequestError
from pdcd.protocol.events import Attention, Event, Progress, ShotArmed
from pdcd.protocol.messages import ShowParams
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.server.jobs import Job, Owner
from pdcd.server.runner import Runner
from pdcd.server.worker import EngineThread
from tests.coroutines import entered
from tests.processes import LONG_S

WHITE = CaptureRequest(goal="white")
ANNA = Owner(uid=1000, pid=11, user="anna", connection=1)
BERT = Owner(uid=1001, pid=12, user="bert", connection=2)


def progress(frame: int) -> Progress:
    return Progress(shot="coded", frame=frame, frames=9, missed=0)


class Engine:
    """Does what the test says; `asked` is what it was called with."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.shown: list[tuple[str, int]] = []
        self.refuses: PdcdError | None = None
        self.deaf_s = 0.0
        self.act: Callable[..., Any] = lambda **given: self.done(**given)

    def done(self, *, job: str, **_: Any) -> CaptureResult:
        return CaptureResult(job=job, state="done", folder=f"/x/{job}")

    def capture(self, request: CaptureRequest, given: Any, **more: Any) -> Any:
        self.asked.append({"request": request, "given": given, **more})
        return self.act(**more)

    def calibrate(self, request: CalibrateRequest, **more: Any) -> Any:
        return self.act(**more)

    def preview(self, **more: Any) -> Any:
        return self.act(**more)

    def show(self, pattern: str, index: int) -> None:
        self.shown.append((pattern, index))
        if self.refuses is not None and pattern != "black":
            raise self.refuses


class Desk:
    """A runner with its engine; `told` is what was published, by type and job."""

    def __init__(self) -> None:
        self.engine, self.worker = Engine(), EngineThread()
        self.told: list[tuple[str, str]] = []
        self.events: list[Event] = []
        self.runner = Runner(cast(Any, self.engine), self.worker, self._publish)

    def _publish(self, job: Job, event: Event) -> None:
        self.told.append((event.type, job.name))
        self.events.append(event)

    def start(self, owner: Owner = ANNA, request: Any = WHITE, **more: Any) -> Job:
        kinds: dict[object, str] = {ShowParams: "show", CalibrateRequest: "calibrate"}
        kind = kinds.get(type(request), "capture")
        return self.runner.start(request, {}, owner, **{"kind": kind, **more})

    def of(self, job: Job) -> list[str]:
        return [kind for kind, name in self.told if name == job.name]


@asynccontextmanager
async def open_desk() -> AsyncIterator[Desk]:
    """A runner; whatever is left when the test ends must end, too."""
    desk = Desk()
    try:
        async with asyncio.timeout(LONG_S):
            yield desk
    finally:
        await asyncio.wait_for(desk.runner.drain(), LONG_S)
        desk.worker.close()


at_desk = entered(desk=open_desk)


def until_cancelled(*, cancelled: Callable[[], bool], **_: Any) -> Any:
    while not cancelled():
        threading.Event().wait(0.001)
    raise Cancelled("cancelled")


@at_desk
async def test_a_job_that_waits_and_is_cancelled_at_once_is_only_told_to_have_ended(
    desk: Desk,
) -> None:
    desk.engine.act = until_cancelled
    first, second = desk.start(), desk.start(queue=True)
    result = await desk.runner.cancel(second.name)
    assert result.state == "cancelled" and result.error is not None
    await asyncio.sleep(0)
    assert desk.of(second) == ["cancelled"]
    assert first.state == "running"
    again = await desk.runner.cancel(second.name)  # harmless on one that has ended
    assert again == result and desk.of(second) == ["cancelled"]


@pytest.mark.parametrize(
    ("error", "state", "kind"),
    [
        (DeviceLost("gone", device="camera", hint="plug it in"), "failed", "device_lost"),
        (Cancelled("enough"), "cancelled", "cancelled"),
        (ZeroDivisionError("by nothing"), "failed", "internal"),
    ],
)
@at_desk
async def test_an_engine_that_raises_ends_its_job_and_the_next_one_runs(
    desk: Desk, error: Exception, state: str, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(**_: Any) -> Any:
        desk.engine.act = desk.engine.done
        raise error

    desk.engine.act = fail
    job, following = desk.start(), desk.start(queue=True)
    result = await desk.runner.wait(job.name)
    assert result.error is not None and (result.state, result.error["kind"]) == (state, kind)
    assert (await desk.runner.wait(following.name)).state == "done"
    assert ("engine raised" in caplog.text) == (kind == "internal")
    assert desk.runner.table.running is None
    assert (await desk.runner.wait(desk.start().name)).state == "done"


@pytest.mark.parametrize("state", ["running", "queued"])
@at_desk
async def test_an_engine_that_returns_from_a_job_that_goes_on_has_failed(
    desk: Desk, state: Any
) -> None:
    desk.engine.act = lambda job, **_: CaptureResult(job=job, state=state)
    result = await desk.runner.wait(desk.start().name)
    assert result.error is not None
    assert result.error["message"] == f"the engine returned in state {state}"


@at_desk
async def test_what_could_not_be_sent_fails_the_job_and_nobody_else(desk: Desk) -> None:
    desk.engine.act = lambda job, **_: CaptureResult(
        job=job, state="done", summary={"codes": cast(Any, object())}
    )
    assert (await desk.runner.wait(desk.start().name)).state == "failed"
    desk.engine.act = lambda emit, **_: emit(ShotArmed(shot="coded", frames=cast(Any, "many")))
    assert (await desk.runner.wait(desk.start().name)).state == "failed"


@at_desk
async def test_progress_that_is_held_back_comes_before_what_follows_it(desk: Desk) -> None:
    def tell(*, job: str, emit: Callable[[Event], None], **_: Any) -> CaptureResult:
        for frame in (1, 2, 3):
            emit(progress(frame))
        emit(ShotArmed(shot="b", frames=9))
        emit(progress(4))
        return desk.engine.done(job=job)

    desk.engine.act = tell
    await desk.runner.wait(desk.start().name)
    told = [getattr(event, "frame", event.type) for event in desk.events]
    assert told == ["queued", 1, 3, "armed", 4, "done"]
    times = [event.t_mono_ns for event in desk.events]
    assert times == sorted(times) and times[0] > 0


@at_desk
async def test_every_word_of_the_engine_is_a_sign_of_life(desk: Desk) -> None:
    beats = []

    def work(*, job: str, emit: Any, cancelled: Callable[[], bool], **_: Any) -> Any:
        for step in (lambda: emit(progress(1)), cancelled, lambda: emit(progress(2))):
            step()
            beats.append(desk.worker.beats)
        return desk.engine.done(job=job)

    desk.engine.act = work
    await desk.runner.wait(desk.start().name)
    assert beats == [1, 2, 3]


@at_desk
async def test_a_calibration_goes_on_when_told_and_not_by_what_was_said_before_it_asked(
    desk: Desk,
) -> None:
    passed: list[str] = []
    asks = threading.Event()

    def work(*, job: str, emit: Any, proceed: Any, **_: Any) -> CaptureResult:
        for text in ("card", "lens"):
            emit(Attention(text=text))
            asks.set()
            proceed(text)
            passed.append(text)
        return desk.engine.done(job=job)

    desk.engine.act = work
    job = desk.start(request=CalibrateRequest())
    job.proceed_flag.set()  # too early
    await asyncio.to_thread(asks.wait, LONG_S)
    await asyncio.sleep(0.02)
    assert passed == []
    asks.clear()
    assert desk.runner.proceed(job.name) is job
    await asyncio.to_thread(asks.wait, LONG_S)
    assert passed == ["card"]
    await desk.runner.cancel(job.name)  # whoever cancels need not proceed
    assert passed == ["card", "lens"]
    desk.runner.proceed(job.name)
    with pytest.raises(RequestError):
        desk.runner.proceed("none")


@at_desk
async def test_a_picture_that_is_cancelled_before_its_turn_is_never_shown(desk: Desk) -> None:
    job = desk.start(request=ShowParams(pattern="white"))
    assert (await desk.runner.cancel(job.name)).state == "cancelled"
    assert ("white", 0) not in desk.engine.shown


@at_desk
async def test_a_picture_that_fails_half_way_goes_black_and_tells_who_asked(desk: Desk) -> None:
    desk.engine.refuses = DeviceLost("gone", device="display")
    job = desk.start(request=ShowParams(pattern="grid"))
    with pytest.raises(DeviceLost, match="gone"):
        await desk.runner.answer(job.name)
    assert desk.engine.shown == [("grid", 0), ("black", 0)]
    assert job.state == "failed"


@at_desk
async def test_a_cancel_is_answered_while_a_device_does_not_let_itself_be_made_safe(
    desk: Desk,
) -> None:
    closed = threading.Event()

    def drawn_out(*, cancelled: Callable[[], bool], **_: Any) -> Any:
        while not cancelled():
            threading.Event().wait(0.001)
        desk.engine.deaf_s = 60.0
        assert closed.wait(LONG_S)
        desk.engine.deaf_s = 0.0
        raise Cancelled("cancelled")

    desk.engine.act = drawn_out
    job, waits = desk.start(), desk.start(queue=True)
    told = await desk.runner.cancel(job.name)
    assert told.state == "running" and "until the job has ended" in told.warnings[0]
    assert desk.of(job) == ["queued"] and not job.ended.is_set()
    assert (await desk.runner.cancel(waits.name)).state == "cancelled"  # it has no device
    closed.set()
    assert (await desk.runner.wait(job.name)).state == "cancelled"
    assert (await desk.runner.cancel(job.name)).state == "cancelled"


@at_desk
async def test_whoever_waits_hears_of_an_end_once_and_nothing_of_it_is_kept(desk: Desk) -> None:
    desk.engine.act = until_cancelled
    runs, waits = desk.start(), desk.start(queue=True)
    waiting = [asyncio.create_task(desk.runner.wait(job.name)) for job in (runs, runs, waits)]
    await asyncio.sleep(0)
    for job in (waits, runs):
        await desk.runner.cancel(job.name)
    results = await asyncio.gather(*waiting)
    assert [result.job for result in results] == [runs.name, runs.name, waits.name]
    assert [kind for kind, _ in desk.told].count("cancelled") == 2


@at_desk
async def test_a_job_that_comes_in_the_turn_in_which_another_ends_is_run_once(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the one to run before it has been announced."""

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


@at_desk
async def test_a_job_whose_outcome_is_lost_ends_and_the_engine_is_told_to_stop(desk: Desk) -> None:
    call, test_ended, calls = desk.worker.call, threading.Event(), list[asyncio.Future[Any]]()

    def work(*, job: str, cancelled: Callable[[], bool], **_: Any) -> CaptureResult:
        desk.engine.act = desk.engine.done
        while not cancelled() and not test_ended.wait(0.001):
            pass
        return desk.engine.done(job=job)

    async def lose_outcome(*asked: Any) -> Any:
        cast(Any, desk.worker).call = call
        calls.append(asyncio.ensure_future(call(*asked)))
        raise asyncio.CancelledError

    desk.engine.act = work
    cast(Any, desk.worker).call = lose_outcome
    try:
        job, following = desk.start(), desk.start(queue=True)
        result = await desk.runner.wait(job.name)
        assert result.state == "failed" and result.error is not None
        async with asyncio.timeout(LONG_S / 2):
            assert (await desk.runner.wait(following.name)).state == "done"
            await calls[0]
    finally:
        test_ended.set()


@at_desk
async def test_a_daemon_that_stops_takes_nothing_more_and_waits_for_what_runs(desk: Desk) -> None:
    desk.engine.act = until_cancelled
    runs, waits = desk.start(), desk.start(queue=True)
    await asyncio.sleep(0)
    await desk.runner.drain()
    assert (runs.state, waits.state) == ("cancelled", "cancelled")
    assert len(desk.engine.asked) == 1
    assert [desk.of(job)[-1] for job in (runs, waits)] == ["cancelled"] * 2
    with pytest.raises(BusyError, match="stopping"):
        desk.start()
