"""The realised probing matrix: what the two panels really multiplied the transport by.

``Pi_hat = sum over time of m(t) i(t)^T dt`` (eq. 4 and 5 of the paper, as an integral). With
first-order panels each pair of overlapping spans contributes a few rank-1 terms whose weights have
a closed form, so the whole exposure is ``Pi_hat = U^T W V`` with U, V the fields of the spans and
W a sparse matrix of weights. `factors` yields it in chunks of bounded memory, already reduced to
the scene's cells; nothing of the size of (panel pixels) squared is ever made.

Two views of the same matrix leave here. Smooth transport sees cell averages: ``left^T right``,
N x N. Direct light comes back at the point it fell on and sees the panels' sub-cell structure:
`coaxial`, its exact mean over each cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pdcd.bench.tables import PanelConfig
from pdcd.frames.frames import BLACK, WHITE, FrameLog, Frames
from pdcd.frames.lattice import Lattice
from pdcd.frames.patterns import levels_of
from pdcd.probing.fine import Fine, FineSums, cut_by_windows, summed
from pdcd.probing.panel import Panel, Trajectory, decay_integral, offset_cells

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

CHUNK_BYTES = 8 * 2**20
"""Largest field array of a chunk: bounds the memory and stays in the cache."""


@dataclass(frozen=True)
class Factors:
    """A realised probing matrix, or a chunk of one; chunks add up. All in seconds.

    left, right : (R, N) float64
        Mask and projector sides: ``Pi_hat = left.T @ right`` between cell averages.
    coaxial : (N,) float64
        Mean over each cell of the time for which a point is both lit and seen.
    open_s : (N,) float64
        Mean over each cell of the time for which the mask is open (what ambient light gets).
    fine : sums over rows for parts of cells; None where windows do not cut the cells, or where
        nobody asked.
    """

    left: Floats
    right: Floats
    coaxial: Floats
    open_s: Floats
    fine: Fine | None = None

    @cached_property
    def total_s(self) -> float:
        """Sum of all entries of ``left.T @ right``, by pairwise sums that no thread reorders."""
        return float(np.sum(self.left.sum(axis=1) * self.right.sum(axis=1)))

    @cached_property
    def trace_s(self) -> float:
        """Sum of the diagonal of ``left.T @ right``."""
        return float(np.sum(self.left * self.right))

    def dense(self) -> Floats:
        """``left.T @ right`` (N, N): for small grids and for tests."""
        return self.left.T @ self.right


def factors(
    frames: Frames,
    log: FrameLog,
    primal: Panel,
    dual: Panel,
    *,
    open_ns: int,
    close_ns: int,
    offset_cells: tuple[float, float] = (0.0, 0.0),
    fine: bool = False,
) -> Iterator[Factors]:
    """Realised probing matrix of one exposure, chunk by chunk.

    Parameters
    ----------
    frames, log : what was asked of the panels, and what they did.
    primal, dual : optics of projector and mask; both rest on black when the shutter opens.
    open_ns, close_ns : the exposure, on the clock of the log.
    offset_cells : misregistration of the mask, in cells (rows, cols).
    fine : look at parts of cells, too.
    """
    lattice = Lattice(frames.grid, frames.window, offset_cells)
    p_rows, p_start_ns = frame_spans(
        frames, log.primal_shown, log.primal_ns, int(log.end_ns[0]), primal, open_ns, True
    )
    d_rows, d_start_ns = frame_spans(
        frames, log.dual_shown, log.dual_ns, int(log.end_ns[1]), dual, open_ns, False
    )
    p_track = Trajectory(
        primal,
        p_start_ns,
        lattice.fields * lattice.cells,
        lambda s: _target(frames, lattice, p_rows[s], primal_side=True),
    )
    d_track = Trajectory(
        dual,
        d_start_ns,
        lattice.fields * (lattice.lattice_cells + 1),
        lambda s: _target(frames, lattice, d_rows[s], primal_side=False),
    )
    weights, open_weights = span_weights(
        primal, dual, p_start_ns, d_start_ns, exposure_ns=close_ns - open_ns
    )
    widest = lattice.fields * (lattice.lattice_cells + 1) * 8
    step = max(1, CHUNK_BYTES // (widest * p_track.fields))
    finely = fine and cut_by_windows(lattice)
    for start in range(0, len(p_rows), step):
        stop = min(start + step, len(p_rows))
        rows = weights[start * p_track.fields : stop * p_track.fields]
        opens = open_weights[start:stop].sum(axis=0)
        yield _chunk(lattice, p_track.take(start, stop), d_track, rows, opens, finely)


def bench_factors(
    frames: Frames,
    log: FrameLog,
    projector: PanelConfig,
    mask: PanelConfig,
    *,
    open_ns: int,
    close_ns: int,
    fine: bool = False,
) -> Iterator[Factors]:
    """`factors` of panels as a configuration describes them, misregistration included."""
    return factors(
        frames,
        log,
        Panel.from_config(projector),
        Panel.from_config(mask),
        open_ns=open_ns,
        close_ns=close_ns,
        offset_cells=offset_cells(projector, mask, frames.grid),
        fine=fine,
    )


def collect(chunks: Iterable[Factors]) -> Factors:
    """One `Factors` from all chunks; of rank at most N, whatever the number of codes was.

    No more than N rows of factors are kept at a time, so that long exposures take no more memory
    than a matrix of all pairs of cells.
    """
    parts: list[Factors] = []
    coaxial, open_s = [], []
    matrix: Floats | None = None
    fine: list[Fine | None] = []
    for chunk in chunks:
        fine = [summed((1.0, part) for part in (*fine, chunk.fine))]
        coaxial.append(chunk.coaxial)
        open_s.append(chunk.open_s)
        parts.append(chunk)
        cells = chunk.coaxial.size
        if matrix is None and sum(len(p.left) for p in parts) > cells:
            matrix = np.zeros((cells, cells))
        if matrix is not None:
            for part in parts:
                matrix += part.dense()
            parts = []
    if matrix is not None:
        left, right = np.eye(len(matrix)), matrix
    else:
        left = np.concatenate([p.left for p in parts])
        right = np.concatenate([p.right for p in parts])
    return Factors(left, right, sum_of(coaxial), sum_of(open_s), *fine)


def sum_of(arrays: Iterable[Floats]) -> Floats:
    """Sum of equally shaped arrays, in order."""
    return np.asarray(np.sum(list(arrays), axis=0))


def shared(whole: Factors, level: float) -> Factors:
    """The realised matrix of a photo that was divided by a number."""
    fine = None if whole.fine is None else whole.fine.scaled(1.0 / level)
    return Factors(
        whole.left / level, whole.right, whole.coaxial / level, whole.open_s / level, fine
    )


def signed_sum(terms: Iterable[tuple[float, Factors]]) -> Factors:
    """Realised matrix of a sum and difference of photos (black-level shots, eq. 10)."""
    pairs = list(terms)
    if [sign for sign, _ in pairs] == [1.0]:
        return pairs[0][1]
    return Factors(
        np.concatenate([sign * f.left for sign, f in pairs]),
        np.concatenate([f.right for _, f in pairs]),
        sum_of(sign * f.coaxial for sign, f in pairs),
        sum_of(sign * f.open_s for sign, f in pairs),
        summed((sign, f.fine) for sign, f in pairs),
    )


def _chunk(
    lattice: Lattice,
    primal_fields: Floats,
    d_track: Trajectory,
    rows: sparse.csr_array,
    opens: Floats,
    finely: bool,
) -> Factors:
    """Reduce the spans of one chunk to the cells of the scene."""
    cells, k = lattice.cells, lattice.fields
    right = primal_fields.reshape(rows.shape[0], -1)
    left, alive, open_fine = met(right, d_track, rows, opens)
    right = right[alive]
    masks = left.reshape(-1, k, lattice.lattice_cells + 1)
    lights = right.reshape(-1, k, cells)
    coaxial = np.zeros(lattice.grid)
    fine = FineSums(lattice) if finely else None
    for o in lattice.overlaps:
        mask, light = masks[:, o.dual_field], lights[:, o.primal_field].reshape(-1, *lattice.grid)
        live = mask.any(axis=1)  # a window is shut under the other sub-shifts
        if not live.all():
            mask, light = mask[live], light[live]
        time_s = np.einsum("rij,rij->ij", lattice.seen(mask, o), light)
        coaxial += o.area * time_s
        if fine is not None:
            fine.add_coaxial(o, time_s)
    mean = lights.mean(axis=1)
    if fine is not None:
        fine.add_rows(masks, mean)
    return Factors(
        left @ lattice.spread,
        mean,
        coaxial.ravel(),
        open_fine @ lattice.spread,
        None if fine is None else fine.fine(),
    )


def met(
    right: Floats, d_track: Trajectory, rows: sparse.csr_array, opens: Floats
) -> tuple[Floats, NDArray[np.bool_], Floats]:
    """What some spans of the projector meet on the mask, pixel by pixel of either.

    Parameters
    ----------
    right : (spans * fields, P) float64
        Their fields, as `Trajectory.take` gives them.
    d_track : the mask's; it is asked for those spans that overlap these ones, in order.
    rows, opens : the rows of both results of `span_weights` for these spans, `opens` summed.

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


