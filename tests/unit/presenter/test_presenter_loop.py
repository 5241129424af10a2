"""The loop on a simulated display that queues swaps, as a graphics card's does."""

from __future__ import annotations

import time
from collections.abc import Callable

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
    assert set(log[:, Column.FLIPPED]) == {1}


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
