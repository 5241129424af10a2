"""The talk with a guardian that stands in this process: bounds, order, and what is left behind."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivers import guard as guard_module
from drivers.guard import ShutterGuard
from pdcd.child import WORDS, LineClosedError, start_child
from pdcd.errors import DeviceLost
from tests.child_rig import Process, stand_ins


class Guardians:
    """Those that were started; each says in advance what it answers to whatever it is told."""

    def __init__(self) -> None:
        self.answers: tuple[str, ...] = ("ok",) * 3
        self.started: list[Process] = []

    def start(self, process: Process) -> None:
        self.started.append(process)
        line = process.line(WORDS)
        for answer in self.answers:
            line.send(answer)

    def heard(self, number: int = 0) -> list[bytes]:
        words: list[bytes] = []
        line = self.started[number].lines[0]
        while line.wait(0.0):
            try:
                words.append(line.receive())
            except LineClosedError:
                return [*words, b"(end)"]
        return words


@pytest.fixture
def guardians(monkeypatch: pytest.MonkeyPatch) -> Iterator[Guardians]:
    monkeypatch.setattr(guard_module, "_look_after", lambda *_: None)  # nobody looks by himself
    made = Guardians()
    for children in stand_ins(monkeypatch):
        children.on_start = made.start
        yield made


def made(answer_s: float = 0.01, **how: Any) -> ShutterGuard:
    return ShutterGuard(("guardian",), 7, 8, answer_s=answer_s, **how)


def test_a_lost_guardian_is_noticed_within_four_tenths_of_a_second() -> None:
    assert guard_module.GUARD_LOOK_S <= 0.1
    assert guard_module.HEARD_S <= 0.3


def test_a_guardian_gets_what_it_inherits_and_is_born_deaf(
    guardians: Guardians, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[bool] = []

    def started(*what: Any, **how: Any) -> Any:
        told.append(how["deaf"])
        return start_child(*what, **how)

    monkeypatch.setattr(guard_module, "start_child", started)
    guard = made()
    assert guard.pid is None
    guard.start()
    (process,) = guardians.started
    assert guard.pid == process.pid and told == [True]
    assert process.inherits == (7, 8) and process.command[:-1] == ["guardian"]
    guard.stop()


def test_the_bound_of_an_answer_is_that_of_the_class_unless_another_is_given(
    guardians: Guardians,
) -> None:
    guard = made(answer_s=3.5)
    guard.start()
    bounds: list[float] = []
    line: Any = guard._child.line  # type: ignore[union-attr]
    real = line.receive
    line.receive = lambda within_s: bounds.append(within_s) or real(within_s=within_s)  # type: ignore[func-returns-value]
    assert [guard.ask("a"), guard.ask("b", 0.25), guard.ask("c", 0.0)] == [b"ok"] * 3
    assert bounds == [3.5, 0.25, 0.0]
    guard.stop()


def test_one_that_does_not_answer_is_killed(guardians: Guardians) -> None:
    guardians.answers = ()
    guard = made()
    guard.start()
    assert guard.ask("look") == b""
    assert guardians.started[0].done == ["kill", ("wait", 5.0)]
    assert guardians.heard() == [b"look", b"(end)"]
    assert guard.pid is None
    assert guard.ask("look") == b""
    assert len(guardians.started[0].done) == 2  # it is no more


def test_one_whose_end_is_closed_has_no_answer(guardians: Guardians) -> None:
    guard = made()
    guard.start()
    guardians.started[0].die(None)
    assert [guard.ask("look") for _ in range(4)][-1] == b""
    assert guard.pid is None


def test_one_that_ends_in_time_is_told_to_and_waited_for(guardians: Guardians) -> None:
    guard = made()
    guard.start()
    guardians.started[0].returncode = 0
    guard.stop()
    assert guardians.started[0].done == [("wait", 5.0)]
    assert guardians.heard() == [b"(end)"]
    guard.stop()
    assert len(guardians.started[0].done) == 1
    assert guard.pid is None


def test_one_that_does_not_end_is_killed_and_waited_for(guardians: Guardians) -> None:
    guard = made()
    guard.start()
    guard.stop()
    assert guardians.started[0].done == [("wait", 5.0), "kill", ("wait", 5.0)]


def test_one_that_nobody_waits_for_is_told_to_end_and_buried_later(guardians: Guardians) -> None:
    guard = made()
    guard.start()
    guard.stop(wait=False)
    assert guardians.started[0].done == [("wait", 0.0)]
    assert guardians.heard() == [b"(end)"]
    assert guard.pid is None


def test_one_that_hears_is_not_replaced(guardians: Guardians) -> None:
    guard = made()
    guard.start()
    guard.insist("a")
    guard.insist("b")
    assert len(guardians.started) == 1
    assert guardians.heard(0) == [b"a", b"b"]
    guard.stop()


def test_one_that_does_not_hear_is_replaced_once_and_told_the_same(
    guardians: Guardians, caplog: pytest.LogCaptureFixture
) -> None:
    guardians.answers = ()
    guard = made()
    with pytest.raises(DeviceLost, match="does not start"):
        guard.insist("a")
    assert len(guardians.started) == 1 and guardians.started[0].done[0] == "kill"
    assert "replaced" not in caplog.text
    guard.start()
    guardians.answers = ("ok",)
    guard.insist("b")
    assert [len(guardians.started), guardians.heard(2)] == [3, [b"b"]]
    assert "guardian replaced" in caplog.text
    guard.stop()


def test_an_armed_guardian_is_looked_at_until_it_is_disarmed(guardians: Guardians) -> None:
    guard = made()
    guard.start()
    assert guard.look() is False  # nobody is armed, and nobody is asked
    guard.arm(lambda: "arm 30")
    assert guard.look() is True
    assert guard.disarm() == b"ok"
    assert guard.look() is False
    assert guardians.heard(0) == [b"arm 30", b"look", b"disarm"]
    guard.stop()


def test_a_stopped_guardian_is_armed_no_more(guardians: Guardians) -> None:
    ended: list[str] = []
    guard = made(unguarded=ended.append)
    guard.start()
    guard.arm(lambda: "arm 30")
    guard.stop()
    assert guard.look() is False
    assert (len(guardians.started), ended) == (1, [])


def test_a_lost_one_is_replaced_and_armed_and_a_lost_cause_is_told_once(
    guardians: Guardians, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard_module, "HEARD_S", 0.01)
    ended: list[str] = []
    words = iter(["arm 30", "arm 20", "arm 10"])
    guardians.answers = ("ok",)
    guard = made(unguarded=ended.append)
    guard.arm(lambda: next(words))
    assert guard.look() is True
    assert [guardians.heard(n) for n in range(len(guardians.started))] == [
        [b"arm 30", b"look", b"(end)"],
        [b"arm 20"],
    ]
    assert ended == []
    guardians.answers = ()
    assert guard.look() is False
    assert ended == ["the process that guards the shutter does not start"]
    assert guard.look() is False
    assert (len(ended), len(guardians.started)) == (1, 3)


@pytest.mark.parametrize("later", ["ended", "guarded", "disarmed"])
def test_an_exposure_that_could_not_be_ended_is_looked_after_still(
    guardians: Guardians, monkeypatch: pytest.MonkeyPatch, later: str
) -> None:
    monkeypatch.setattr(guard_module, "HEARD_S", 0.01)
    guardians.answers = ("ok",)
    failures = [DeviceLost("the camera does not answer")] * 2
    ended: list[str] = []

    def unguarded(why: str) -> None:
        ended.append(why)
        if failures:
            raise failures.pop()

    guard = made(unguarded=unguarded)
    guard.arm(lambda: "arm 30")
    guardians.answers = ()
    assert guard.look() is True and guard.look() is True
    assert len(ended) == 2
    if later == "ended":
        assert guard.look() is False and len(ended) == 3
    elif later == "guarded":
        guardians.answers = ("ok",) * 3
        assert guard.look() is True and guard.look() is True
        assert guardians.heard(-1) == [b"arm 30", b"look"]
    else:
        guard.disarm()
    if later != "guarded":
        assert guard.look() is False
    guard.stop()