def frame_spans(
    frames: Frames,
    shown: NDArray[np.int32],
    start_ns: Times,
    end_ns: int,
    panel: Panel,
    open_ns: int,
    primal_side: bool,
) -> tuple[list[int], Times]:
    """Rows of `frames` that start a span (-1 is black) and when, (S,) int64 ns from the opening.

    shown, start_ns, end_ns : of one panel, as its log has them.

    Refreshes that repeat the content before them belong to its span; black comes first and last.
    """
    asked = frames.primal_index if primal_side else frames.dual_index
    index = np.append(asked, BLACK)[shown]  # a row of -1 is black too
    # The sub-shift moves patterns only: uniform panels look the same under all of them.
    key = np.where(index >= 0, index * 4 + np.append(frames.shift, 0)[shown], index)
    changes, starts = span_starts(key, start_ns, end_ns, panel, open_ns)
    return [int(shown[c]) if c >= 0 else -1 for c in changes], starts


def span_starts(
    content: NDArray[np.int32], start_ns: Times, end_ns: int, panel: Panel, open_ns: int
) -> tuple[list[int], Times]:
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


def _target(frames: Frames, lattice: Lattice, row: int, *, primal_side: bool) -> Floats:
    """Level that one span asks of every pixel of a panel, (P,)."""
    index = frames.primal_index if primal_side else frames.dual_index
    which = BLACK if row < 0 else int(index[row])
    if which in (BLACK, WHITE):
        if primal_side:
            return np.full(lattice.fields * lattice.cells, float(which == WHITE))
        return lattice.dual_field_uniform(float(which == WHITE)).ravel()
    patterns = frames.primal_patterns if primal_side else frames.dual_patterns
    pattern = levels_of(patterns, which, lattice.lattice_cells)
    place = lattice.primal_field_values if primal_side else lattice.dual_field_values
    return place(pattern, int(frames.shift[row])).ravel()


