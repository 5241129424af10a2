"""Spans of panels: stretches in which the target of a panel does not change, and what two of them
that overlap let through together.

The second half is about rows of a panel that are set one after the other: when the light of each
part of a code comes. A panel whose last row comes `scan_s` after its first sets its rows in
`scan_bands` bands. The panel's map says which row a part of a code lies in: if the panel stands on
its head, rows count from below; if it is turned, they depend on the column. All of a window, or of
a lit half cell, comes when the row under its centre does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.placed import place_panel
from pdcd.bench.tables import PanelConfig
from pdcd.panels.curve import Curve, compute_pattern_light
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.map import Map
from pdcd.panels.windows import LOWER, MOVED, PLACED, UPPER
from pdcd.probing.panel import (
    PanelOptics,
    RecentSpans,
    StoredSpans,
    Trajectory,
    compute_decay_integral,
)

SpanTimes = NDArray[np.int64]


def meet_spans(
    right: Floats,
    d_track: Trajectory | RecentSpans | StoredSpans,
    rows: scipy.sparse.csr_array,
    opens: Floats,
) -> tuple[Floats, NDArray[np.bool_], Floats]:
    """What some spans of the projector meet on the mask, by pixels of either.

    Parameters
    ----------
    right : (spans * fields, P) float64
        Their fields, as `Trajectory.take` gives them.
    d_track : the mask's; it is asked for the spans that overlap these ones, in order.
    rows, opens : the rows of both results of `compute_span_weights` for these spans, `opens`
    summed.

    Returns
    -------
    left : (R, D) float64
        With `right[alive]`, (R, P): ``left.T @ right`` is the time for which mask pixel d and
        projector pixel p were open and lit together, in seconds.
    alive : (spans * fields,) bool
        Rows that are not dark or shut throughout.
    open_s : (D,) float64
        Time for which each mask pixel was open.
    """
    used = np.flatnonzero(opens)  # dual spans that overlap these: contiguous in time
    if not used.size:
        never = np.zeros(len(right), dtype=np.bool_)
        return np.zeros((0, d_track.pixels)), never, np.zeros(d_track.pixels)
    d_lo = min(int(used[0]) // d_track.fields, d_track.reached)
    d_hi = int(used[-1]) // d_track.fields + 1
    columns = slice(d_lo * d_track.fields, d_hi * d_track.fields)
    dual = d_track.take(d_lo, d_hi).reshape(columns.stop - columns.start, -1)
    left = rows[:, columns] @ dual
    alive = left.any(axis=1) & right.any(axis=1)
    return left[alive], alive, opens[columns] @ dual


def find_frame_spans(
    frames: Frames,
    shown: NDArray[np.int32],
    start_ns: SpanTimes,
    end_ns: int,
    panel: PanelOptics,
    open_ns: int,
    primal_side: bool,
) -> tuple[list[int], SpanTimes]:
    """Rows of `frames` that start a span (-1 is black) and when, (S,) int64 ns from the opening.

    shown, start_ns, end_ns : of one panel, as its log has them.

    Refreshes that repeat the content before them belong to its span; black comes first and last.
    """
    asked = frames.primal_index if primal_side else frames.dual_index
    index = np.append(asked, BLACK)[shown]  # a row of -1 is black too
    # The sub-shift moves patterns only: uniform panels look the same under all of them.
    key = np.where(index >= 0, index * 4 + np.append(frames.shift, 0)[shown], index)
    changes, starts = find_span_starts(key, start_ns, end_ns, panel, open_ns)
    return [int(shown[c]) if c >= 0 else -1 for c in changes], starts


def find_span_starts(
    content: NDArray[np.int32], start_ns: SpanTimes, end_ns: int, panel: PanelOptics, open_ns: int
) -> tuple[list[int], SpanTimes]:
    """Refreshes that change what a panel shows, and when its light does, in ns from the opening.

    `content` (F,) names what each refresh shows; `BLACK` is black. The first span and all black
    at the end are -1; refreshes that repeat the content before them belong to its span.
    """
    light_ns = np.maximum.accumulate(np.append(start_ns, end_ns) + panel.skew_ns)
    key = np.append(content, BLACK)
    changes = np.flatnonzero(np.diff(np.append(BLACK, key)))
    rows = [-1] + [int(c) if c < len(content) else -1 for c in changes]
    starts = np.append(0, light_ns[changes] - open_ns)
    return rows, np.maximum(starts, 0)


def compute_span_light(
    frames: Frames, lattice: Lattice, row: int, curve: Curve | None, *, primal_side: bool
) -> Floats:
    """Light that one span asks of every pixel of a panel with that curve, (P,)."""
    index = frames.primal_index if primal_side else frames.dual_index
    which = BLACK if row < 0 else int(index[row])
    if which in (BLACK, WHITE):
        if primal_side:
            return np.full(lattice.fields * lattice.cells, float(which == WHITE))
        return lattice.dual_field_uniform(float(which == WHITE)).ravel()
    patterns = frames.primal_patterns if primal_side else frames.dual_patterns
    pattern = compute_pattern_light(patterns, which, lattice.lattice_cells, curve)
    place = lattice.primal_field_values if primal_side else lattice.dual_field_values
    return place(pattern, int(frames.shift[row])).ravel()


def compute_span_weights(
    primal: PanelOptics,
    dual: PanelOptics,
    p_start_ns: SpanTimes,
    d_start_ns: SpanTimes,
    *,
    exposure_ns: int,
    spans: tuple[int, int] | None = None,
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Integrals of products of fields over the overlaps of spans.

    Returns ``(primal spans * fields, dual spans * fields)`` and, for the open time of the mask
    alone, ``(primal spans, dual spans * fields)``. If `spans` is given, only primal spans from the
    first of it to before the second are returned.

    Times are subtracted as whole numbers: an hour after the opening, times in s would lose the
    picoseconds of a short overlap.
    """
    first, end = spans or (0, p_start_ns.size)
    begin_ns = min(int(p_start_ns[first]) if first else 0, exposure_ns)
    end_ns = min(int(p_start_ns[end]) if end < p_start_ns.size else exposure_ns, exposure_ns)
    edges = np.unique(np.concatenate([p_start_ns, d_start_ns, [begin_ns, end_ns]]))
    edges = edges[(begin_ns <= edges) & (edges <= end_ns)]
    lo, length_s = edges[:-1], np.diff(edges) * 1e-9
    p = np.searchsorted(p_start_ns, lo, side="right") - 1
    d = np.searchsorted(d_start_ns, lo, side="right") - 1
    p_age_s, d_age_s = (lo - p_start_ns[p]) * 1e-9, (lo - d_start_ns[d]) * 1e-9
    p_rates, d_rates = primal.rates, dual.rates
    entries, opens = [], []
    for b, d_rate in enumerate(d_rates):
        before_d = np.exp(-d_rate * d_age_s)
        opens.append(
            (p - first, d * d_rates.size + b, before_d * compute_decay_integral(d_rate, length_s))
        )
        for a, p_rate in enumerate(p_rates):
            before = before_d * np.exp(-p_rate * p_age_s)
            value = before * compute_decay_integral(np.asarray(p_rate + d_rate), length_s)
            entries.append(((p - first) * p_rates.size + a, d * d_rates.size + b, value))
    columns = d_start_ns.size * d_rates.size
    return (
        _sparse(entries, ((end - first) * p_rates.size, columns)),
        _sparse(opens, (end - first, columns)),
    )


