"""How far apart the borders of cells are that both panels draw, where their pixels do not meet.

A pixel shows the cell in which its centre lies, so that the border of a cell follows the pixels of
a panel. On panels whose pixels end where cells end, and on equal ones that lie on each other, both
borders are the same. On all others, a mask that is turned or has another number of pixels, some
light of a cell goes through the mask of the next one: as much as if the panels lay that far apart.
What comes straight back from there is direct light with the weight of a path between two cells.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.map import Map, PanelView

Floats = NDArray[np.float64]
Grid = tuple[int, int]

BORDERS = 48
"""Borders that are looked at along either axis, evenly."""
POINTS = 12
"""Places along each of them."""
ACROSS = 32
"""Places across it at each of those."""
GOLDEN = 0.6180339887498949
"""Places along borders must not keep step with the pixels."""
PLASTIC = 0.7548776662466927
"""The same of places all over the field: steps along x, its square along y (Roberts' R2)."""
PLACES = 2**14
"""Places all over the field."""
PIECE = 2**11
"""Places that are looked at together."""


def drawn_apart_px(
    projector: PanelView, mask: PanelView, grid: Grid, projector_px: tuple[int, int]
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
            # Across this border alone: near a corner they may differ across the other one, too.
            one, other = (c % grid[1] if axis == 0 else c // grid[1] for c in (first, second))
            away = np.abs(off_px[part][shown & (one != other)])
            worst = max(worst, float(away.max(initial=0.0)) * 2.0 * reach_px)
    return worst


def drawn_apart_share(projector: PanelView, mask: PanelView, grid: Grid) -> float:
    """Share of the field, 0 to 1, in which the panels show different cells; places where one of
    them shows none count as the same.

    projector, mask : as they are believed to lie. grid : rows and columns of cells.
    """
    apart = 0
    for part in _pieces(PLACES):
        points = np.outer(np.arange(part.start, part.stop), (PLASTIC, PLASTIC**2)) % 1.0
        first, second = (_cells(view.map, points, grid) for view in (projector, mask))
        apart += int(np.count_nonzero((first >= 0) & (second >= 0) & (first != second)))
    return apart / PLACES


def _pieces(count: int) -> Iterator[slice]:
    """So many places, a few at a time: a plan of a small grid takes no more memory than this."""
    for start in range(0, count, PIECE):
        yield slice(start, min(start + PIECE, count))


def _beside(axis: int, grid: Grid, size: Floats) -> tuple[Floats, Floats]:
    """Points (n, 2) of the field on the borders of cells along an axis, and how far beside them to
    look, (n,), -1 to 1 and never 0."""
    count = grid[1 - axis]
    if count < 2:
        return np.empty((0, 2)), np.empty(0)
    chosen = np.unique(np.linspace(1, count - 1, min(BORDERS, count - 1)).round()) / count
    along = (np.arange(chosen.size * POINTS) * GOLDEN) % 1.0
    off = (np.arange(ACROSS) + 0.5) * 2.0 / ACROSS - 1.0
    points = np.empty((chosen.size * POINTS, ACROSS, 2))
    points[..., axis] = np.repeat(chosen, POINTS)[:, None]
    points[..., 1 - axis] = along[:, None]
    return points.reshape(-1, 2), np.tile(off, len(along))


def _half_px(map_: Map, size: Floats) -> Floats:
    """Half a pixel of a device along x and y of the field, in projector pixels, (2,): the most over
    some pixels."""
    width, height = map_.size_px
    at = np.stack(np.meshgrid(np.linspace(0, width, 5), np.linspace(0, height, 5)), axis=-1)
    at = at.reshape(-1, 2)
    here = map_.to_field(at)
    right, down = (map_.to_field(at + step) - here for step in ((1.0, 0.0), (0.0, 1.0)))
    return np.asarray(0.5 * ((np.abs(right) + np.abs(down)) * size).max(axis=0))


def _cells(map_: Map, points: Floats, grid: Grid) -> NDArray[np.int64]:
    """The cell that a panel shows at points of the field, (n,); -1 where it shows none."""
    width, height = map_.size_px
    pixel = np.floor(map_.from_field(points))
    with np.errstate(invalid="ignore"):
        on = np.all((pixel >= 0.0) & (pixel < (width, height)), axis=1, keepdims=True)
    centre = map_.to_field(np.where(on, pixel, 0.0) + 0.5)
    cell = np.floor(centre * grid[::-1]).astype(np.int64)
    shown = on[:, 0] & np.all((cell >= 0) & (cell < grid[::-1]), axis=1)
    return np.where(shown, cell[:, 1] * grid[1] + cell[:, 0], -1)
