"""The realised probing matrix: what the two panels really multiplied the transport by.

``Pi_hat = sum over time of m(t) i(t)^T dt`` (eq. 4 and 5 of the paper, as an integral). With
first-order panels each pair of overlapping spans contributes a few rank-1 terms whose weights have
a closed form, so the whole exposure is ``Pi_hat = U^T W V`` with U, V the fields of the spans and W
a sparse matrix of weights. `compute_factors` yields it in chunks of bounded memory, already reduced
to the scene's cells; nothing of the size of (panel pixels) squared is ever made.

The result has two views of the same matrix. Smooth transport sees cell averages: ``left^T right``,
N x N. Direct light comes back at the point it fell on and sees the panels' sub-cell structure:
`coaxial`, its exact mean over each cell.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.tables import PanelConfig
from pdcd.panels.frames import FrameLog, Frames, split_dark_times
from pdcd.panels.lattice import Lattice, Overlap
from pdcd.probing.borders import BorderStrips
from pdcd.probing.fine import (
    Beams,
    Blur,
    PieceSums,
    PieceWeights,
    is_cut_by_windows,
    sum_piece_weights,
)
from pdcd.probing.panel import PanelOptics, RecentSpans, Trajectory, blur_cells, offset_cells
from pdcd.probing.spans import (
    ALL_AT_ONCE,
    Band,
    SpanTimes,
    compute_span_light,
    compute_span_weights,
    find_frame_spans,
    meet_spans,
    split_into_bands,
)

_Bands = tuple[Band, ...]

CELL_BLOCK = 1024
"""Least number of cells processed together; bounds the memory in addition to the factors."""
FIELD_CHUNK_BYTES = 8 * 2**20
"""Largest field array of a chunk: bounds the memory and stays in the cache."""


@dataclass(frozen=True)
class Factors:
    """A realised probing matrix, or a chunk of one; chunks add up. All in seconds.

    left, right : (R, N) float64
        Mask and projector sides: ``Pi_hat = left.T @ right`` between cell averages.
    coaxial : (N,) float64
        Mean over each cell of the time for which a point is both lit and seen.
    open_s : (N,) float64
        Mean over each cell of the time for which the mask is open (the weight of ambient light).
    fine : sums over rows for parts of cells; None if windows do not cut the cells, or if not asked
        for.
    displaced : (N,) float64
        As `coaxial`, of points whose light comes from another place; None if not asked for.
    apart : strips along borders in which the panels show different cells; () if not asked for.
    """

    left: Floats
    right: Floats
    coaxial: Floats
    open_s: Floats
    fine: PieceWeights | None = None
    displaced: Floats | None = None
    apart: tuple[BorderStrips, ...] = ()

    @cached_property
    def total_s(self) -> float:
        """Sum of all entries of ``left.T @ right``, by pairwise sums in a fixed order."""
        return float(np.sum(self.left.sum(axis=1) * self.right.sum(axis=1)))

    @cached_property
    def trace_s(self) -> float:
        """Sum of the diagonal of ``left.T @ right``."""
        return float(np.sum(self.left * self.right))

    @cached_property
    def row_sums_s(self) -> tuple[Floats, Floats]:
        """Sums over the rows of ``left.T @ right``, and its diagonal, (N,) each."""
        cells = self.left.shape[1]
        level = self.right.sum(axis=1)[:, None]
        sums, own = np.empty(cells), np.empty(cells)
        for here in split_into_blocks(cells):
            left = self.left[:, here]
            sums[here] = np.sum(left * level, axis=0)
            own[here] = np.sum(left * self.right[:, here], axis=0)
        return sums, own

    def dense(self) -> Floats:
        """``left.T @ right`` (N, N): for small grids and for tests."""
        return self.left.T @ self.right


def split_into_blocks(cells: int) -> Iterator[slice]:
    """All cells, in blocks of `CELL_BLOCK` to twice as many: numpy sums a single column in another
    order than several."""
    starts = [*range(0, max(cells - CELL_BLOCK, 1), CELL_BLOCK), cells]
    return (slice(start, stop) for start, stop in itertools.pairwise(starts))


def compute_factors(
    frames: Frames,
    log: FrameLog,
    primal: PanelOptics,
    dual: PanelOptics,
    *,
    open_ns: int,
    close_ns: int,
    offset_cells: tuple[float, float] = (0.0, 0.0),
    fine: bool = False,
    bands: tuple[_Bands, _Bands] = (ALL_AT_ONCE, ALL_AT_ONCE),
    blur_cells: tuple[float, float] = (0.0, 0.0),
    displacement: Floats | None = None,
) -> Iterator[Factors]:
    """Realised probing matrix of one exposure, chunk by chunk.

    Parameters
    ----------
    frames, log : what was asked of the panels, and what they did.
    primal, dual : optics of projector and mask; both rest on black when the shutter opens.
    open_ns, close_ns : the exposure, on the clock of the log.
    offset_cells : misregistration of the mask, in cells (rows, cols).
    fine : compute parts of cells, too.
    bands : fields of projector and mask whose light comes later than that of others. Time grows
        with the number of the projector's bands, and less with the mask's.
    blur_cells : blur of the light on the mask, of direct light only, in cells (rows, cols).
    displacement : (N, 2) of an off-axis scene, in cells down and right, for `Factors.displaced`;
        this light is not blurred.
    """
    log = split_dark_times(log)
    lattice = Lattice(frames.grid, frames.window, offset_cells)
    exposed = _Exposed(frames, lattice, log, primal, dual, open_ns, close_ns)
    blur = Blur(lattice, blur_cells) if any(blur_cells) else None
    finely = fine and is_cut_by_windows(lattice)
    beams = None if displacement is None else Beams(lattice, displacement)
    sides = [exposed.side(band, primal_side=True) for band in bands[0]]
    gates = [exposed.side(band, primal_side=False) for band in bands[1]]
    fields = sides[0].track.fields
    widest = lattice.dual_fields * (lattice.lattice_cells + 1) * 8
    step = max(1, FIELD_CHUNK_BYTES // (widest * fields))
    # All bands of a chunk are processed before the next one, so that the mask is followed once.
    for start in range(0, len(sides[0].starts), step):
        stop = min(start + step, len(sides[0].starts))
        for number, side in enumerate(sides):
            right = side.track.take(start, stop).reshape((stop - start) * fields, -1)
            if not isinstance(side.band.pixels, slice):  # the others have their turn
                whole = np.zeros((len(right), lattice.fields * lattice.cells))
                whole[:, side.band.pixels] = right
                right = whole
            met_here = exposed.through(right, side, gates, start, stop)
            yield _chunk(lattice, right, met_here, finely, blur, beams, first=number == 0)
        for side in sides:
            side.track.forget(stop)
        for gate in gates:
            gate.track.forget(exposed.first_met(gate, sides, stop))


@dataclass(frozen=True)
class _Side:
    """One band of a panel: its pixels among all, when its spans start, and what they show."""

    band: Band
    panel: PanelOptics
    starts: SpanTimes
    track: RecentSpans


@dataclass(frozen=True)
class _Exposed:
    """One exposure, whose panels are processed band by band."""

    frames: Frames
    lattice: Lattice
    log: FrameLog
    primal: PanelOptics
    dual: PanelOptics
    open_ns: int
    close_ns: int

    def side(self, band: Band, *, primal_side: bool) -> _Side:
        """Starts and levels of the spans of one band of a panel."""
        log, lattice = self.log, self.lattice
        shown, at = (
            (log.primal_shown, log.primal_ns) if primal_side else (log.dual_shown, log.dual_ns)
        )
        panel = (self.primal if primal_side else self.dual).later(band.delay_ns)
        end_ns = int(log.end_ns[0 if primal_side else 1])
        rows, starts = find_frame_spans(
            self.frames, shown, at, end_ns, panel, self.open_ns, primal_side
        )
        pixels = lattice.fields * lattice.cells
        if not primal_side:
            pixels = lattice.dual_fields * (lattice.lattice_cells + 1)
        asked = self._asked[0 if primal_side else 1]
        track = Trajectory(panel, starts, band.count(pixels), lambda s: asked(rows[s])[band.pixels])
        return _Side(band, panel, starts, RecentSpans(track))

    @cached_property
    def _asked(self) -> tuple[Callable[[int], Floats], Callable[[int], Floats]]:
        """Light that a row asks for of all pixels of either panel; cached, as bands repeat it."""

        def of(panel: PanelOptics, primal_side: bool) -> Callable[[int], Floats]:
            wide = self.lattice.dual_fields * (self.lattice.lattice_cells + 1) * 8
            return lru_cache(FIELD_CHUNK_BYTES // wide + 8)(
                lambda row: compute_span_light(
                    self.frames, self.lattice, row, panel.curve, primal_side=primal_side
                )
            )

        return of(self.primal, True), of(self.dual, False)

    def first_met(self, gate: _Side, sides: list[_Side], number: int) -> int:
        """The first span of the mask that the projector's spans from `number` on may meet."""
        soonest = min((int(s.starts[number]) for s in sides if number < len(s.starts)), default=0)
        return max(int(np.searchsorted(gate.starts, soonest, side="right")) - 1, 0)

    def through(
        self, right: Floats, side: _Side, gates: list[_Side], start: int, stop: int
    ) -> tuple[Floats, NDArray[np.bool_], Floats]:
        """`meet_spans` of all bands of the mask: left (R, D), alive, open_s (D,)."""
        exposure_ns = self.close_ns - self.open_ns
        part = [
            compute_span_weights(
                side.panel, gate.panel, side.starts, gate.starts, exposure_ns=exposure_ns,
                spans=(start, stop),
            )
            for gate in gates
        ]  # fmt: skip
        if len(gates) == 1 and isinstance(gates[0].band.pixels, slice):
            return meet_spans(right, gates[0].track, part[0][0], part[0][1].sum(axis=0))
        count = sum(gate.track.pixels for gate in gates)
        left, open_s = np.zeros((len(right), count)), np.zeros(count)
        always = np.ones((len(right), 1))
        for gate, (weights, opens) in zip(gates, part, strict=True):
            some, alive, opened = meet_spans(always, gate.track, weights, opens.sum(axis=0))
            index = np.arange(count)[gate.band.pixels]
            left[np.ix_(np.flatnonzero(alive), index)] = some
            open_s[gate.band.pixels] = opened
        both = np.asarray(left.any(axis=1) & right.any(axis=1))
        return left[both], both, open_s


