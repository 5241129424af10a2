"""For how long pairs of sites were lit and open together, and the indirect light in that time.

An exposure is a sum of products of what a mask site lets through and what falls on it. Neither
changes within a site, so a photo of millions of samples needs one number for each pair of sites
that meet somewhere, and one for each mask site and scene cell: tables of some ten thousand numbers.
Only such pairs are computed, tile by tile, as products of small matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.tables import Config
from pdcd.panels.curve import make_power_curve
from pdcd.panels.frames import FrameLog, Frames
from pdcd.probing.panel import PanelOptics, StoredSpans, Trajectory
from pdcd.probing.spans import SpanTimes, compute_span_weights, find_frame_spans, meet_spans
from pdcd.virtual.optics.histories import Histories
from pdcd.virtual.optics.sites import PanelSites
from pdcd.virtual.scene.effects import Array, Effect

_Numbers = NDArray[np.int64]

SPAN_CHUNK_BYTES = 48 * 2**20
"""Largest array of spans that is worked on at a time."""
MASK_CACHE_BYTES = 128 * 2**20
"""Most memory in which the mask's levels are kept."""
COLOUR_COUNT = 3
_LINEAR = 1.0
"""Gamma of a panel whose curve is not known."""


@dataclass(frozen=True)
class PanelExposure:
    """What two panels showed, and when the shutter was open; times on the clock of the log.

    covered : whether the projector's lens was covered. lights_off : whether the room was still as
        the configuration says, and not yet as the truth does (`ambient_from`).
    """

    frames: Frames
    log: FrameLog
    open_ns: int
    close_ns: int
    covered: bool = False
    lights_off: bool = False


@dataclass(frozen=True)
class SitePairs:
    """Distinct pairs of a mask site and something else, one entry of either array each.

    mask, other : (P,) int64
    """

    mask: _Numbers
    other: _Numbers


def find_distinct_pairs(
    pairs: SitePairs, mask: _Numbers, other: _Numbers | None
) -> tuple[SitePairs, _Numbers]:
    """The distinct pairs of histories among pairs of sites, and the index of each pair's own.
    `mask` and `other` are the histories of sites; `other` is None where pairs hold cells there."""
    first = mask[pairs.mask]
    second = pairs.other if other is None else other[pairs.other]
    width = int(second.max(initial=0)) + 1
    keys, which = np.unique(first * width + second, return_inverse=True)
    return SitePairs(*np.divmod(keys, width)), which


@dataclass(frozen=True)
class PairTables:
    """The numbers of pairs, for one exposure.

    direct : (P,) seconds for which the two sites were lit and open together.
    indirect : (Q, 3) light from a cell while a mask site was open, in scene units times seconds.
        Of all pairs, either is a matrix (`Products.all_tables`).
    open_s : (S,) seconds for which each mask site was open.
    """

    direct: Floats
    indirect: Floats
    open_s: Floats


