"""The loop on a simulated display that queues swaps, as a graphics card's does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.presenter import loop
from pdcd.presenter.loop import Loop
from pdcd.presenter.messages import HEAD_SIZE, LOG_COLUMNS, Column, Head

PERIOD_NS = 10_000_000


class Screen:
    """A display in simulated time: each swap is shown at the first free vblank after it.

    `now_ns` moves by what the test takes from it; `lit` is what was on the panel, by vblank.
    """

    name = "screen"
    queues = True

    def __init__(self, delays_ns: dict[int, int]) -> None:
        self.now_ns = 5 * PERIOD_NS
        self.ns, self.msc, self.flipped = 5 * PERIOD_NS, 5, 1
        self._last = 5
        self._queue: list[int] = []
        self._delays_ns = delays_ns
        self._drawn = -1
        self.lit: dict[int, int] = {}

    def sync(self) -> None:
        pass

    def draw(self, number: int) -> None:
        # Drawing this refresh takes so much longer: a process that was held up.
        self.now_ns += self._delays_ns.get(number, 0) + 100_000
        self._drawn = number

    def put(self) -> None:
        self._last = max(self._last + 1, -(-self.now_ns // PERIOD_NS))
        self._queue.append(self._last)
        self.lit[self._last] = self._drawn

    def shown(self) -> None:
        self.msc = self._queue.pop(0)
        self.ns = self.msc * PERIOD_NS
        self.now_ns = max(self.now_ns, self.ns)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Screen, NDArray[np.int64]]]:
    def play(
        opens: list[bool],
        *,
        delays_ns: dict[int, int] | None = None,
        queues: bool = True,
        stop: Callable[[NDArray[np.int64]], bool] = lambda _: False,
    ) -> tuple[Screen, NDArray[np.int64]]:
        screen = Screen(delays_ns or {})
        screen.queues = queues

        def sleep_until(t_ns: int) -> None:
            screen.now_ns = max(screen.now_ns, t_ns)

        monkeypatch.setattr(time, "monotonic_ns", lambda: screen.now_ns)
        monkeypatch.setattr(loop, "wait_until_ns", sleep_until)
        log = np.zeros((len(opens), LOG_COLUMNS), dtype=np.int64)
        head = np.zeros(HEAD_SIZE, dtype=np.int64)
        Loop(screen, screen.draw, opens, PERIOD_NS, lambda: stop(head), {}).run(log, head, 0)
        assert (
            head[Head.MISSED]
            == np.maximum(np.diff(log[: head[Head.SHOWN], Column.MSC]) - 1, 0).sum()
        )
        return screen, log[: head[Head.SHOWN]]

    return play


Run = Callable[..., tuple[Screen, NDArray[np.int64]]]

GUARDED = [False, False] + [False, True, False] * 4 + [False]


def lasted(log: NDArray[np.int64]) -> list[int]:
    return [int(n) for n in np.diff(log[:, Column.MSC])]


def test_every_refresh_is_shown_once(run: Run) -> None:
    screen, log = run(GUARDED)
    assert lasted(log) == [1] * (len(GUARDED) - 1)
    assert list(screen.lit.values()) == list(range(len(GUARDED)))
    np.testing.assert_array_equal(log[:, Column.NS], log[:, Column.MSC] * PERIOD_NS)


@pytest.mark.parametrize("late", [n for n in range(2, 15) if not GUARDED[n - 1]])
def test_a_late_process_stretches_black_and_never_a_code(run: Run, late: int) -> None:
    """Held up before any refresh but the black that ends a code: that was queued with it."""
    _, log = run(GUARDED, delays_ns={late: 3 * PERIOD_NS})
    stretched = [n for n, count in enumerate(lasted(log)) if count > 1]
    assert not any(GUARDED[n] for n in stretched)


def test_a_code_just_late_waits_for_one_more_black(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Held up by 0.6 refreshes before a code: there is time for this vblank, but no margin."""
    wait = round(0.6 * PERIOD_NS)
    shown = Screen.shown

    def slow(screen: Screen) -> None:
        shown(screen)
        if screen.msc == 8:  # the guard before the first code is on
            screen.now_ns += wait

    monkeypatch.setattr(Screen, "shown", slow)
    _, log = run(GUARDED)
    assert lasted(log)[2] == 2
    assert sum(lasted(log)) == len(GUARDED)


def test_held_up_between_a_code_and_its_black_is_counted(run: Run) -> None:
    """The moment between two swaps is all that a queue leaves to the process."""
    _, log = run(GUARDED, delays_ns={4: 3 * PERIOD_NS})
    assert lasted(log)[3] == 3


def test_without_a_queue_a_late_black_stretches_the_code_and_is_counted(run: Run) -> None:
    _, log = run(GUARDED, delays_ns={4: 2 * PERIOD_NS}, queues=False)
    assert lasted(log)[3] == 3


def test_stop_ends_the_pass(run: Run) -> None:
    _, log = run(GUARDED, stop=lambda head: head[Head.SHOWN] == 5)
    assert len(log) == 5


