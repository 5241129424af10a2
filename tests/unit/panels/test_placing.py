"""A device placed by hand: numbers by hand, and what is said twice."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_file import save_maps
from pdcd.panels.placing import Placing, check_once, make_placed_map, project_points

PROJECTOR = (100, 50)
ONE = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
TO_FIELD = (0.1, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)


def in_px(point: tuple[float, float], **place: Any) -> Any:
    """Where a point of a device of 10 x 5 pixels lies, in projector pixels from the middle."""
    map_ = make_placed_map(Placing(**place), (10, 5), PROJECTOR, "mask")
    found = (map_.to_field(point) - 0.5) * PROJECTOR
    return pytest.approx(found.tolist(), abs=1e-9)


COS, SIN = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))


@pytest.mark.parametrize(
    ("place", "at"),
    [
        ({}, (40.0, -15.0)),
        ({"flip": "none"}, (40.0, -15.0)),
        ({"flip": "horizontal"}, (-40.0, -15.0)),
        ({"flip": "vertical"}, (40.0, 15.0)),
        ({"turn_deg": 90.0}, (15.0, 40.0)),
        ({"turn_deg": -270.0}, (15.0, 40.0)),
        ({"turn_deg": 180.0}, (-40.0, 15.0)),
        ({"turn_deg": 270.0}, (-15.0, -40.0)),
        ({"turn_deg": -90.0}, (-15.0, -40.0)),
        ({"turn_deg": 360.0}, (40.0, -15.0)),
        ({"turn_deg": 30.0}, (40.0 * COS + 15.0 * SIN, 40.0 * SIN - 15.0 * COS)),
        ({"turn_deg": 390.0}, (40.0 * COS + 15.0 * SIN, 40.0 * SIN - 15.0 * COS)),
        ({"scale": 1.5}, (60.0, -22.5)),
        ({"offset_px": (3.0, -4.0)}, (43.0, -19.0)),
        # First mirrored, then turned, then enlarged, then shifted.
        (
            {"flip": "horizontal", "turn_deg": 90.0, "scale": 2.0, "offset_px": (3.0, -4.0)},
            (33.0, -84.0),
        ),
        ({"flip": "vertical", "turn_deg": 90.0, "scale": 0.5}, (-7.5, 20.0)),
    ],
)
def test_a_place_by_hand(place: dict[str, Any], at: tuple[float, float]) -> None:
    # The point lies 40 right of the middle and 15 above it where the device fills the field.
    assert list(at) == in_px((9.0, 1.0), **place)


def test_a_homography_may_lead_from_the_field() -> None:
    back = (10.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0)
    map_ = make_placed_map(
        Placing(homography=back, homography_from="field"), (10, 5), PROJECTOR, "mask"
    )
    np.testing.assert_allclose(map_.homography, TO_FIELD, atol=1e-16)


def test_what_is_given_by_hand() -> None:
    assert Placing().by_hand == ()
    assert Placing(map="maps.npz").by_hand == ()
    assert Placing(scale=2.0, flip="vertical").by_hand == ("flip", "scale")
    every = Placing(
        flip="vertical", turn_deg=1.0, scale=2.0, offset_px=(1.0, 0.0), homography=ONE,
        homography_from="field", radial=(0.1, 0.0), tangential=(0.1, 0.0),
    )  # fmt: skip
    assert set(every.by_hand) == {*Placing.__struct_fields__} - {"map"}


@pytest.mark.parametrize(
    ("place", "besides"),
    [
        (Placing(map="m.npz"), ""),
        (Placing(homography=ONE), ""),
        (Placing(homography=ONE, homography_from="field", radial=(0.1, 0.0)), ""),
        (Placing(homography=ONE, tangential=(0.1, 0.0)), ""),
        (Placing(flip="vertical", turn_deg=3.0, scale=2.0, offset_px=(1.0, 1.0)), ""),
        (Placing(homography_from="field"), ""),
        (Placing(map="m.npz", turn_deg=3.0), "map says .* so does turn_deg \\("),
        (
            Placing(map="m.npz", scale=3.0, homography=ONE),
            "so does homography, scale \\(",
        ),
        (Placing(map="m.npz", radial=(0.1, 0.0)), "map says .* so does radial \\("),
        (Placing(homography=ONE, flip="vertical"), "homography says .* so does flip \\("),
        (Placing(homography=ONE, turn_deg=3.0), "homography says .* so does turn_deg \\("),
        (Placing(homography=ONE, scale=3.0), "homography says .* so does scale \\("),
        (
            Placing(homography=ONE, radial=(0.1, 0.0), offset_px=(1.0, 0.0)),
            "homography says .* so does offset_px \\(",
        ),
    ],
)
def test_a_place_is_said_once(place: Placing, besides: str) -> None:
    if not besides:
        check_once(place, "mask")
        return
    with pytest.raises(ConfigError, match=besides) as caught:
        check_once(place, "mask")
    assert caught.value.device == "mask" and caught.value.hint == "take out one of them"
    with pytest.raises(ConfigError, match=besides):
        make_placed_map(place, (10, 5), PROJECTOR, "mask")


@pytest.mark.parametrize("stored", [True, False])
def test_a_map_is_taken_as_it_is_if_it_is_of_that_device(tmp_path: Path, stored: bool) -> None:
    path = str(tmp_path / "maps.npz")
    map_ = Map.filling((10, 5))
    save_maps(path, {"camera": map_, "mask": map_})
    place = Placing(map=path if stored else map_)
    assert make_placed_map(place, (10, 5), PROJECTOR, "camera") == map_
    for size, counted in (((10, 6), "10 x 6"), ((11, 5), "11 x 5")):
        with pytest.raises(ConfigError) as caught:
            make_placed_map(place, size, PROJECTOR, "camera")
        assert caught.value.message == (
            f"the map is of a camera of 10 x 5 pixels, this one has {counted}, counted in "
            "pixels of its pictures"
        )
        assert caught.value.device == "camera"
        assert caught.value.hint == "calibrate the geometry again"
    with pytest.raises(ConfigError, match="this one has 9 x 5 \\("):
        make_placed_map(place, (9, 5), PROJECTOR, "mask")


SWAP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""(x, y) becomes (x / y, 1 / y): a point's depth is its y."""


