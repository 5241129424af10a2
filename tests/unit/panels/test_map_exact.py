"""Maps whose points, slopes and numbers are worked out by hand."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from pdcd.panels import distortion as lenses
from pdcd.panels import map as maps
from pdcd.panels.map import Map, map_between, to_map_matrix

KEYSTONE = Map(size_px=(4, 2), homography=(1.0, 0.0, 2.0, 0.0, 3.0, 1.0, 0.5, 0.25, 1.0))
PLANE = (((1.0, 0.0), (4.0, -6.0)), ((3.0, 8.0), (6.0, 2.0)))


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


@pytest.mark.parametrize("count", [1, 6, 7, 8, 14, 15])
def test_points_are_worked_on_a_piece_at_a_time(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(maps, "PIECE", 7)
    bent = msgspec.structs.replace(Map.filling((8, 4)), radial=(0.05, 0.0))
    points = np.random.default_rng(1).uniform(0.5, 3.5, (count, 2))
    single = [bent.to_field(point) for point in points]
    np.testing.assert_allclose(bent.to_field(points), single, rtol=1e-14)
    np.testing.assert_allclose(bent.from_field(np.array(single)), points, rtol=1e-9)
    wide = Map.filling((9, 5)).centres()  # wider than a piece, and row by row all the same
    np.testing.assert_allclose(wide[:, 0], [[0.5 / 9, (row + 0.5) / 5] for row in range(5)])
    few = Map.filling((3, 5)).centres()  # two rows at a time, the last one alone
    np.testing.assert_allclose(few[:, 2], [[2.5 / 3, (row + 0.5) / 5] for row in range(5)])


@pytest.mark.parametrize(
    ("quarters", "at", "size_px"),
    [
        (0, (1.0, 0.5), (4, 2)),
        (4, (1.0, 0.5), (4, 2)),
        (1, (1.5, 1.0), (2, 4)),
        (-3, (1.5, 1.0), (2, 4)),
        (2, (3.0, 1.5), (4, 2)),
        (3, (0.5, 3.0), (2, 4)),
        (-1, (0.5, 3.0), (2, 4)),
    ],
)
def test_where_a_pixel_is_stored_in_a_turned_picture(
    quarters: int, at: tuple[float, float], size_px: tuple[int, int]
) -> None:
    lens = msgspec.structs.replace(
        KEYSTONE, radial=(0.1, 0.02), tangential=(0.003, -0.004), residual=PLANE
    )
    turned = lens.turned(quarters)
    assert turned.size_px == size_px
    np.testing.assert_allclose(turned.to_field(at), lens.to_field([1.0, 0.5]), rtol=1e-12)
    corner = lens.turned(quarters).turned(-quarters)
    np.testing.assert_allclose(corner.to_field([3.7, 0.1]), lens.to_field([3.7, 0.1]), rtol=1e-12)


def test_where_a_pixel_is_stored_in_a_mirrored_picture() -> None:
    lens = msgspec.structs.replace(
        KEYSTONE, radial=(0.1, 0.02), tangential=(0.003, -0.004), residual=PLANE
    )
    wanted = lens.to_field([1.0, 0.5])
    np.testing.assert_allclose(lens.flipped("horizontal").to_field([3.0, 0.5]), wanted, rtol=1e-12)
    np.testing.assert_allclose(lens.flipped("vertical").to_field([1.0, 1.5]), wanted, rtol=1e-12)


def test_a_lens_in_the_units_of_a_turned_device() -> None:
    """Half heights become half widths: twice as long here, or half as long."""
    lens = msgspec.structs.replace(KEYSTONE, radial=(0.1, 0.02), tangential=(0.003, -0.004))
    upside = lens.turned(2)
    assert upside.radial == (0.1, 0.02) and upside.tangential == (-0.003, 0.004)
    side = lens.turned(1)
    assert side.radial == pytest.approx((0.4, 0.32))
    assert side.tangential == pytest.approx((-0.008, -0.006))
    assert lens.flipped("horizontal").tangential == (0.003, 0.004)
    assert side.residual == ()


def test_squares_of_pixels_take_the_place_of_single_ones() -> None:
    map_ = msgspec.structs.replace(Map.filling((8, 4)), radial=(0.1, 0.0), residual=PLANE)
    coarse = map_.binned(2)
    assert coarse.size_px == (4, 2) and coarse.radial == (0.1, 0.0)
    assert coarse.residual == (((0.5, 0.0), (2.0, -3.0)), ((1.5, 4.0), (3.0, 1.0)))
    assert coarse.homography == (1 / 4, 0.0, 0.0, 0.0, 1 / 2, 0.0, 0.0, 0.0, 1.0)


def test_a_matrix_is_held_over_its_last_number() -> None:
    held = to_map_matrix([[2, 4, 6], [8, 10, 12], [14, 16, 2]])
    assert held == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 1.0)
    assert to_map_matrix([[1, 2, 3], [4, 5, 6], [7, 8, 0]]) == (1, 2, 3, 4, 5, 6, 7, 8, 0)
    huge = to_map_matrix(np.diag([1e300, 1.0, 1e-300]))  # left to a check, without a warning
    assert huge[0] == np.inf
    assert np.isnan(to_map_matrix(np.diag([np.inf, 1.0, np.inf]))[0])


def test_between_two_devices_a_point_keeps_its_place_on_the_field() -> None:
    found = map_between(Map.filling((8, 4)), Map.filling((100, 50)), [[2.0, 1.0], [8.0, 4.0]])
    np.testing.assert_allclose(found, [[25.0, 12.5], [100.0, 50.0]])


def test_what_lies_on_the_horizon_is_nowhere() -> None:
    """And no warning comes of it, nor of points that are no numbers."""
    map_ = Map(size_px=(8, 8), homography=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.1, 0.0, 1.0))
    found = map_.to_field([[10.0, 1.0], [np.inf, 1.0], [np.nan, np.nan], [4.0, 6.0]])
    assert np.isnan(found[:3]).all() and found[3].tolist() == pytest.approx([4 / 0.6, 10.0])


def test_a_device_turned_around_by_its_residual_is_not_searched() -> None:
    """Newton's method would find the point at once, but it is not one a lens shows."""
    around = (((8.0, 4.0), (-8.0, 4.0)), ((8.0, -4.0), (-8.0, -4.0)))
    map_ = msgspec.structs.replace(Map.filling((8, 4)), residual=around)
    assert map_.to_field([2.0, 1.0]).tolist() == pytest.approx([0.75, 0.75])
    assert np.isnan(map_.from_field([[0.75, 0.75], [0.5, 0.5]])).all()


