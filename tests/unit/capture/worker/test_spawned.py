"""The daemon's side of the worker, against a stand-in that this thread plays itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import Config
from pdcd.capture.worker import spawned
from pdcd.capture.worker.answers import RigFacts
from pdcd.capture.worker.calls import (
    LifeSign,
    StopCall,
    TaskCall,
    TaskFailure,
    TaskResult,
    start_worker,
)
from pdcd.capture.worker.spawned import SpawnedWorker
from pdcd.capture.worker.work import SPENT
from pdcd.capture.worker.worker import Worker
from pdcd.child import PICKLES, REAP_S, MessageLine
from pdcd.errors import Cancelled, DecodeError, PdcdError, PlanError, RequestError
from pdcd.watch import Watch
from tests.child_rig import Children, Process, stand_ins


class Other:
    """The far end of whichever worker was started last."""

    def __init__(self, children: Children) -> None:
        self.children = children
        self._lines: dict[int, MessageLine[Any]] = {}

    @property
    def processes(self) -> list[Process]:
        return self.children.started

    @property
    def line(self) -> MessageLine[Any]:
        last = self.children.last
        if last.pid not in self._lines:
            self._lines[last.pid] = last.line(PICKLES)
        return self._lines[last.pid]

    def heard(self) -> list[Any]:
        found = []
        while self.line.wait(0.0):
            found.append(self.line.receive())
        return found

    def say(self, *messages: object) -> None:
        for message in messages:
            self.line.send(message)

    def die(self, status: int | None) -> None:
        self.children.last.die(status)


@pytest.fixture
def other(monkeypatch: pytest.MonkeyPatch) -> Iterator[Other]:
    monkeypatch.setattr("pdcd.child.LOOK_INTERVAL_S", 0.001)
    monkeypatch.setattr(spawned, "STOP_S", 0.02)
    for children in stand_ins(monkeypatch):
        yield Other(children)


@pytest.fixture
def worker(other: Other) -> Iterator[SpawnedWorker]:
    limits = msgspec.structs.replace(Config().limits, work_silent_s=0.05)
    profile: Any = None
    facts = RigFacts(msgspec.structs.replace(Config(), limits=limits), profile, (3, 4), None)
    made = SpawnedWorker(facts, ("program",), start_worker(("program",)))
    yield made
    for process in other.processes:
        process.stubborn = False
    made.stop()


FLIP: Any = Worker.head
PLAN: Any = Worker.plan
ANSWERED: Any = Worker.answered
"""Tasks with and without a job before; what they do in truth is of no matter here."""


def when_asked(other: Other, *answers: object, then: Callable[[], object] | None = None) -> Watch:
    """A watch by which the other end answers once it has been asked."""
    heard: list[Any] = []

    def alive() -> None:
        found = other.heard()
        if any(isinstance(one, TaskCall) for one in found):
            other.say(*answers)
            if then is not None:
                then()
        heard.extend(found)

    watch = Watch(alive)
    watch.heard = heard  # type: ignore[attr-defined]
    return watch


def heard_by(watch: Watch) -> list[Any]:
    found: list[Any] = watch.heard  # type: ignore[attr-defined]
    return found


def test_facts_are_told_once_and_each_call_is_answered(worker: SpawnedWorker, other: Other) -> None:
    for number in (1, 2):
        watch = when_asked(other, TaskResult(number))
        assert worker.do(watch, FLIP, "folder", raw="a") == number
        kinds = [type(one) for one in heard_by(watch)]
        assert kinds == ([RigFacts, TaskCall] if number == 1 else [TaskCall])
        assert heard_by(watch)[-1] == TaskCall("head", ("folder",), {"raw": "a"})
    assert worker.pid == 100 and len(other.processes) == 1


def test_signs_tell_how_far_it_is_only_where_they_know(worker: SpawnedWorker, other: Other) -> None:
    watch, steps = when_asked(other, LifeSign(), LifeSign(1.0, 4.0, "codes"), TaskResult(None)), []
    watch._step = lambda *told: steps.append((*told, watch.stage))
    worker.do(watch, ANSWERED)
    assert steps == [(1.0, 4.0, "codes")]


@pytest.mark.parametrize("spent", [False, True])
def test_a_task_that_failed_raises_and_a_spent_process_is_replaced(
    worker: SpawnedWorker, other: Other, spent: bool
) -> None:
    with pytest.raises(RequestError, match="no such"):
        worker.do(when_asked(other, TaskFailure(RequestError("no such"), spent)), ANSWERED)
    assert ("kill" in other.processes[0].done) == spent and worker.pid == 100 + spent


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "ended with status 0"),
        (3, "ended with status 3"),
        (-11, r"was ended by signal 11 \(SIGSEGV\)"),
        (-99, r"was ended by signal 99 \(.*see"),
        (None, "closed its end"),
        (SPENT, "ran out of memory"),
    ],
)
@pytest.mark.parametrize("task", [ANSWERED, PLAN])
def test_a_death_is_told_in_words_and_the_next_one_is_ready(
    worker: SpawnedWorker, other: Other, status: Any, words: str, task: Any
) -> None:
    kind = PlanError if task is PLAN else DecodeError
    with pytest.raises(kind, match=words):
        worker.do(when_asked(other, then=lambda: other.die(status)), task)
    assert worker.pid == 101 and other.processes[0].returncode == (-9 if status is None else status)
    assert worker.do(when_asked(other, TaskResult(7)), PLAN) == 7


def test_a_death_between_jobs_is_no_ones_and_amid_a_job_is_told(
    worker: SpawnedWorker, other: Other
) -> None:
    other.processes[0].returncode = 3
    with pytest.raises(DecodeError, match="ended with status 3"):
        worker.do(Watch(), ANSWERED)
    other.processes[1].returncode = 3
    assert worker.do(when_asked(other, TaskResult(1)), PLAN) == 1
    assert worker.pid == 102


def test_a_process_that_is_silent_too_long_is_killed(worker: SpawnedWorker, other: Other) -> None:
    with pytest.raises(DecodeError, match=r"no sign of life for 0\.05 s"):
        worker.do(Watch(), ANSWERED)
    assert "kill" in other.processes[0].done and worker.pid == 101


def test_signs_of_life_keep_a_long_task_alive(worker: SpawnedWorker, other: Other) -> None:
    now_s, told = 0.0, 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pdcd.child.time.monotonic", lambda: now_s)

        def alive() -> None:
            nonlocal now_s, told
            now_s += 0.04
            told += 1
            other.say(TaskResult(None) if told == 9 else LifeSign())

        worker.do(Watch(alive), ANSWERED)
    assert told >= 9 and worker.pid == 100


@pytest.mark.parametrize("answer", [TaskResult(1), TaskFailure(PdcdError("x")), None])
def test_who_gives_up_has_the_task_stopped_and_the_process_if_need_be(
    worker: SpawnedWorker, other: Other, answer: object
) -> None:
    looks = 0

    def alive() -> None:
        nonlocal looks
        looks += 1
        if looks == 3:
            if answer is not None:
                other.say(LifeSign(), answer)
            raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        worker.do(Watch(alive), ANSWERED)
    if answer is None:
        assert "kill" in other.processes[0].done and worker.pid == 101
    else:
        assert isinstance(other.heard()[-1], StopCall) and worker.pid == 100
        assert worker.do(when_asked(other, TaskResult(2)), ANSWERED) == 2


@pytest.mark.parametrize("look", [1, 2])
def test_who_gives_up_before_it_asked_costs_nobody_anything(
    worker: SpawnedWorker, other: Other, look: int
) -> None:
    looks = 0

    def alive() -> None:
        nonlocal looks
        looks += 1
        if looks == look:
            raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        worker.do(Watch(alive), FLIP, "x" * (1 << 22), "")
    watch = when_asked(other, TaskResult(None))
    worker.do(watch, ANSWERED)
    assert worker.pid == 100 and "kill" not in other.processes[0].done
    assert [type(one) for one in heard_by(watch)] == [RigFacts, TaskCall]


def test_an_answer_that_comes_too_late_is_not_that_to_the_next_task(
    worker: SpawnedWorker, other: Other
) -> None:
    """Nor is one that dribbles in: a cancel ends in its time, whatever is said meanwhile."""
    looks = 0

    def alive() -> None:
        nonlocal looks
        looks += 1
        if looks == 3:
            other.say(*[LifeSign()] * 20)
            raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        worker.do(Watch(alive), ANSWERED)
    assert worker.pid == 101 and other.processes[0].done[0] == "kill"


def test_only_work_of_the_table_is_asked_for(worker: SpawnedWorker) -> None:
    def plan(worker: Worker, watch: Watch) -> None:
        pass

    def stranger(worker: Worker, watch: Watch) -> None:
        pass

    for asked in (plan, stranger):
        with pytest.raises(PdcdError, match="no work is called"):
            worker.do(Watch(), asked)


def test_it_starts_once_and_stops_for_good(worker: SpawnedWorker, other: Other) -> None:
    worker.start()
    assert len(other.processes) == 1
    worker.stop()
    worker.stop()
    assert (
        worker.pid is None
        and "kill" in other.processes[0].done
        and ("wait", REAP_S) in other.processes[0].done
    )
    worker.start()
    assert worker.pid == 101


def test_where_no_process_can_be_had_the_next_task_tries_again(
    worker: SpawnedWorker, other: Other
) -> None:
    other.children.refusal = OSError(11, "no more processes")
    with pytest.raises(DecodeError, match="status 3"):
        worker.do(when_asked(other, then=lambda: other.die(3)), ANSWERED)
    with pytest.raises(PdcdError, match="no more processes"):
        worker.do(Watch(), PLAN)
    other.children.refusal = None
    assert worker.do(when_asked(other, TaskResult(1)), PLAN) == 1
