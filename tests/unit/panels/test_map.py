"""Maps: there and back, slopes, grids, and points that no device has."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RectBivariateSpline

from pdcd.errors import ConfigError
from pdcd.panels.distortion import make_residual
from pdcd.panels.map import PIECE, Map, map_between, to_map_matrix
from pdcd.panels.map_soundness import check_map

few = settings(max_examples=12)


def bent(seed: int, size_px: tuple[int, int] = (64, 48)) -> Map:
    """Some sound map: keystone, turn, perhaps mirrored, a lens, a residual."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    full = np.eye(3)
    full[:2, :2] = turn @ np.diag(rng.uniform(0.7, 1.3, 2) * rng.choice([-1.0, 1.0], 2))
    full[:2, 2] = rng.uniform(-0.2, 0.2, 2)
    full[2, :2] = rng.uniform(-0.3, 0.3, 2)
    to_middle = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    shape = (*rng.integers(2, 9, 2), 2)
    nodes = rng.uniform(-0.004, 0.004, shape) * size_px[1]
    map_ = Map.filling(size_px).then(np.linalg.inv(to_middle) @ full @ to_middle)
    map_ = msgspec.structs.replace(
        map_,
        radial=tuple(rng.uniform(-0.02, 0.04, 2).tolist()),
        tangential=tuple(rng.uniform(-0.004, 0.004, 2).tolist()),
        residual=tuple(tuple((r, d) for r, d in row) for row in nodes.tolist()),
    )
    return check_map(map_, "device")


def some_points(map_: Map, seed: int = 0, count: int = 60) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2)) * map_.size_px


@few
@given(seed=st.integers(0, 10**6))
def test_a_sound_map_leads_back(seed: int) -> None:
    map_ = bent(seed)
    points = some_points(map_, seed)
    back = map_.from_field(map_.to_field(points))
    np.testing.assert_allclose(back, points, rtol=0.0, atol=1e-9)


@few
@given(seed=st.integers(0, 10**6))
def test_the_jacobian_is_the_slope(seed: int) -> None:
    map_ = bent(seed)
    # Not across a node, where the third derivative jumps and numbers say less.
    points = some_points(map_, seed)
    step = 1e-3
    numbers = np.stack(
        [
            (
                8.0 * (map_.to_field(points + d) - map_.to_field(points - d))
                - (map_.to_field(points + 2 * d) - map_.to_field(points - 2 * d))
            )
            / (12.0 * step)
            for d in step * np.eye(2)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(map_.jacobian(points), numbers, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_the_grid_of_centres_is_that_of_single_points(seed: int) -> None:
    map_ = bent(seed, size_px=(90, 61))  # several pieces, the last one short
    x, y = np.meshgrid(np.arange(90) + 0.5, np.arange(61) + 0.5)
    assert PIECE < x.size
    points = np.stack([x, y], axis=-1)
    one_by_one = np.array([map_.to_field(point) for point in points[::7, ::7].reshape(-1, 2)])
    np.testing.assert_allclose(map_.centres(), map_.to_field(points), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(
        map_.centres()[::7, ::7].reshape(-1, 2), one_by_one, rtol=0.0, atol=1e-14
    )


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (8, 10)])
def test_the_residual_is_the_cubic_spline_of_its_nodes(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    nodes = rng.normal(size=(*shape, 2))
    residual = make_residual(
        tuple(tuple((r, d) for r, d in row) for row in nodes.tolist()), (60, 40)
    )
    points = rng.uniform(0.0, 1.0, (200, 2)) * (60, 40)
    down, right = np.linspace(0, 40, shape[0]), np.linspace(0, 60, shape[1])
    order = {"kx": min(3, shape[0] - 1), "ky": min(3, shape[1] - 1)}
    for axis in (0, 1):
        spline = RectBivariateSpline(down, right, nodes[..., axis], **order)
        wanted = spline.ev(points[:, 1], points[:, 0])
        np.testing.assert_allclose(residual.at(points)[:, axis], wanted, rtol=0.0, atol=1e-11)
    beyond = np.array([[-5.0, 10.0], [70.0, 45.0]])
    np.testing.assert_array_equal(
        residual.at(beyond), residual.at(np.clip(beyond, 0.0, (60.0, 40.0)))
    )


@few
@given(seed=st.integers(0, 10**6))
def test_points_beyond_the_edges_lead_back(seed: int) -> None:
    """To themselves, or where a map folds out there to another that lies on the same place."""
    map_ = bent(seed)
    points = (some_points(map_, seed) - 0.5 * np.array(map_.size_px)) * 1.2
    points += 0.5 * np.array(map_.size_px)
    field = map_.to_field(points)
    np.testing.assert_allclose(map_.to_field(map_.from_field(field)), field, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_behind_the_horizon_is_nowhere(sign: float) -> None:
    # The horizon is where x = 10. The device, 8 wide, lies on one side of it, pixel 0 far away.
    full = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.1 * sign, 0.0, 1.0 * sign]]
    map_ = Map(size_px=(8, 8), homography=to_map_matrix(full))
    there = map_.to_field([[4.0, 4.0], [9.9, 4.0], [10.1, 4.0], [20.0, 4.0], [np.nan, 1.0]])
    assert np.isfinite(there).all(axis=-1).tolist() == [True, True, False, False, False]
    jacobian = map_.jacobian([[4.0, 4.0], [10.1, 4.0]])
    assert np.isfinite(jacobian).all(axis=(1, 2)).tolist() == [True, False]
    # To the place where pixels behind would come from, x / (1 - x / 10) = -15, none in front goes.
    field = map_.to_field([[4.0, 4.0]])
    np.testing.assert_allclose(map_.from_field(field), [[4.0, 4.0]])
    behind = np.array([[-30.0, -4.0]])
    assert np.isnan(map_.from_field(behind * sign)).all()


def test_the_horizon_may_cross_the_first_corner() -> None:
    """Which side is ahead is the centre's to say, not that of the pixel (0, 0)."""
    full = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, -1.0]]
    map_ = Map(size_px=(8, 8), homography=to_map_matrix(full))
    assert np.isfinite(map_.to_field([[4.0, 4.0], [7.0, 0.0]])).all()
    assert np.isnan(map_.to_field([[1.0, 4.0]])).all()
    with pytest.raises(ConfigError, match="beyond infinity"):
        check_map(map_, "mask")


