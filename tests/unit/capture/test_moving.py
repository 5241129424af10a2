"""A shutter that moves while a display plays, told so by the display's progress."""

from __future__ import annotations

import pytest

from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import ShutterTiming
from pdcd.capture.moving import MovingShutter
from pdcd.errors import DeviceLost, ExposureError
from pdcd.protocol.events import Event, ShutterClosed, ShutterOpen

REFRESH_NS = 16_666_667
SURE_NS = 100_000_000
BEGIN_NS = 5_000_000_000


class Blades:
    """A shutter that takes a tenth of a second."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock, self.orders = clock, list[tuple[str, int]]()
        self.jammed = ""

    def connect(self) -> dict[str, str]:
        return {}

    def open(self) -> int:
        return self._move("open")

    def close(self) -> int:
        return self._move("close")

    def disconnect(self) -> None:
        pass

    def _move(self, word: str) -> int:
        if word == self.jammed:
            raise DeviceLost("the line is gone", device="shutter")
        self.orders.append((word, self.clock.now_ns()))
        self.clock.sleep_until_ns(self.clock.now_ns() + SURE_NS)
        return self.clock.now_ns()


def played(
    refreshes: int, *, jammed: str = ""
) -> tuple[MovingShutter, Blades, list[Event], list[int]]:
    """A display that tells every sixth refresh how far it is."""
    clock, heard, told = VirtualClock(), list[Event](), list[int]()
    blades = Blades(clock)

    def progress(frame: int, frames: int, missed: int) -> None:
        told.append(frame)

    mover = MovingShutter(
        blades, clock, ShutterTiming(10, 0.5), "bar", heard.append, progress, lambda: False
    )
    blades.jammed = jammed
    for frame in range(0, refreshes, 6):
        if mover.over():
            break
        clock.sleep_until_ns(BEGIN_NS + frame * REFRESH_NS)
        mover(frame, refreshes, 0)
    return mover, blades, heard, told


def test_it_opens_and_closes_once() -> None:
    mover, blades, heard, told = played(120)
    opened_ns = BEGIN_NS + 12 * REFRESH_NS
    closed_ns = opened_ns + SURE_NS + 500_000_000
    assert blades.orders == [("open", opened_ns), ("close", closed_ns)]
    assert mover.ended() == (opened_ns + SURE_NS, closed_ns + SURE_NS)
    assert [type(event) for event in heard] == [ShutterOpen, ShutterClosed]
    assert told == list(range(0, 120, 6))


@pytest.mark.parametrize("refreshes", [6, 24])
def test_frames_that_end_first_leave_a_closed_shutter(refreshes: int) -> None:
    mover, blades, _, _ = played(refreshes)
    with pytest.raises(ExposureError, match="ended before"):
        mover.ended()
    assert blades.orders[-1][0] == "close"


@pytest.mark.parametrize("word", ["open", "close"])
def test_a_shutter_that_fails_ends_the_display_before_it_is_told(word: str) -> None:
    """An error that is raised through a display which plays would leave it playing."""
    mover, _, _, told = played(120, jammed=word)
    assert told[-1] < 114
    with pytest.raises(DeviceLost, match="line is gone"):
        mover.ended()
