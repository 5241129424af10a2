"""Distortion of a lens: numbers by hand, its slope, and where it folds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pdcd.panels.distortion import compute_distortion_slope, correct_distortion, find_fold_radius

RADIAL, TANGENTIAL = (0.1, 0.02), (0.003, -0.004)
POINTS = np.array([[0.5, -1.0], [-0.3, 0.7], [1.2, 0.9], [0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])


def test_a_point_by_hand() -> None:
    # r^2 = 1.25, and the factor 1 + 0.125 + 0.03125 + 2 (-0.004 0.5 - 0.003) = 1.14625.
    found = correct_distortion(POINTS[:1], RADIAL, TANGENTIAL)
    np.testing.assert_allclose(found, [[0.573125 - 0.005, -1.14625 + 0.00375]], rtol=1e-14)


def test_the_slope_is_that_of_small_steps() -> None:
    step = 1e-5
    numbers = np.stack(
        [
            correct_distortion(POINTS + d, RADIAL, TANGENTIAL)
            - correct_distortion(POINTS - d, RADIAL, TANGENTIAL)
            for d in step * np.eye(2)
        ],
        axis=-1,
    ) / (2.0 * step)
    np.testing.assert_allclose(
        compute_distortion_slope(POINTS, RADIAL, TANGENTIAL), numbers, atol=1e-9
    )


@pytest.mark.parametrize(
    ("radial", "at"),
    [
        ((0.0, 0.0), math.inf),
        ((0.1, 0.0), math.inf),
        ((0.1, 0.2), math.inf),
        ((-1.0 / 3.0, 0.2), math.inf),  # 1 - u + u^2 is nowhere zero
        ((-0.1, 0.0), math.sqrt(1.0 / 0.3)),
        ((0.0, -0.2), 1.0),
        ((-1.0, 0.2), math.sqrt(1.5 - math.sqrt(1.25))),  # the nearer of two
        ((-1.0 / 6.0, -0.1), 1.0),  # 1 - u / 2 - u^2 / 2, whose other root is negative
    ],
)
def test_a_lens_folds_where_its_straight_distance_stops_growing(
    radial: tuple[float, float], at: float
) -> None:
    assert find_fold_radius(radial) == pytest.approx(at, rel=1e-12)
    if math.isfinite(at):
        ways = np.array([[at * share, 0.0] for share in (0.999, 1.0, 1.001)])
        near, top, far = correct_distortion(ways, radial, (0.0, 0.0))[:, 0]
        assert near < top > far
