"""Smooth maps by polynomials: which they follow exactly, and which are computed point by point."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.virtual.optics import raster as rasters
from pdcd.virtual.optics.raster import MapRaster

Floats = NDArray[np.float64]
X, Y = np.linspace(0.5, 99.5, 300), np.linspace(3.0, 40.0, 200)


def curved(points: Floats) -> Floats:
    """Of the seventh degree along both axes, and not the same across and down."""
    x, y = points[..., 0] / 100.0, points[..., 1] / 40.0
    across = 1.0 + 2.0 * x - 3.0 * x**7 + x**3 * y**4
    return np.stack([across, 5.0 * y**7 - x * y + x**2], axis=-1)


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rasters of more points than these are large."""
    monkeypatch.setattr(rasters, "EXACT_POINTS", 300 * 199)


def wanted(start: int, stop: int) -> Floats:
    return curved(np.stack(np.meshgrid(X, Y[start:stop]), axis=-1))


@pytest.mark.parametrize("rows", [(0, 1), (0, 200), (199, 200), (97, 103)])
def test_polynomials_follow_one_of_their_degree_everywhere(rows: tuple[int, int]) -> None:
    across, down = MapRaster(curved, X, Y).rows(*rows)
    assert across.shape == down.shape == (rows[1] - rows[0], 300)
    np.testing.assert_allclose(np.stack([across, down], axis=-1), wanted(*rows), rtol=1e-10)


def wave(length: float) -> rasters.PointMap:
    """Across and down by a wave so long."""
    return lambda points: np.sin(2.0 * np.pi * points / length)


def test_short_waves_are_followed_by_more_nodes_or_computed_point_by_point() -> None:
    raster = MapRaster(wave(14.0), X, Y)
    assert not raster.exact
    points = np.stack(np.meshgrid(X, Y[50:53]), axis=-1)
    assert np.abs(np.stack(raster.rows(50, 53), axis=-1) - wave(14.0)(points)).max() < 2e-5
    assert MapRaster(wave(5.0), X, Y).exact


@pytest.mark.parametrize("axis", [0, 1])
def test_a_map_that_ends_somewhere_is_computed_point_by_point(axis: int) -> None:
    def place(points: Floats) -> Floats:
        found = curved(points)
        found[points[..., axis] > 30.0] = np.nan
        return found

    raster = MapRaster(place, X, Y)
    assert raster.exact
    across, down = raster.rows(100, 120)
    np.testing.assert_array_equal(
        np.stack([across, down], axis=-1), place(np.stack(np.meshgrid(X, Y[100:120]), axis=-1))
    )


@pytest.mark.parametrize("rows", [199, 200])
def test_points_beside_a_raster_go_where_the_map_has_them(rows: int) -> None:
    """Exactly where the map is asked; else to the second order of half a step."""
    rng = np.random.default_rng(1)
    right, below = rng.uniform(-0.5, 0.5, (2, 40, 300))
    raster = MapRaster(curved, X, Y[:rows])
    found = np.stack(raster.rows(100, 140, (right, below)), axis=-1)
    points = np.stack(np.meshgrid(X, Y[100:140]), axis=-1)
    points += np.stack([right * (X[1] - X[0]), below * (Y[1] - Y[0])], axis=-1)
    close = 1e-12 if raster.exact else 1e-3
    np.testing.assert_allclose(found, curved(points), atol=close)
    plain = np.stack(raster.rows(100, 140), axis=-1)
    assert np.abs(found - plain).max() > 0.005