@pytest.mark.parametrize(("held_up", "waits"), [(0.45, False), (0.55, True), (0.9, True)])
@pytest.mark.parametrize("before", [0, 2])
def test_half_a_refresh_is_the_last_moment_for_a_code(
    monkeypatch: pytest.MonkeyPatch, held_up: float, waits: bool, before: int
) -> None:
    """Also for one that comes first; it is then put well after the vblank that was let go by."""
    screen = Screen({})
    slept_ns: list[int] = []

    def sleep_until(t_ns: int) -> None:
        slept_ns.append(t_ns)
        screen.now_ns = max(screen.now_ns, t_ns)

    monkeypatch.setattr(time, "monotonic_ns", lambda: screen.now_ns)
    monkeypatch.setattr(loop, "wait_until_ns", sleep_until)
    shown = screen.shown

    def late() -> None:
        shown()
        if len(screen.lit) == before:
            screen.now_ns += round(held_up * PERIOD_NS)

    monkeypatch.setattr(screen, "shown", late)
    if not before:
        screen.now_ns += round(held_up * PERIOD_NS)
    opens = [False] * before + [True, False, False]
    log = np.zeros((len(opens), LOG_COLUMNS), dtype=np.int64)
    Loop(screen, screen.draw, opens, PERIOD_NS, lambda: False, {}).run(
        log, np.zeros(HEAD_SIZE, dtype=np.int64), 0
    )
    vblank_ns = (5 + before) * PERIOD_NS
    assert len(slept_ns) == waits
    put_ns = log[before, Column.PUT_NS] - vblank_ns
    assert 1.0 <= put_ns / PERIOD_NS < 1.5 if waits else put_ns == round(held_up * PERIOD_NS)


def test_a_code_right_after_the_black_of_another_is_let_wait_too(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where one black ends a code and precedes the next."""
    shown = Screen.shown

    def slow(screen: Screen) -> None:
        shown(screen)
        if screen.msc == 8:  # the black between the codes is on
            screen.now_ns += round(0.6 * PERIOD_NS)

    monkeypatch.setattr(Screen, "shown", slow)
    _, log = run([False, True, False, True, False])
    assert log[3, Column.PUT_NS] >= 9 * PERIOD_NS
    assert lasted(log) == [1, 1, 2, 1]


def test_every_refresh_has_its_times_also_a_code_that_is_the_last(run: Run) -> None:
    for opens in (GUARDED, [False, True]):
        _, log = run(opens)
        assert (log[:, Column.PUT_NS] >= 5 * PERIOD_NS).all()
        assert (log[:, Column.SWAP_NS] >= log[:, Column.PUT_NS] + 100_000).all()
        used_ns = log[:, Column.CPU_NS]
        assert used_ns[0] > 0 and (np.diff(used_ns) > 0).all()
        assert used_ns[-1] <= time.thread_time_ns()


@pytest.mark.parametrize(("late", "spoilt"), [(None, 0), (2, 0), (4, 1), (5, 0)])
def test_only_codes_that_lasted_too_long_are_called_spoilt(
    run: Run, late: int | None, spoilt: int
) -> None:
    """Refresh 3 is a code; without a queue its black may come late."""
    heads: list[NDArray[np.int64]] = []

    def note(head: NDArray[np.int64]) -> bool:
        heads.append(head)
        return False

    delays = {} if late is None else {late: 2 * PERIOD_NS}
    _, log = run(GUARDED, delays_ns=delays, queues=False, stop=note)
    assert heads[-1][Head.SPOILT] == spoilt
    assert heads[-1][Head.MISSED] == (0 if late is None else 2)
    assert heads[-1][Head.SHOWN] == len(GUARDED)
    assert set(log[:, Column.FLIPPED]) == {1}


@pytest.mark.parametrize(("first", "stalled"), [(0, [4]), (3, [7]), (-2, [2]), (20, [])])
def test_a_wanted_stall_comes_after_its_refresh(
    monkeypatch: pytest.MonkeyPatch, first: int, stalled: list[int]
) -> None:
    source = Steady(PERIOD_NS, 1)
    found: list[tuple[int, Any]] = []
    monkeypatch.setattr(
        time, "sleep", lambda seconds: found.append((source.msc - 1, pytest.approx(seconds)))
    )
    log = np.zeros((9, LOG_COLUMNS), dtype=np.int64)
    head = np.zeros(HEAD_SIZE, dtype=np.int64)
    stopped = Loop(source, lambda n: None, [False] * 9, PERIOD_NS, lambda: False, {4: 50_000_000})
    assert stopped.run(log, head, first) is True
    assert found == [(n, 0.05) for n in stalled]


def test_a_pass_that_is_stopped_says_so() -> None:
    log = np.zeros((9, LOG_COLUMNS), dtype=np.int64)
    head = np.zeros(HEAD_SIZE, dtype=np.int64)
    one = Loop(Steady(PERIOD_NS, 1), lambda n: None, [False] * 9, PERIOD_NS, lambda: True, {})
    assert one.run(log, head, 0) is False
    assert head[Head.SHOWN] == 1


class Steady:
    """A source whose every refresh lasts as long and counts as many as the last."""

    name, queues, flipped = "steady", False, 0

    def __init__(self, period_ns: int, step: int) -> None:
        self.ns = self.msc = 0
        self._period_ns, self._step = period_ns, step

    def sync(self) -> None:
        pass

    def put(self) -> None:
        pass

    def shown(self) -> None:
        self.ns += self._period_ns
        self.msc += self._step
