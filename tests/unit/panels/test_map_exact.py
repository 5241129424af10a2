"""Maps whose points, slopes and numbers are worked out by hand."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from pdcd.panels import distortion as lenses
from pdcd.panels.map import Map, to_map_matrix

KEYSTONE = Map(size_px=(4, 2), homography=(1.0, 0.0, 2.0, 0.0, 3.0, 1.0, 0.5, 0.25, 1.0))


def test_a_device_fills_the_field_evenly() -> None:
    map_ = Map.filling((8, 4))
    assert map_ == Map(size_px=(8, 4), homography=(1 / 8, 0, 0, 0, 1 / 4, 0, 0, 0, 1))
    assert map_.to_field([[0, 0], [8, 4], [2, 1]]).tolist() == [[0, 0], [1, 1], [0.25, 0.25]]
    assert map_.from_field([0.25, 0.75]).tolist() == [2.0, 3.0]
    assert map_.centres()[3, 6].tolist() == [6.5 / 8, 3.5 / 4]
    assert map_.centres().shape == (4, 8, 2)


def test_a_homography_by_hand() -> None:
    # (2, 1): x + 2 = 4, 3 y + 1 = 4, over 1 + 1 + 0.25.
    np.testing.assert_allclose(KEYSTONE.to_field([2.0, 1.0]), [4 / 2.25, 4 / 2.25], rtol=1e-15)
    np.testing.assert_allclose(KEYSTONE.from_field([4 / 2.25, 4 / 2.25]), [2.0, 1.0], rtol=1e-12)
    # d(u / w) = (du - (u / w) dw) / w.
    wanted = np.array([[1.0, 0.0], [0.0, 3.0]]) - (4 / 2.25) * np.array([[0.5, 0.25], [0.5, 0.25]])
    np.testing.assert_allclose(KEYSTONE.jacobian([2.0, 1.0]), wanted / 2.25, rtol=1e-14)


def test_a_lens_is_measured_in_half_heights_about_the_centre() -> None:
    map_ = msgspec.structs.replace(Map.filling((8, 4)), radial=(0.1, 0.0), tangential=(0.0, 0.0))
    # (7, 2) is 1.5 half heights to the right: straight it is 1.5 (1 + 0.225).
    np.testing.assert_allclose(map_.to_field([7.0, 2.0]), [(4 + 2 * 1.5 * 1.225) / 8, 0.5])
    tilted = msgspec.structs.replace(map_, radial=(0.0, 0.0), tangential=(0.01, 0.0))
    np.testing.assert_allclose(tilted.to_field([6.0, 2.0]), [0.75, (2 + 2 * 0.01) / 4])
    np.testing.assert_allclose(tilted.from_field(tilted.to_field([6.0, 3.0])), [6.0, 3.0])


def test_a_residual_moves_points_before_the_homography() -> None:
    little = (((0.1, 0.0), (0.4, -0.6)), ((0.3, 0.8), (0.6, 0.2)))
    map_ = msgspec.structs.replace(KEYSTONE, residual=little)
    # In the middle of the device the mean of the nodes: (0.35, 0.1).
    np.testing.assert_allclose(map_.to_field([2.0, 1.0]), KEYSTONE.to_field([2.35, 1.1]))
    np.testing.assert_allclose(map_.centres()[0, 0], map_.to_field([0.5, 0.5]))
    np.testing.assert_allclose(map_.from_field(map_.to_field([2.0, 1.0])), [2.0, 1.0])


def test_a_homography_of_the_field_comes_after_the_map() -> None:
    turned = KEYSTONE.then([[0.0, -1.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    x, y = KEYSTONE.to_field([3.0, 1.5])
    np.testing.assert_allclose(turned.to_field([3.0, 1.5]), [1.0 - y, x], rtol=1e-14)
    assert turned.size_px == (4, 2)


def test_points_keep_the_shape_they_come_in() -> None:
    assert KEYSTONE.to_field([1, 1]).shape == (2,)
    assert KEYSTONE.to_field(np.ones((2, 3, 5, 2))).shape == (2, 3, 5, 2)
    assert KEYSTONE.from_field(np.ones((0, 2))).shape == (0, 2)
    assert KEYSTONE.jacobian([1, 1]).shape == (2, 2)
    assert KEYSTONE.jacobian(np.ones((3, 1, 2))).shape == (3, 1, 2, 2)
    for wrong in (1.0, [1.0], [[1.0, 2.0, 3.0]]):
        with pytest.raises(ValueError, match="x and y along their last axis"):
            KEYSTONE.to_field(wrong)


def test_a_matrix_is_held_over_its_last_number() -> None:
    held = to_map_matrix([[2, 4, 6], [8, 10, 12], [14, 16, 2]])
    assert held == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 1.0)
    assert to_map_matrix([[1, 2, 3], [4, 5, 6], [7, 8, 0]]) == (1, 2, 3, 4, 5, 6, 7, 8, 0)
    huge = to_map_matrix(np.diag([1e300, 1.0, 1e-300]))  # left to a check, without a warning
    assert huge[0] == np.inf
    assert np.isnan(to_map_matrix(np.diag([np.inf, 1.0, np.inf]))[0])


def test_a_device_turned_around_by_its_residual_is_not_searched() -> None:
    """Newton's method would find the point at once, but it is not one a lens shows."""
    around = (((8.0, 4.0), (-8.0, 4.0)), ((8.0, -4.0), (-8.0, -4.0)))
    map_ = msgspec.structs.replace(Map.filling((8, 4)), residual=around)
    assert map_.to_field([2.0, 1.0]).tolist() == pytest.approx([0.75, 0.75])
    assert np.isnan(map_.from_field([[0.75, 0.75], [0.5, 0.5]])).all()


@pytest.mark.parametrize("far", [1e150, 1e300])
def test_places_beyond_all_measure_have_no_point(far: float) -> None:
    """And no warning comes of looking for one."""
    barrel = msgspec.structs.replace(Map.filling((64, 48)), radial=(-0.1, 0.01))
    found = barrel.from_field([[far, 0.5], [0.5, -far], [0.5, 0.5]])
    assert np.isnan(found[:2]).all() and found[2].tolist() == pytest.approx([32.0, 24.0])


@pytest.mark.parametrize("folds", [True, False])
def test_a_point_beyond_the_fold_is_not_the_one_that_is_seen(
    folds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """r - r^3 + r^5 / 5 falls from 0.62 to 1.62 half heights, and rises again further out: there
    a root is found that looks like any other."""
    filling = Map.filling((64, 48))
    wild = msgspec.structs.replace(filling, radial=(-1.0, 0.2))
    at = filling.to_field([32.0 + 24.0 * 2.5 * 2.5625, 24.0])
    if folds:
        assert np.isnan(wild.from_field(at)).all()
        return
    monkeypatch.setattr(lenses, "find_fold_radius", lambda _: np.inf)
    np.testing.assert_allclose(wild.from_field(at), [32.0 + 24.0 * 2.5, 24.0], rtol=1e-9)
