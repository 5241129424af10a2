"""Each source of time by itself: when it swaps, what it counts, and that it does not wait for ever.

Time is simulated: it moves by what a test takes from it, and by what is slept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import clocks
from pdcd.presenter.clocks import (
    Completions,
    FreeRunningSource,
    ProcessorClock,
    SwapReturns,
    Vblanks,
)
from tests.own_clock import keep_time

PERIOD_NS = 10_000_000


class Desk:
    """A clock and what was done by it."""

    def __init__(self) -> None:
        self.now_ns = 7_000_000_000
        self.done: list[tuple[str, int]] = []
        self.swap_ns = 0

    def swap(self) -> None:
        self.now_ns += self.swap_ns
        self.done.append(("swap", self.now_ns))

    def finish(self) -> None:
        self.done.append(("finish", self.now_ns))

    def words(self) -> list[str]:
        return [word for word, _ in self.done]


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Desk:
    desk = Desk()
    keep_time(monkeypatch, desk)
    return desk


# The processor's clock.


@pytest.mark.parametrize(
    ("passed", "steps"),
    [(0.0, 1), (0.2, 1), (0.9, 1), (1.0, 1), (1.24, 1), (1.26, 2), (2.2, 2), (2.3, 3), (7.9, 8)],
)
def test_the_grid_of_the_clock_is_kept_whatever_the_delay(
    desk: Desk, passed: float, steps: int
) -> None:
    """A point that went by less than a quarter of a refresh ago is still met."""
    source = ProcessorClock(desk.swap, desk.finish, float(PERIOD_NS))
    start_ns = desk.now_ns
    desk.now_ns += 5 * PERIOD_NS
    source.sync()
    assert source.msc == 5
    desk.now_ns += round(passed * PERIOD_NS)
    source.put()
    assert desk.words() == ["finish"]
    source.shown()
    assert source.msc == 5 + steps
    assert source.ns == start_ns + (5 + steps) * PERIOD_NS
    word, at_ns = desk.done[-1]
    assert word == "swap"
    assert 0 <= at_ns - source.ns <= 0.25 * PERIOD_NS
    assert source.flipped == 0


@pytest.mark.parametrize(("part", "point"), [(0.0, 3), (0.5, 3), (0.99, 3), (1.0, 4)])
def test_after_a_pause_the_clock_stands_at_the_last_point_of_its_grid(
    desk: Desk, part: float, point: int
) -> None:
    source = ProcessorClock(desk.swap, desk.finish, float(PERIOD_NS))
    desk.now_ns += round((3 + part) * PERIOD_NS)
    source.sync()
    assert source.msc == point


# Swaps that return at a vblank.


@pytest.mark.parametrize(
    ("took", "count"), [(0.1, 1), (1.0, 1), (1.4, 1), (1.6, 2), (2.4, 2), (3.6, 4)]
)
def test_a_swap_that_returns_late_counts_the_refreshes_that_passed(
    desk: Desk, took: float, count: int
) -> None:
    source = SwapReturns(desk.swap, desk.finish, float(PERIOD_NS))
    desk.swap_ns = PERIOD_NS
    source.sync()
    assert desk.words() == ["swap", "finish"] * 2
    assert (source.msc, source.flipped) == (2, 0)
    desk.swap_ns = round(took * PERIOD_NS)
    source.put()
    assert len(desk.done) == 4  # nothing yet
    source.shown()
    assert source.msc == 2 + count
    assert source.ns == desk.now_ns


def test_without_a_pace_frames_are_counted_one_by_one(desk: Desk) -> None:
    source = FreeRunningSource(desk.swap, desk.finish)
    source.sync()
    assert (source.ns, source.msc, source.flipped, desk.done) == (0, 0, 0, [])
    for count in (1, 2, 3):
        desk.now_ns += 77
        source.put()
        source.shown()
        assert (source.msc, source.ns) == (count, desk.now_ns)
    assert desk.words() == ["swap", "finish"] * 3


# Sources that are told, and may be told nothing.


class Mute:
    """Reports nothing, and notes how long it was waited for."""

    def __init__(self) -> None:
        self.ns = self.msc = self.flipped = 0
        self.waits_s: list[float] = []

    def ask(self, msc: int) -> None: ...

    def wait(self, kind: int, timeout_s: float) -> bool:
        self.waits_s.append(timeout_s)
        return False


def test_who_hears_nothing_of_a_swap_or_a_vblank_gives_up(desk: Desk) -> None:
    mute: Any = Mute()
    reported = Completions(mute, desk.swap)
    assert (reported.ns, reported.msc, reported.flipped) == (0, 0, 0)
    reported.sync()
    with pytest.raises(DeviceLost, match=r"not reported as shown \(choose another time_source"):
        reported.shown()
    with pytest.raises(DeviceLost, match=r"no vblanks are reported \(choose another time_source"):
        Vblanks(mute, desk.swap, desk.finish, float(PERIOD_NS)).sync()
    assert max(mute.waits_s) < 2.0  # well before anybody calls the process hung
    settled_s, *others_s = mute.waits_s
    # Three refreshes are waited for where nothing need come, thirty where something must.
    assert 3 / 60 <= settled_s < 6 / 60 and min(others_s) >= 30 / 60


# Waiting, and looking whether a source is to be believed.


@pytest.mark.parametrize("left_ns", [-5, 0, 1, 40_000, 50_000, 60_000, 3_000_000])
def test_a_wait_ends_at_its_time_though_every_sleep_wakes_late(
    monkeypatch: pytest.MonkeyPatch, left_ns: int
) -> None:
    begin_ns = now_ns = 10**9
    sleeps_s: list[float] = []

    def look() -> int:
        nonlocal now_ns
        assert now_ns <= max(begin_ns, begin_ns + left_ns), "looked on although it was time"
        now_ns += 1
        return now_ns - 1

    def sleep(seconds: float) -> None:
        nonlocal now_ns
        sleeps_s.append(seconds)
        now_ns += round(seconds * 1e9) + 45_000  # as late as a busy kernel is

    monkeypatch.setattr(time, "monotonic_ns", look)
    monkeypatch.setattr(time, "sleep", sleep)
    clocks.wait_until_ns(begin_ns + left_ns)
    assert now_ns - begin_ns == max(left_ns, 0) + 1
    # Short of the time nothing is slept; before that, once.
    assert len(sleeps_s) == (left_ns > 50_000)


class Even:
    """A source of this period, whose counts go on by one."""

    name, queues, flipped = "even", False, 0

    def __init__(self, period_ns: int, late: Callable[[int], int] = lambda n: 1) -> None:
        self.ns = self.msc = self.put_count = self.frames = self.syncs = 0
        self._period_ns, self._late = period_ns, late

    def sync(self) -> None:
        self.syncs += 1

    def put(self) -> None:
        self.put_count += 1

    def shown(self) -> None:
        self.frames += 1
        steps = self._late(self.frames)
        self.msc += steps
        self.ns += steps * self._period_ns


@pytest.mark.parametrize(
    ("off", "believed"), [(-0.03, False), (-0.015, True), (0.015, True), (0.03, False)]
)
def test_a_source_within_two_percent_of_the_period_is_believed(off: float, believed: bool) -> None:
    period_ns = round(PERIOD_NS * (1 + off))
    source = Even(period_ns)
    drawn: list[int] = []
    found = clocks.measure_period_ns(
        source, lambda: drawn.append(source.put_count), float(PERIOD_NS)
    )
    assert found == (period_ns if believed else None)
    assert source.frames == source.put_count == 30 and source.syncs == 1
    assert drawn == list(range(30))  # each drawn before it is handed over


@pytest.mark.parametrize(
    ("busy_frames", "rounds"), [(14, 1), (16, 2), (44, 2), (46, 3), (74, 3), (76, None)]
)
def test_a_source_is_asked_three_times_before_it_is_called_late(
    busy_frames: int, rounds: int | None
) -> None:
    """It is believed when no more than half of a round's frames came late."""
    source = Even(PERIOD_NS, lambda n: 2 if n <= busy_frames else 1)
    found = clocks.measure_period_ns(source, lambda: None, float(PERIOD_NS))
    assert found == (None if rounds is None else PERIOD_NS)
    assert source.syncs == (rounds or 3)


