"""The work process by itself: what it says, when it looks up, and how it ends; played by hand."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.capture.worker import process
from pdcd.capture.worker.answers import RigFacts, make_run_record
from pdcd.capture.worker.calls import LifeSign, StopCall, TaskCall, TaskFailure, TaskResult
from pdcd.capture.worker.process import TaskLine, run_worker, serve_tasks
from pdcd.capture.worker.proxy import InProcessWorker
from pdcd.child import PICKLES, LineClosedError, MessageLine
from pdcd.errors import Cancelled, ConfigError, PdcdError, PlanError
from pdcd.planning.make import make_plan
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.watch import Watch

NOBODY: Any = None
FACTS = RigFacts(Config(), NOBODY, (3, 4), None)


class Far:
    """The other end of the line, and a clock that stands until it is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ours, self.theirs = (MessageLine(end, PICKLES) for end in ends)
        self.talk = TaskLine(self.theirs)
        clock = SimpleNamespace(monotonic=lambda: self.now_s)
        monkeypatch.setattr(process, "time", clock)

    def say(self, *messages: object) -> None:
        for message in messages:
            self.ours.send(message)

    def heard(self) -> list[Any]:
        found = []
        while self.ours.wait(0.0):
            found.append(self.ours.receive())
        return found

    def at(self, now_s: float, watch: Watch) -> list[Any]:
        """What is heard of a sign of life at that time."""
        self.now_s = now_s
        watch()
        return self.heard()


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Iterator[Far]:
    made = Far(monkeypatch)
    yield made
    made.ours.close()
    made.theirs.close()


def test_a_sign_of_life_is_given_twice_a_second(far: Far) -> None:
    watch = far.talk.watch()
    heard = [far.at(now_s, watch) for now_s in (100.0, 100.25, 100.49, 100.52, 100.9, 101.1)]
    assert heard == [[LifeSign()], [], [], [LifeSign()], [], [LifeSign()]]


def test_whether_the_work_is_wanted_is_looked_at_fifty_times_a_second(far: Far) -> None:
    watch = far.talk.watch()
    watch()
    far.say(StopCall())
    far.at(100.019, watch)
    with pytest.raises(Cancelled):
        far.at(100.021, watch)
    far.say(LifeSign())  # anything else ends nothing
    far.at(100.06, watch)


def test_how_far_it_is_is_told_now_and_then_and_at_the_end(far: Far) -> None:
    watch = far.talk.watch()
    watch.stage = "codes"

    def told(now_s: float, done: float) -> list[Any]:
        far.now_s = now_s
        watch.step(done, 10.0)
        return far.heard()

    assert told(100.0, 1.0) == [LifeSign(1.0, 10.0, "codes")]
    assert told(100.04, 2.0) == told(100.04, 9.999) == []
    assert told(100.051, 3.0) == [LifeSign(3.0, 10.0, "codes")]
    assert told(100.06, 4.0) == []
    last = 10.0 * (1.0 - 1e-10)
    assert told(100.06, last) == [LifeSign(last, 10.0, "codes")]
    assert far.at(100.55, watch) == []  # what was told was a sign of life, too
    assert far.at(100.58, watch) == [LifeSign()]


class Table:
    """Stands for a desk: notes what it is made of, and what is forgotten."""

    made: ClassVar[list[Table]] = []

    def __init__(self, facts: RigFacts) -> None:
        self.facts, self.forgotten = facts, 0
        Table.made.append(self)

    def forget(self, watch: Watch) -> None:
        self.forgotten += 1


class Said:
    """A line of messages that are known beforehand."""

    def __init__(self, *messages: object) -> None:
        self.messages, self.sent = list(messages), list[Any]()

    def receive(self) -> object:
        if not self.messages:
            raise LineClosedError
        return self.messages.pop(0)

    def send(self, message: object) -> None:
        self.sent.append(message)