def compute_bench_factors(
    frames: Frames,
    log: FrameLog,
    projector: PanelConfig,
    mask: PanelConfig,
    *,
    open_ns: int,
    close_ns: int,
    fine: bool = False,
    displacement: Floats | None = None,
) -> Iterator[Factors]:
    """`compute_factors` of panels as a configuration describes them: misregistration, rows that are
    set one after the other, and blur included."""
    return compute_factors(
        frames,
        log,
        PanelOptics.from_config(projector),
        PanelOptics.from_config(mask),
        open_ns=open_ns,
        close_ns=close_ns,
        offset_cells=offset_cells(projector, mask, frames.grid),
        fine=fine,
        bands=(
            split_into_bands(projector, projector, Lattice(frames.grid, frames.window), mask=False),
            split_into_bands(mask, projector, Lattice(frames.grid, frames.window), mask=True),
        ),
        blur_cells=blur_cells(projector, mask, frames.grid),
        displacement=displacement,
    )


def collect_factors(chunks: Iterable[Factors]) -> Factors:
    """One `Factors` from all chunks, of rank at most N, whatever the number of codes.

    No more than N rows of factors are kept at a time, so that long exposures take no more memory
    than a matrix of all pairs of cells.
    """
    parts: list[Factors] = []
    coaxial, open_s, displaced = [], [], []
    matrix: Floats | None = None
    fine: list[PieceWeights | None] = []
    for chunk in chunks:
        fine = [sum_piece_weights((1.0, part) for part in (*fine, chunk.fine))]
        coaxial.append(chunk.coaxial)
        open_s.append(chunk.open_s)
        if chunk.displaced is not None:
            displaced.append(chunk.displaced)
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
    moved = sum_arrays(displaced) if displaced else None
    finely = fine[0] if fine else None
    return Factors(left, right, sum_arrays(coaxial), sum_arrays(open_s), finely, moved)


