"""Lines along the borders of cells, in pictures that are drawn point by point."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy

from pdcd.arrays import Floats
from pdcd.bench.tables import PanelConfig
from pdcd.panels.map import Map
from pdcd.pictures.border_lines import measure_border_blur
from pdcd.pictures.picture import PictureWithErrors
from pdcd.sensor.cells import CellMap

GRID, CELL_PX, QUAD_PX, POINTS = (12, 16), 32, 8, 4
"""Points along a side of a pixel of the projector."""
PIECE = 64
"""Points along a side of a piece of one brightness: two quads."""


def of_quads(points: Floats) -> Floats:
    """Means over the points of a quad, (h, w)."""
    side = QUAD_PX * POINTS
    height, width = points.shape[0] // side, points.shape[1] // side
    return np.asarray(points.reshape(height, side, width, side).mean(axis=(1, 3)))


def passed(count: int, blur_px: float, offset_px: float = 0.0) -> Floats:
    """Share of the light of each point that goes through the mask of its own cell, along an axis
    of so many cells."""
    at = (np.arange(count * CELL_PX * POINTS) + 0.5) / POINTS % CELL_PX - offset_px
    if not blur_px:
        return np.asarray((at >= 0.0) & (at < CELL_PX), np.float64)
    inside = scipy.stats.norm(scale=blur_px).cdf
    return np.asarray(inside(at) - inside(at - CELL_PX))


def measured(
    blur_px: float, offset_px: float = 0.0, seams: int = 0, window: str = "whole"
) -> float:
    """Of a photo through such a bench before a scene with edges. seams : columns of borders that a
    bright edge of the scene lies along."""
    random = np.random.default_rng(4)
    rows, cols = (n * CELL_PX * POINTS for n in GRID)
    pieces = np.exp(0.7 * random.normal(size=(rows // PIECE + 1, cols // PIECE + 1)))
    direct = np.kron(pieces, np.ones((PIECE, PIECE)))[:rows, :cols]
    indirect = np.linspace(0.1, 0.2, cols) + np.zeros((rows, 1))
    for column in range(seams):
        edge = (column + 1) * CELL_PX * POINTS
        indirect[:, edge - POINTS : edge + POINTS] *= 4.0
    own = passed(GRID[0], blur_px)[:, None] * passed(GRID[1], blur_px, offset_px)
    photo, white = (of_quads(one) for one in (indirect + (1.0 - own) * direct, indirect + direct))
    photo *= 1.0 + 0.005 * random.normal(size=photo.shape)

    def picture(image: Floats) -> PictureWithErrors:
        grey = image[..., None]
        return PictureWithErrors(grey, 0.01 * grey, 0.01 * grey, 0.0 * grey, "sensor")

    def named(name: str, uniform: tuple[float, float]) -> Any:
        wanted = SimpleNamespace(uniform=uniform)
        return SimpleNamespace(name=name, wanted=wanted, shots=((1.0, name),))

    recipe: Any = SimpleNamespace(
        photos=[named("coded", (0.0, 1.0)), named("all", (1.0, 1.0))],
        pictures={"indirect": ((1.0, "coded"),), "white": ((1.0, "all"),)},
    )
    record: Any = SimpleNamespace(
        grid=GRID,
        shots=[SimpleNamespace(name="coded", window=window)],
        projector=PanelConfig(size_px=(GRID[1] * CELL_PX, GRID[0] * CELL_PX)),
    )
    frame = photo.shape
    cells = CellMap(grid=GRID, frame=(frame[0], frame[1]), map=Map.filling(frame[::-1]))
    return measure_border_blur(
        record, recipe, {"indirect": picture(photo), "white": picture(white)}, cells
    )


@pytest.mark.parametrize("blur_px", [0.2, 0.5, 1.0])
def test_a_blur_far_below_a_quad_is_told(blur_px: float) -> None:
    assert measured(blur_px) == pytest.approx(blur_px, abs=0.04)


def test_a_mask_half_a_pixel_beside_its_place_makes_such_lines_along_one_axis() -> None:
    """All light of half a pixel, at the borders along one axis of two."""
    line_px = 0.5 / (2.0 / np.sqrt(2.0 * np.pi))
    assert measured(0.0, 0.5) == pytest.approx(line_px / np.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize("seams", [0, 5])
def test_edges_of_a_scene_along_some_borders_are_none(seams: int) -> None:
    assert measured(0.0, seams=seams) == 0.0


def test_quarter_windows_have_none() -> None:
    assert measured(0.5, window="quarter") == 0.0