def failing(error: Exception) -> Any:
    def task(*_: object, **__: object) -> None:
        raise error

    return task


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How much memory was allowed; desks are stand-ins."""
    found: list[int] = []
    Table.made = []
    monkeypatch.setattr(process, "Worker", Table)
    monkeypatch.setattr(process, "limit_memory", found.append)
    return found


def served(monkeypatch: pytest.MonkeyPatch, work: dict[str, Any], *messages: object) -> Any:
    monkeypatch.setattr(process, "WORK", work)
    line: Any = Said(*messages)
    with pytest.raises(LineClosedError):
        serve_tasks(line)
    return line.sent


def test_what_is_asked_is_done_in_turn_once_the_facts_are_known(
    monkeypatch: pytest.MonkeyPatch, limits: list[int]
) -> None:
    seen: list[object] = []

    def task(desk: Table, watch: Watch, *args: object, **kwargs: object) -> int:
        seen.append((desk.facts, args, kwargs))
        return len(seen)

    call = TaskCall("plan", (1,), {"a": 2})
    sent = served(monkeypatch, {"plan": task}, call, StopCall(), FACTS, call, call)
    assert sent == [TaskResult(1), TaskResult(2)]
    assert seen == [(FACTS, (1,), {"a": 2})] * 2
    assert limits == [Config().limits.work_bytes]
    assert [desk.forgotten for desk in Table.made] == [0]


def test_whatever_a_task_raises_is_the_answer_and_the_job_is_forgotten(
    monkeypatch: pytest.MonkeyPatch, limits: list[int]
) -> None:
    error = ConfigError("no place")
    work = {
        "plan": failing(MemoryError()), "look": failing(error), "see": failing(ValueError("x")),
    }  # fmt: skip
    calls = [TaskCall(name, (), {}) for name in ("look", "plan", "see", "none")]
    own, full, fault, unknown = served(monkeypatch, work, FACTS, *calls)
    assert (own.error, own.spent) == (error, False)
    assert isinstance(full.error, PlanError) and full.spent
    assert "ran out of memory" in full.error.message
    assert (fault.error.message, fault.spent) == ("ValueError: x", False)
    assert type(fault.error) is PdcdError and "KeyError" in unknown.error.message
    assert all(isinstance(one, TaskFailure) for one in (own, full, fault, unknown))
    assert [desk.forgotten for desk in Table.made] == [4]


def test_nobody_is_told_where_nobody_is_left(
    monkeypatch: pytest.MonkeyPatch, limits: list[int]
) -> None:
    work = {"plan": failing(LineClosedError()), "look": failing(EOFError("of a file"))}
    assert served(monkeypatch, work, FACTS, TaskCall("plan", (), {})) == [] and limits
    (failed,) = served(monkeypatch, work, FACTS, TaskCall("look", (), {}))
    assert "EOFError: of a file" in failed.error.message


@pytest.mark.parametrize(
    ("end", "status"),
    [
        (LineClosedError(), 0), (MemoryError(), 12), (ValueError("a fault"), None),
    ],
    ids=repr,
)  # fmt: skip
def test_how_the_process_ends(
    end: Exception, status: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    monkeypatch.setattr(process, "serve_tasks", failing(end))
    monkeypatch.setattr(
        "pdcd.capture.worker.process.faulthandler.enable", lambda: told.append("crashes")
    )
    ours, theirs = socket.socketpair()
    with ours:
        if status is None:
            with pytest.raises(ValueError, match="a fault"):
                run_worker(theirs.detach())
        else:
            assert run_worker(theirs.detach()) == status
        assert ours.recv(1) == b"" and told == ["crashes"]  # its end is closed


def test_who_works_here_runs_out_of_memory_in_the_same_words() -> None:
    here = InProcessWorker(FACTS)

    def plan(desk: object, watch: Watch, count: int) -> int:
        if count > 2:
            raise MemoryError
        return 2 * count

    task: Any = plan
    assert here.do(Watch(), task, 2) == 4
    with pytest.raises(PlanError, match="ran out of memory"):
        here.do(Watch(), task, 3)


@pytest.mark.parametrize(
    ("level", "limit", "left"), [("none", 0.1, 0.2), ("none", 0.2, 0.0), ("ambient", 0.1, 0.0)]
)
def test_a_run_remembers_leaks_that_count_and_were_not_subtracted(
    level: Any, limit: float, left: float
) -> None:
    plan: Any = make_plan(CaptureRequest(goal="indirect", codes=8), Config(), (3, 4))
    leaks = LeakErrors(ambient=0.0, mask=0.0, both=0.2, floor=0.0, limit=limit, raw=())
    plan = replace(plan, how=msgspec.structs.replace(plan.how, black_level=level), leaks=leaks)
    camera: Any = SimpleNamespace(responsivity_e=np.array([1, 2, 3]))
    for request, normalise in (
        (CaptureRequest(goal="indirect"), Config().schedule.normalise),
        (CaptureRequest(goal="indirect", normalise="row"), "row"),
    ):
        found = make_run_record(plan, request, Config(), camera, NOBODY)
        assert (found.leak, found.normalise, found.shots) == (left, normalise, ())