def _sparse(
    entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]], shape: tuple[int, int]
) -> scipy.sparse.csr_array:
    rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    return scipy.sparse.csr_array((values, (rows, columns)), shape=shape)


@dataclass(frozen=True)
class Band:
    """Pixels of a panel's fields whose light comes equally late. All of them where `pixels` is
    `slice(None)`."""

    delay_ns: int
    pixels: slice | NDArray[np.intp]

    def count(self, of: int) -> int:
        """How many pixels it has; `of` is that of all."""
        return of if isinstance(self.pixels, slice) else int(self.pixels.size)


ALL_AT_ONCE = (Band(0, slice(None)),)

_STRIP_CENTRES = {PLACED: 0.5, MOVED: 0.0, LOWER: 0.25, UPPER: 0.75}
"""Distance of a strip's centre from the edge of the code cell that it is numbered by."""


def band_delays_ns(scan_s: float, bands: int) -> SpanTimes:
    """When each band of rows is set, after the first of them, (bands,) int64 in ns.

    scan_s : from the first row to the last one; negative: from the last row to the first.
    """
    if bands == 1:
        return np.zeros(1, dtype=np.int64)
    step = np.arange(bands) / (bands - 1)
    return np.rint(1e9 * (scan_s * step if scan_s > 0 else -scan_s * (1.0 - step))).astype(np.int64)


def split_into_bands(
    panel: PanelConfig, projector: PanelConfig, lattice: Lattice, *, mask: bool
) -> tuple[Band, ...]:
    """The fields of a panel (`pdcd.panels.lattice`), in bands that are equally late.

    Raises ConfigError for a place that cannot be used.
    """
    height = panel.size_px[1]
    count = min(panel.scan_bands, height)
    if panel.scan_s == 0.0 or count == 1:
        return ALL_AT_ONCE
    map_ = place_panel(panel, "mask" if mask else "projector", projector)
    rows = _rows(map_, _mask_centres(lattice) if mask else _lit_centres(lattice))
    band = rows * count // height
    if mask:  # the rest of the panel stays black: no matter when
        band = np.pad(band, ((0, 0), (0, 1)), mode="edge")
    delays = band_delays_ns(panel.scan_s, count)[band.ravel()]
    return tuple(Band(int(delay), np.flatnonzero(delays == delay)) for delay in np.unique(delays))


def _rows(map_: Map, centres: NDArray[np.float64]) -> NDArray[np.int64]:
    """Row of the panel under each point of the field, or the nearest one if there is none."""
    y = map_.from_field(centres)[..., 1]
    height = map_.size_px[1]
    return np.clip(np.floor(np.nan_to_num(y)), 0, height - 1).astype(np.int64)


def _lit_centres(lattice: Lattice) -> NDArray[np.float64]:
    """Centres of the projector's fields, (fields, N, 2) as x, y of the field."""
    quarter = 0.25 if lattice.fields > 1 else 0.0
    places = []
    for field in range(lattice.fields):
        down = np.arange(lattice.grid[0]) + 0.5 + quarter * (2 * (field >> 1) - 1)
        right = np.arange(lattice.grid[1]) + 0.5 + quarter * (2 * (field & 1) - 1)
        places.append(_grid(down, right, lattice.grid))
    return np.stack(places)


def _mask_centres(lattice: Lattice) -> NDArray[np.float64]:
    """Centres of the mask's strips, (dual_fields, L, 2), as x, y of the field."""
    places = []
    for field in range(lattice.dual_fields):
        strips = (_STRIP_CENTRES[strip] for strip in lattice.strips(field))
        down, right = (np.arange(n) + at for n, at in zip(lattice.shape, strips, strict=True))
        places.append(_grid(down, right, lattice.grid))
    return np.stack(places)


def _grid(
    down: NDArray[np.floating], right: NDArray[np.floating], grid: tuple[int, int]
) -> NDArray[np.float64]:
    x, y = np.meshgrid(right / grid[1], down / grid[0])
    return np.stack([x.ravel(), y.ravel()], axis=-1)
