"""Shift, turn and size of points, against points that were moved by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.check.moved import MapDrift
from pdcd.calibration.check.moved import fit_map_drift as fitted
from pdcd.panels.map import Map

Floats = NDArray[np.float64]

SIZE = (130, 100)
Y, X = np.mgrid[:9, :13]
POINTS = np.stack([X.ravel() * 10.0 + 5.0, Y.ravel() * 10.0 + 10.0], axis=-1)
COUNT = len(POINTS)
EVEN = np.full(COUNT, 0.1)


def moved(
    points: Floats, shift: tuple[float, float], turn: float = 0.0, growth: float = 0.0
) -> Floats:
    """Turned clockwise by `turn` and grown about the middle, then shifted."""
    centre = 0.5 * np.array(SIZE)
    x, y = (points - centre).T
    scale = 1.0 + growth
    return np.asarray(
        centre + shift + np.stack([scale * x - turn * y, turn * x + scale * y], axis=-1)
    )


@pytest.mark.parametrize(
    ("shift", "turn", "growth"),
    [((0.0, 0.0), 0.0, 0.0), ((1.5, -0.7), 0.0, 0.0), ((0.3, 0.2), 0.01, -0.02)],
)
def test_points_that_all_moved_alike_tell_how(
    shift: tuple[float, float], turn: float, growth: float
) -> None:
    now = moved(POINTS, shift, turn, growth)
    found = fitted(SIZE, POINTS, now, EVEN)
    np.testing.assert_allclose(found.numbers, (*shift, growth, turn), atol=1e-9)
    assert found.unlike_px == pytest.approx(0.0, abs=1e-8)
    np.testing.assert_allclose(found(POINTS), now, atol=1e-8)
    # A map that is followed by it leads to where the points are.
    by_map = Map.filling(SIZE).then(found.of_field).to_field(POINTS) * SIZE
    np.testing.assert_allclose(by_map, now, atol=1e-8)


def test_a_few_points_that_moved_by_themselves_change_nothing() -> None:
    now = moved(POINTS, (0.4, 0.1), 0.005)
    now[[3, 50, 99]] += (25.0, -14.0)
    found = fitted(SIZE, POINTS, now, EVEN)
    np.testing.assert_allclose(found.numbers[:2], (0.4, 0.1), atol=0.002)
    np.testing.assert_allclose(found.numbers[2:], (0.0, 0.005), atol=1e-4)
    assert found.unlike_px < 0.01  # nor do they count as what is left of a part


@pytest.mark.parametrize("scatter", [0.1, 0.5])
def test_its_errors_are_those_of_many_looks(scatter: float) -> None:
    """Told by the points' own scatter where that is more than their sigma says."""
    rng = np.random.default_rng(4)
    found = [
        fitted(SIZE, POINTS, POINTS + scatter * rng.standard_normal(POINTS.shape), EVEN)
        for _ in range(120)
    ]
    real = np.array([one.numbers for one in found]).std(axis=0)
    ratio = np.mean([one.sigma for one in found], axis=0) / real
    assert (ratio > 0.9).all()
    assert (ratio < 1.4).all()


def test_what_no_similarity_explains_is_the_worst_part_of_the_picture() -> None:
    """A part of three rows by four columns that slid by (0.6, 0.8), away from all others."""
    now = POINTS.copy()
    inside = (POINTS[:, 0] > 97.5) & (POINTS[:, 1] > 66.6)
    now[inside] += (0.6, 0.8)
    then = fitted(SIZE, POINTS, POINTS, EVEN)
    found = fitted(SIZE, POINTS, now, EVEN)
    assert found.unlike_px == pytest.approx(1.0, abs=0.1)
    assert found.since(then).unlike_px == pytest.approx(1.0, abs=0.1)
    assert found.since(found).unlike_px == 0.0
    few = POINTS.copy()
    few[np.flatnonzero(inside)[:3]] += (0.6, 0.8)
    assert fitted(SIZE, POINTS, few, EVEN).unlike_px < 0.1  # three of twelve are no majority


def test_it_is_the_same_once_it_was_kept() -> None:
    found = fitted(SIZE, POINTS, moved(POINTS, (0.4, 0.1), 0.005), EVEN)
    again = MapDrift.kept(SIZE, found.array)
    np.testing.assert_array_equal(again.array, found.array)
    assert again.since(found).worst_px[0] == 0.0


def test_sure_points_count_for_more() -> None:
    """Half of the points with a tenth of the others' error, which are 1 px off."""
    sigma = np.where(np.arange(COUNT) % 2, 0.1, 1.0)
    now = POINTS + np.where(np.arange(COUNT) % 2, 0.0, 1.0)[:, None] * (1.0, 0.0)
    found = fitted(SIZE, POINTS, now, sigma)
    assert np.hypot(*found.numbers[:2]) < 0.02


def test_the_corner_that_moved_most_is_told_with_its_error() -> None:
    """A shift right and down and a turn about the middle: the corner above moves to the right."""
    numbers, sigma = np.array([3.0, 4.0, 0.0, 0.1]), np.array([0.3, 0.3, 0.05, 0.05])
    found = MapDrift((20, 16), numbers, sigma, np.zeros((3, 4, 2)), 9)
    steps = [np.hypot(3.0 - 0.1 * y, 4.0 + 0.1 * x) for x in (-10, 10) for y in (-8, 8)]
    far, error = found.worst_px
    assert far == pytest.approx(max(steps)) == pytest.approx(np.hypot(3.8, 5.0))
    assert error == pytest.approx(np.hypot(0.3, 0.05 * np.hypot(10.0, 8.0)))