def of(matrix: np.ndarray, *points: tuple[float, float]) -> list[list[float]]:
    return project_points(tuple(matrix.ravel().tolist()), np.array(points)).tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize("size", [1.0, 1000.0, 0.001, -2.0])
def test_points_go_through_whatever_the_size_of_the_numbers(size: float) -> None:
    matrix = np.array([[2.0, 1.0, 3.0], [0.0, 4.0, 5.0], [1.0, 0.0, 2.0]])
    found = of(size * matrix, (0.0, 0.0), (1.0, 0.0), (2.0, 1.0))
    np.testing.assert_allclose(found, [[1.5, 2.5], [5 / 3, 5 / 3], [2.0, 2.25]], rtol=1e-14)


@pytest.mark.parametrize("size", [1.0, 1000.0, 0.001])
def test_a_matrix_is_singular_below_a_share_of_its_largest_entry(size: float) -> None:
    (found,) = of(size * np.diag([1.0, 1.5e-9, 1.0]), (0.5, 0.5))
    assert found == pytest.approx([0.5, 0.75e-9])
    with pytest.raises(ValueError, match="has no inverse"):
        of(size * np.diag([1.0, 0.7e-9, 1.0]), (0.5, 0.5))


@pytest.mark.parametrize("size", [1.0, 1000.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_all_points_lie_on_one_side_of_the_horizon(size: float, side: float) -> None:
    near = side * 1.5e-6
    np.testing.assert_allclose(
        of(size * SWAP, (0.0, near), (1.0, side)), [[0.0, 1.0 / near], [side, side]]
    )
    for depths in ((0.7e-6 * side, side), (side, 1e-6 * side), (side, -side), (-0.5, 0.5), (0.0,)):
        with pytest.raises(ValueError, match="a part of the field to infinity"):
            of(size * SWAP, *((0.0, depth) for depth in depths))