def sum_arrays(arrays: Iterable[Floats]) -> Floats:
    """Sum of equally shaped arrays, in order."""
    return np.asarray(np.sum(list(arrays), axis=0))


def divide_factors(whole: Factors, level: float) -> Factors:
    """The realised matrix of a photo that was divided by a number."""
    fine = None if whole.fine is None else whole.fine.scaled(1.0 / level)
    return Factors(
        whole.left / level, whole.right, whole.coaxial / level, whole.open_s / level, fine
    )


def sum_signed_factors(terms: Iterable[tuple[float, Factors]]) -> Factors:
    """Realised matrix of a sum and difference of photos (black-level shots, eq. 10)."""
    pairs = list(terms)
    if [sign for sign, _ in pairs] == [1.0]:
        return pairs[0][1]
    return Factors(
        np.concatenate([sign * f.left for sign, f in pairs]),
        np.concatenate([f.right for _, f in pairs]),
        sum_arrays(sign * f.coaxial for sign, f in pairs),
        sum_arrays(sign * f.open_s for sign, f in pairs),
        sum_piece_weights((sign, f.fine) for sign, f in pairs),
        apart=pairs[0][1].apart if all(f.apart for _, f in pairs) else (),
    )


def _chunk(
    lattice: Lattice,
    right: Floats,
    through: tuple[Floats, NDArray[np.bool_], Floats],
    finely: bool,
    blur: Blur | None,
    beams: Beams | None,
    *,
    first: bool,
) -> Factors:
    """Reduce the spans of one chunk to the cells of the scene. The mask's own open time is counted
    only with the `first` band of the projector."""
    cells = lattice.cells
    left, alive, open_fine = through
    right = right[alive]
    masks = left.reshape(-1, lattice.dual_fields, lattice.lattice_cells + 1)
    lights = right.reshape(-1, lattice.fields, cells)
    coaxial = np.zeros(lattice.grid)
    fine = PieceSums(lattice) if finely else None
    for o, mask, light in _meetings(lattice, masks, lights, blur):
        live = mask.any(axis=1)  # a window is shut under the other sub-shifts
        if not live.all():
            mask, light = mask[live], light[live]
        time_s = np.einsum("rij,rij->ij", lattice.stepped(mask, o.step), light)
        coaxial += o.area * time_s
        if fine is not None:
            fine.add_coaxial(o, time_s)
    mean = lights.mean(axis=1)
    if fine is not None:
        fine.add_rows(masks, mean)
    opened = open_fine @ lattice.spread
    return Factors(
        left @ lattice.spread,
        mean,
        coaxial.ravel(),
        opened if first else np.zeros_like(opened),
        None if fine is None else fine.fine(),
        None if beams is None else beams.seen_s(masks, lights),
    )


def _meetings(
    lattice: Lattice, masks: Floats, lights: Floats, blur: Blur | None
) -> Iterator[tuple[Overlap, Floats, Floats]]:
    """Parts of every cell, with the mask's field there (R, L + 1) and the light on it
    (R, rows, cols): parts where one field of either panel meets, or the blurred light of a piece.
    """
    if blur is None:
        for o in lattice.overlaps:
            yield o, masks[:, o.dual_field], lights[:, o.primal_field].reshape(-1, *lattice.grid)
        return
    for o, light in zip(lattice.windows, blur.light(lights), strict=True):
        yield o, masks[:, o.dual_field], light
