"""Which vblank a frame was shown at: time sources, and the probe that finds the best one.

A source also sets the pace: `put` hands over what was drawn, `shown` returns once the oldest frame
handed over is on the panels, with `ns` and `msc` of the vblank at which that began. From best to
worst: the display system reports when each swap was shown; the vblank is known but not which swap
it took; or there is only the processor's clock. What a server advertises is not believed: a source
is used only after 30 frames through it have come back as they should.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from pdcd.errors import DeviceLost
from pdcd.presenter.xconnection import ServerLost
from pdcd.presenter.xpresent import KIND_MSC, KIND_PIXMAP, PresentEvents

_WARM_UP_FRAMES = 30
_ROUNDS = 3
"""How many times a source is tried that keeps the period but misses refreshes."""
_PERIOD_TOLERANCE = 0.02
"""Largest relative error of the period at which a source is believed."""
_SPIN_NS = 50_000
"""A real-time process may wake this late, so it polls the clock for as long instead of sleeping."""
_LATE = 0.25
"""Part of a refresh by which a swap may follow its vblank and still count as in time."""
EARLY_NS = 2_000_000
"""Vblanks that a server makes up scatter by a millisecond; one reported earlier than this is
waited for."""
_VBLANK_TRIES = 4
"""Vblanks that may be late in a row; after that, the grid they are measured against has moved."""
_EVENT_TIMEOUT_S = 0.5
_SETTLED_S = 0.05
"""Three refreshes: when no swap was shown for this long, none is under way."""

_Swap = Callable[[], None]


class TimeSource(Protocol):
    """One way to know when a frame was shown.

    queues : two frames handed over in one go are shown at two vblanks.
    ns, msc : time (CLOCK_MONOTONIC) and number of the vblank of the oldest frame, after `shown`.
    flipped : 1 when that frame was reported as a page flip.
    """

    name: str
    queues: bool
    ns: int
    msc: int
    flipped: int

    def sync(self) -> None:
        """Find the vblank again after a pause."""
        ...

    def put(self) -> None:
        """Hand over what was drawn."""
        ...

    def shown(self) -> None:
        """Wait until the oldest frame handed over is on the panels."""
        ...


class Completions:
    """Present CompleteNotify of each swap: the display system says when, and whether it flipped."""

    name = "present-complete"
    queues = True

    def __init__(self, events: PresentEvents, swap: _Swap) -> None:
        self._events = events
        self._swap = swap
        self.ns = self.msc = self.flipped = 0

    def sync(self) -> None:
        """Let swaps be shown that were not waited for, such as black panels."""
        while self._events.wait(KIND_PIXMAP, _SETTLED_S):
            pass

    def put(self) -> None:
        """Swap; the server shows it at the next vblank that is free."""
        self._swap()

    def shown(self) -> None:
        """Take the oldest completion."""
        if not self._events.wait(KIND_PIXMAP, _EVENT_TIMEOUT_S):
            raise DeviceLost("swaps are not reported as shown", device="display", hint=_OTHER)
        self.ns, self.msc = self._events.ns, self._events.msc
        self.flipped = self._events.flipped


class Vblanks:
    """Present NotifyMSC: swaps right after a vblank that the server reports.

    The vblank is the screen's; a server without a screen makes vblanks up from its clock. The swap
    itself is not reported: it is assumed to show at that vblank.
    """

    name = "present-msc"
    queues = False

    def __init__(self, events: PresentEvents, swap: _Swap, finish: _Swap, period_ns: float) -> None:
        self._events = events
        self._swap = swap
        self._finish = finish
        self._period_ns = period_ns
        self.ns = self.msc = self.flipped = 0

    def sync(self) -> None:
        """Find a current vblank."""
        self._ask(0)
        self._ask(self._events.msc + 2)
        ns, msc = self._events.ns, self._events.msc
        self._ask(msc + 1)
        self.ns, self.msc = self._events.ns, self._events.msc
        if self.ns - ns < (self.msc - msc) * self._period_ns:
            # A server without a screen answered this one too early: count from the other one.
            self.ns = ns + round((self.msc - msc) * self._period_ns)

    def put(self) -> None:
        """Finish the drawing: the swap must cost no time."""
        self._finish()

    def shown(self) -> None:
        """Swap at the next vblank; one that passed too long ago is skipped."""
        msc, late_ns = self.msc + 1, round(_LATE * self._period_ns)
        for _ in range(_VBLANK_TRIES):
            self._ask(msc)
            msc = self._events.msc
            # A server without a screen reports a vblank up to half a refresh before it comes.
            due_ns = self.ns + round((msc - self.msc) * self._period_ns)
            now_ns = time.monotonic_ns()
            if now_ns - due_ns <= late_ns:
                break
            msc += 1
        ns, msc = self._events.ns, self._events.msc
        if due_ns - now_ns > EARLY_NS:
            wait_until_ns(due_ns)
            ns = due_ns
        self._swap()
        self.ns, self.msc = ns, msc

    def _ask(self, msc: int) -> None:
        self._events.ask(msc)
        if not self._events.wait(KIND_MSC, _EVENT_TIMEOUT_S):
            raise DeviceLost("no vblanks are reported", device="display", hint=_OTHER)


class SwapReturns:
    """The processor's clock after a swap that waits for the vblank has returned and finished."""

    name = "swap"
    queues = False

    def __init__(self, swap: _Swap, finish: _Swap, period_ns: float) -> None:
        self._swap = swap
        self._finish = finish
        self._period_ns = period_ns
        self.ns = time.monotonic_ns()
        self.msc = self.flipped = 0

    def sync(self) -> None:
        """Two swaps: the second returns at a vblank."""
        self.shown()
        self.shown()

    def put(self) -> None:
        """Nothing yet: the swap waits."""

    def shown(self) -> None:
        """Swap and wait for the graphics card."""
        self._swap()
        self._finish()
        ns = time.monotonic_ns()
        self.msc += max(1, round((ns - self.ns) / self._period_ns))
        self.ns = ns