def test_a_source_that_counts_backwards_once_is_not_believed() -> None:
    source = Even(PERIOD_NS)
    shown = source.shown

    def back() -> None:
        shown()
        if source.frames == 12:
            source.msc -= 2

    source.shown = back  # type: ignore[method-assign]
    assert clocks.measure_period_ns(source, lambda: None, float(PERIOD_NS)) is None


def test_a_source_that_counts_one_refresh_twice_is_believed() -> None:
    """Its stamps go on; what it skips after that, it had not counted."""
    source = Even(PERIOD_NS)
    shown = source.shown

    def repeat() -> None:
        shown()
        source.msc += {12: -1, 13: 1}.get(source.frames, 0)

    source.shown = repeat  # type: ignore[method-assign]
    assert clocks.measure_period_ns(source, lambda: None, float(PERIOD_NS)) == PERIOD_NS


def test_only_a_lost_device_is_a_source_that_does_not_deliver() -> None:
    def source(fault: Exception) -> Even:
        made = Even(PERIOD_NS)

        def shown() -> None:
            raise fault

        made.shown = shown  # type: ignore[method-assign]
        return made

    lost = source(DeviceLost("late"))
    assert clocks.measure_period_ns(lost, lambda: None, float(PERIOD_NS)) is None
    for fault in (ZeroDivisionError(), ConfigError("odd")):
        with pytest.raises(type(fault)):
            clocks.measure_period_ns(source(fault), lambda: None, float(PERIOD_NS))