def span_weights(
    primal: Panel, dual: Panel, p_start_ns: Times, d_start_ns: Times, *, exposure_ns: int
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Integrals of products of fields over the overlaps of spans.

    Returns ``(primal spans * fields, dual spans * fields)`` and, for the open time of the mask
    alone, ``(primal spans, dual spans * fields)``.

    Times are subtracted as whole numbers: an hour after the opening, those in s have lost the
    picoseconds of a short overlap.
    """
    edges = np.unique(np.concatenate([p_start_ns, d_start_ns, [0, exposure_ns]]))
    edges = edges[edges <= exposure_ns]
    lo, length_s = edges[:-1], np.diff(edges) * 1e-9
    p = np.searchsorted(p_start_ns, lo, side="right") - 1
    d = np.searchsorted(d_start_ns, lo, side="right") - 1
    p_age_s, d_age_s = (lo - p_start_ns[p]) * 1e-9, (lo - d_start_ns[d]) * 1e-9
    p_rates, d_rates = primal.rates, dual.rates
    entries, opens = [], []
    for b, d_rate in enumerate(d_rates):
        before_d = np.exp(-d_rate * d_age_s)
        opens.append((p, d * d_rates.size + b, before_d * decay_integral(d_rate, length_s)))
        for a, p_rate in enumerate(p_rates):
            before = before_d * np.exp(-p_rate * p_age_s)
            value = before * decay_integral(np.asarray(p_rate + d_rate), length_s)
            entries.append((p * p_rates.size + a, d * d_rates.size + b, value))
    columns = d_start_ns.size * d_rates.size
    return (
        _sparse(entries, (p_start_ns.size * p_rates.size, columns)),
        _sparse(opens, (p_start_ns.size, columns)),
    )


def _sparse(
    entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]], shape: tuple[int, int]
) -> sparse.csr_array:
    rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    return sparse.csr_array((values, (rows, columns)), shape=shape)
