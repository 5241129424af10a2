"""Phase between the vblanks of two outputs: their periods, and how late one comes after the other.

The X server is asked for each output's vblanks through a small window that lies on it and is never
shown. A server without screens counts one clock for all windows; this is recognised, and nothing is
measured then. It has never been run on two real outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.presenter.messages import Rect
from pdcd.presenter.xconnection import close_x_connection, guard_x_calls, open_x_connection
from pdcd.presenter.xpresent import KIND_MSC, PresentEvents

_SAMPLES = 20
_FIRST_SAMPLES = 8
"""Samples after which a server's timer is mostly recognised; then no more samples are taken."""
_STEP = 2
"""Refreshes between two samples of one output."""
_TIMEOUT_S = 0.5
_STEADY_NS = 100_000.0
"""The vblank stamps of a screen scatter by less than this: the kernel takes them from the scan-out.
A server that makes vblanks up uses a timer of whole milliseconds (`present_fake.c` of xserver
21.1), which scatters by at least 290 us."""

_Stamps = NDArray[np.int64]
"""(S, 2): ns and msc of some vblanks of one output."""


@dataclass(frozen=True)
class VblankPhase:
    """Periods of two outputs, and the phase between them.

    period_s : length of a refresh of projector and mask.
    lag_s : how much later the mask's vblank comes than the projector's nearest one, at the last
        sample; negative when it comes earlier.
    """

    period_s: tuple[float, float]
    lag_s: float


def is_from_timer(stamps: _Stamps) -> bool:
    """Whether these stamps come from the server's timer, not from a screen."""
    period, at_ns = _line(stamps)
    expected = at_ns + (stamps[:, 1] - stamps[-1, 1]) * period
    return float(np.std(stamps[:, 0] - expected)) > _STEADY_NS


def compare_vblanks(projector: _Stamps, mask: _Stamps) -> VblankPhase | None:
    """Periods and phase by straight lines through the stamps; None where a timer made them."""
    if is_from_timer(projector) or is_from_timer(mask):
        return None
    lines = [_line(s) for s in (projector, mask)]
    (first, first_ns), (second, second_ns) = lines
    period = min(first, second)
    # Both lines at the same time: a vblank of the projector near the last sample.
    at_ns = float(max(projector[-1, 0], mask[-1, 0]))
    apart = (second_ns - at_ns) % second - (first_ns - at_ns) % first
    lag = (apart + 0.5 * period) % period - 0.5 * period
    return VblankPhase((first * 1e-9, second * 1e-9), lag * 1e-9)


def measure_vblank_phase(name: str, panels: tuple[Rect, Rect]) -> VblankPhase | None:
    """Ask an X server about both outputs; takes a second.

    None if the server cannot say. Raises DeviceLost when the server goes away.
    """
    found = _sample_windows(name, panels)
    return None if found is None else compare_vblanks(*found)


def _line(stamps: _Stamps) -> tuple[float, float]:
    """Period and time of one vblank, in ns, by least squares."""
    origin_ns, count = stamps[-1]
    period, offset = np.polyfit(stamps[:, 1] - count, (stamps[:, 0] - origin_ns).astype(float), 1)
    return float(period), float(origin_ns + offset)


def _sample_windows(name: str, panels: tuple[Rect, Rect]) -> tuple[_Stamps, _Stamps] | None:
    """Vblanks of both outputs, as a server reports them to windows there."""
    display = open_x_connection(name)
    try:
        with guard_x_calls(display):
            windows = [_window(display, place) for place in panels]
            display.sync()
        projector, mask = (PresentEvents(name, int(window.id)) for window in windows)
        try:
            return _sample((projector, mask))
        finally:
            projector.close()
            mask.close()
    finally:
        close_x_connection(display)


def _window(display: Any, place: Rect) -> Any:
    screen = display.screen()
    return screen.root.create_window(
        place.x, place.y, 1, 1, 0, screen.root_depth, override_redirect=True
    )


def _sample(both: tuple[PresentEvents, PresentEvents]) -> tuple[_Stamps, _Stamps] | None:
    """Vblanks of both outputs, one after the other; None where none come."""
    stamps: tuple[list[tuple[int, int]], ...] = ([], [])
    for number in range(_SAMPLES + 1):
        for events in both:
            events.ask(events.msc + _STEP if number else 0)
        for events, seen in zip(both, stamps, strict=True):
            if not events.wait(KIND_MSC, _TIMEOUT_S):
                return None
            seen.append((events.ns, events.msc))
        if number == _FIRST_SAMPLES and is_from_timer(np.array(stamps[0][1:], dtype=np.int64)):
            return None
    # The first request was answered at once, between two vblanks.
    projector, mask = (np.array(seen[1:], dtype=np.int64) for seen in stamps)
    return projector, mask
