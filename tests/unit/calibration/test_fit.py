"""Fitting a map to points: right, robust, and honest about its error."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.geometry.fit import FittedMap, PointPairs, fit_map, mad_px
from pdcd.errors import CalibrationError
from tests.unit.calibration.geometry_bench import Way

Floats = NDArray[np.float64]

FRAME = (1424, 2136)
SIZE = (1024, 768)
WAY = Way(SIZE, FRAME, turn_deg=2.0, keystone=(0.04, -0.02))


def points(count: int, seed: int, way: Way = WAY) -> tuple[Floats, Floats]:
    """Places of the photo that see the panel, and which of its pixels."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(0.0, 1.0, (4 * count, 2)) * (FRAME[1], FRAME[0])
    target = way.to_panel(source)
    inside = ((target > 0.0) & (target < SIZE)).all(axis=-1)
    return source[inside][:count], target[inside][:count]


def fitted(source: Floats, target: Floats, sigma_px: float) -> FittedMap:
    sigma = np.full(target.shape, sigma_px)
    return fit_map(PointPairs(source, target, sigma), (FRAME[1], FRAME[0]), SIZE, "projector")


@pytest.mark.parametrize(
    "way", [WAY, Way(SIZE, FRAME, turn_deg=180.0), Way(SIZE, FRAME, turn_deg=88.0, mirrored=True)]
)
def test_a_bent_way_is_found_to_hundredths_of_a_pixel(way: Way) -> None:
    found = fitted(*points(800, 1, way), 0.02)
    source, target = points(2000, 2, way)
    error = np.hypot(*(found.to_target(source) - target).T)
    assert np.percentile(error, 95.0) < 0.01
    assert found.inlier.mean() > 0.95


def test_the_map_is_what_the_numbers_say() -> None:
    source, target = points(600, 1)
    found = fitted(source, target, 0.02)
    left = target - found.to_target(source)
    np.testing.assert_allclose(found.residual_px, left, rtol=0.0, atol=1e-9)
    step = 1e-3
    moved = (found.to_target(source + np.array([step, 0.0])) - found.to_target(source)) / step
    np.testing.assert_allclose(found.slope(source)[:, :, 0], moved, atol=1e-5)


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_outliers_do_not_matter(share: float) -> None:
    rng = np.random.default_rng(5)
    source, target = points(800, 1)
    seen = target + rng.normal(0.0, 0.02, target.shape)
    wrong = rng.random(len(seen)) < share
    seen[wrong] += rng.uniform(-60.0, 60.0, (int(wrong.sum()), 2))
    found = fitted(source, seen, 0.02)
    there, wanted = points(1000, 2)
    assert np.percentile(np.hypot(*(found.to_target(there) - wanted).T), 95.0) < 0.03
    assert found.inlier[wrong].mean() < 0.05
    assert found.inlier[~wrong].mean() > 0.97


def test_errors_are_what_sigma_says() -> None:
    there, wanted = points(300, 99)
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        source, target = points(500, seed)
        # The stated error of a point may be wrong; its scatter corrects that.
        found = fitted(source, target + rng.normal(0.0, 0.2, target.shape), 0.1)
        ratios.append((found.to_target(there) - wanted) / found.sigma_px(there))
    assert 0.8 < np.concatenate(ratios).std() < 1.2


def test_errors_that_neighbours_share_do_not_average_out() -> None:
    source, target = points(4000, 1)
    rng = np.random.default_rng(1)
    shared = np.kron(rng.normal(0.0, 0.05, (24, 36, 2)), np.ones((60, 60, 1)))
    at = source.astype(np.int64)
    alike = fitted(source, target + shared[at[:, 1], at[:, 0]], 0.05)
    alone = fitted(source, target + rng.normal(0.0, 0.05, target.shape), 0.05)
    assert mad_px(alike.residual_px) < 1.2 * mad_px(alone.residual_px)
    there = points(100, 99)[0]
    assert np.median(alike.sigma_px(there) / alone.sigma_px(there)) > 1.3


def test_a_lens_is_not_made_up_where_there_are_no_points() -> None:
    way = Way(SIZE, FRAME, scale=0.6, radial=0.0, waves_px=0.0)
    rng = np.random.default_rng(0)
    source, target = points(300, 1, way)
    found = fitted(source, target + rng.normal(0.0, 0.05, target.shape), 0.05)
    corners = np.array([[0.0, 0.0], [FRAME[1], FRAME[0]]])
    assert np.abs(found.to_target(corners) - way.to_panel(corners)).max() < 60.0


def test_points_of_no_plane_are_refused() -> None:
    rng = np.random.default_rng(0)
    source = rng.uniform(0.0, 1.0, (300, 2)) * (FRAME[1], FRAME[0])
    with pytest.raises(CalibrationError, match="no flat picture"):
        fitted(source, rng.uniform(0.0, 1.0, (300, 2)) * SIZE, 0.02)
    line = np.column_stack([np.arange(300.0), np.arange(300.0)])
    with pytest.raises(CalibrationError):
        fitted(line, line, 0.02)
