"""Distortion: a lens and its smooth rest, their slopes, folds and edges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pdcd.panels.distortion import (
    MapResidual,
    ResidualNodes,
    correct_distortion,
    find_fold_radius,
    make_residual,
)

RADIAL, TANGENTIAL = (0.1, 0.02), (0.003, -0.004)


def test_a_point_by_hand() -> None:
    # r^2 = 1.25, and the factor 1 + 0.125 + 0.03125 + 2 (-0.004 0.5 - 0.003) = 1.14625.
    found = correct_distortion(np.array([[0.5, -1.0]]), RADIAL, TANGENTIAL)
    np.testing.assert_allclose(found, [[0.573125 - 0.005, -1.14625 + 0.00375]], rtol=1e-14)


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


SIZE = (60, 40)
PLANE: ResidualNodes = (((1.0, 0.0), (4.0, -6.0)), ((3.0, 8.0), (6.0, 2.0)))
"""Right: 1 + 3 x / 60 + 2 y / 40. Down: 8 y / 40 - 6 x / 60."""
RNG = np.random.default_rng(11)
WAVY = RNG.normal(size=(5, 7, 2))


def test_it_has_a_slope_up_to_the_edges_and_none_beyond() -> None:
    plane = make_residual(PLANE, SIZE)
    across, down = [3.0 / 60.0, -6.0 / 60.0], [2.0 / 40.0, 8.0 / 40.0]
    none = [0.0, 0.0]
    for point, right, below in (
        ([20.0, 30.0], across, down), ([0.0, 0.0], across, down), ([60.0, 40.0], across, down),
        ([-1.0, 20.0], none, down), ([61.0, 20.0], none, down), ([20.0, -1.0], across, none),
        ([20.0, 41.0], across, none), ([-1.0, 41.0], none, none),
    ):  # fmt: skip
        at, slope = plane.slope(np.array([point]))
        np.testing.assert_allclose(slope[0], np.transpose([right, below]), atol=1e-14)
        np.testing.assert_allclose(at, plane.at(np.array([point])), atol=1e-14)


def test_what_is_no_number_moves_to_nowhere() -> None:
    wavy = MapResidual(WAVY, SIZE)
    found = wavy.at(np.array([[np.nan, 3.0], [3.0, np.nan], [3.0, 3.0]]))
    assert np.isnan(found).all(axis=1).tolist() == [True, True, False]
