"""The source that paces itself by a server's vblanks: on a simulated server, and at its edges."""

from __future__ import annotations

from typing import Any

import pytest

from pdcd.errors import DeviceLost
from pdcd.presenter import clocks
from pdcd.presenter.clocks import EARLY_NS, Completions, Vblanks
from pdcd.presenter.xconnection import make_server_lost
from pdcd.presenter.xpresent import KIND_MSC
from tests.own_clock import keep_time

PERIOD_NS = 16_667_000


class Server:
    """Counts vblanks as present_fake.c of xserver 21.1 does: ust over the interval, rounded.

    A vblank that the count has reached is answered at once, which may be half a refresh before its
    time; others at their time, rounded up to whole milliseconds.
    """

    def __init__(self) -> None:
        self.now_ns = 1000 * PERIOD_NS + 3_000_000
        self.ns = self.msc = self.flipped = 0
        self._asked = 0
        self.swapped_ns: list[int] = []

    def ask(self, msc: int) -> None:
        self._asked = msc

    def wait(self, kind: int, timeout_s: float) -> bool:
        if self._asked > self._count():
            due_ns = self._asked * PERIOD_NS
            self.now_ns = max(self.now_ns, -(-due_ns // 1_000_000) * 1_000_000)
        self.now_ns += 40_000
        self.ns, self.msc = self.now_ns, self._count()
        return True

    def _count(self) -> int:
        return (self.now_ns + PERIOD_NS // 2) // PERIOD_NS

    def swap(self) -> None:
        self.swapped_ns.append(self.now_ns)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    server = Server()
    keep_time(monkeypatch, server)
    return server


def source_of(server: Any) -> Vblanks:
    source = Vblanks(server, server.swap, lambda: None, float(PERIOD_NS))
    source.sync()
    return source


def show(source: Vblanks) -> None:
    source.put()
    source.shown()


@pytest.mark.parametrize("held_up", [0.1, 0.6, 0.9, 1.3, 1.8, 2.4, 2.6, 7.7])
def test_each_delay_costs_the_refreshes_that_passed(server: Server, held_up: float) -> None:
    source = source_of(server)
    for _ in range(5):
        show(source)
    before = source.msc
    server.now_ns += round(held_up * PERIOD_NS)
    show(source)
    # A vblank that passed less than a quarter of a refresh ago still counts as met.
    assert source.msc - before == max(1, -int(-(held_up - 0.25) // 1))
    # And the swap came with its vblank, to two milliseconds or that quarter.
    late = (server.swapped_ns[-1] - source.msc * PERIOD_NS) / PERIOD_NS
    assert -0.13 <= late <= 0.32
    for _ in range(5):
        before = source.msc
        show(source)
        assert source.msc == before + 1


@pytest.mark.parametrize("held_up", [0.0, 0.3, 0.6, 0.9, 1.6, 1.9])
def test_a_pause_before_or_within_sync_moves_nothing(server: Server, held_up: float) -> None:
    """Held up between its questions, sync gets an answer half a refresh early."""
    wait, calls = server.wait, 0

    def slow(kind: int, timeout_s: float) -> bool:
        nonlocal calls
        calls += 1
        if calls == 2:
            server.now_ns += round(held_up * PERIOD_NS)
        return wait(kind, timeout_s)

    server.wait = slow  # type: ignore[method-assign]
    source = source_of(server)
    for _ in range(10):
        before = source.msc
        show(source)
        assert source.msc == before + 1
        assert abs(server.swapped_ns[-1] - source.msc * PERIOD_NS) < 0.3 * PERIOD_NS


class Reports:
    """Completions of swaps, oldest first, each with the number of its vblank."""

    def __init__(self) -> None:
        self.ns = self.msc = self.flipped = 0
        self.pending: list[int] = []

    def wait(self, kind: int, timeout_s: float) -> bool:
        if not self.pending:
            return False
        self.msc = self.pending.pop(0)
        self.ns, self.flipped = self.msc * PERIOD_NS, 1
        return True


def test_a_completion_is_that_of_its_own_swap_and_of_none_before() -> None:
    reports: Any = Reports()
    source = Completions(reports, lambda: reports.pending.append(8))
    reports.pending = [5, 6]  # black panels: shown, and nobody asked when
    source.sync()
    source.put()
    source.shown()
    assert (source.msc, source.ns, source.flipped) == (8, 8 * PERIOD_NS, 1)


def test_a_server_that_is_gone_ends_the_probing() -> None:
    """The next source would only be asked the same, and told of as if it had failed."""
    reports: Any = Reports()

    def swap() -> None:
        raise make_server_lost(":7", "it ended the connection")

    with pytest.raises(DeviceLost, match=":7 does not answer"):
        clocks.measure_period_ns(Completions(reports, swap), lambda: None, float(PERIOD_NS))


VBLANK_NS = 10_000_000

QUARTER_NS = VBLANK_NS // 4


class Events:
    """Answers each question from a list: how long after its vblank, and by how much it is late in
    numbers; then in time for ever."""

    def __init__(self) -> None:
        self.now_ns = 100 * VBLANK_NS
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
        self.now_ns = self.msc * VBLANK_NS + after_ns
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
    source = Vblanks(events, events.swap, lambda: None, float(VBLANK_NS))
    source.sync()
    assert events.asked == [0, 102, 103]
    assert (source.msc, source.ns) == (103, 103 * VBLANK_NS)
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
    assert (source.msc, source.ns) == (107, 107 * VBLANK_NS + 1000)


def test_vblanks_that_all_come_late_are_left_to_go_by_three_times(events: Events) -> None:
    """Then it is the grid that has moved."""
    source = synced(events)
    events.answers = [(QUARTER_NS + 1, 0)] * 9
    source.shown()
    assert events.asked == [104, 105, 106, 107]
    assert source.msc == 107 and source.ns == 107 * VBLANK_NS + QUARTER_NS + 1
    assert len(events.swapped_ns) == 1


@pytest.mark.parametrize(("early_ns", "waits"), [(EARLY_NS, False), (EARLY_NS + 1, True)])
def test_an_answer_before_its_time_is_waited_for_beyond_two_milliseconds(
    events: Events, early_ns: int, waits: bool
) -> None:
    assert EARLY_NS == 2_000_000
    source = synced(events)
    events.answers = [(-early_ns, 0)]
    source.shown()
    due_ns = 104 * VBLANK_NS
    assert source.ns == events.swapped_ns[0] == (due_ns if waits else due_ns - early_ns)


@pytest.mark.parametrize(("early_ns", "ns"), [(1, 0), (0, 0), (3_000_000, 0), (-1, 1)])
def test_a_grid_begins_at_the_later_of_what_two_answers_say(
    events: Events, early_ns: int, ns: int
) -> None:
    """One that came before its time is put right by the one before it."""
    made: Any = events
    source = Vblanks(made, events.swap, lambda: None, float(VBLANK_NS))
    events.answers = [(0, 0), (0, 0), (-early_ns, 0)]
    source.sync()
    assert (source.msc, source.ns) == (103, 103 * VBLANK_NS + ns)


def test_a_source_that_hears_nothing_swaps_nothing(events: Events) -> None:
    source = synced(events)
    events.silent = True
    with pytest.raises(DeviceLost, match="no vblanks are reported"):
        source.shown()
    assert events.swapped_ns == [] and events.asked == [104]
