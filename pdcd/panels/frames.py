"""What both panels are asked to show, refresh by refresh, and what they really did."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.patterns import Patterns

BLACK = -1
"""Pattern index of a black panel."""


WHITE = -2
"""Pattern index of a fully lit (projector) or fully open (mask) panel."""


PIXEL_WINDOW = "pixels"
"""Window of frames whose patterns are pictures of the panels' own pixels."""


@dataclass(frozen=True)
class Frames:
    """What both panels are asked to show, refresh by refresh (F refreshes).

    primal_patterns, dual_patterns : (P, ceil(L/8)) uint8 or (P, L) float32
        Patterns over the L lattice cells (row-major), as `pdcd.panels.patterns` describes: packed
        bits or grey levels, as they are sent (`pdcd.panels.curve` says what light they give).
    primal_index, dual_index : (F,) int32
        Which pattern each panel shows at each refresh; `BLACK` and `WHITE` are negative.
    shift : (F,) uint8
        Sub-shift 0..3 of both panels at this refresh (0 everywhere in whole-cell mode).
        Bit 0 shifts by half a cell along columns, bit 1 along rows, towards the origin.
    code : (F,) int32
        Code that the refresh belongs to, counted over all passes; -1 before and after.
    guard : (F,) bool
        True where the mask is black by plan.
    grid : (rows, cols)
        Cells of the scene; `lattice` (rows, cols) is that of the patterns (one more of each in
        quarter-window mode, so that shifted cells cover the borders).
    window : "whole", "quarter" or "pixels"
        Part of each mask cell that opens: all of it, or its central half by half. "pixels": there
        are no cells, and patterns are pictures of each panel's own pixels, L = width * height of
        that panel, row-major from its upper left corner. Then white is every pixel, nothing is
        shifted, and `grid` and `lattice` say nothing.
    dark_s : (F,) float64, or None
        Seconds for which both panels are black after each row, beyond the time of the row itself:
        the dark time between two patterns of a DMD. None is none.
    delay_s : (F,) float64, or None
        Seconds by which the mask begins each row after the projector does, on purpose (negative:
        before it). None is none.
    """

    primal_patterns: Patterns
    dual_patterns: Patterns
    primal_index: NDArray[np.int32]
    dual_index: NDArray[np.int32]
    shift: NDArray[np.uint8]
    code: NDArray[np.int32]
    guard: NDArray[np.bool_]
    grid: tuple[int, int]
    lattice: tuple[int, int]
    window: str
    dark_s: NDArray[np.float64] | None = None
    delay_s: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return int(self.primal_index.size)

    @property
    def of_pixels(self) -> bool:
        """Whether patterns are pictures of the panels' own pixels."""
        return self.window == PIXEL_WINDOW


