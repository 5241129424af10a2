"""One deadline and one cancel for every loop that waits for a device."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from pdcd.bench.clock import VirtualClock
from pdcd.bench.patience import LOOK_S, Patience
from pdcd.errors import Cancelled, DeviceLost, ExposureError, PdcdError


class Waits:
    """Who waits: on a clock of its own, with a job that may be cancelled."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.looks_ns: list[int] = []
        self.cancelled = False
        self.patience = Patience(self.clock, self._look, lambda: self.cancelled)
        self.begun_ns = self.clock.now_ns()

    def _look(self) -> None:
        self.looks_ns.append(self.clock.now_ns())

    @property
    def waited_s(self) -> float:
        return (self.clock.now_ns() - self.begun_ns) * 1e-9


def error(kind: type[PdcdError]) -> Callable[[], PdcdError]:
    return lambda: kind("over", device="camera")


def test_a_wait_looks_often_and_lasts_as_long_as_it_should() -> None:
    waits = Waits()
    waits.patience.sleep(1.05)
    assert waits.waited_s == pytest.approx(1.05, abs=1e-9)
    gaps = [b - a for a, b in zip(waits.looks_ns, waits.looks_ns[1:], strict=False)]
    assert max(gaps) <= LOOK_S * 1e9 and waits.looks_ns[-1] == waits.clock.now_ns()
    waits.patience.sleep_until_ns(0)  # has passed
    assert waits.waited_s == pytest.approx(1.05, abs=1e-9)


@pytest.mark.parametrize(
    ("inner_s", "outer_s", "kind", "at_s"),
    [(1.0, 5.0, ExposureError, 1.0), (5.0, 1.0, DeviceLost, 1.0), (1.0, 1.0, DeviceLost, 1.0)],
)
def test_of_nested_deadlines_the_first_ends_the_wait_and_the_outer_of_equal_ones(
    inner_s: float, outer_s: float, kind: type[PdcdError], at_s: float
) -> None:
    waits = Waits()
    patience = waits.patience
    with pytest.raises(kind):
        with patience.within(outer_s, error(DeviceLost)):
            with patience.within(inner_s, error(ExposureError)):
                patience.sleep(100.0)
    assert at_s <= waits.waited_s <= at_s + LOOK_S
    patience.sleep(100.0)  # deadlines end with their blocks


def test_a_cancel_is_heard_but_for_what_closes() -> None:
    waits = Waits()
    waits.cancelled = True
    with waits.patience.deaf():
        with waits.patience.deaf():
            waits.patience.sleep(1.0)
        waits.patience.sleep(1.0)
    with pytest.raises(Cancelled):
        waits.patience.sleep(1.0)
    assert waits.waited_s == pytest.approx(2.0)


def test_deadline_and_deafness_are_of_one_thread() -> None:
    waits = Waits()
    waits.cancelled = True
    raised: list[PdcdError] = []

    def look() -> None:
        try:
            waits.patience.look()
        except PdcdError as err:
            raised.append(err)

    with waits.patience.deaf(), waits.patience.within(-1.0, error(ExposureError)):
        other = threading.Thread(target=look)
        other.start()
        other.join()
    assert [type(err) for err in raised] == [Cancelled]


def test_a_lock_that_another_thread_holds_is_waited_for_with_patience() -> None:
    waits, lock = Waits(), threading.Lock()
    lock.acquire()
    waits.cancelled = True
    with pytest.raises(Cancelled):
        waits.patience.acquire(lock)
    lock.release()
    waits.patience.acquire(lock)
    assert lock.locked()
