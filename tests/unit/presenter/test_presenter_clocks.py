"""The source that paces itself by a server's vblanks: on a simulated server, and at its edges."""

from __future__ import annotations

from typing import Any

import pytest

from pdcd.errors import DeviceLost
from pdcd.presenter import clocks
from pdcd.presenter.clocks import Completions, Vblanks
from pdcd.presenter.xconnection import make_server_lost
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


def test_vblanks_that_all_come_late_are_not_let_go_by_for_ever(server: Server) -> None:
    """Then it is the grid that has moved."""
    source, wait, asked = source_of(server), server.wait, 0

    def late(kind: int, timeout_s: float) -> bool:
        nonlocal asked
        asked += 1
        server.now_ns += round(0.4 * PERIOD_NS)
        return wait(kind, timeout_s)

    server.wait = late  # type: ignore[method-assign]
    show(source)
    assert len(server.swapped_ns) == 1 and asked < 10
