"""What share of each scene cell each site of the projector lights.

Points lie evenly in every cell of the scene. Which pixel of the projector lights a point depends
only on where the projector is, so it is found once, and summed by site for each way of driving it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.virtual.optics.raster import MapRaster
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sights import NO_SITE, find_changes, sample_pixels
from pdcd.virtual.optics.sites import PanelSites

_POINTS_PER_PX = 2
"""Least number of points along a projector pixel at which the light on a scene cell is sampled."""
_ELONGATED = 6
"""A cell that is longer than wide by this factor has fewer points along its short side."""
_FEWEST_POINTS = 64
"""Fewest points along that short side, as a pixel may lie in two cells."""
_CHUNK_POINTS = 1 << 16


@dataclass(frozen=True, eq=False)
class LitCellPoints:
    """Points of the scene's cells, as runs (R,) of points in one cell that one pixel lights.

    pixel : int32, of the projector, counted row by row. cell : int32. share : of the cell, float64.
    cells : number of cells.
    """

    pixel: NDArray[np.int32]
    cell: NDArray[np.int32]
    share: Floats
    cells: int

    @classmethod
    def of(cls, setting: OpticalSetting, grid: tuple[int, int]) -> LitCellPoints:
        """The points of a grid (rows, cols) on a bench."""
        (rows, cols), (width, height) = grid, setting.true.projector.size_px
        across, down = _count_points((width, height), grid)
        x, y = (
            (np.arange(count * points) + 0.5) / (count * points)
            for count, points in ((cols, across), (rows, down))
        )
        raster = MapRaster(setting.on_projector, x, y)
        numbers = np.arange(width * height, dtype=np.int32).reshape(height, width)
        column = (np.arange(x.size) // across).astype(np.int32)
        step = max(1, _CHUNK_POINTS // (x.size * down))
        found = []
        for start in range(0, rows, step):
            lines = np.arange(start * down, min(start + step, rows) * down, dtype=np.int32)
            place = (v.ravel() for v in raster.rows(int(lines[0]), int(lines[-1]) + 1))
            pixel = sample_pixels(numbers, *place, missing=NO_SITE)
            cell = ((lines // down * cols)[:, None] + column).ravel()
            first = find_changes(pixel, cell)
            count = np.diff(first, append=np.int32(pixel.size))
            on = pixel[first] != NO_SITE
            found.append((pixel[first][on], cell[first][on], count[on]))
        pixel, cell, count = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return cls(pixel, cell, count / float(across * down), rows * cols)

    def by_site(self, sites: PanelSites, uneven: Floats | None) -> scipy.sparse.csr_array:
        """The share of each cell that each site lights, (sites, cells); `uneven` (height, width) is
        the light of each pixel relative to the brightest, None where all are alike."""
        site = sites.image.take(self.pixel)
        share = self.share if uneven is None else self.share * uneven.take(self.pixel)
        # Neighbours mostly light the same, so they are summed before they are sorted.
        first = find_changes(site, self.cell)
        place = (site[first], self.cell[first])
        shape = (len(sites), self.cells)
        return scipy.sparse.csr_array((np.add.reduceat(share, first), place), shape=shape)


def _count_points(size_px: tuple[int, int], grid: tuple[int, int]) -> tuple[int, int]:
    """Points of a cell across and down. Both numbers are the same, as the projector may be turned,
    except along the short side of cells that are much longer than wide."""
    (width, height), (rows, cols) = size_px, grid
    both = _POINTS_PER_PX * max(-(-width // cols), -(-height // rows))
    each = (max(_POINTS_PER_PX * -(-max(size_px) // n), _FEWEST_POINTS) for n in (cols, rows))
    across, down = (least if least * _ELONGATED <= both else both for least in each)
    return across, down