def test_beyond_the_fold_of_a_lens_no_point_is_found() -> None:
    filling = Map.filling((64, 48))
    barrel = check_map(msgspec.structs.replace(filling, radial=(-0.1, 0.0)), "camera")
    # Straight distances grow up to r = sqrt(1 / 0.3) half heights, to 1.217 of them.
    half = 0.5 * 48
    for way, found in ((1.2, True), (1.23, False), (3.0, False), (40.0, False)):
        at = filling.to_field([32.0 + way * half, 24.0])
        assert np.isfinite(barrel.from_field(at)).all() == found, way


@few
@given(seeds=st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)))
def test_points_go_from_device_to_device_over_the_field(seeds: tuple[int, int]) -> None:
    one, two = bent(seeds[0]), bent(seeds[1], size_px=(90, 80))
    points = two.from_field(np.random.default_rng(seeds[0]).uniform(0.3, 0.7, (20, 2)))
    there = map_between(two, one, points)
    known = np.isfinite(there).all(axis=-1)
    np.testing.assert_allclose(
        one.to_field(there[known]), two.to_field(points[known]), rtol=0.0, atol=1e-11
    )
    assert known.any()


@few
@given(seed=st.integers(0, 10**6), side=st.sampled_from([1, 2, 3, 4]))
def test_squares_of_pixels_lie_where_their_pixels_lie(seed: int, side: int) -> None:
    map_ = bent(seed, size_px=(48, 36))
    points = some_points(map_, seed)
    coarse = map_.binned(side)
    assert coarse.size_px == (48 // side, 36 // side)
    np.testing.assert_allclose(coarse.to_field(points / side), map_.to_field(points), atol=1e-12)


KEYSTONE = Map(size_px=(4, 2), homography=(1.0, 0.0, 2.0, 0.0, 3.0, 1.0, 0.5, 0.25, 1.0))


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


def test_a_point_beyond_the_fold_is_not_the_one_that_is_seen() -> None:
    """r - r^3 + r^5 / 5 falls from 0.62 to 1.62 half heights, and rises again further out: there
    a root is found that looks like any other."""
    filling = Map.filling((64, 48))
    wild = msgspec.structs.replace(filling, radial=(-1.0, 0.2))
    at = filling.to_field([32.0 + 24.0 * 2.5 * 2.5625, 24.0])
    np.testing.assert_allclose(wild.to_field([32.0 + 24.0 * 2.5, 24.0]), at, rtol=1e-12)
    assert np.isnan(wild.from_field(at)).all()