@dataclass(frozen=True)
class FrameLog:
    """What the panels really did, one row per refresh that was shown (R rows).

    R is the number of rows of `Frames`, or more: after passes that compensate for missed refreshes,
    with a delayed mask, or where a packed video refresh was shown again.

    primal_shown, dual_shown : (R,) int32
        Row of `Frames` whose content each panel carried (differs from what was asked when a
        frame was dropped or stale); `BLACK` where the panel was black for no row of `Frames`.
    primal_ns, dual_ns : (R,) int64
        When that content began to be sent to each panel, on the injected clock.
    end_ns : (2,) int64
        When each panel (primal, dual) went black after the last row.
    missed : (R,) int32
        Refreshes by which the row came late; 0 when on time.
    source, verified :
        Name of the time source, and whether it proves presentation rather than submission.
    primal_asked, dual_asked : (R,) int32, or None
        Row of `Frames` that each panel was to carry, `BLACK` for none; None is 0, 1, 2 ...
    mask_delay : rows
        By how many rows the mask's stream was sent later than the projector's, on purpose.
    dark_s, delay_s : (R,) float64, or None
        As of `Frames`, of what was shown: for how long both panels were black before the next row,
        and by how much the mask began after the projector on purpose. None is none.
    pulses : how many pulses projector and mask have given at their outputs if they showed exactly
        these rows, for a camera that counts them (`pdcd.bench.devices.PhotoFrame`); None for
        displays without such outputs. Tables of refreshes do not have it.
    pulses_hint : what to check on this display if a camera counted another number.
    """

    primal_shown: NDArray[np.int32]
    dual_shown: NDArray[np.int32]
    primal_ns: NDArray[np.int64]
    dual_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    missed: NDArray[np.int32]
    source: str
    verified: bool
    primal_asked: NDArray[np.int32] | None = None
    dual_asked: NDArray[np.int32] | None = None
    mask_delay: int = 0
    dark_s: NDArray[np.float64] | None = None
    delay_s: NDArray[np.float64] | None = None
    pulses: tuple[int, int] | None = None
    pulses_hint: str = ""

    def __len__(self) -> int:
        return int(self.primal_shown.size)

    @property
    def asked(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Rows of `Frames` that projector and mask were to carry, (R,) int32 each."""
        rows = np.arange(len(self), dtype=np.int32)
        primal = rows if self.primal_asked is None else self.primal_asked
        return primal, rows if self.dual_asked is None else self.dual_asked


def invert_mask_patterns(frames: Frames) -> Frames:
    """The same frames with the mask's patterns inverted, through the same windows.

    A sensor of two buckets gathers in the second one the light that a pattern keeps out of the
    first. Where the mask is black by plan, and outside its windows, neither gathers anything.
    """
    patterns: Patterns
    if frames.dual_patterns.dtype == np.uint8:
        patterns = ~np.asarray(frames.dual_patterns, np.uint8)
    else:
        patterns = np.asarray(1.0 - frames.dual_patterns, np.float32)
    index = np.where(frames.dual_index == WHITE, BLACK, frames.dual_index).astype(np.int32)
    return replace(frames, dual_patterns=patterns, dual_index=index)


def split_dark_times(log: FrameLog) -> FrameLog:
    """The same log with each dark time as a black row of its own, and without times of rows.

    For all that sums over what panels showed: no row of `Frames` asks for such a row. The last row
    goes black at `end_ns`, and has none after it. A dark time that is longer than its row lasted
    fills that row. The delay of the mask is still in `dual_ns`.
    """
    dark_s, count = log.dark_s, len(log)
    if dark_s is None or not np.any(dark_s[:-1]):
        return replace(log, dark_s=None, delay_s=None)
    dark = np.append(dark_s[:-1] > 0.0, False)
    place = np.arange(count) + np.append(0, np.cumsum(dark)[:-1])
    after = place[dark] + 1
    rows = count + int(dark.sum())
    dark_ns = np.rint(1e9 * dark_s[dark]).astype(np.int64)

    def spread(values: NDArray[np.int32], gap: int) -> NDArray[np.int32]:
        spreaded = np.full(rows, gap, dtype=np.int32)
        spreaded[place] = values
        return spreaded

    def spread_times(start_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        times = np.empty(rows, dtype=np.int64)
        times[place] = start_ns
        times[after] = np.maximum(start_ns[1:][dark[:-1]] - dark_ns, start_ns[:-1][dark[:-1]])
        return times

    asked = [spread(rows_of, BLACK) for rows_of in log.asked]
    return replace(
        log,
        primal_shown=spread(log.primal_shown, BLACK),
        dual_shown=spread(log.dual_shown, BLACK),
        primal_ns=spread_times(log.primal_ns),
        dual_ns=spread_times(log.dual_ns),
        missed=spread(log.missed, 0),
        primal_asked=asked[0],
        dual_asked=asked[1],
        dark_s=None,
        delay_s=None,
    )


def check_row_times(*shown: Frames | FrameLog) -> None:
    """Refuse dark times and delays of single rows, for code that does not support them.

    Called by displays that show one row right after the other, and by other code that would ignore
    such times. Raises ConfigError.
    """
    for part in shown:
        for name, seconds in (("dark time", part.dark_s), ("a delay", part.delay_s)):
            if seconds is not None and np.any(seconds):
                raise ConfigError(
                    f"rows with {name} of their own are not supported here",
                    device="display",
                    hint="use a display and a schedule that show one row right after the other",
                )
