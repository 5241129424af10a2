"""How small cells may be, given the direct light that leaks into indirect photos.

An indirect photo of a cell is taken while the cell itself is dark and the cells around it are lit
by chance, through a window on the mask in the cell's middle. Blur and misregistration bring the
neighbours' light into that window. At a point x of an axis, the cell's own light has the share

    own(x) = Phi((x - e) / s) - Phi((x - c - e) / s)

for a cell of side c, blur s and offset e; all light that is not its own is leak. The mean of own
over the window from g to c - g, g = c (1 - w) / 2, is 1 - l with

    l = [S(g-e) - S(c-g-e) + S(g+e) - S(c-g+e)] / (w c),    S(t) = s phi(t/s) - t Q(t/s),

and over both axes the leak is 1 - (1 - lx)(1 - ly). For small leaks that is the sum of
[S(g-e) + S(g+e)] / (w c) over both axes, which counts each edge by itself.

The leak is in units of the weight of indirect light: 0.01 means that 1 % of a point's direct light
is added to its indirect photo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from pdcd.arrays import Floats
from pdcd.errors import CalibrationError

_BLURS = 2.5
"""Width of a guard in standard deviations of the blur: at the edge of a window, 0.6 % of the light
is then a neighbour's, and less further in."""
_WHOLE, HALF = 1.0, 0.5
"""Shares of a cell's side that windows take: the whole cell, or a quarter of its area."""
_TABLE_PX = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
"""Cells of the printed table."""
_STEP_PX = 1.0 / 64.0
"""Step of the search for the smallest cell with a given leak."""
_LARGEST_PX = 64.0
"""Largest cell of that search."""
_PLACES = 48
"""Places along a window over which `compute_leak_rms` averages."""


@dataclass(frozen=True)
class MaskAlignment:
    """How well light and mask meet on a bench, in projector pixels.

    e95_px : length of the offset that 95 % of the field do not exceed.
    blur_px : standard deviation of the blur from the projector's pixels to the mask.
    mask_px : side of a mask's pixel. Windows end at whole pixels of the mask; over a field their
        edges scatter uniformly within a pixel, which counts as blur. 0 leaves that out.
    """

    e95_px: float
    blur_px: float
    mask_px: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.e95_px, self.blur_px, self.mask_px)
        if not (np.isfinite(numbers).all() and min(numbers) >= 0.0):
            raise CalibrationError(
                f"offset {self.e95_px:.3g} px, blur {self.blur_px:.3g} px and mask pixels of "
                f"{self.mask_px:.3g} px tell no cell size",
                device="mask",
                hint="calibrate the registration again",
            )

    @property
    def spread_px(self) -> float:
        """Standard deviation of blur and of the windows' edges together."""
        return float(np.hypot(self.blur_px, self.mask_px / np.sqrt(12.0)))

    @property
    def guard_px(self) -> float:
        """The guard that this bench needs: e95 + 2.5 s, between a window and the next cell."""
        return self.e95_px + _BLURS * self.spread_px


def compute_leak(
    cell_px: ArrayLike, window: ArrayLike, offset_px: tuple[ArrayLike, ArrayLike], blur_px: float
) -> Floats:
    """Direct light in an indirect photo, over the weight of indirect light; 0 to 1.

    cell_px : side of a cell in projector pixels, any shape.
    window : share of the side that the mask's window has, in its middle; broadcast with the cells.
    offset_px : (right, down) of the light against the mask; broadcast.
    blur_px : standard deviation of the blur of the light on the mask.
    """
    c, w = np.asarray(cell_px, dtype=np.float64), np.asarray(window, dtype=np.float64)
    kept = [1.0 - _lost(c, w, np.asarray(e, dtype=np.float64), blur_px) for e in offset_px]
    return np.asarray(1.0 - kept[0] * kept[1])


def compute_bench_leak(meeting: MaskAlignment, cell_px: ArrayLike, window: ArrayLike) -> Floats:
    """`compute_leak` of a bench, with its offset along the diagonal: the worst of 95 % of the
    field."""
    along = meeting.e95_px / np.sqrt(2.0)
    return compute_leak(cell_px, window, (along, along), meeting.spread_px)


def compute_leak_rms(
    cell_px: float,
    window: float,
    offset_px: tuple[Floats, Floats],
    blur_px: float,
    quad_px: float = 0.0,
) -> Floats:
    """Root of the mean square over the camera's quads of the leak, of which `compute_leak` is the
    mean: leaks lie along the edges of cells, where fine quads see them in full. offset_px : (n,)
    each way; returns (n,). quad_px : side of a quad; one that sees two windows averages both.
    """
    at = cell_px * (0.5 + window * ((np.arange(_PLACES) + 0.5) / _PLACES - 0.5))
    of_quad = int(np.clip(round(quad_px / (cell_px * window) * _PLACES), 1, _PLACES))

    def own(off: Floats) -> Floats:
        share = compute_own_share(cell_px, at, off[:, None], blur_px)
        return np.asarray(scipy.ndimage.uniform_filter1d(share, of_quad, axis=1, mode="wrap"))

    across, down = (own(np.asarray(off, dtype=np.float64)) for off in offset_px)
    lost = 1.0 - across[:, :, None] * down[:, None, :]
    return np.asarray(np.sqrt(np.mean(lost**2, axis=(1, 2))))


