"""Pictures sampled on the field, against fields whose values are known at every point."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.upright import FieldSampler, FieldView

Floats = NDArray[np.float64]

KEYSTONE = np.array([[0.95, 0.05, 0.01], [-0.04, 1.02, 0.02], [0.05, 0.02, 1.0]])
BENT = msgspec.structs.replace(
    Map.filling((213, 142)).then(KEYSTONE), radial=(0.02, 0.003), tangential=(0.004, -0.003)
)


def centres(width: int, height: int) -> tuple[Floats, Floats]:
    """x and y of the middle of each pixel of a raster of the field."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return x, y


def everywhere(map_: Map) -> NDArray[np.bool_]:
    return np.ones(map_.size_px[::-1], dtype=np.bool_)


def seen_ramp(map_: Map) -> Floats:
    """What a camera sees of a field that holds its own coordinates: (h, w, 3) of x, y and 1."""
    at = map_.centres()
    return np.concatenate([at, np.ones((*at.shape[:2], 1))], axis=-1)


def test_an_aligned_camera_is_copied() -> None:
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 8, 3)).astype(np.float32)
    sampler = FieldSampler(FieldView(Map.filling((8, 6)), 8 / 6), (8, 6))
    found, known = sampler(image, np.ones((6, 8), dtype=np.bool_))
    assert known.all()
    np.testing.assert_allclose(found, image, atol=1e-5)


@pytest.mark.parametrize("width", [90, 400])
@pytest.mark.parametrize(
    "map_",
    [
        BENT,
        make_placed_map(Placing(turn_deg=90.0), (142, 213), (1024, 768), "camera"),
        make_placed_map(
            Placing(flip="horizontal", turn_deg=7.0), (213, 142), (1024, 768), "camera"
        ),
    ],
    ids=["bent", "turned", "mirrored"],
)
def test_every_place_of_the_field_is_found(map_: Map, width: int) -> None:
    """Shrunk or enlarged, the picture of a ramp is the ramp, to a twentieth of a quad on average;
    at the camera's own edge there is nothing beyond to draw a line to."""
    view = FieldView(map_, 4 / 3)
    size = width, round(width * 0.75)
    found, known = FieldSampler(view, size)(seen_ramp(map_), everywhere(map_))
    x, y = centres(*size)
    right, down = (np.abs(found[..., i] - want)[known] * 213 for i, want in ((0, x), (1, y)))
    for error in (right, down):
        assert np.sqrt(np.mean(error**2)) < 0.05 * max(1.0, 213 / width)
        assert error.max() < 1.0 * max(1.0, 213 / width)
    inside = map_.from_field(np.stack([x, y], axis=-1))
    seen = ((inside > 0.0) & (inside < map_.size_px)).all(axis=-1)
    assert np.mean(seen != known) < 1e-3 and (known.mean() > 0.5)
    assert np.allclose(found[known][:, 2], 1.0, atol=1e-5) and not found[~known].any()


def test_fine_stripes_become_grey_when_shrunk() -> None:
    stripes = np.zeros((96, 128, 3))
    stripes[:, ::2] = 1.0
    view = FieldView(Map.filling((128, 96)), 4 / 3)
    found, _ = FieldSampler(view, (50, 38))(stripes, np.ones((96, 128), dtype=np.bool_))
    assert np.ptp(found[1:-1, 1:-1]) < 0.45  # looked up without shrinking: 1
    assert found.mean() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("width", [16, 64])
def test_what_is_not_known_does_not_leak(bad: float, width: int) -> None:
    image, known = np.full((24, 32, 3), 0.25), np.ones((24, 32), dtype=np.bool_)
    image[8:12, 10:16], known[8:12, 10:16] = bad, False
    found, seen = FieldSampler(FieldView(Map.filling((32, 24)), 4 / 3), (width, width * 3 // 4))(
        image, known
    )
    step = width / 32
    rows, cols = np.nonzero(~seen)
    assert (rows.min() / step, (rows.max() + 1) / step) == pytest.approx((8, 12), abs=1.0)
    assert (cols.min() / step, (cols.max() + 1) / step) == pytest.approx((10, 16), abs=1.0)
    assert np.allclose(found[seen], 0.25, atol=1e-6) and not found[~seen].any()


def test_places_that_no_point_of_the_camera_sees_are_not_known() -> None:
    """A lens whose model folds has no place for the field's corners."""
    folding = msgspec.structs.replace(
        Map.filling((64, 48)).then(np.diag([0.3, 0.3, 1.0])), radial=(-0.2, 0.0)
    )
    _, known = FieldSampler(FieldView(folding, 4 / 3), (64, 48))(
        np.ones((48, 64, 3)), everywhere(folding)
    )
    assert known[7, 9] and not known[-1, -1]


def test_the_raster_is_as_fine_as_the_camera_within_bounds() -> None:
    view = FieldView(Map.filling((900, 600)), 4 / 3)
    assert view.size_px(640, 1600) == (900, 675)
    assert view.size_px(1000, 1600) == (1000, 750)
    assert view.size_px(100, 640) == (640, 480)
    turned = FieldView(
        make_placed_map(Placing(turn_deg=90.0), (600, 900), (400, 300), "camera"), 4 / 3
    )
    # Its 900 quads lie along the width of the field, and fill it: a turn keeps the picture's size.
    assert turned.size_px(1, 5000)[0] == pytest.approx(900 * 4 / 3, abs=1)