def test_points_are_found_to_the_last_digits_and_lost_ones_beside_them() -> None:
    barrel = msgspec.structs.replace(Map.filling((64, 48)), radial=(-0.1, 0.0))
    points = np.array([[1.0, 1.0], [32.0, 24.0], [63.0, 5.0], [40.0, 47.0]])
    wanted = np.vstack([barrel.to_field(points), [[5.0, 5.0], [np.nan, 0.5]]])
    found = barrel.from_field(wanted[[4, 0, 1, 5, 2, 3]])
    assert np.isnan(found).all(axis=1).tolist() == [True, False, False, True, False, False]
    np.testing.assert_allclose(found[[1, 2, 4, 5]], points, rtol=0.0, atol=1e-11)


def test_a_map_is_said_by_names_and_only_by_those_it_has() -> None:
    with pytest.raises(TypeError):
        Map((4, 2), KEYSTONE.homography)  # type: ignore[call-arg]
    with pytest.raises(AttributeError):
        KEYSTONE.size_px = (2, 4)  # type: ignore[misc]
    plain = msgspec.to_builtins(KEYSTONE)
    with pytest.raises(msgspec.ValidationError, match="more"):
        msgspec.convert({**plain, "more": 1}, type=Map)
    assert msgspec.convert(plain, type=Map) == KEYSTONE and hash(KEYSTONE)


def test_numbers_of_a_map_are_floats_however_they_are_given() -> None:
    for rows in ([[1, 2, 3], [4, 5, 6], [7, 8, 0]], [[10**30, 0, 0], [0, 10**30, 0], [0, 0, 4]]):
        assert {type(number) for number in to_map_matrix(rows)} == {float}
    large = Map(size_px=(4, 2), homography=(10**30, 0, 0, 0, 2 * 10**30, 0, 0, 0, 4 * 10**30))
    np.testing.assert_allclose(large.to_field([2.0, 1.0]), [0.5, 0.5])
    np.testing.assert_allclose(large.from_field([0.5, 0.5]), [2.0, 1.0])


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
