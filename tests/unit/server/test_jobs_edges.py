"""The job table at its edges: what is kept, who gives way, and what a refusal says."""

from __future__ import annotations

from typing import Any, cast

import pytest

from pdcd.errors import BusyError, Cancelled, RequestError
from pdcd.protocol.events import Progress
from pdcd.protocol.messages import ShowParams
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.server.jobs import (
    PROGRESS_INTERVAL_NS,
    Coalescer,
    Job,
    JobTable,
    Owner,
    make_failed_result,
)

WHITE = CaptureRequest(goal="white")
ANNA = Owner(uid=1000, pid=11, user="anna", connection=1)
AGAIN = Owner(uid=1000, pid=13, user="anna", connection=3)
BERT = Owner(uid=1001, pid=12, user="bert", connection=2)
SHOW = ShowParams(pattern="grid")


class Place:
    def __init__(self) -> None:
        self.closed = 0

    def close(self) -> None:
        self.closed += 1


def admit(table: JobTable, owner: Owner = ANNA, request: Any = WHITE, **more: Any) -> Job:
    return table.admit(request, {}, owner, **{"queue": True, "detach": False, **more})


def ended(table: JobTable, job: Job) -> Job | None:
    return table.finish(job, CaptureResult(job=job.name, state="done", folder=f"/x/{job.name}"))


def frame(number: int) -> Progress:
    return Progress(shot="coded", frame=number, frames=1000, missed=0)


def test_64_jobs_wait_and_64_that_ended_are_kept_of_each_kind() -> None:
    table = JobTable()
    jobs = [admit(table) for _ in range(65)]
    with pytest.raises(BusyError, match="64 jobs are waiting already") as caught:
        admit(table)
    assert caught.value.hint == "wait until some have ended"
    for job in jobs:
        ended(table, job)
    assert table.all() == jobs[1:]
    with pytest.raises(RequestError, match=f"no job '{jobs[0].name}'") as gone:
        table.get(jobs[0].name)
    assert "the last 64" in str(gone.value.hint)
    plan = admit(table, kind="plan")
    ended(table, plan)
    assert table.all() == [*jobs[1:], plan]  # of another kind


def test_what_a_job_is_about_is_told_in_a_word() -> None:
    goals = [
        admit(JobTable(), request=request).goal
        for request in (
            WHITE, SHOW, CalibrateRequest(), CalibrateRequest(steps=("timing", "check")),
        )
    ]  # fmt: skip
    assert goals == ["white", "grid", "all", "timing check"]


def test_a_job_that_ended_lets_go_of_what_it_was_given() -> None:
    table, places = JobTable(), [Place(), Place()]
    runs, waits = (
        table.admit(
            WHITE, {"kernel": cast(Any, 1)}, ANNA, detach=False, queue=True, place=cast(Any, place)
        )
        for place in places
    )
    assert runs.given and waits.given
    assert table.cancel(waits)
    assert [place.closed for place in places] == [0, 1] and not waits.given
    assert waits.result is not None and waits.result.error == {
        "kind": "cancelled", "message": "cancelled before it began", "device": None,
        "hint": "the rig was not touched",
    }  # fmt: skip
    assert ended(table, runs) is None
    assert [place.closed for place in places] == [1, 1] and not runs.given
    assert not table.cancel(waits) and waits.cancel_flag.is_set()


def test_jobs_are_told_apart_though_they_are_alike() -> None:
    table = JobTable()
    first, second = admit(table), admit(table)
    assert first != second and len({first, second}) == 2
    assert len({admit(table).name for _ in range(20)}) == 20
    with pytest.raises(AttributeError):
        ANNA.uid = 0  # type: ignore[misc]


def test_a_view_tells_the_whole_job() -> None:
    table = JobTable()
    job = admit(table, kind="plan", detach=True)
    view = job.view()
    assert (view.job, view.state, view.kind, view.detach) == (job.name, "running", "plan", True)
    assert view.created_utc == job.created_utc and view.created_utc.endswith("Z")
    assert len(view.created_utc) == len("2026-01-01T00:00:00Z") and view.folder is None
    ended(table, job)
    assert (job.view().state, job.view().folder) == ("done", f"/x/{job.name}")


def test_a_picture_gives_way_to_its_user_from_anywhere_once() -> None:
    table = JobTable()
    show = admit(table, request=SHOW, kind="show")
    assert show.gives_way_to(AGAIN) and not show.gives_way_to(BERT)
    assert not admit(JobTable(), request=WHITE).gives_way_to(ANNA)
    other = admit(table, BERT)
    mine = admit(table, AGAIN, queue=False)  # needs no place in the queue
    assert [*table.queue] == [mine, other]
    show.given_up = True
    with pytest.raises(BusyError):
        admit(table, queue=False)
    last = admit(table)
    assert [*table.queue] == [mine, other, last]
    assert ended(table, show) is mine


def test_a_picture_that_was_given_up_for_one_that_is_gone_gives_way_again() -> None:
    table = JobTable()
    show = admit(table, request=SHOW, kind="show")
    show.given_up = True
    mine = admit(table, queue=False)
    assert [*table.queue] == [mine]


def test_a_refusal_says_who_holds_the_rig_and_how_to_wait() -> None:
    table = JobTable()
    assert table.busy().message == "the rig is busy" and table.busy().hint
    holder = admit(table, request=SHOW, kind="show")
    error = table.busy()
    assert error.message == f"job {holder.name} (show) of anna (uid 1000) holds the rig"
    assert '"queue": true' in str(error.hint)
    table.stopping = True
    with pytest.raises(BusyError, match="the daemon is stopping") as caught:
        admit(table)
    assert caught.value.hint == "ask again in a moment"


def test_the_result_of_a_fault_says_that_it_is_one() -> None:
    job = admit(JobTable())
    fault = make_failed_result(job, ValueError("oops"))
    assert (fault.job, fault.state) == (job.name, "failed")
    assert fault.error == {
        "kind": "internal", "message": "ValueError: oops", "device": None,
        "hint": "a fault of the program: see the daemon's log",
    }  # fmt: skip
    cancelled = make_failed_result(job, Cancelled("enough", hint="h")).error
    assert cancelled is not None and (cancelled["message"], cancelled["hint"]) == ("enough", "h")


def test_thinned_events_come_ten_times_a_second_at_most() -> None:
    assert PROGRESS_INTERVAL_NS == 10**8
    thin = Coalescer()
    assert thin.offer(0, frame(0)) == frame(0)
    assert thin.offer(10**8 - 1, frame(1)) is None
    assert thin.offer(10**8, frame(2)) == frame(2)


def test_what_was_flushed_is_told_once_and_takes_no_turn() -> None:
    thin = Coalescer(interval_ns=100)
    assert thin.flush() is None and thin.due(0) is None
    thin.offer(0, frame(0))
    thin.offer(60, frame(1))
    assert thin.wants_timer() and thin.timed
    assert thin.flush() == (60, frame(1))
    assert thin.due(70) is None and not thin.timed  # the timer finds nothing, and ends
    assert not thin.wants_timer()
    assert thin.offer(100, frame(2)) == frame(2)
