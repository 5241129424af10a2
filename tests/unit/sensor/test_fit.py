"""How a camera sees the grid, what a frame must show at least, and when quads run along cells."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.sensor.fit import FrameFit, check_frame_fit, measure_frame_fit

GRID = (48, 64)
PROJECTOR = (1024, 768)


def of(size: tuple[int, int], **place: object) -> Map:
    return make_placed_map(Placing(**place), size, PROJECTOR, "camera")  # type: ignore[arg-type]


def test_a_frame_of_a_450d_spread_over_the_field() -> None:
    fit = measure_frame_fit(Map.filling((2145, 1428)), GRID)
    assert fit.frame == (1428, 2145)
    assert fit.seen == 1.0 and not fit.aligned
    assert fit.across == pytest.approx((1428 / 48, 2145 / 64))
    check_frame_fit(fit, "quarter")


@pytest.mark.parametrize(
    ("size", "place", "seen"),
    [
        ((640, 480), {"offset_px": (512.0, 0.0)}, 0.5),
        ((640, 480), {"scale": 0.5}, 0.25),
        ((640, 480), {"offset_px": (0.0, -2000.0)}, 0.0),
        ((640, 480), {"turn_deg": 180.0, "flip": "horizontal"}, 1.0),
    ],
)
def test_the_share_of_cells_that_is_seen(
    size: tuple[int, int], place: dict[str, object], seen: float
) -> None:
    assert measure_frame_fit(of(size, **place), GRID).seen == pytest.approx(seen, abs=0.02)


def test_quads_are_counted_where_the_map_is_coarsest() -> None:
    """A keystone that leaves the right edge half as high as the left."""
    homography = (1 / 640, 0.0, 0.0, 0.0, 1 / 480, 0.0, 0.0005, 0.0, 1.0)
    map_ = of((640, 480), homography=homography)
    low, high = measure_frame_fit(map_, GRID).across
    points = np.array([[0.5, 0.5], [639.5, 479.5], [639.5, 0.5], [0.5, 479.5]])
    steps = np.linalg.svd(map_.jacobian(points) * [[64], [48]], compute_uv=False)
    assert low == pytest.approx(1.0 / steps.max(), rel=0.05)
    assert high == pytest.approx(1.0 / steps.min(), rel=0.05)
    assert low < 10.0 < high


FULL = Map.filling((64, 48))


def fit(seen: float = 1.0, fewest: float = 5.0, *, aligned: bool = False) -> FrameFit:
    return FrameFit(frame=(48, 64), seen=seen, across=(fewest, 9.0), aligned=aligned)


@pytest.mark.parametrize(
    ("given", "window"),
    [
        (fit(0.5), "quarter"),
        (fit(fewest=2.0), "quarter"),
        (fit(fewest=2.0 - 0.9e-6), "quarter"),
        (fit(fewest=1.0), "whole"),
        (fit(fewest=1.0 - 0.9e-6), "whole"),
        (fit(fewest=1.0, aligned=True), "quarter"),
        (fit(fewest=1.0 - 0.9e-6, aligned=True), "whole"),
    ],
)
def test_what_is_just_enough(given: FrameFit, window: str) -> None:
    check_frame_fit(given, window)


@pytest.mark.parametrize(
    ("given", "window", "says", "hint"),
    [
        (fit(0.0), "whole", "does not see the field", "point the camera"),
        (fit(0.4999), "whole", "sees 50 % of the cells, less than 50 %", "move the camera back"),
        (fit(0.123), "quarter", "sees 12.3 % of the cells, less than 50 %", "a larger scale"),
        (fit(fewest=1.99), "quarter", "has 1.99 pixels along a cell's side, 2 are needed: it does "
         "not resolve its quarter windows", "take fewer cells"),
        (fit(fewest=2.0 - 1.5e-6), "quarter", "2 are needed", "take fewer cells"),
        (fit(fewest=1.0), "quarter", "resolve its quarter windows", "take fewer cells"),
        (fit(fewest=0.99), "quarter", "2 are needed: it does not resolve single cells", "nearer"),
        (fit(fewest=0.99), "whole", "1 are needed: it does not resolve single cells", "nearer"),
        (fit(fewest=1.0 - 1.5e-6), "whole", "resolve single cells", "take fewer cells"),
        (fit(fewest=0.99, aligned=True), "quarter", "resolve single cells", "take fewer cells"),
        (fit(fewest=0.0), "whole", "has 0 pixels", "take fewer cells"),
    ],
)  # fmt: skip
def test_what_is_not_enough(given: FrameFit, window: str, says: str, hint: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check_frame_fit(given, window)
    assert caught.value.message.startswith("the camera's frame of 64 x 48 pixels ")
    assert says in caught.value.message and hint in (caught.value.hint or "")
    assert caught.value.device == "camera"


def test_a_frame_beside_the_field_sees_nothing() -> None:
    found = measure_frame_fit(
        FULL.then([[1.0, 0.0, 5.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), (4, 4)
    )
    assert found == FrameFit((48, 64), 0.0, (0.0, 0.0), aligned=True)


@pytest.mark.parametrize(
    ("matrix", "grid", "aligned"),
    [
        (np.eye(3), (4, 4), True),
        (np.eye(3), (4, 5), False),  # 12.8 quads a cell
        (np.eye(3), (5, 4), False),
        (np.eye(3), (96, 128), False),  # half a quad a cell
        (np.diag([-1.0, 1.0, 1.0]), (4, 4), True),
        (np.diag([0.5, 0.5, 1.0]), (4, 4), True),
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], (4, 4), True),  # 12 quads one way, 16 the other
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], (3, 16), False),  # 21.3 quads a cell
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], (2, 16), True),
        ([[1, 0, 0.25], [0, 1, 0.5], [0, 0, 1]], (4, 4), True),
        ([[1, 0, 0.1], [0, 1, 0], [0, 0, 1]], (4, 4), False),
        ([[1, 0, 0], [0, 1, 0.1], [0, 0, 1]], (4, 4), False),
        ([[1, 0, 5e-7 / 4], [0, 1, 0], [0, 0, 1]], (4, 4), True),
        ([[1, 0, 1.5e-6 / 4], [0, 1, 0], [0, 0, 1]], (4, 4), False),
        ([[1, 0.25, 0], [0, 1, 0], [0, 0, 1]], (4, 4), False),  # a shear by a whole cell
        ([[1, 0, 0], [0.25, 1, 0], [0, 0, 1]], (4, 4), False),
        ([[2, 0, 0], [0, 2, 0], [1, 0, 1]], (1, 1), False),  # corners on corners, or near
    ],
)  # fmt: skip
def test_quads_run_along_cells(matrix: Any, grid: tuple[int, int], aligned: bool) -> None:
    assert measure_frame_fit(FULL.then(matrix), grid).aligned is aligned


def test_a_lens_that_leaves_the_corners_alone_still_bends() -> None:
    """k1 r^2 + k2 r^4 is 0 at the corners, where r^2 is 25/9."""
    bent = msgspec.structs.replace(FULL, radial=(0.025, -0.009))
    corners = bent.to_field([[0.0, 0.0], [64.0, 48.0]])
    np.testing.assert_allclose(corners, [[0.0, 0.0], [1.0, 1.0]], atol=1e-12)
    assert not measure_frame_fit(bent, (4, 4)).aligned


def test_the_share_and_the_scale_are_those_of_cells_in_the_frame() -> None:
    half = FULL.then([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = measure_frame_fit(half, (4, 8))
    assert found.seen == 0.5 and found.frame == (48, 64)
    assert found.across == pytest.approx((8.0, 12.0))
