"""The daemon's side of the work process, against a stand-in that this thread plays itself."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import Config
from pdcd.capture.worker import keeper
from pdcd.capture.worker.answers import Facts
from pdcd.capture.worker.birth import Newborn, born
from pdcd.capture.worker.keeper import Child
from pdcd.capture.worker.pipe import Call, Done, Failed, Inbox, Sign, Stop, packed
from pdcd.capture.worker.work import SPENT
from pdcd.capture.worker.worker import Worker
from pdcd.errors import Cancelled, DecodeError, PdcdError, PlanError, RequestError
from pdcd.watch import Watch


class Dummy:
    """A process that ends as it is told to, or when it is killed."""

    def __init__(self, pid: int) -> None:
        self.pid, self.killed = pid, False
        self.returncode: int | None = None

    def kill(self) -> None:
        self.killed = True
        self.returncode = -9 if self.returncode is None else self.returncode

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout_s: float) -> int:
        if self.returncode is None:
            raise subprocess.TimeoutExpired("dummy", timeout_s)
        return self.returncode


class Other:
    """Both ends of the socket, and what was heard at the far one."""

    def __init__(self) -> None:
        self.ends: list[socket.socket] = []
        self.processes: list[Dummy] = []
        self._inbox = Inbox()

    def newborn(self, command: object = ()) -> Newborn:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        theirs.setblocking(False)
        self.ends += [ours, theirs]
        self.processes.append(Dummy(100 + len(self.processes)))
        self._inbox = Inbox()
        process: Any = self.processes[-1]
        return Newborn(process, ours)

    def heard(self) -> list[Any]:
        try:
            return list(self._inbox.take(self.ends[-1].recv(1 << 20)))
        except BlockingIOError:
            return []

    def say(self, *messages: object) -> None:
        self.ends[-1].send(b"".join(map(packed, messages)))

    def die(self, status: int | None) -> None:
        self.processes[-1].returncode = status
        self.ends[-1].close()


@pytest.fixture
def other(monkeypatch: pytest.MonkeyPatch) -> Iterator[Other]:
    made = Other()
    monkeypatch.setattr(keeper, "born", made.newborn)
    monkeypatch.setattr(keeper, "LOOK_S", 0.001)
    monkeypatch.setattr(keeper, "STOP_S", 0.02)
    yield made
    for end in made.ends:
        end.close()


@pytest.fixture
def child(other: Other) -> Child:
    limits = msgspec.structs.replace(Config().limits, work_silent_s=0.05)
    profile: Any = None
    facts = Facts(msgspec.structs.replace(Config(), limits=limits), profile, (3, 4), None)
    return Child(facts, (), other.newborn())


FLIP: Any = Worker.flip
PLAN: Any = Worker.plan
ANSWERED: Any = Worker.answered
"""Tasks with and without a job before; what they do in truth is of no matter here."""


def when_asked(other: Other, *answers: object, then: Callable[[], object] | None = None) -> Watch:
    """A watch by which the other end answers once it has been asked."""
    heard: list[Any] = []

    def alive() -> None:
        found = other.heard()
        if any(isinstance(one, Call) for one in found):
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


def test_facts_are_told_once_and_each_call_is_answered(child: Child, other: Other) -> None:
    for number in (1, 2):
        watch = when_asked(other, Done(number))
        assert child.do(watch, FLIP, "folder", raw="a") == number
        kinds = [type(one) for one in heard_by(watch)]
        assert kinds == ([Facts, Call] if number == 1 else [Call])
        assert heard_by(watch)[-1] == Call("flip", ("folder",), {"raw": "a"})
    assert child.pid == 100 and len(other.processes) == 1


def test_signs_tell_how_far_it_is_only_where_they_know(child: Child, other: Other) -> None:
    watch, steps = when_asked(other, Sign(), Sign(1.0, 4.0, "codes"), Done(None)), []
    watch._step = lambda *told: steps.append((*told, watch.stage))
    child.do(watch, ANSWERED)
    assert steps == [(1.0, 4.0, "codes")]


@pytest.mark.parametrize("spent", [False, True])
def test_a_task_that_failed_raises_and_a_spent_process_is_replaced(
    child: Child, other: Other, spent: bool
) -> None:
    with pytest.raises(RequestError, match="no such"):
        child.do(when_asked(other, Failed(RequestError("no such"), spent)), ANSWERED)
    assert other.processes[0].killed == spent and child.pid == 100 + spent


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
    child: Child, other: Other, status: Any, words: str, task: Any
) -> None:
    kind = PlanError if task is PLAN else DecodeError
    with pytest.raises(kind, match=words):
        child.do(when_asked(other, then=lambda: other.die(status)), task)
    assert child.pid == 101 and other.processes[0].killed
    assert child.do(when_asked(other, Done(7)), PLAN) == 7


def test_a_death_between_jobs_is_no_ones_and_amid_a_job_is_told(child: Child, other: Other) -> None:
    other.processes[0].returncode = 3
    with pytest.raises(DecodeError, match="ended with status 3"):
        child.do(Watch(), ANSWERED)
    other.processes[1].returncode = 3
    assert child.do(when_asked(other, Done(1)), PLAN) == 1
    assert child.pid == 102


def test_a_process_that_is_silent_too_long_is_killed(child: Child, other: Other) -> None:
    with pytest.raises(DecodeError, match=r"no sign of life for 0\.05 s"):
        child.do(Watch(), ANSWERED)
    assert other.processes[0].killed and child.pid == 101


def test_signs_of_life_keep_a_long_task_alive(child: Child, other: Other) -> None:
    now_s, told = 0.0, 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pdcd.capture.worker.keeper.time.monotonic", lambda: now_s)

        def alive() -> None:
            nonlocal now_s, told
            now_s += 0.04
            told += 1
            other.say(Done(None) if told == 9 else Sign())

        child.do(Watch(alive), ANSWERED)
    assert told == 9 and child.pid == 100


@pytest.mark.parametrize("answer", [Done(1), Failed(PdcdError("x")), None])
def test_who_gives_up_has_the_task_stopped_and_the_process_if_need_be(
    child: Child, other: Other, answer: object
) -> None:
    looks = 0

    def alive() -> None:
        nonlocal looks
        looks += 1
        if looks == 3:
            if answer is not None:
                other.say(Sign(), answer)
            raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        child.do(Watch(alive), ANSWERED)
    if answer is None:
        assert other.processes[0].killed and child.pid == 101
    else:
        assert isinstance(other.heard()[-1], Stop) and child.pid == 100
        assert child.do(when_asked(other, Done(2)), ANSWERED) == 2


def test_half_a_message_is_never_followed_by_another(child: Child, other: Other) -> None:
    """A task that is broken off while it is sent costs the process."""
    looks = 0

    def alive() -> None:
        nonlocal looks
        looks += 1
        if looks == 2:
            raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        child.do(Watch(alive), FLIP, "x" * (1 << 22), "")
    assert other.processes[0].killed and child.pid == 101
    watch = when_asked(other, Done(None))
    child.do(watch, ANSWERED)
    assert [type(one) for one in heard_by(watch)] == [Facts, Call]


def test_a_long_message_goes_over_in_pieces(child: Child, other: Other) -> None:
    watch = when_asked(other, Done(None))
    child.do(watch, FLIP, "x" * (1 << 22), "")
    assert heard_by(watch)[-1].args[0] == "x" * (1 << 22)


def test_only_work_of_the_table_is_asked_for(child: Child) -> None:
    def plan(worker: Worker, watch: Watch) -> None:
        pass

    for stranger in (plan, Worker.forget):
        with pytest.raises(PdcdError, match="no work is called"):
            child.do(Watch(), stranger)


def test_it_starts_once_and_stops_for_good(child: Child, other: Other) -> None:
    child.start()
    assert len(other.processes) == 1
    child.stop()
    child.stop()
    assert child.pid is None and other.processes[0].killed and other.ends[0].fileno() == -1
    child.start()
    assert child.pid == 101


def test_where_no_process_can_be_had_the_next_task_tries_again(
    child: Child, other: Other, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(command: object) -> Newborn:
        raise PdcdError("no more processes")

    monkeypatch.setattr(keeper, "born", none)
    with pytest.raises(DecodeError, match="status 3"):
        child.do(when_asked(other, then=lambda: other.die(3)), ANSWERED)
    with pytest.raises(PdcdError, match="no more processes"):
        child.do(Watch(), PLAN)
    monkeypatch.setattr(keeper, "born", other.newborn)
    assert child.do(when_asked(other, Done(1)), PLAN) == 1


TELLS_THREADS = """
import os, sys, time
os.write(int(sys.argv[1]), os.environ["OMP_NUM_THREADS"].encode())
time.sleep(60)
"""


def test_a_process_is_born_in_a_session_of_its_own_and_ends_whole() -> None:
    made = born((sys.executable, "-I", "-S", "-c", TELLS_THREADS))
    try:
        made.talk.setblocking(True)
        assert made.talk.recv(10) == os.environ.get("OMP_NUM_THREADS", "1").encode()
        assert os.getsid(made.process.pid) == made.process.pid
        fds = Path(f"/proc/{made.process.pid}/fd")
        assert [str((fds / n).readlink()) for n in "01"] == ["/dev/null"] * 2
    finally:
        made.end()
    assert made.process.returncode == -signal.SIGKILL and made.talk.fileno() == -1
    made.end()
    made = born(("/bin/true",))
    assert not made.talk.getblocking()
    made.end()


def test_a_program_that_is_not_there_is_told() -> None:
    with pytest.raises(PdcdError, match="cannot start the process"):
        born(("/no/such/program",))
