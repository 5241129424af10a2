"""Shares of pieces in quads: areas by hand, by clipping polygons, and one form against another."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.special

from pdcd.panels.map import Map
from pdcd.sensor.footprint import Cuts, Footprint, compute_footprint

UNCUT: Cuts = ((0.0, 1.0), (0.0, 1.0))
QUARTERS: Cuts = ((0.0, 0.25, 1.0), (0.0, 0.5, 0.75, 1.0))
RNG = np.random.default_rng(9)


def shares(seen: Footprint, pieces: tuple[int, int]) -> np.ndarray:
    """(h, w, R, C), the share of each piece in each quad."""
    found = np.zeros((*seen.known.shape, *pieces))
    for at in np.ndindex(*pieces):
        one = np.zeros(pieces)
        one[at] = 1.0
        found[..., *at] = seen.gather(one)
    return found


def turned_by(degrees: float, scale: float, shift: tuple[float, float], size: int) -> Map:
    """A frame of size x size quads, turned about its middle, which lies in that of the field."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    middle = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    turn = scale * np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0 / scale]])
    turn[:2, 2] = shift
    return Map.filling((size, size)).then(np.linalg.inv(middle) @ turn @ middle)


def part_left_of(corners: np.ndarray, x: float) -> float:
    """Share of a polygon's area on the left of a line, by clipping it."""
    kept = []
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if ax <= x:
            kept.append((ax, ay))
        if (ax <= x) != (bx <= x):
            kept.append((x, ay + (x - ax) / (bx - ax) * (by - ay)))
    return area(np.array(kept)) / area(corners) if len(kept) > 2 else 0.0


def area(corners: np.ndarray) -> float:
    x, y = corners.T
    return abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))) / 2.0


