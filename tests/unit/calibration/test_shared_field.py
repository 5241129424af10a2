"""The largest rectangle that three devices share, against all rectangles and against the maps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from pdcd.calibration.geometry.shared_field import (
    FieldBox,
    SharedField,
    edge_px,
    find_largest_box,
    find_shared_field,
    fit_whole_cells,
)
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, find_pixels_on
from pdcd.panels.placing import Placing, make_placed_map

Bools = NDArray[np.bool_]
PROJECTOR, MASK, QUADS = (256, 192), (400, 300), (360, 270)


def every_rectangle(good: Bools) -> int:
    """Area of the largest in which all is good, by trying all."""
    rows, cols = good.shape
    return max(
        (
            (bottom - top) * (right - left)
            for top in range(rows)
            for bottom in range(top + 1, rows + 1)
            for left in range(cols)
            for right in range(left + 1, cols + 1)
            if good[top:bottom, left:right].all()
        ),
        default=0,
    )


@settings(max_examples=150)
@given(
    arrays(
        np.bool_,
        st.tuples(st.integers(1, 6), st.integers(1, 6)),
        elements=st.integers(0, 5).map(bool),
    )
)
def test_no_rectangle_is_larger(good: Bools) -> None:
    left, top, width, height = find_largest_box(good)
    assert width * height == every_rectangle(good)
    assert good[top : top + height, left : left + width].all()


def devices(mask: dict[str, Any], camera: dict[str, Any]) -> dict[str, Map]:
    return {
        "mask": make_placed_map(Placing(**mask), MASK, PROJECTOR, "mask"),
        "camera": make_placed_map(Placing(**camera), QUADS, PROJECTOR, "camera"),
    }


def field_of(mask: dict[str, Any], camera: dict[str, Any]) -> SharedField:
    return find_shared_field(PROJECTOR, devices(mask, camera), {"mask": -0.5, "camera": 0.0}, None)


@pytest.mark.parametrize(
    ("mask", "camera"),
    [
        ({"offset_px": (10.0, -6.25)}, {"scale": 1.1}),
        ({"turn_deg": 3.0}, {"scale": 1.2}),
        ({"flip": "horizontal", "scale": 0.8, "offset_px": (5.0, 0.0)}, {"scale": 1.2}),
        ({"scale": 1.1, "radial": (0.05, 0.0)}, {"scale": 0.85, "turn_deg": 2.0}),
        ({"scale": 0.9, "radial": (-0.04, 0.01)}, {"turn_deg": 90.0, "scale": 1.0}),
    ],
)
def test_all_of_the_field_lies_on_all_devices_and_none_larger_does(
    mask: dict[str, Any], camera: dict[str, Any]
) -> None:
    """Asked at many points of its border; and a side further out, another is lost."""
    found = field_of(mask, camera)

    def inside(box: FieldBox, slack: float) -> bool:
        left, top, width, height = box
        if left < 0 or top < 0 or left + width > PROJECTOR[0] or top + height > PROJECTOR[1]:
            return False
        along = np.linspace(0.0, 1.0, 401)
        ends = np.zeros_like(along), np.ones_like(along)
        border = np.concatenate(
            [np.stack(p, axis=-1) for e in ends for p in ((along, e), (e, along))]
        )
        points = (border * [width, height] + [left, top]) / PROJECTOR
        for name, map_ in devices(mask, camera).items():
            edge = (-0.5 if name == "mask" else 0.0) - slack
            at = map_.from_field(points)
            if not ((at >= edge) & (at <= np.array(map_.size_px) - edge)).all():
                return False
        return True

    assert inside(found.box, 0.01)
    left, top, width, height = found.box
    for grown in (
        (left - 1, top, width + 1, height), (left, top - 1, width, height + 1),
        (left, top, width + 1, height), (left, top, width, height + 1),
    ):  # fmt: skip
        assert not inside(grown, -0.01)
    assert found.share == pytest.approx(width * height / (PROJECTOR[0] * PROJECTOR[1]))


def test_an_exact_bench_keeps_its_whole_picture() -> None:
    """A map may be off by a fifth of the mask's pixels, and its edge still be taken for that of the
    picture; one that is less sure loses a pixel."""
    assert edge_px(0.05, 1.5) < 0.0
    both = devices({}, {})
    for sigma_px, box in ((0.05, (0, 0, 256, 192)), (0.3, (1, 1, 254, 190))):
        edges = {"mask": edge_px(sigma_px, 1.5625), "camera": -0.5}
        assert find_shared_field(PROJECTOR, both, edges, None).box == box


def test_cells_of_whole_pixels_are_worth_a_fiftieth() -> None:
    assert fit_whole_cells((3, 4, 1001, 722), (48, 64)) == (3, 4, 1001, 722)
    assert fit_whole_cells((3, 4, 1027, 769), (48, 64)) == (4, 4, 1024, 768)
    both, edges = devices({"offset_px": (1.0, 0.0)}, {"scale": 1.2}), {"mask": -0.5, "camera": 0.0}
    found = find_shared_field(PROJECTOR, both, edges, (24, 32))
    assert found.box == (1, 0, 255, 192) and not found.advice
    found = find_shared_field(PROJECTOR, both, edges, (24, 36))
    assert found.box == (2, 0, 252, 192)
    assert "the field is 252 x 192 pixels, not 255 x 192" in found.advice[0]


@pytest.mark.parametrize(
    ("mask", "camera", "words"),
    [
        (
            {"offset_px": (125.0, 20.0)}, {"scale": 1.2},
            ("the mask covers 4", "125 px left and 20 px up"),
        ),
        ({"scale": 0.6}, {"scale": 1.2}, ("the mask covers 3", "0.60 times as large")),
        ({}, {"scale": 0.5}, ("the camera sees 2", "zoom it out, so that it sees 2.00 times")),
        (
            {}, {"offset_px": (-140.0, 0.0), "scale": 1.0},
            ("the camera sees 4", "its view moves 140 px right"),
        ),
    ],
)  # fmt: skip
def test_where_little_is_shared_it_is_said_what_to_move(
    mask: dict[str, Any], camera: dict[str, Any], words: tuple[str, ...]
) -> None:
    (advice,) = field_of(mask, camera).advice
    assert all(word in advice for word in words), advice


def test_nothing_shared_is_refused_with_what_to_move() -> None:
    with pytest.raises(CalibrationError, match="no part of") as caught:
        field_of({"offset_px": (300.0, 0.0)}, {"scale": 1.2})
    assert "300 px left" in str(caught.value.hint)


def test_a_pixel_lies_on_another_device_with_all_of_its_corners() -> None:
    """Every corner asked one by one, of bent devices."""
    one = make_placed_map(
        Placing(scale=1.2, turn_deg=7.0, radial=(0.03, 0.0)), (60, 44), PROJECTOR, "mask"
    )
    other = make_placed_map(Placing(scale=0.9, radial=(-0.05, 0.0)), (90, 70), PROJECTOR, "camera")
    x, y = np.meshgrid(np.arange(61.0), np.arange(45.0))
    at = other.from_field(one.to_field(np.stack([x, y], axis=-1)))
    apart = np.minimum(at, np.array([90, 70]) - at).min(axis=-1)
    on = apart >= 0.0
    wanted = on[1:, 1:] & on[1:, :-1] & on[:-1, 1:] & on[:-1, :-1]
    sure = np.abs(apart) > 0.1  # between nodes the maps are taken to be straight
    sure = sure[1:, 1:] & sure[1:, :-1] & sure[:-1, 1:] & sure[:-1, :-1]
    found = find_pixels_on(one, other)
    assert wanted.any() and not wanted.all()
    np.testing.assert_array_equal(found[sure], wanted[sure])


def test_a_large_picture_is_searched_by_blocks_and_to_the_pixel() -> None:
    good = np.zeros((1100, 1501), dtype=np.bool_)
    good[7:900, 11:1118] = True
    good[40, 3] = good[2, 60] = True
    assert find_largest_box(good) == (11, 7, 1107, 893)
    assert find_largest_box(np.zeros_like(good)) == (0, 0, 0, 0)
