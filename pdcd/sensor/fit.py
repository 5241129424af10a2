"""Does a camera's frame fit the field: is enough of it seen, and finely enough?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_soundness import find_points_on_device, list_cell_centres, measure_cell_sides

_LEAST_SEEN = 0.5
"""Least share of the cells that the camera must see; cells outside are not in its photos."""
_WINDOW_QUADS = 2.0
"""Least quads along a cell's side that resolve its two quarter windows along that side."""
_CLOSE = 1e-6
"""Edges no further apart than this, in cells, count as the same."""


@dataclass(frozen=True)
class FrameFit:
    """How a camera sees the grid of cells.

    frame : rows and columns of quads.
    seen : share of the cells whose centre lies in the frame.
    across : fewest and most quads along a side of the cells that are seen; 0 where none is.
    aligned : whether the edges of the quads lie on the edges of cells, so that each quad sees parts
        of one cell only.
    """

    frame: tuple[int, int]
    seen: float
    across: tuple[float, float]
    aligned: bool


def measure_frame_fit(map_: Map, grid: tuple[int, int]) -> FrameFit:
    """How the camera of this map sees a grid of cells (rows, columns)."""
    width, height = map_.size_px
    points = map_.from_field(list_cell_centres(grid))
    inside = find_points_on_device(map_, points)
    return FrameFit(
        frame=(height, width),
        seen=float(inside.mean()),
        across=measure_cell_sides(map_, points[inside], grid),
        aligned=_aligned(map_, grid),
    )


def check_frame_fit(fit: FrameFit, window: str) -> None:
    """Raise ConfigError for a frame that cannot resolve the cells; the error says what to change.

    window : "quarter" or "whole", that of the codes.
    """
    frame = f"the camera's frame of {fit.frame[1]} x {fit.frame[0]} pixels"
    if fit.seen == 0.0:
        raise _unfit(f"{frame} does not see the field", "mend [camera.place], or point the camera")
    if fit.seen < _LEAST_SEEN:
        raise _unfit(
            f"{frame} sees {100.0 * fit.seen:.3g} % of the cells, less than "
            f"{100.0 * _LEAST_SEEN:g} %",
            "mend [camera.place] (a larger scale sees more), or move the camera back",
        )
    fewest = fit.across[0]
    needed = _WINDOW_QUADS if window == "quarter" else 1.0
    if fewest >= (1.0 if fit.aligned else needed) - _CLOSE:
        return
    what = "its quarter windows" if window == "quarter" and fewest >= 1.0 else "single cells"
    raise _unfit(
        f"{frame} has {fewest:.3g} pixels along a cell's side, {needed:g} are needed: it does not "
        f"resolve {what}",
        "take fewer cells (scene.grid), full-size RAW, or move the camera nearer",
    )


def _aligned(map_: Map, grid: tuple[int, int]) -> bool:
    """Whether the edges of cells lie on edges of quads, with a whole number of quads in a cell."""
    width, height = map_.size_px
    size = np.array([width, height], dtype=np.float64)
    corners = map_.to_field(size * [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    cells = corners * np.array(grid[::-1], dtype=np.float64)
    if not np.isfinite(cells).all() or np.abs(cells - cells.round()).max() > _CLOSE:
        return False
    steps = map_.jacobian(size * np.array([[0.1, 0.1], [0.5, 0.5], [0.9, 0.9]]))
    steps = np.abs(steps * np.array([[grid[1]], [grid[0]]]))
    across = 1.0 / steps.max(axis=-2)
    # Steps equal everywhere, along the axes, and whole: the map is neither turned nor bent.
    straight = np.allclose(steps, steps[0], atol=_CLOSE) and steps.min(axis=-2).max() < _CLOSE
    return bool(straight and np.abs(across - across.round()).max() < 1e-3)


def _unfit(what: str, hint: str) -> ConfigError:
    return ConfigError(what, device="camera", hint=hint)