def compute_own_share(
    cell_px: float, at_px: Floats, offset_px: ArrayLike, blur_px: float
) -> Floats:
    """Share of the light that is a cell's own along one axis, at places from 0 at the cell's edge
    to `cell_px`; places and offsets broadcast."""
    spread = max(blur_px, 1e-6 * cell_px)
    begin = (at_px - np.asarray(offset_px, dtype=np.float64)) / spread
    share = scipy.special.ndtr(begin) - scipy.special.ndtr(begin - cell_px / spread)
    return np.asarray(share, dtype=np.float64)


def guard_px(cell_px: float, window: float) -> float:
    """Distance from the window's edge to that of its cell."""
    return 0.5 * cell_px * (1.0 - window)


def find_largest_window(meeting: MaskAlignment, cell_px: float) -> float:
    """The largest share of a cell's side that leaves the guard that the bench needs.

    0 where the cell is too small for any window.
    """
    return max(0.0, 1.0 - 2.0 * meeting.guard_px / cell_px)


def smallest_cell_px(meeting: MaskAlignment) -> float:
    """Side of the smallest cell, in projector pixels, whose half window keeps the guard
    e95 + 2.5 s."""
    return 2.0 * meeting.guard_px / (1.0 - HALF)


def find_cell_below_leak(meeting: MaskAlignment, most_leak: float) -> float:
    """Side of the smallest cell that leaks at most ``most_leak`` by quarter windows, in projector
    pixels, in steps of 1/64 px; infinite where none up to `_LARGEST_PX` does."""
    cells = np.arange(_STEP_PX, _LARGEST_PX + _STEP_PX, _STEP_PX)
    too_much = np.flatnonzero(compute_bench_leak(meeting, cells, HALF) > most_leak)
    first = int(too_much[-1]) + 1 if too_much.size else 0
    return float(cells[first]) if first < cells.size else float("inf")


@dataclass(frozen=True)
class CellSizeRow:
    """One line of the table: a cell, and its leak with whole cells and with quarter windows."""

    cell_px: float
    whole: float
    half: float
    keeps_guard: bool
    """Whether quarter windows leave the guard that the bench needs."""


def list_cell_leaks(meeting: MaskAlignment) -> list[CellSizeRow]:
    """The leaks of cells of some sizes on this bench."""
    cells = np.asarray(_TABLE_PX, dtype=np.float64)
    whole, half = (compute_bench_leak(meeting, cells, window) for window in (_WHOLE, HALF))
    enough = guard_px(1.0, HALF) * cells >= meeting.guard_px
    rows = zip(cells.tolist(), whole.tolist(), half.tolist(), enough.tolist(), strict=True)
    return [CellSizeRow(*row) for row in rows]


def format_cell_leaks(meeting: MaskAlignment) -> list[str]:
    """The table as lines of text, its smallest cell last."""
    lines = [
        f"offset {meeting.e95_px:.2f} px, blur {meeting.blur_px:.2f} px: a guard of "
        f"{meeting.guard_px:.2f} px is needed",
        f"{'cell':>8} {'whole cells':>12} {'quarter windows':>15}",
    ]
    for row in list_cell_leaks(meeting):
        mark = "" if row.keeps_guard else "  guard too small"
        lines.append(
            f"{row.cell_px:>5g} px {100 * row.whole:>10.2f} % {100 * row.half:>13.2f} %{mark}"
        )
    smallest = smallest_cell_px(meeting)
    at_most = 100 * float(compute_bench_leak(meeting, smallest, HALF)) if smallest > 0.0 else 0.0
    lines.append(
        f"smallest cell with quarter windows: {smallest:.2f} px, which leaks {at_most:.2f} % of "
        "direct light"
    )
    return lines


def _lost(c: Floats, w: Floats, e: Floats, s: float) -> Floats:
    """Share of the light in a window along one axis that is not the cell's own."""
    g = 0.5 * c * (1.0 - w)
    from_edges = _beyond(g - e, s) + _beyond(g + e, s)
    past_window = _beyond(c - g - e, s) + _beyond(c - g + e, s)
    return np.asarray((from_edges - past_window) / (w * c))


def _beyond(t: Floats, s: float) -> Floats:
    """S(t): the integral of Q(x / s) from t on."""
    if s == 0.0:
        return np.maximum(-t, 0.0)
    at = t / s
    density = np.exp(-0.5 * at * at) / np.sqrt(2.0 * np.pi)
    return np.asarray(s * density - t * scipy.special.ndtr(-at))
