"""The edges by which a swap still belongs to a vblank: late, early, and how often it is tried."""

from __future__ import annotations

from typing import Any

import pytest

from pdcd.errors import DeviceLost
from pdcd.presenter.clocks import EARLY_NS, Vblanks
from pdcd.presenter.xpresent import KIND_MSC
from tests.own_clock import keep_time

PERIOD_NS = 10_000_000
QUARTER_NS = PERIOD_NS // 4


class Events:
    """Answers each question from a list: how long after its vblank, and by how much it is late in
    numbers; then in time for ever."""

    def __init__(self) -> None:
        self.now_ns = 100 * PERIOD_NS
        self.ns, self.msc = self.now_ns, 100
        self.answers: list[tuple[int, int]] = []
        self.asked: list[int] = []
        self.swapped_ns: list[int] = []
        self.silent = False

    def ask(self, msc: int) -> None:
        self.asked.append(msc)

    def wait(self, kind: int, timeout_s: float) -> bool:
        assert kind == KIND_MSC and timeout_s == 0.5
        after_ns, further = self.answers.pop(0) if self.answers else (0, 0)
        self.msc = (self.asked[-1] or 100) + further
        self.now_ns = self.msc * PERIOD_NS + after_ns
        self.ns = self.now_ns
        return not self.silent

    def swap(self) -> None:
        self.swapped_ns.append(self.now_ns)


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> Events:
    made = Events()
    keep_time(monkeypatch, made)
    return made


def synced(events: Any) -> Vblanks:
    """A source that stands at vblank 103."""
    source = Vblanks(events, events.swap, lambda: None, float(PERIOD_NS))
    source.sync()
    assert events.asked == [0, 102, 103]
    assert (source.msc, source.ns) == (103, 103 * PERIOD_NS)
    del events.asked[:]
    return source


@pytest.mark.parametrize(
    ("late_ns", "asked"), [(0, [104]), (QUARTER_NS, [104]), (QUARTER_NS + 1, [104, 105])]
)
def test_a_vblank_is_met_up_to_a_quarter_of_a_refresh_after_it(
    events: Events, late_ns: int, asked: list[int]
) -> None:
    source = synced(events)
    events.answers = [(late_ns, 0)]
    source.shown()
    assert events.asked == asked and source.msc == asked[-1]
    assert events.swapped_ns == [events.now_ns]


def test_an_answer_for_a_later_vblank_is_taken_as_that(events: Events) -> None:
    source = synced(events)
    events.answers = [(1000, 3)]
    source.shown()
    assert (source.msc, source.ns) == (107, 107 * PERIOD_NS + 1000)


def test_vblanks_that_all_come_late_are_left_to_go_by_three_times(events: Events) -> None:
    """Then it is the grid that has moved."""
    source = synced(events)
    events.answers = [(QUARTER_NS + 1, 0)] * 9
    source.shown()
    assert events.asked == [104, 105, 106, 107]
    assert source.msc == 107 and source.ns == 107 * PERIOD_NS + QUARTER_NS + 1
    assert len(events.swapped_ns) == 1


@pytest.mark.parametrize(("early_ns", "waits"), [(EARLY_NS, False), (EARLY_NS + 1, True)])
def test_an_answer_before_its_time_is_waited_for_beyond_two_milliseconds(
    events: Events, early_ns: int, waits: bool
) -> None:
    assert EARLY_NS == 2_000_000
    source = synced(events)
    events.answers = [(-early_ns, 0)]
    source.shown()
    due_ns = 104 * PERIOD_NS
    assert source.ns == events.swapped_ns[0] == (due_ns if waits else due_ns - early_ns)


@pytest.mark.parametrize(("early_ns", "ns"), [(1, 0), (0, 0), (3_000_000, 0), (-1, 1)])
def test_a_grid_begins_at_the_later_of_what_two_answers_say(
    events: Events, early_ns: int, ns: int
) -> None:
    """One that came before its time is put right by the one before it."""
    made: Any = events
    source = Vblanks(made, events.swap, lambda: None, float(PERIOD_NS))
    events.answers = [(0, 0), (0, 0), (-early_ns, 0)]
    source.sync()
    assert (source.msc, source.ns) == (103, 103 * PERIOD_NS + ns)


def test_a_source_that_hears_nothing_swaps_nothing(events: Events) -> None:
    source = synced(events)
    events.silent = True
    with pytest.raises(DeviceLost, match="no vblanks are reported"):
        source.shown()
    assert events.swapped_ns == [] and events.asked == [104]