class ProcessorClock:
    """Swaps on a grid of the processor's clock: for servers with no vblank of any kind."""

    name = "clock"
    queues = False

    def __init__(self, swap: _Swap, finish: _Swap, period_ns: float) -> None:
        self._swap = swap
        self._finish = finish
        self._period_ns = period_ns
        self._start_ns = time.monotonic_ns()
        self.ns = self._start_ns
        self.msc = self.flipped = 0

    def sync(self) -> None:
        """Find the current point of the grid."""
        self.msc = int((time.monotonic_ns() - self._start_ns) / self._period_ns)

    def put(self) -> None:
        """Finish the drawing: the swap must cost no time."""
        self._finish()

    def shown(self) -> None:
        """Swap at the next point of the grid that has not passed."""
        elapsed = (time.monotonic_ns() - self._start_ns) / self._period_ns
        # A point that has only just passed counts as met.
        self.msc = max(self.msc + 1, int(np.ceil(elapsed - _LATE)))
        due_ns = self._start_ns + round(self.msc * self._period_ns)
        wait_until_ns(due_ns)
        self._swap()
        self.ns = due_ns


_OTHER = "choose another time_source in [display.options]"


class FreeRunningSource:
    """No pace at all: each frame as soon as the last one is drawn, to measure how fast that is."""

    name = "free"
    queues = False

    def __init__(self, swap: _Swap, finish: _Swap) -> None:
        self._swap = swap
        self._finish = finish
        self.ns = self.msc = self.flipped = 0

    def sync(self) -> None:
        """Nothing to find."""

    def put(self) -> None:
        """Swap."""
        self._swap()

    def shown(self) -> None:
        """Wait for the drawing; counts frames, not vblanks."""
        self._finish()
        self.ns = time.monotonic_ns()
        self.msc += 1


def wait_until_ns(t_ns: int) -> None:
    """Sleep, then spin: a sleep alone wakes too late."""
    while (left_ns := t_ns - time.monotonic_ns()) > 0:
        if left_ns > _SPIN_NS:
            time.sleep((left_ns - _SPIN_NS) * 1e-9)


def measure_period_ns(
    source: TimeSource, frame: Callable[[], None], period_ns: float
) -> float | None:
    """Show 30 black frames; the source's period in ns, or None when the source does not deliver.

    A source delivers when it counts at least half of the frames once, as some come late on a busy
    machine, and its period is the nominal one within 2 %. A source that keeps the period while most
    frames come late is tried again: brief load must not lead to a worse source.
    """
    for _ in range(_ROUNDS):
        stamps, counts = [], []
        try:
            source.sync()
            for _ in range(_WARM_UP_FRAMES):
                frame()
                source.put()
                source.shown()
                stamps.append(source.ns)
                counts.append(source.msc)
        except ServerLost:
            raise
        except DeviceLost:
            return None
        steps, ticks = np.diff(stamps), np.diff(counts)
        if np.any(steps <= 0) or np.any(ticks < 0):
            return None
        found = float((stamps[-1] - stamps[0]) / max(counts[-1] - counts[0], 1))
        if abs(found / period_ns - 1.0) > _PERIOD_TOLERANCE:
            return None
        if np.mean(ticks == 1) >= 0.5:
            return found
    return None
