"""How far apart two panels draw the borders of cells, where their pixels do not coincide.

A pixel shows the cell in which its centre lies, so that the border of a cell follows the pixels of
a panel. On panels whose pixels end where cells end, and on equal ones that lie on each other, both
borders are the same. On all others, such as a mask that is turned or has another number of pixels,
some light of a cell goes through the mask of the next one: as much as if the panels lay that far
apart. Light that comes straight back from there is direct light with the weight of a path between
two cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.panels.atoms import ATOMS_PER_CELL, NEAR
from pdcd.panels.map import Map, PanelView

_Grid = tuple[int, int]

_BORDERS = 48
"""Most borders that are sampled along either axis, evenly spread."""
_POINTS = 12
"""Places along each of them."""
ACROSS = 32
"""Places across it at each of those."""
GOLDEN = 0.6180339887498949
"""Step of places along borders, irrational so that they do not coincide with the pixels."""
PLASTIC = 0.7548776662466927
"""The same for places all over the field: steps along x, its square along y (Roberts' R2)."""
_PLACES = 2**14
"""Places all over the field."""
_STEPS = 10
"""Bisections that locate the place at which a panel changes from one cell to the next."""
_EDGES = 8
"""Pieces on either side of a border within reach of a pixel."""
_SPLIT, _LINES = 4, 2
"""For panels that do not lie straight: pieces into which each is split along a border, as strips
have steps there, and sampled places in each."""
_MOST_REACH = 0.45
"""Largest distance, in cells: borders that are drawn further away are those of other cells."""
LEAST_APART = 1e-4
"""Share of the field in which panels draw different cells below which it is not visible."""
APART = 4
"""Rows or columns between cells whose strips are shown together: only one of neighbours is, so that
no pixel sees what it lights itself, and little light comes from elsewhere."""
_ON_EDGE = NEAR / ATOMS_PER_CELL
"""Distance in cells from a border at which a centre counts as lying on it, as panels draw it."""
_KEPT = 4
"""Geometries whose strips are remembered."""
_PIECE = 2**11
"""Places that are processed together."""


def cell_mismatch_px(
    projector: PanelView, mask: PanelView, grid: _Grid, projector_px: tuple[int, int]
) -> float:
    """Largest distance from a border of cells, in projector pixels, at which both panels show
    different cells.

    projector, mask : as they are believed to lie. grid : rows and columns of cells. projector_px :
    width and height.
    """
    size = np.array(projector_px, dtype=np.float64)
    worst = 0.0
    for axis in (0, 1):  # borders across x, then across y
        points, off_px = _beside(axis, grid, size)
        reach_px = float(np.hypot(*np.max([_half_px(v.map, size) for v in (projector, mask)], 0)))
        points[:, axis] += off_px * 2.0 * reach_px / size[axis]
        for part in _pieces(len(points)):
            first, second = (_cells(view.map, points[part], grid) for view in (projector, mask))
            shown = (first >= 0) & (second >= 0)
            # Only across this border: near a corner they may differ across the other one, too.
            one, other = (c % grid[1] if axis == 0 else c // grid[1] for c in (first, second))
            away = np.abs(off_px[part][shown & (one != other)])
            worst = max(worst, float(away.max(initial=0.0)) * 2.0 * reach_px)
    return worst


def compute_cell_mismatch_share(projector: PanelView, mask: PanelView, grid: _Grid) -> float:
    """Share of the field, 0 to 1, in which the panels show different cells; places where one of
    them shows none count as the same.

    projector, mask : as they are believed to lie. grid : rows and columns of cells.
    """
    apart = 0
    for part in _pieces(_PLACES):
        points = np.outer(np.arange(part.start, part.stop), (PLASTIC, PLASTIC**2)) % 1.0
        first, second = (_cells(view.map, points, grid) for view in (projector, mask))
        apart += int(np.count_nonzero((first >= 0) & (second >= 0) & (first != second)))
    return apart / _PLACES


@dataclass(frozen=True, eq=False)
class BorderStrips:
    """Strips along the borders of one direction in which both panels show different cells.

    axis : 0 for borders between columns of cells, 1 between rows.
    cuts : where cells are cut along rows and columns into the pieces by which strips are given.
    piece, share : (E,), number of a piece, row by row, and how much of it a strip takes.
    border : (E,), number of the border, row by row: of (rows, cols - 1) or (rows - 1, cols).
    ahead : (E,), whether the projector already shows the cell behind the border where the mask
        still shows the one in front of it; else the other way around.
    """

    axis: int
    cuts: tuple[tuple[float, ...], tuple[float, ...]]
    piece: NDArray[np.int64]
    share: Floats
    border: NDArray[np.int64]
    ahead: NDArray[np.bool_]

    @property
    def step(self) -> float:
        """Width of a piece across a border, in cells."""
        return self.cuts[1 - self.axis][1]

    def of_field(self, grid: _Grid) -> float:
        """Share of the field that the strips take."""
        along = grid[self.axis] * (len(self.cuts[self.axis]) - 1)
        return float(self.share.sum()) * self.step / (grid[1 - self.axis] * along)

    @cached_property
    def pieces(self) -> NDArray[np.int64]:
        """Numbers of the pieces that have a strip, ascending."""
        return np.unique(self.piece)

    def centres(self, grid: _Grid) -> Floats:
        """Where these pieces lie on the field, (pieces, 2): x and y of their centres."""
        (down, right), across = self.cuts, grid[1] * (len(self.cuts[1]) - 1)
        row, column = np.divmod(self.pieces, across)
        found = []
        for place, cuts, cells in ((column, right, grid[1]), (row, down, grid[0])):
            middles = 0.5 * (np.array(cuts[1:]) + np.array(cuts[:-1]))
            cell, part = np.divmod(place, len(middles))
            found.append((cell + middles[part]) / cells)
        return np.stack(found, axis=-1)

    def area(self, grid: _Grid) -> Floats:
        """Share of each piece that strips take: (pieces down, pieces right)."""
        return self._table(self.share, grid)

    def lit_s(self, left: Floats, right: Floats, grid: _Grid) -> Floats:
        """Mean time for which points of each piece are lit as one cell and seen as the other.

        left, right : (R, N), of a realised matrix. Returned: (pieces down, pieces right).
        """
        rows, cols = grid
        mask, light = (side.reshape(-1, rows, cols) for side in (left, right))
        along = (rows - 1, cols) if self.axis else (rows, cols - 1)
        near, far = np.s_[:, : along[0], : along[1]], np.s_[:, rows - along[0] :, cols - along[1] :]
        behind = np.einsum("rij,rij->ij", mask[far], light[near]).ravel()
        before = np.einsum("rij,rij->ij", mask[near], light[far]).ravel()
        time_s = np.where(self.ahead, before[self.border], behind[self.border]) * self.share
        return self._table(time_s, grid)

    def _table(self, values: Floats, grid: _Grid) -> Floats:
        """Sums over the strips of each piece."""
        down, right = (side * (len(cuts) - 1) for side, cuts in zip(grid, self.cuts, strict=True))
        found = np.bincount(self.piece, values, minlength=down * right)
        return np.asarray(found, dtype=np.float64).reshape(down, right)


@lru_cache(maxsize=_KEPT)
def find_strips(
    projector: PanelView, mask: PanelView, grid: _Grid, fine: int
) -> tuple[BorderStrips, ...]:
    """Where the panels show different cells along the borders of cells, to a thousandth of a
    pixel; empty if they do so nowhere, or where a pixel is as large as a cell.

    projector, mask : as they are believed to lie. grid : rows and columns of cells. fine : least
    number of pieces of a cell along each border. The results for the last geometries are cached:
    most runs of a bench have the same.
    """
    maps = projector.map, mask.map
    straight = all(map(_lies_straight, maps))
    fine, lines = (fine, 1) if straight else (_SPLIT * fine, _LINES)
    found = [_strips(axis, *maps, grid, fine, lines) for axis in (0, 1)]
    taken = sum(strips.of_field(grid) for strips in found if strips is not None)
    if taken < LEAST_APART:
        return ()
    return tuple(strips for strips in found if strips is not None and strips.piece.size)


@dataclass(frozen=True, eq=False)
class BorderPixels:
    """Pixels of both panels beside borders, which reach into any strip in which the other panel
    shows another cell.

    projector, inner, mask : (height, width) uint16, the kinds of a pixel, a bit each: the kind of
        the cell that it lights, or those of the cells across the borders beside it. Cells of a
        kind lie `APART` rows or columns from each other. `inner` are pixels of the projector that
        lie next to those beside borders, and reach into no strip.
    reach : half width of the lines of pixels beside borders, in cells (x, y).
    """

    projector: NDArray[np.uint16]
    inner: NDArray[np.uint16]
    mask: NDArray[np.uint16]
    reach: tuple[float, float]

    def of_kinds(
        self, inner: bool = False
    ) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
        """The pixels of projector and mask that are lit and open for strips of each kind; with
        `inner`, the inner pixels of the projector instead."""
        lit = self.inner if inner else self.projector
        for kind in range(APART**2):
            yield (lit >> kind & 1) > 0, (self.mask >> kind & 1) > 0


def find_border_pixels(
    projector: PanelView, mask: PanelView, grid: _Grid, margin_px: float
) -> BorderPixels:
    """The pixels that make up the strips along borders, for a photo of their light
    (`pdcd.planning.border_photo`).

    projector, mask : as they are believed to lie. margin_px : projector pixels by which one of them
    may lie elsewhere.
    """
    reach = measure_border_reach(projector, mask, grid, margin_px)
    found = [np.zeros(view.size_px[::-1], dtype=np.uint16) for view in (projector, mask)]
    inner = np.zeros_like(found[0])
    for view, kinds in zip((projector, mask), found, strict=True):
        place = view.map.centres() * grid[::-1] + _ON_EDGE
        with np.errstate(invalid="ignore"):
            inside = np.all((place >= 0.0) & (place < grid[::-1]), axis=-1)
        own = np.floor(np.where(inside[..., None], place, 0.0)).astype(np.int64)
        nearest = np.rint(np.where(inside[..., None], place, 0.0))
        off = np.where(inside[..., None], np.abs(place - nearest), np.inf)
        off[(nearest <= 0) | (nearest >= grid[::-1])] = np.inf  # beyond the field there is no cell
        near = off <= reach
        if view is projector:
            beside = near.any(axis=-1)
            kinds[:] = np.where(beside, _bit(own), 0)
            inner[:] = np.where((off <= 2.0 * np.array(reach)).any(axis=-1) & ~beside, _bit(own), 0)
            continue
        beyond = np.where(nearest > own, own + 1, own - 1)
        for across in ((True, False), (False, True), (True, True)):
            cell = np.where(across, beyond, own)
            kinds |= np.where(near[..., across].all(axis=-1), _bit(cell), 0).astype(np.uint16)
    return BorderPixels(found[0], inner, found[1], reach)


def measure_border_reach(
    projector: PanelView, mask: PanelView, grid: _Grid, margin_px: float
) -> tuple[float, float]:
    """Largest distance (x, y) from a border of a pixel that reaches into its strip, in cells."""
    half = [_half_px(view.map, np.ones(2)) for view in (projector, mask)]
    reach = (half[0] + half[1] + 2.0 * margin_px * half[0]) * grid[::-1]
    return float(reach[0]), float(reach[1])


def _bit(cell: NDArray[np.int64]) -> NDArray[np.uint16]:
    """The kind of cells (..., 2), column and row, as a bit."""
    column, row = np.moveaxis(cell % APART, -1, 0)
    bit: NDArray[np.uint16] = np.left_shift(1, row * APART + column).astype(np.uint16)
    return bit


def find_nearest_grid(projector: PanelView, mask: PanelView, grid: _Grid) -> _Grid | None:
    """The nearest rows and columns of cells that end on pixels of both panels, the finer of two
    equally near ones; None where panels do not fill the field, or none is within a factor of 2."""
    sizes = [view.size_px[::-1] for view in (projector, mask) if _fills(view.map)]
    if len(sizes) < 2:
        return None
    found = []
    for count, lengths in zip(grid, zip(*sizes, strict=True), strict=True):
        whole = math.gcd(*lengths)
        fitting = (n for n in range(1, whole + 1) if whole % n == 0)
        found.append(min(fitting, key=lambda n: (round(abs(math.log(n / count)), 9), -n)))
        if not 0.5 <= found[-1] / count <= 2.0:
            return None
    return found[0], found[1]


def _fills(map_: Map) -> bool:
    """Whether the corners of a panel that lies straight are those of the field."""
    if not _lies_straight(map_):
        return False
    ends = np.sort(map_.to_field(np.array([[0.0, 0.0], map_.size_px])), axis=0)
    return bool(np.allclose(ends, [[0.0, 0.0], [1.0, 1.0]], rtol=0.0, atol=1e-9))


def _lies_straight(map_: Map) -> bool:
    """Whether rows of pixels lie along rows or columns of cells, all over the field."""
    a, b, _, d, e, _, g, h, _ = map_.homography
    bent = any(map_.radial) or any(map_.tangential) or bool(map_.residual)
    return not bent and g == h == 0.0 and (b == d == 0.0 or a == e == 0.0)


def _strips(
    axis: int, projector: Map, mask: Map, grid: _Grid, fine: int, lines: int
) -> BorderStrips | None:
    """The strips of one direction of borders; None where pixels are as large as cells."""
    across, along = (grid[1], grid[0]) if axis == 0 else grid
    ones = np.ones(2)
    # The outermost pieces stay empty, so that strips can be shifted by one.
    half = max(float(_half_px(m, ones)[axis]) for m in (projector, mask))
    reach = half * across * _EDGES / (_EDGES - 1.001)
    if across < 2 or reach > _MOST_REACH:
        return None
    steps = np.linspace(0.0, reach, _EDGES + 1)
    whole = tuple((np.arange(fine + 1.0) / fine).tolist())
    edges = (*steps.tolist(), *(1.0 - steps[::-1]).tolist())
    cuts = (whole, edges) if axis == 0 else (edges, whole)
    count = along * fine * lines
    # Each line has another place within its stretch, so that lines do not coincide with pixels.
    spread = (np.arange(count) * GOLDEN) % 1.0 if lines > 1 else np.full(count, 0.5)
    place = (np.arange(count) + spread) / count
    border = np.repeat(np.arange(1, across), count)
    points = np.empty((border.size, 2))
    points[:, axis], points[:, 1 - axis] = border / across, np.tile(place, across - 1)
    first, second = (_turns(m, points, axis, border, across, reach) for m in (projector, mask))
    low, high = np.fmin(first, second), np.fmax(first, second)
    there = np.flatnonzero(np.isfinite(first + second) & (high > low))
    low, high, border = low[there, None], high[there, None], border[there]
    stretch = there % count // lines
    ends = np.concatenate([-steps[::-1], steps[1:]])
    taken = np.minimum(high, ends[1:]) - np.maximum(low, ends[:-1])
    line, part = np.nonzero(taken > 0.0)
    share = taken[line, part] / (steps[1] * lines)
    pieces = 2 * _EDGES + 1
    piece = border[line] * pieces + part - _EDGES
    if axis == 0:
        number = stretch[line] * (across * pieces) + piece
        at = stretch[line] // fine * (across - 1) + border[line] - 1
    else:
        number = piece * (along * fine) + stretch[line]
        at = (border[line] - 1) * along + stretch[line] // fine
    ahead = (first < second)[there][line]
    return BorderStrips(axis, cuts, number, share, at, ahead)


def _turns(
    map_: Map, points: Floats, axis: int, border: NDArray[np.int64], across: int, reach: float
) -> Floats:
    """How far behind a border, in cells, a panel changes from the cell in front of it to the one
    behind; NaN where it has no pixel. points : (n, 2) on borders."""
    low, high = np.full(len(points), -reach), np.full(len(points), reach)
    size = np.array(map_.size_px)
    at = points.copy()
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        at[:, axis] = (border + middle) / across
        pixel = np.floor(map_.from_field(at))
        on = np.all((pixel >= 0.0) & (pixel < size), axis=1)
        behind = map_.to_field(pixel + 0.5)[:, axis] * across + _ON_EDGE >= border
        low, high = np.where(behind, low, middle), np.where(behind, middle, high)
        low[~on] = np.nan
    return np.asarray(0.5 * (low + high))


def _pieces(count: int) -> Iterator[slice]:
    """Slices of so many places, a few at a time, to bound the memory."""
    for start in range(0, count, _PIECE):
        yield slice(start, min(start + _PIECE, count))


def _beside(axis: int, grid: _Grid, size: Floats) -> tuple[Floats, Floats]:
    """Points (n, 2) of the field on the borders of cells along an axis, and the relative distance
    from them to sample, (n,), -1 to 1 and never 0."""
    count = grid[1 - axis]
    if count < 2:
        return np.empty((0, 2)), np.empty(0)
    chosen = np.unique(np.linspace(1, count - 1, min(_BORDERS, count - 1)).round()) / count
    along = (np.arange(chosen.size * _POINTS) * GOLDEN) % 1.0
    off = (np.arange(ACROSS) + 0.5) * 2.0 / ACROSS - 1.0
    points = np.empty((chosen.size * _POINTS, ACROSS, 2))
    points[..., axis] = np.repeat(chosen, _POINTS)[:, None]
    points[..., 1 - axis] = along[:, None]
    return points.reshape(-1, 2), np.tile(off, len(along))


def _half_px(map_: Map, size: Floats) -> Floats:
    """Half a pixel of a device along x and y of the field, in projector pixels, (2,): the largest
    of some pixels."""
    width, height = map_.size_px
    at = np.stack(np.meshgrid(np.linspace(0, width, 5), np.linspace(0, height, 5)), axis=-1)
    at = at.reshape(-1, 2)
    here = map_.to_field(at)
    right, down = (map_.to_field(at + step) - here for step in ((1.0, 0.0), (0.0, 1.0)))
    return np.asarray(0.5 * ((np.abs(right) + np.abs(down)) * size).max(axis=0))


def _cells(map_: Map, points: Floats, grid: _Grid) -> NDArray[np.int64]:
    """The cell that a panel shows at points of the field, (n,); -1 where it shows none."""
    width, height = map_.size_px
    pixel = np.floor(map_.from_field(points))
    with np.errstate(invalid="ignore"):
        on = np.all((pixel >= 0.0) & (pixel < (width, height)), axis=1, keepdims=True)
    centre = map_.to_field(np.where(on, pixel, 0.0) + 0.5)
    cell = np.floor(centre * grid[::-1] + _ON_EDGE).astype(np.int64)
    shown = on[:, 0] & np.all((cell >= 0) & (cell < grid[::-1]), axis=1)
    return np.where(shown, cell[:, 1] * grid[1] + cell[:, 0], -1)
