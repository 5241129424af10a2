"""The realised probing matrix from the pixels that two panels really showed.

`pdcd.probing.realised` trusts that a panel shows each code where it belongs, and so needs only a
few fields for a cell. Here nothing is trusted: every pixel of both panels has a history of its own.
A wrong pixel, exchanged panels, or a mirrored or shifted window change the matrix as they would on
a bench. Pixels that lie across the edge of a cell are shared between cells by area.

Not for long runs: an exposure of K codes costs K passes over all pixels of both panels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.tables import PanelConfig
from pdcd.errors import ConfigError
from pdcd.panels.curve import Curve
from pdcd.panels.frames import FrameLog, check_row_times
from pdcd.panels.pixels import BLACK_PICTURE, PanelPictures, ShownPictures
from pdcd.probing.panel import PanelOptics, Trajectory, offset_cells
from pdcd.probing.realised import Factors
from pdcd.probing.spans import compute_span_weights, find_span_starts


@dataclass(frozen=True)
class _Axis:
    """One axis of the scene cut wherever a cell or a pixel of either panel ends (A pieces).

    primal, dual : (A,) intp, pixel of each panel; for the mask, one past the last is outside it.
    cells : (cells, A) sparse, length of each piece in its cell, in cells.
    """

    primal: NDArray[np.intp]
    dual: NDArray[np.intp]
    cells: scipy.sparse.csr_array

    @classmethod
    def cut(cls, cells: int, primal_px: int, dual_px: int, offset_cells: float) -> _Axis:
        """Cut `cells` cells, over which both panels spread; the mask is seen at x + offset."""
        # In units in which all edges of aligned panels are whole numbers: no slivers by rounding.
        unit = primal_px * dual_px * cells
        offset = offset_cells * primal_px * dual_px
        edges = [np.arange(n + 1.0) * (unit // n) for n in (cells, primal_px, dual_px)]
        edges[2] -= offset
        cuts = np.unique(np.concatenate(edges))
        cuts = cuts[(cuts >= 0.0) & (cuts <= unit)]
        middle, length = 0.5 * (cuts[1:] + cuts[:-1]), np.diff(cuts)
        cell = np.floor(middle * cells / unit).astype(np.intp)
        primal = np.floor(middle * primal_px / unit).astype(np.intp)
        dual = np.floor((middle + offset) * dual_px / unit).astype(np.intp)
        dual[(dual < 0) | (dual >= dual_px)] = dual_px
        share = scipy.sparse.csr_array(
            (length * cells / unit, (cell, np.arange(cell.size))), shape=(cells, cell.size)
        )
        return cls(primal, dual, share)


class _Places:
    """Where the pixels of both panels lie over the cells of the scene."""

    def __init__(
        self,
        grid: tuple[int, int],
        primal_px: tuple[int, int],
        dual_px: tuple[int, int],
        offset: tuple[float, float],
    ) -> None:
        self.cells = grid[0] * grid[1]
        self._primal_shape = primal_px[1], primal_px[0]
        # One more row and column for all that lies outside the mask: black, like its frame.
        self.dual_shape = dual_px[1] + 1, dual_px[0] + 1
        axes = [
            _Axis.cut(grid[a], self._primal_shape[a], self.dual_shape[a] - 1, offset[a])
            for a in (0, 1)
        ]
        self._y, self._x = axes
        self._primal_means = [_gathered(a.cells, a.primal, n) for a, n in self._pairs("primal")]
        self._dual_means = [_gathered(a.cells, a.dual, n) for a, n in self._pairs("dual")]

    def _pairs(self, side: str) -> list[tuple[_Axis, int]]:
        shape = self._primal_shape if side == "primal" else self.dual_shape
        return [(self._y, shape[0]), (self._x, shape[1])]

    def primal_mean(self, field: Floats) -> Floats:
        """Mean over each cell of a projector field (pixels,), (N,)."""
        down, right = self._primal_means
        return np.asarray(down @ field.reshape(self._primal_shape) @ right.T).ravel()

    def dual_mean(self, field: Floats) -> Floats:
        """Mean over each cell of a mask field (pixels,), (N,)."""
        down, right = self._dual_means
        return np.asarray(down @ field.reshape(self.dual_shape) @ right.T).ravel()

    def product_mean(self, dual: Floats, primal: Floats) -> Floats:
        """Mean over each cell of the product of a mask and a projector field, (N,)."""
        y, x = self._y, self._x
        mask = dual.reshape(self.dual_shape)[:, x.dual][y.dual]
        mask *= primal.reshape(self._primal_shape)[:, x.primal][y.primal]
        return np.asarray(y.cells @ mask @ x.cells.T).ravel()


def _gathered(
    cells: scipy.sparse.csr_array, pixel: NDArray[np.intp], count: int
) -> scipy.sparse.csr_array:
    """(cells, pixels): length of each pixel in each cell."""
    ones = scipy.sparse.csr_array(
        (np.ones(pixel.size), (np.arange(pixel.size), pixel)), shape=(pixel.size, count)
    )
    return scipy.sparse.csr_array(cells @ ones)


def compute_pixel_factors(
    shown: ShownPictures,
    log: FrameLog,
    projector: PanelConfig,
    mask: PanelConfig,
    *,
    grid: tuple[int, int],
    open_ns: int,
    close_ns: int,
) -> Iterator[Factors]:
    """Realised probing matrix of one exposure, chunk by chunk, from pictures of both panels.

    Parameters
    ----------
    shown : one picture of each panel for every row of `log`.
    log : when each row began on each panel; its row numbers are not used.
    projector, mask : optics of the panels, misregistration included; both rest on black when the
        shutter opens. Levels become light by `gamma` or `lut`, the same for all colours.
    grid : (rows, cols) of the scene's cells; both panels spread over all of them.
    open_ns, close_ns : the exposure, on the clock of the log.

    Raises ConfigError when pictures and log differ in number, or pictures and panels in size, and
    for panels with `scan_s` or `blur_px` and rows with times of their own.
    """
    check_row_times(log)
    _check(shown, log, projector, mask)
    places = _Places(grid, projector.size_px, mask.size_px, offset_cells(projector, mask, grid))
    primal, dual = PanelOptics.from_config(projector), PanelOptics.from_config(mask)
    ends_ns = int(log.end_ns[0]), int(log.end_ns[1])
    lit, opened = shown.projector.index, shown.mask.index
    p_rows, p_start_ns = find_span_starts(lit, log.primal_ns, ends_ns[0], primal, open_ns)
    d_rows, d_start_ns = find_span_starts(opened, log.dual_ns, ends_ns[1], dual, open_ns)
    p_track = Trajectory(
        primal,
        p_start_ns,
        projector.size_px[0] * projector.size_px[1],
        lambda s: _light(shown.projector, p_rows[s], primal.curve).ravel(),
    )
    height, width = places.dual_shape
    d_track = Trajectory(
        dual,
        d_start_ns,
        height * width,
        lambda s: np.pad(_light(shown.mask, d_rows[s], dual.curve), (0, 1)).ravel(),
    )
    weights, opens = compute_span_weights(
        primal, dual, p_start_ns, d_start_ns, exposure_ns=close_ns - open_ns
    )
    yield from _chunks(places, p_track, d_track, weights, opens, spans=len(p_rows))


def _chunks(
    places: _Places, p_track: Trajectory, d_track: Trajectory, weights: Any, opens: Any, spans: int
) -> Iterator[Factors]:
    """The factors of each span of the projector that the shutter was open for."""
    reached = 0  # spans of the mask come in order, without gaps, the last one perhaps twice
    for span in range(spans):
        lights = p_track.take(span, span + 1)[0]
        rows = weights[span * p_track.fields : (span + 1) * p_track.fields]
        used = np.unique(opens[[span]].indices) // d_track.fields
        if used.size == 0:  # over before the shutter opened, or after it closed
            continue
        lo, hi = min(int(used[0]), reached), int(used[-1]) + 1
        reached = hi
        columns = slice(lo * d_track.fields, hi * d_track.fields)
        masks = d_track.take(lo, hi).reshape(columns.stop - columns.start, -1)
        yield _reduce(
            places, lights, rows[:, columns] @ masks, (opens[[span]][:, columns] @ masks)[0]
        )


def _check(shown: ShownPictures, log: FrameLog, projector: PanelConfig, mask: PanelConfig) -> None:
    """Raise ConfigError when pictures and log differ in number, pictures and panels in size, or
    panels have more to them than pixels that all respond alike."""
    if len(shown) != len(log):
        raise ConfigError(
            f"{len(shown)} pictures of the screen for {len(log)} refreshes",
            device="display",
            hint="every refresh of the frame log needs one",
        )
    for name, panel, pictures in (
        ("projector", projector, shown.projector),
        ("mask", mask, shown.mask),
    ):
        if panel.scan_s or panel.blur_px:
            raise ConfigError(
                "rows that are set one after the other, and blur, are not known of single pixels",
                device=name,
                hint=f"leave out scan_s and blur_px of [{name}], or say them in the bench's truth",
            )
        if pictures.size_px != panel.size_px:
            raise ConfigError(
                f"pictures of {pictures.size_px} pixels for a panel of {panel.size_px}",
                device=name,
                hint=f"mend size_px of [{name}]",
            )


def _reduce(places: _Places, lights: Floats, masks: Floats, open_fine: Floats) -> Factors:
    """Average the fields of one span of the projector, and what they meet, over the cells."""
    alive = masks.any(axis=1) & lights.any(axis=1)
    cells = places.cells
    left, right, coaxial = np.zeros((0, cells)), np.zeros((0, cells)), np.zeros(cells)
    for mask, light in zip(masks[alive], lights[alive], strict=True):
        left = np.vstack([left, places.dual_mean(mask)])
        right = np.vstack([right, places.primal_mean(light)])
        coaxial += places.product_mean(mask, light)
    return Factors(left, right, coaxial, places.dual_mean(open_fine))


def _light(pictures: PanelPictures, row: int, curve: Curve | None) -> Floats:
    """Light of one row, or of the black before and after all of them (-1)."""
    sent = pictures.levels(BLACK_PICTURE if row < 0 else int(pictures.index[row]))
    return sent if curve is None else curve.given(sent)
