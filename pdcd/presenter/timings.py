"""Video modes by their clock and totals, and pairs of modes with the same rate.

Sources: VESA E-EDID A2 (EDID 1.4), 3.10.2 (detailed timings); VESA DMT 1.13, by which displays
accept pixel clocks that are off by half a per cent; xorg.conf(5), Modeline.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from pdcd.bench.checks import RATE_TOLERANCE

CLOCK_TOLERANCE = 0.005
"""Largest relative difference between a pixel clock and the one that a display names."""
_USUAL_HZ = 60.0
_POSITIVE_H, _POSITIVE_V, _FIELDS, _DOUBLE = 1, 4, 16, 32
"""Flags of RandR."""


@dataclass(frozen=True)
class VideoTiming:
    """A mode without interlace: pixels and lines that are shown, at start and end of sync, in all.

    positive : whether the horizontal and the vertical sync pulses are positive.
    """

    clock_khz: int
    horizontal: tuple[int, int, int, int]
    vertical: tuple[int, int, int, int]
    positive: tuple[bool, bool] = (True, True)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.horizontal[0], self.vertical[0]

    @property
    def refresh_hz(self) -> float:
        """Pictures a second."""
        return self.clock_khz * 1e3 / (self.horizontal[3] * self.vertical[3])

    def to_modeline(self, name: str) -> str:
        """The mode as xorg.conf has it after the word Modeline."""
        numbers = " ".join(map(str, (*self.horizontal, *self.vertical)))
        signs = " ".join(
            f"{'+' if up else '-'}{axis}sync" for up, axis in zip(self.positive, "hv", strict=True)
        )
        return f'"{name}" {self.clock_khz / 1e3:.3f} {numbers} {signs}'


def _is_sound(timing: VideoTiming) -> bool:
    rising = all(
        0 < shown <= start < end <= total
        for shown, start, end, total in (timing.horizontal, timing.vertical)
    )
    return timing.clock_khz > 0 and rising


def parse_detailed_timing(block: bytes) -> VideoTiming | None:
    """The timing in 18 bytes of an EDID; None for a descriptor of another kind, and for an
    interlaced or impossible timing."""
    (clock,) = struct.unpack_from("<H", block)
    if not clock or block[17] & 0x80:
        return None
    high = block[11]
    axes = []
    for at, start, width in (
        (2, block[8] | high >> 6 << 8, block[9] | (high >> 4 & 3) << 8),
        (5, block[10] >> 4 | (high >> 2 & 3) << 4, block[10] & 15 | (high & 3) << 4),
    ):
        shown = block[at] | block[at + 2] >> 4 << 8
        blank = block[at + 1] | (block[at + 2] & 15) << 8
        axes.append((shown, shown + start, shown + start + width, shown + blank))
    separate = block[17] & 0x18 == 0x18
    signs = bool(block[17] & 2), bool(block[17] & 4)
    found = VideoTiming(clock * 10, axes[0], axes[1], signs if separate else (True, True))
    return found if _is_sound(found) else None


def from_server_mode(mode: Any) -> VideoTiming | None:
    """The timing of a RandR mode; None for a mode that is interlaced or lacks clock or totals."""
    flags = mode["flags"]
    if flags & (_FIELDS | _DOUBLE):
        return None
    axes = [
        (mode[size], mode[f"{axis}_sync_start"], mode[f"{axis}_sync_end"], mode[f"{axis}_total"])
        for size, axis in (("width", "h"), ("height", "v"))
    ]
    signs = bool(flags & _POSITIVE_H), bool(flags & _POSITIVE_V)
    found = VideoTiming(mode["dot_clock"] // 1000, axes[0], axes[1], signs)
    return found if _is_sound(found) else None


def match_timings(
    projector: Sequence[VideoTiming], mask: Sequence[VideoTiming]
) -> tuple[VideoTiming, VideoTiming] | None:
    """Modes of one rate for two panels, from the modes that each offers, its own best mode first.

    Each panel keeps the size of its best mode. The projector's clock is moved to the mask's rate,
    by `CLOCK_TOLERANCE` at most. None where the panels have no such modes.
    """
    found: list[tuple[int, float, int, tuple[VideoTiming, VideoTiming]]] = []
    for first, second in product(_of_own_size(projector), _of_own_size(mask)):
        ratio = second.refresh_hz / first.refresh_hz
        clock = round(first.clock_khz * ratio)
        moved = replace(first, clock_khz=clock)
        step = abs(moved.refresh_hz / second.refresh_hz - 1.0)
        if abs(ratio - 1.0) <= CLOCK_TOLERANCE and step <= RATE_TOLERANCE:
            cost = abs(second.refresh_hz - _USUAL_HZ), abs(ratio - 1.0)
            found.append((round(cost[0]), cost[1], len(found), (moved, second)))
    return min(found)[-1] if found else None


def _of_own_size(timings: Sequence[VideoTiming]) -> list[VideoTiming]:
    return [timing for timing in timings if timing.size == timings[0].size]
