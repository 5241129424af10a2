"""Shift, turn and size between two looks, against points that were moved by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.check.similarity import Similarity, similarity

Floats = NDArray[np.float64]

Y, X = np.mgrid[:9, :13]
POINTS = np.stack([X.ravel() * 10.0 + 5.0, Y.ravel() * 10.0 + 20.0], axis=-1)
COUNT = len(POINTS)
EVEN = np.full(COUNT, 0.1)


def moved(
    points: Floats, shift: tuple[float, float], turn: float = 0.0, growth: float = 0.0
) -> Floats:
    """Turned clockwise by `turn` and grown about the mean of all points, then shifted."""
    centre = POINTS.mean(axis=0)
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
    found = similarity(POINTS, now, EVEN)
    assert found.centre == pytest.approx(complex(*POINTS.mean(axis=0)))
    assert found.shift == pytest.approx(complex(*shift), abs=1e-9)
    assert found.growth == pytest.approx(complex(growth, turn), abs=1e-11)
    assert found.left == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found(POINTS), now, atol=1e-9)
    np.testing.assert_allclose(found.back(now), POINTS, atol=1e-9)


def test_a_few_points_that_moved_by_themselves_change_nothing() -> None:
    now = moved(POINTS, (0.4, 0.1), 0.005)
    now[[3, 50, 99]] += (25.0, -14.0)
    found = similarity(POINTS, now, EVEN)
    assert found.shift == pytest.approx(complex(0.4, 0.1), abs=0.002)
    assert found.growth == pytest.approx(0.005j, abs=1e-4)
    assert found.left < 0.01  # nor do they count as what is left of a part


def test_sure_points_count_for_more() -> None:
    """Half of the points with a tenth of the others' error, which are 1 px off."""
    sigma = np.where(np.arange(COUNT) % 2, 0.1, 1.0)
    now = POINTS + np.where(np.arange(COUNT) % 2, 0.0, 1.0)[:, None] * (1.0, 0.0)
    found = similarity(POINTS, now, sigma)
    assert abs(found.shift) < 0.02


@pytest.mark.parametrize("scatter", [0.1, 0.5])
def test_its_errors_are_no_less_than_those_of_many_looks(scatter: float) -> None:
    """Told by the points' own scatter where that is more than their sigma says."""
    rng = np.random.default_rng(4)
    found = [
        similarity(POINTS, POINTS + scatter * rng.standard_normal(POINTS.shape), EVEN)
        for _ in range(200)
    ]
    for values, told in (
        ([one.shift for one in found], found[0].sigma[0]),
        ([one.growth for one in found], found[0].sigma[1]),
    ):
        either = np.concatenate([np.real(values), np.imag(values)])
        assert 1.0 < told / float(either.std()) < 1.5


def test_the_corner_that_moved_most_is_told_with_its_error() -> None:
    """A shift right and a turn about the middle: the corner below is moved to the left."""
    found = Similarity(0j, complex(3.0, 4.0), 0.1j, (0.3, 0.05), 0.0)
    corners = np.array([[-10.0, -8.0], [10.0, -8.0], [10.0, 8.0], [-10.0, 8.0]])
    steps = [np.hypot(3.0 - 0.1 * y, 4.0 + 0.1 * x) for x, y in corners]
    worst = int(np.argmax(steps))
    far, sigma = found.worst(corners)
    assert far == pytest.approx(steps[worst]) == pytest.approx(np.hypot(3.8, 5.0))
    assert sigma == pytest.approx(np.hypot(0.3, 0.05 * np.hypot(10.0, 8.0)))


def test_what_no_similarity_explains_is_the_worst_part_of_the_field() -> None:
    """A part of three rows by four columns that slid by (0.6, 0.8), away from all others."""
    now = POINTS.copy()
    inside = (POINTS[:, 0] > 95.0) & (POINTS[:, 1] > 74.0)
    now[inside] += (0.6, 0.8)
    found = similarity(POINTS, now, EVEN)
    assert found.left == pytest.approx(1.0, abs=0.1)
    corner = (POINTS[:, 0] < 10.0) & (POINTS[:, 1] < 50.0)
    few = POINTS.copy()
    few[np.flatnonzero(corner)[:3]] += (0.6, 0.8)
    assert similarity(POINTS, few, EVEN).left < 0.1  # three of nine are no majority
    # Four points make a part: of three that all moved nobody can tell.
    for count, left in ((3, 0.0), (4, 1.0)):
        lone = np.arange(count)[:, None] * (0.5, 0.0) + (400.0, 300.0)
        then = np.concatenate([POINTS, lone])
        after = then.copy()
        after[COUNT:] += (0.6, 0.8)
        told = similarity(then, after, np.full(COUNT + count, 0.1)).left
        assert told == pytest.approx(left, abs=0.3)
