"""The job table: who runs, who waits, what ends and what is kept; how progress is thinned."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import BusyError, RequestError
from pdcd.protocol.events import PilotLearning, Progress, make_end_event
from pdcd.protocol.messages import MAX_LINE, ShowParams
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.server.jobs import (
    ENDED,
    Job,
    JobTable,
    Owner,
)
from pdcd.server.protocol import encode_notification, encode_reply
from pdcd.server.thinning import Coalescer

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


def finish(table: JobTable, job: Job) -> Job | None:
    """The job that is next when this one has ended; each step is made twice, as after an error."""
    for _ in range(2):
        table.end(job, done(job))
    for _ in range(2):
        table.release(job)
    return table.take_turn()


def frame(number: int) -> Progress:
    return Progress(shot="coded", frame=number, frames=1000, missed=0)


def test_64_jobs_wait_and_64_that_ended_are_kept_of_each_kind() -> None:
    table = JobTable()
    jobs = [admit(table) for _ in range(65)]
    with pytest.raises(BusyError, match="64 jobs are waiting already") as caught:
        admit(table)
    assert caught.value.hint == "wait until some have ended"
    for job in jobs:
        finish(table, job)
    assert table.all() == jobs[1:]
    with pytest.raises(RequestError, match=f"no job '{jobs[0].name}'") as gone:
        table.get(jobs[0].name)
    assert "the last 64" in str(gone.value.hint)
    plan = admit(table, kind="plan")
    finish(table, plan)
    assert table.all() == [*jobs[1:], plan]  # of another kind


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
    assert finish(table, runs) is None
    assert [place.closed for place in places] == [1, 1] and not runs.given
    assert not table.cancel(waits) and waits.cancel_flag.is_set()


def test_a_view_tells_the_whole_job() -> None:
    table = JobTable()
    job = admit(table, kind="plan", detach=True)
    view = job.view()
    assert (view.job, view.state, view.kind, view.detach) == (job.name, "running", "plan", True)
    assert view.created_utc == job.created_utc and view.created_utc.endswith("Z")
    assert len(view.created_utc) == len("2026-01-01T00:00:00Z") and view.folder is None
    finish(table, job)
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
    assert finish(table, show) is mine


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


def done(job: Job) -> CaptureResult:
    return CaptureResult(job=job.name, state="done", folder=f"/x/{job.name}")


def test_events_are_numbered_by_job_and_cannot_be_relabelled() -> None:
    table = JobTable()
    first, second = admit(table), admit(table)
    assert [first.numbered(PilotLearning(photos=8), 5).seq for _ in range(3)] == [0, 1, 2]
    event = second.numbered(PilotLearning(photos=8, job="other", seq=99, t_mono_ns=3), 7)
    assert event == PilotLearning(photos=8, job=second.name, seq=0, t_mono_ns=7)


LONG = "x" * MAX_LINE


@pytest.mark.parametrize(
    ("long", "kept"),
    [
        ({"files": tuple(f"raw/coded-{n}.dng" for n in range(70_000))}, {"summary": {"codes": 8}}),
        ({"warnings": (LONG, "late")}, {"summary": {"codes": 8}}),
        ({"error": {"kind": "sync", "message": LONG, "device": None, "hint": "mend it"}}, {}),
        ({"summary": {"method": LONG}}, {"summary": {}}),
        ({"files": ("\udce9" * (MAX_LINE // 5),)}, {}),
    ],
)
def test_an_end_can_always_be_told(long: dict[str, Any], kept: dict[str, Any]) -> None:
    table = JobTable()
    job = admit(table)
    fields: dict[str, Any] = {"summary": {"codes": 8}, "folder": "/x", **long}
    told = table.end(job, CaptureResult(job=job.name, state="failed", **fields))
    for line in (
        encode_reply("i" * 128, told),
        encode_notification("event", job.numbered(make_end_event(told), 2**62)),
    ):
        assert len(line) <= MAX_LINE
    assert told is job.result and (told.folder, told.files) == ("/x", ())
    assert told.warnings[-1].startswith(f"{len(fields.get('files', ()))} files, and")
    assert kept.items() <= msgspec.to_builtins(told).items()
    assert told.error is None or (told.error["kind"], told.error["hint"]) == ("sync", "mend it")


def test_progress_is_thinned_to_the_interval_and_the_newest_wins() -> None:
    thin = Coalescer(interval_ns=100)
    passed = [t for t in range(0, 1000, 7) if thin.offer(t, frame(t)) is not None]
    assert passed[0] == 0
    assert min(b - a for a, b in pairwise(passed)) >= 100
    assert len(passed) == 10
    assert thin.flush() == (994, frame(994))
    assert thin.flush() is None


def test_what_is_held_goes_out_by_a_timer_and_no_sooner_than_others() -> None:
    thin = Coalescer(interval_ns=100)
    assert not thin.wants_timer()
    thin.offer(0, frame(0))
    thin.offer(50, frame(1))
    assert thin.wants_timer() and not thin.wants_timer()
    assert thin.due(99) is None and thin.timed
    assert thin.due(100) == (50, frame(1)) and not thin.timed
    assert thin.offer(150, frame(2)) is None  # one has just gone out
    assert thin.wants_timer()
    assert thin.offer(200, frame(3)) == frame(3)
    assert thin.due(201) is None and not thin.timed


@settings(max_examples=50)
@given(st.lists(st.sampled_from(["admit", "finish", "cancel first", "cancel last"]), max_size=30))
def test_never_two_at_a_time_and_never_out_of_an_end(steps: list[str]) -> None:
    table = JobTable(history=100)
    ended: dict[str, str] = {}
    for step in steps:
        if step == "admit":
            admit(table)
        elif step == "finish" and table.running is not None:
            finish(table, table.running)
        elif step.startswith("cancel") and table.all():
            table.cancel(table.all()[0 if step == "cancel first" else -1])
        running = [job for job in table.all() if job.state == "running"]
        assert running == ([] if table.running is None else [table.running])
        assert [job for job in table.all() if job.state == "queued"] == list(table.queue)
        assert table.running is not None or not table.queue
        for job in table.all():
            if job.name in ended:
                assert job.state == ended[job.name]
            elif job.state in ENDED:
                ended[job.name] = job.state
                assert job.result is not None and job.result.state == job.state