class Products:
    """Both panels of one exposure, and the indirect light of their patterns in the scene.

    spread : (projector sites, N) sparse, share of each scene cell that is lit by each site.
    effects : the scene's indirect light.
    """

    def __init__(
        self,
        config: Config,
        lit: PanelSites | Histories,
        opened: PanelSites | Histories,
        exposure: PanelExposure,
        spread: scipy.sparse.csr_array,
        effects: tuple[Effect, ...],
    ) -> None:
        """`config` describes the panels as they are; `lit` and `opened` are the
        sites of projector and mask."""
        self._primal, self._dual = (
            PanelOptics.from_config(panel) for panel in (config.projector, config.mask)
        )
        # A panel of pixels is sent bytes, whether or not its curve is known.
        self._curves = [
            panel.curve or make_power_curve(_LINEAR) for panel in (self._primal, self._dual)
        ]
        self._p_sites, self._d_sites = lit, opened
        self._exposure, self._spread, self._effects = exposure, spread, effects

    def tables(self, direct: SitePairs, indirect: SitePairs) -> PairTables:
        """The numbers of these pairs: `direct` of sites of both panels, `indirect` of mask sites
        and cells."""
        out = PairTables(
            np.zeros(direct.mask.size),
            np.zeros((indirect.mask.size, COLOUR_COUNT)),
            np.zeros(len(self._d_sites)),
        )
        cells = _blocks(indirect, self._d_sites, None) if self._effects else {}
        return self._filled(out, _blocks(direct, self._d_sites, self._p_sites), cells)

    def all_tables(self) -> PairTables:
        """The numbers of all pairs: `direct` (mask sites, projector sites), `indirect` (mask sites,
        N, 3), where N is 0 if the scene has no indirect light."""
        mask, lit = self._d_sites, self._p_sites
        cells = self._spread.shape[1] if self._effects else 0
        out = PairTables(
            np.zeros((len(mask), len(lit))),
            np.zeros((len(mask), cells, COLOUR_COUNT)),
            np.zeros(len(mask)),
        )
        bands, of_cells = range(mask.delay_ns.size), slice(0, cells)
        direct = {
            (p_band, band): [_WholeBlock(mask.in_band(band), lit.in_band(p_band))]
            for p_band in range(lit.delay_ns.size)
            for band in bands
        }
        whole = {(0, band): [_WholeBlock(mask.in_band(band), of_cells)] for band in bands}
        return self._filled(out, direct, whole if self._effects else {})

    def _filled(self, out: PairTables, pairs: _Blocks, cells: _Blocks) -> PairTables:
        """The tables with the light of the whole exposure, added block by block."""
        kept = self._kept_tracks()
        for p_band in range(self._p_sites.delay_ns.size):
            tracks: Sequence[tuple[SpanTimes, Trajectory | StoredSpans]] = (
                kept or self._mask_tracks()
            )
            masks = [
                _Mask(
                    self._d_sites.in_band(band),
                    starts,
                    track,
                    pairs.get((p_band, band), []),
                    cells.get((0, band), []),
                )
                for band, (starts, track) in enumerate(tracks)
            ]
            self._add_band(out, p_band, masks)
        if self._exposure.covered:
            out.direct[:] = out.indirect[:] = 0.0
        return out

    def _add_band(self, out: PairTables, p_band: int, masks: list[_Mask]) -> None:
        """Add the light of one band of the projector's rows."""
        lit = self._p_sites.in_band(p_band)
        p_rows, p_starts, p_track = self._track(p_band, mask=False)
        overlaps = [
            compute_span_weights(
                self._primal, self._dual, p_starts, mask.starts, exposure_ns=self._exposed_ns
            )
            for mask in masks
        ]
        widest = max(len(self._d_sites), lit.stop - lit.start, self._spread.shape[1])
        fields = p_track.fields
        step = max(1, SPAN_CHUNK_BYTES // (8 * widest * fields))
        share = self._spread[lit]
        for start in range(0, len(p_rows), step):
            stop = min(start + step, len(p_rows))
            right = p_track.take(start, stop).reshape((stop - start) * fields, -1)
            found = []
            for mask, (weights, opens) in zip(masks, overlaps, strict=True):
                rows = weights[start * fields : stop * fields]
                left, alive, open_s = meet_spans(
                    right, mask.track, rows, opens[start:stop].sum(axis=0)
                )
                if p_band == 0:
                    out.open_s[mask.part] += open_s
                found.append((mask, left, alive))
            self._add_chunk(out, right, share, found)

    def _add_chunk(
        self,
        out: PairTables,
        right: Floats,
        share: scipy.sparse.csr_array,
        found: list[tuple[_Mask, Floats, NDArray[np.bool_]]],
    ) -> None:
        """Add the light of some spans of the projector, at all bands of the mask."""
        for mask, left, alive in found:
            lights = right[alive]
            for block in mask.direct:
                block.add(out.direct, left, lights)
        used = np.any([alive for _, _, alive in found], axis=0)
        place = np.cumsum(used) - 1
        for tint, light in self._sent(np.asarray(right[used] @ share)):
            for mask, left, alive in found:
                lights = light[place[alive]]
                for block in mask.indirect:
                    block.add(out.indirect, left, lights, tint)

    def _sent(self, cells: Floats) -> list[tuple[Array, Floats]]:
        """Indirect light for light on the cells (R, N): tint (3,) and light (R, N) of each effect,
        or of each colour where there are fewer colours than effects."""
        if len(self._effects) <= COLOUR_COUNT:
            return [(effect.tint, effect.apply(cells)) for effect in self._effects]
        whole = np.zeros((COLOUR_COUNT, *cells.shape))
        for effect in self._effects:
            seen = effect.apply(cells)
            for colour in np.flatnonzero(effect.tint):
                whole[colour] += effect.tint[colour] * seen
        return list(zip(np.eye(COLOUR_COUNT), whole, strict=True))

    @property
    def _exposed_ns(self) -> int:
        return self._exposure.close_ns - self._exposure.open_ns

    def _mask_tracks(self) -> list[tuple[SpanTimes, Trajectory]]:
        """Starts and levels of the spans of each band of the mask."""
        return [self._track(band, mask=True)[1:] for band in range(self._d_sites.delay_ns.size)]

    def _kept_tracks(self) -> list[tuple[SpanTimes, StoredSpans]] | None:
        """The same, stored, to be read again for each band of the projector; None where there is
        only one band, or where it would take too much memory."""
        spans = self._exposure.log.dual_ns.size + 2
        needed = 8 * spans * self._dual.rates.size * len(self._d_sites)
        if self._p_sites.delay_ns.size == 1 or needed > MASK_CACHE_BYTES:
            return None
        return [(starts, StoredSpans(track)) for starts, track in self._mask_tracks()]

    def _track(self, band: int, *, mask: bool) -> tuple[list[int], SpanTimes, Trajectory]:
        """Rows, starts and levels of the spans of one band of a panel."""
        frames, log = self._exposure.frames, self._exposure.log
        sites = self._d_sites if mask else self._p_sites
        panel = (self._dual if mask else self._primal).later(int(sites.delay_ns[band]))
        curve, part = self._curves[int(mask)], sites.in_band(band)
        rows, starts = find_frame_spans(
            frames,
            log.dual_shown if mask else log.primal_shown,
            log.dual_ns if mask else log.primal_ns,
            int(log.end_ns[int(mask)]),
            panel,
            self._exposure.open_ns,
            not mask,
        )
        track = Trajectory(
            panel,
            starts,
            part.stop - part.start,
            lambda span: sites.levels(frames, rows[span], curve, part),
        )
        return rows, starts, track


@dataclass(frozen=True)
class _Block:
    """Pairs of one tile: their places in the table, and in a product of two small matrices."""

    where: _Numbers
    rows: _Numbers
    columns: _Numbers
    row: _Numbers
    column: _Numbers

    def add(self, table: Floats, left: Floats, right: Floats, tint: Array | None = None) -> None:
        """Add ``left.T @ right`` at the pairs, times a tint (3,) where there is one."""
        product = (left[:, self.rows].T @ right[:, self.columns])[self.row, self.column]
        table[self.where] += product if tint is None else product[:, None] * tint


@dataclass(frozen=True)
class _WholeBlock:
    """All pairs of some rows and columns of a matrix."""

    rows: slice
    columns: slice

    def add(self, table: Floats, left: Floats, right: Floats, tint: Array | None = None) -> None:
        """Add ``left.T @ right`` to that part of the matrix, times a tint (3,) if there is one."""
        product = left.T @ right
        if tint is None:
            table[self.rows, self.columns] += product
            return
        for colour in np.flatnonzero(tint):
            table[self.rows, self.columns, colour] += tint[colour] * product


_Blocks = Mapping[tuple[int, int], Sequence[_Block | _WholeBlock]]
"""What is added, by the bands of the projector and of the mask."""


def _blocks(
    pairs: SitePairs, opened: PanelSites | Histories, lit: PanelSites | Histories | None
) -> dict[tuple[int, int], list[_Block]]:
    """The pairs, tile by tile, by the bands of the projector and of the mask. Where `lit` is None,
    all pairs count to band 0 of the projector."""
    band = opened.band[pairs.mask]
    p_band = np.zeros_like(band) if lit is None else lit.band[pairs.other]
    keys = opened.tile[pairs.mask], band, p_band
    order = np.lexsort(keys)
    changes = np.any([np.diff(key[order]) != 0 for key in keys], axis=0)
    found: dict[tuple[int, int], list[_Block]] = {}
    for where in np.split(order, np.flatnonzero(changes) + 1):
        if where.size:
            at = int(p_band[where[0]]), int(band[where[0]])
            first = 0 if lit is None else lit.in_band(at[0]).start
            rows, row = np.unique(
                pairs.mask[where] - opened.in_band(at[1]).start, return_inverse=True
            )
            columns, column = np.unique(pairs.other[where] - first, return_inverse=True)
            found.setdefault(at, []).append(_Block(where, rows, columns, row, column))
    return found


@dataclass(frozen=True)
class _Mask:
    """One band of the mask's rows: its sites, their levels, and the pairs that they are in.

    starts : of its spans.
    """

    part: slice
    starts: SpanTimes
    track: Trajectory | StoredSpans
    direct: Sequence[_Block | _WholeBlock]
    indirect: Sequence[_Block | _WholeBlock]
