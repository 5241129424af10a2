"""How a camera sees the grid: worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.sensor.fit import check_frame_fit, measure_frame_fit

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
