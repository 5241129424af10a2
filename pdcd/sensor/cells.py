"""Which quads of a camera's frame see which cells of the field: the one place that knows it.

A quad is a Bayer quad: the pixel of all planes and pictures. `CellMap` says where the quads lie on
the field, and converts values between cells and quads. `pdcd.sensor.footprint` does the sums; its
libraries take half a second to import, so it is imported only when they are needed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.errors import DecodeError
from pdcd.panels.map import Map
from pdcd.sensor.bands import OfRows, fill_in_bands, make_planar_image, run_in_channels

if TYPE_CHECKING:
    from scipy import sparse

    from pdcd.sensor.footprint import Cuts, Footprint


_UNCUT: Cuts = ((0.0, 1.0), (0.0, 1.0))
_LEAST_SEEN = 0.05
"""Share of a cell's area that quads must see; below it they do not measure the cell."""
_PURE = 1e-6
"""Rough share of a second cell from which a quad counts as seeing two cells."""
_LEAST_KNOWN = 0.9
"""Share of a cell's seen area that must be known; otherwise the cell is unknown."""
_TOUCHED = 0.01
"""Share of a quad from which the quad counts as seeing a cell."""


class CellMap(msgspec.Struct, frozen=True, kw_only=True):
    """Where the quads of a frame lie on the grid of cells.

    grid : rows and columns of cells, N in all.
    frame : rows and columns of quads (h, w).
    map : from quads to the field. With None the frame fills the field, and every quad counts as
        seeing the mean of the parts of cells it covers, however finely codes divide the cells: runs
        from before there were maps are decoded so, and forecasts are made so.
    blur_quads : standard deviation of the blur between field and sensor, in quads.
    panels : maps of panels that do not cover all of the field. Quads beside their pixels count as
        unknown, although the camera sees light there.

    It is kept with every run, so that a run is decoded with the map it was taken with.
    """

    grid: tuple[int, int]
    frame: tuple[int, int]
    map: Map | None = None
    blur_quads: float = 0.0
    panels: tuple[Map, ...] = ()

    @classmethod
    def block(cls, grid: tuple[int, int], frame: tuple[int, int]) -> CellMap:
        """The map of a frame that is cut evenly into cells. Raises DecodeError when the grid does
        not divide the frame."""
        if frame[0] % grid[0] or frame[1] % grid[1] or not frame[0] * frame[1]:
            raise DecodeError(
                f"a frame of {frame[0]} x {frame[1]} pixels cannot be cut into {grid[0]} x "
                f"{grid[1]} cells",
                device="camera",
                hint="choose scene.grid so that its rows and columns divide those of the frame",
            )
        return cls(grid=grid, frame=frame)

    def binned(self, side: int) -> CellMap:
        """The map of a frame whose pixels are squares of `side` x `side` quads (`can_bin`)."""
        rows, cols = self.frame
        return msgspec.structs.replace(
            self,
            frame=(rows // side, cols // side),
            map=None if self.map is None else self.map.binned(side),
            blur_quads=self.blur_quads / side,
        )

    def can_bin(self, side: int) -> bool:
        """Whether squares of `side` x `side` quads fill the frame, and its cells where these are
        blocks."""
        whole = self.frame if self.map is not None else self.blocks or self.frame
        return not (whole[0] % side or whole[1] % side)

    @property
    def known(self) -> Bools:
        """(h, w), quads that lie wholly within the field, and on the pixels of both panels."""
        return _known(self)

    @property
    def single(self) -> Bools:
        """(h, w), quads that see one cell alone, or nothing of the field."""
        return _single(self)

    def amid(self, quads: float) -> Bools:
        """(h, w), quads whose centre lies at least `quads` quads from the edges of its cell."""
        least = quads * self.quad_cells**0.5
        found: Bools = np.ones(self.frame, np.bool_)
        for place in _places(self):  # from the centre of the first cell
            found &= np.abs(place - np.rint(place)) <= 0.5 - least
        return found

    @property
    def inside(self) -> NDArray[np.float32] | None:
        """(h, w), share of a quad's light that comes from inside the field; None where it is 1 for
        all known quads."""
        return _footprint(self, _UNCUT).inside

    @property
    def centres(self) -> Floats:
        """(h, w, 2), where the centres of quads lie on the field: x right, y down, 0 to 1."""
        return self.filled.centres()

    def spread(self, cells: NDArray[Any]) -> NDArray[Any]:
        """Values of cells, (N, ...) -> of quads, (h, w, ...): the mean over what each quad sees.

        0 outside the field. Bool values stay bool: true where more than half of what a quad sees is
        true.
        """
        if self.blocks is not None:
            down, right = self.blocks
            table = cells.reshape(*self.grid, *cells.shape[1:])
            return table.repeat(down, axis=0).repeat(right, axis=1)
        seen = self.gather(cells.reshape(*self.grid, *cells.shape[1:]))
        return seen > 0.5 if cells.dtype == np.bool_ else seen

    def gather(self, values: NDArray[Any], cuts: Cuts = _UNCUT) -> Floats:
        """Values of pieces of cells, (R, C, ...) -> of quads, (h, w, ...): the mean over what each
        quad sees; 0 outside the field. `cuts` says where cells are cut into pieces."""
        seen = _footprint(self, cuts)
        if values.ndim == 2:
            return seen.gather(values)
        out = make_planar_image((*self.frame, *values.shape[2:]))
        for at in np.ndindex(*values.shape[2:]):
            out[:, :, *at] = seen.gather(values[:, :, *at])
        return out

    def smooth(self, cells: NDArray[Any]) -> NDArray[Any]:
        """Values of cells, (N, ...) -> of quads, (h, w, ...), without edges: bilinear between the
        centres of cells. With more cells than quads, or without a map, it is `spread`."""
        if not self._smooths:
            return self.spread(cells)
        table = cells.reshape(*self.grid, *cells.shape[1:])
        parts = {at: _smooth(self, table[:, :, *at]) for at in np.ndindex(*cells.shape[1:])}

        def some(rows: slice) -> NDArray[Any]:
            out = make_planar_image((rows.stop - rows.start, self.frame[1], *cells.shape[1:]))
            for at, part in parts.items():
                out[:, :, *at] = part(rows)
            return out

        return fill_in_bands((*self.frame, *cells.shape[1:]), np.float64, some)

    def smooth_rows(self, cells: NDArray[Any]) -> OfRows:
        """The same for one value a cell, (N,), some rows of quads at a time: (n, w)."""
        if not self._smooths:
            whole = self.spread(cells)
            return lambda rows: whole[rows]
        return _smooth(self, cells.reshape(self.grid))

    @property
    def _smooths(self) -> bool:
        coarse = self.frame[0] * self.frame[1] < self.grid[0] * self.grid[1]
        return self.map is not None and not coarse

    def mean(self, image: NDArray[Any], known: Bools | None = None) -> Floats:
        """Values of quads (h, w, C) -> their mean over each cell, (N, C), by area.

        Quads that are not `known` (h, w), or not wholly in the field, do not count. A cell that no
        quad sees gets 0.
        """
        if self.blocks is not None and known is None:
            (rows, cols), (down, right) = self.grid, self.blocks
            blocks = image.reshape(rows, down, cols, right, image.shape[2])
            means: Floats = blocks.mean(axis=(1, 3)).reshape(rows * cols, -1)
            return means
        return self._weighed(image, known, squares=False)

    def error_of_mean(self, variance: NDArray[Any], known: Bools | None = None) -> Floats:
        """Variances of quads (h, w, C) -> standard deviation of `mean`, (N, C), with independent
        quads; 0 for cells that no quad sees."""
        return self._weighed(variance, known, squares=True)

    def seen(self, known: Bools | None = None) -> Bools:
        """(N,), cells of which enough area is seen, and enough of the seen area is known."""
        whole = self._area.ravel()
        enough = whole * self.quad_cells >= _LEAST_SEEN
        if known is None:
            return enough
        seen = _footprint(self, _UNCUT).collect(known & self.known).ravel()
        return enough & (seen >= _LEAST_KNOWN * whole)

    def touched(self, quads: Bools) -> Bools:
        """(N,), cells that these quads (h, w) see, even in part."""
        shares = _footprint(self, _UNCUT).collect(quads & self.known).ravel()
        return np.asarray(shares > _TOUCHED)

    @property
    def quad_cells(self) -> float:
        """Area of the quad in the middle of the frame, in cells."""
        middle = np.array([0.5 * self.frame[1], 0.5 * self.frame[0]])
        slope = self.filled.jacobian(middle)
        return abs(float(np.linalg.det(slope))) * self.grid[0] * self.grid[1]

    def _weighed(self, image: NDArray[Any], known: Bools | None, *, squares: bool) -> Floats:
        """Means over cells; with `squares`, standard deviations of the means of variances."""
        shares = _footprint(self, _UNCUT)
        good = self.known if known is None else known & self.known
        area = (self._area if known is None else shares.collect(good)).reshape(-1, 1)
        out, whole = np.empty((area.size, image.shape[2])), bool(good.all())

        def channel_of(channel: int) -> None:
            kept = image[..., channel] if whole else np.where(good, image[..., channel], 0.0)
            out[:, channel] = shares.collect(kept, squares=squares).ravel()

        run_in_channels(image, channel_of)
        if squares:
            np.sqrt(out, out=out)
        return np.divide(out, area, out=np.zeros_like(out), where=area > 0.0)

    @property
    def _area(self) -> Floats:
        """Area of each cell that known quads see, (rows, cols), in quads."""
        shares = _footprint(self, _UNCUT)
        return shares.collect(self.known) if self.panels else shares.area

    @property
    def filled(self) -> Map:
        """The map; where there is none, that of a frame which fills the field."""
        return self.map or Map.filling((self.frame[1], self.frame[0]))

    @property
    def blocks(self) -> tuple[int, int] | None:
        """Rows and columns of quads in a cell; None with a map, or where they are not whole."""
        (rows, cols), (height, width) = self.grid, self.frame
        if self.map is not None or height % rows or width % cols:
            return None
        return height // rows, width // cols


@lru_cache(maxsize=4)
def _footprint(cells: CellMap, cuts: Cuts) -> Footprint:
    from pdcd.sensor.footprint import compute_footprint

    return compute_footprint(cells.filled, cells.frame, cells.grid, cuts, cells.blur_quads)


@lru_cache(maxsize=4)
def _known(cells: CellMap) -> Bools:
    within = _footprint(cells, _UNCUT).known
    if not cells.panels:
        return within
    from pdcd.sensor.beside import find_covered_quads  # few benches need it

    return within & find_covered_quads(cells.filled, cells.panels, cells.blur_quads)


@lru_cache(maxsize=2)
def _single(cells: CellMap) -> Bools:
    if cells.blocks is not None:
        return np.ones(cells.frame, np.bool_)
    seen = _footprint(cells, _UNCUT)
    alone: Bools = np.ones(cells.frame, np.bool_)
    for at in np.indices(cells.grid).astype(np.float64):
        alone &= seen.gather(at**2) - seen.gather(at) ** 2 < _PURE
    return alone


@lru_cache(maxsize=2)
def _places(cells: CellMap) -> NDArray[np.float32]:
    from pdcd.sensor.quad_places import compute_quad_places

    return compute_quad_places(cells.filled, cells.frame, cells.grid)


@lru_cache(maxsize=2)
def _lines(cells: CellMap) -> tuple[bool, sparse.csr_array, sparse.csr_array] | None:
    from pdcd.sensor.quad_places import make_axis_weights

    return make_axis_weights(cells.filled, cells.frame, cells.grid)


@lru_cache(maxsize=64)
def _line_rows(cells: CellMap, start: int, stop: int) -> sparse.csr_array:
    """Some rows of the weights along columns; a picture needs each band of them many times."""
    lines = _lines(cells)
    if lines is None:
        raise ValueError("no upright map")
    return lines[1][start:stop]


def _smooth(cells: CellMap, table: Floats) -> OfRows:
    lines = _lines(cells)
    if lines is None:
        from pdcd.sensor.quad_places import interpolate_between_cells

        places, values = _places(cells), table.astype(np.float32)
        return lambda rows: interpolate_between_cells(values, places[:, rows])
    turned, _, right = lines
    table = np.ascontiguousarray(table if turned else table.T)
    across = np.ascontiguousarray((right @ table).T)
    return lambda rows: np.asarray(_line_rows(cells, rows.start, rows.stop) @ across)