def test_an_upright_frame_by_hand() -> None:
    # Three quads over two cells across, one over one down.
    seen = compute_footprint(Map.filling((3, 1)), (1, 3), (1, 2), UNCUT, 0.0)
    np.testing.assert_allclose(shares(seen, (1, 2))[0, :, 0], [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    assert seen.inside is None and seen.known.all()
    np.testing.assert_allclose(seen.area, [[1.5, 1.5]])
    np.testing.assert_allclose(seen.gather(np.array([[2.0, 6.0]])), [[2.0, 4.0, 6.0]])
    image = np.array([[1.0, 2.0, 4.0]])
    np.testing.assert_allclose(seen.collect(image), [[2.0, 5.0]])
    np.testing.assert_allclose(seen.collect(image, squares=True), [[1.5, 4.5]])


def test_cells_cut_into_pieces_by_hand() -> None:
    # Four quads a cell across, cut at its half and three quarters; two a cell down, at a quarter.
    seen = compute_footprint(Map.filling((4, 2)), (2, 4), (1, 1), QUARTERS, 0.0)
    found = shares(seen, (2, 3))
    np.testing.assert_allclose(found[0, :, 0], [[0.5, 0, 0]] * 2 + [[0, 0.5, 0], [0, 0, 0.5]])
    np.testing.assert_allclose(found[1, :, 1], [[1, 0, 0]] * 2 + [[0, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(seen.area, [[1.0, 0.5, 0.5], [3.0, 1.5, 1.5]])


def test_what_lies_beyond_the_field_is_not_known_and_counts_for_nothing() -> None:
    map_ = Map.filling((4, 4)).then([[2.0, 0.0, -0.75], [0.0, 2.0, -0.5], [0.0, 0.0, 1.0]])
    seen = compute_footprint(map_, (4, 4), (1, 1), UNCUT, 0.0)
    # Across quads lie from -0.75 in steps of 0.5, down from -0.5.
    across, down = [False, False, True, False], [False, True, True, False]
    np.testing.assert_array_equal(seen.known, np.outer(down, across))
    wanted = np.outer([0.0, 1.0, 1.0, 0.0], [0.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(seen.gather(np.ones((1, 1))), wanted)
    np.testing.assert_allclose(seen.area, [[2.0]])


@pytest.mark.parametrize("blur", [0.3, 1.5])
def test_blur_is_that_of_a_gaussian(blur: float) -> None:
    """The share of the left of two cells in a row of quads, and of the light from the field."""
    seen = compute_footprint(Map.filling((12, 1)), (1, 12), (1, 2), UNCUT, blur)

    def below(x: float) -> np.ndarray:
        """Mean over each quad of what lies left of x, by many points."""
        points = (np.arange(12 * 400) + 0.5) / 400
        return np.asarray(scipy.special.ndtr((x - points) / blur).reshape(12, 400).mean(axis=1))

    whole = below(12.0) - below(0.0)
    left = (below(6.0) - below(0.0)) / whole
    np.testing.assert_allclose(shares(seen, (1, 2))[0, :, 0, 0], left, atol=2e-4)
    assert seen.inside is not None and seen.inside.dtype == np.float32
    assert seen.known.all()
    # It is followed over four standard deviations: to 1.2 quads, or 6.
    far = shares(seen, (1, 2))[0, :, 0, 1]
    first = 4 if blur < 1.0 else 0
    assert (far[:first] == 0.0).all() and far[first] > 0.0
    # Down the one quad fills the field, and most of a large blur is lost beyond it.
    height = scipy.special.ndtr((1.0 - np.linspace(0, 1, 2001)) / blur).mean()
    np.testing.assert_allclose(seen.inside[0], whole * (2.0 * height - 1.0), atol=2e-3)


FRAMES: list[tuple[Any, tuple[int, int]]] = [
    (np.eye(3), (4, 6)),
    (np.diag([0.5, 0.7, 1.0]), (4, 6)),
    ([[-1.3, 0, 1.1], [0, 1.2, -0.15], [0, 0, 1]], (9, 7)),
    ([[0, 1.1, -0.05], [0.9, 0, 0.03], [0, 0, 1]], (5, 8)),
    ([[0, -0.8, 0.95], [1.4, 0, -0.2], [0, 0, 1]], (70, 3)),
]


@pytest.mark.parametrize(("matrix", "frame"), FRAMES)
@pytest.mark.parametrize("cuts", [UNCUT, QUARTERS])
@pytest.mark.parametrize("blur", [0.0, 0.8])
def test_a_frame_is_seen_the_same_along_its_axes_and_quad_by_quad(
    matrix: Any, frame: tuple[int, int], cuts: Cuts, blur: float
) -> None:
    """A lens too weak to see makes it a frame of any kind."""
    map_ = Map.filling((frame[1], frame[0])).then(matrix)
    other = msgspec.structs.replace(map_, radial=(1e-12, 0.0))
    grid = (3, 5)
    pieces = (3 * (len(cuts[0]) - 1), 5 * (len(cuts[1]) - 1))
    one, two = (compute_footprint(each, frame, grid, cuts, blur) for each in (map_, other))
    np.testing.assert_array_equal(one.known, two.known)
    assert one.known.any()
    values, image = RNG.random(pieces), RNG.random(frame)
    np.testing.assert_allclose(one.gather(values), two.gather(values), atol=2e-4)
    # Where little light comes from the field its shares are those of little.
    sound = one.known
    np.testing.assert_allclose(one.area, two.area, atol=1e-3)
    for squares in (False, True):
        found = [seen.collect(image * sound, squares=squares) for seen in (one, two)]
        np.testing.assert_allclose(found[0], found[1], atol=2e-3)
    if blur:
        assert one.inside is not None and two.inside is not None
        np.testing.assert_allclose(one.inside[sound], two.inside[sound], atol=2e-4)
    else:
        assert one.inside is None and two.inside is None


@pytest.mark.parametrize("degrees", [0.0, 10.0, 30.0, 45.0, 60.0, 80.0, 90.0, 135.0, -20.0])
def test_a_straight_edge_cuts_a_turned_quad_as_it_cuts_its_polygon(degrees: float) -> None:
    """A frame within a field of two cells, whose only edge runs through it."""
    map_ = turned_by(degrees, 0.5, (0.013, 0.0), 5)
    seen = compute_footprint(map_, (5, 5), (1, 2), UNCUT, 0.0)
    assert seen.known.all()
    found = shares(seen, (1, 2))[:, :, 0]
    down = compute_footprint(map_.then(np.eye(3)[[1, 0, 2]]), (5, 5), (2, 1), UNCUT, 0.0)
    for row, col in np.ndindex(5, 5):
        quad = np.array([[col, row], [col + 1, row], [col + 1, row + 1], [col, row + 1]])
        left = part_left_of(map_.to_field(quad), 0.5)
        assert found[row, col] == pytest.approx([left, 1.0 - left], abs=2e-5)
    np.testing.assert_allclose(shares(down, (2, 1))[:, :, :, 0], found, atol=1e-9)


def test_quads_are_known_up_to_the_border_of_the_field() -> None:
    """A frame that fills the field lies in it, by whatever rounding, and one that is larger not."""
    lens = msgspec.structs.replace(Map.filling((5, 5)), radial=(1e-12, 0.0))
    assert compute_footprint(lens, (5, 5), (2, 2), UNCUT, 0.0).known.all()
    # By half a millionth of half a quad on either side: half a quad is a tenth of the field.
    rounded = lens.then([[1.0 + 1e-7, 0.0, -0.5e-7], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert compute_footprint(rounded, (5, 5), (2, 2), UNCUT, 0.0).known.all()
    for wide in (1.0 + 3e-7, 1.0 + 1e-5, 1.01):
        larger = lens.then([[wide, 0.0, 0.5 - 0.5 * wide], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        known = compute_footprint(larger, (5, 5), (2, 2), UNCUT, 0.0).known
        assert known[:, 1:4].all() and not known[:, [0, 4]].any()
        upright = msgspec.structs.replace(larger, radial=(0.0, 0.0))
        np.testing.assert_array_equal(
            compute_footprint(upright, (5, 5), (2, 2), UNCUT, 0.0).known, known
        )


def test_quads_within_one_piece_see_that_piece_alone() -> None:
    map_ = turned_by(30.0, 0.1, (0.21, -0.3), 4)
    seen = compute_footprint(map_, (4, 4), (2, 2), UNCUT, 0.0)
    found = shares(seen, (2, 2))
    assert (found[:, :, 0, 1] == 1.0).all() and found.sum() == 16.0
    np.testing.assert_array_equal(seen.area, [[0.0, 16.0], [0.0, 0.0]])


@pytest.mark.parametrize("radial", [0.0, 1e-12])
def test_quads_that_see_nothing_of_the_field_have_no_light_from_it(radial: float) -> None:
    """The field ends with the sixth of twelve quads; blur reaches a little further."""
    map_ = Map.filling((12, 2)).then(np.diag([2.0, 1.0, 1.0]))
    seen = compute_footprint(
        msgspec.structs.replace(map_, radial=(radial, 0.0)), (2, 12), (1, 2), UNCUT, 0.3
    )
    assert seen.inside is not None and seen.inside.shape == seen.known.shape == (2, 12)
    assert seen.known.all(axis=0).tolist() == [True] * 6 + [False] * 6
    light = seen.gather(np.ones((1, 2)))
    np.testing.assert_allclose(light[0], [1.0] * 8 + [0.0] * 4)
    # Light of the first and of the sixth quad comes from beyond the field, too.
    points = (np.arange(12 * 400) + 0.5) / 400
    across = scipy.special.ndtr((6.0 - points) / 0.3) - scipy.special.ndtr(-points / 0.3)
    whole = across.reshape(12, 400).mean(axis=1)
    assert whole[0] == pytest.approx(whole[5]) and whole[5] < 0.9
    np.testing.assert_allclose(seen.inside[0] / seen.inside[0, 3], whole, atol=2e-3)
