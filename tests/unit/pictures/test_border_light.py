"""Direct light along borders that panels draw in two places, held against pixels looked at one by
one: 14400 points of every quad, with the pixel of both panels that each lies in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.placed import Panels, place_panels
from pdcd.bench.tables import PanelConfig
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.pictures.border_light import BorderLight, BorderMeasurement
from pdcd.pictures.exposed import AmbientLight
from pdcd.pictures.picture import Picture
from pdcd.pictures.to_quads import QuadWeights
from pdcd.probing.borders import BorderStrips, find_strips
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]

GRID = (3, 4)
N = 12
FINE = 120
PROJECTOR_PX = (50, 38)
BENCHES: list[dict[str, Any]] = [
    {"size_px": (78, 58)},
    {"size_px": (85, 65), "place": Placing(flip="horizontal")},
    {"size_px": (78, 58), "place": Placing(turn_deg=4.0, scale=1.2)},
]
CAMERAS = [(12, 16), (10, 13)]


def setting_of(mask: dict[str, Any], frame: tuple[int, int]) -> tuple[Any, CellMap, Any, Any]:
    """Panels, camera, and at all points of each quad the cell that is lit and that which is open:
    (quads, points), -1 where a panel has no pixel."""
    panels = place_panels(PanelConfig(size_px=PROJECTOR_PX), PanelConfig(**mask))
    cells = CellMap(grid=GRID, frame=frame, map=Map.filling(frame[::-1]))
    y, x = (np.arange(side * FINE) + 0.5 for side in frame)
    points = np.stack(np.meshgrid(x / x.size, y / y.size), axis=-1)
    shown = []
    for view in (panels.projector, panels.mask):
        pixel = np.floor(view.map.from_field(points))
        on = np.all((pixel >= 0) & (pixel < view.size_px), axis=-1)
        at = np.floor(view.map.to_field(pixel + 0.5) * GRID[::-1])
        on &= np.all((at >= 0) & (at < GRID[::-1]), axis=-1)
        shown.append(np.where(on, at[..., 1] * GRID[1] + at[..., 0], -1).astype(np.int64))
    return panels, cells, shown[0], shown[1]


def realised_of(strips: tuple[BorderStrips, ...]) -> Factors:
    """A matrix in which no two pairs of cells have the same weight, and direct light has none."""
    rng = np.random.default_rng(3)
    left, right = rng.uniform(0.5, 1.5, (2, 4, N)) / 4.0
    return Factors(left, right, np.zeros(N), np.ones(N), apart=strips)


def light_between(panels: Panels, cells: CellMap, weight_s: float) -> tuple[Factors, BorderLight]:
    """A matrix for the strips of these panels, and their light in a photo of that weight."""
    realised = realised_of(find_strips(panels.projector, panels.mask, GRID, 4))
    return realised, BorderLight.of(realised, QuadWeights(np.array(weight_s), None), cells)


def leak_of(realised: Factors, lit: Any, opened: Any, direct: Floats | float) -> Floats:
    """What gets into each quad, (h, w): direct light is given at all points."""
    pairs = realised.left.T @ realised.right
    apart = (lit != opened) & (lit >= 0) & (opened >= 0)
    there = np.where(apart, pairs[opened, lit] * direct, 0.0)
    height, width = (side // FINE for side in there.shape)
    return np.asarray(there.reshape(height, FINE, width, FINE).mean(axis=(1, 3)))


@pytest.mark.parametrize(
    ("mask", "frame"),
    [(BENCHES[0], CAMERAS[0]), (BENCHES[1], CAMERAS[1]), (BENCHES[2], CAMERAS[0])],
)
def test_each_quad_has_what_the_pixels_let_through(
    mask: dict[str, Any], frame: tuple[int, int]
) -> None:
    panels, cells, lit, opened = setting_of(mask, frame)
    realised, light = light_between(panels, cells, 2.0)
    wanted = leak_of(realised, lit, opened, 1.0) / 2.0
    found = light.share()
    assert wanted.max() > 0.01
    # A point stands for half of its width to either side; where borders cross, a few differ across
    # both and are counted for each.
    np.testing.assert_allclose(found, wanted, atol=0.5 / FINE)
    assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.06 * np.sqrt(np.mean(wanted**2))
    assert found.sum() == pytest.approx(wanted.sum(), rel=0.05)


@pytest.mark.parametrize("mask", BENCHES)
def test_quads_of_direct_light_weigh_what_both_panels_show_of_one_cell(
    mask: dict[str, Any],
) -> None:
    frame = CAMERAS[0]
    panels, cells, lit, opened = setting_of(mask, frame)
    realised, light = light_between(panels, cells, 2.0)
    there = 2.0 * ((lit == opened) | (lit < 0) | (opened < 0))
    height, width = frame
    alike = there.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    wanted = alike + leak_of(realised, lit, opened, 1.0)
    found = light.weigh_direct(QuadWeights(np.array(2.0), None))
    assert wanted.min() < 1.95 and found.blind is None
    off, dark = found.quads_s - wanted, 2.0 - wanted
    assert np.sqrt(np.mean(off**2)) < 0.06 * np.sqrt(np.mean(dark**2))


def slants(frame: tuple[int, int]) -> tuple[Floats, Floats]:
    """Direct and indirect light at all points."""
    down, right = ((np.arange(side * FINE) + 0.5) / (side * FINE) for side in frame)
    slant = 5.0 + 4.0 * right + 2.0 * down[:, None]
    return slant, 1.0 + np.sin(3.0 * right) + 0.0 * slant


def of_quads(image: Floats) -> Floats:
    """Means over quads, (h, w, 3), of light at all points."""
    height, width = (side // FINE for side in image.shape)
    mean = image.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    return np.repeat(mean[..., None], 3, axis=2)


@pytest.mark.parametrize("mask", BENCHES[1:])
def test_indirect_light_is_what_is_left(mask: dict[str, Any]) -> None:
    frame = CAMERAS[0]
    panels, cells, lit, opened = setting_of(mask, frame)
    realised, light = light_between(panels, cells, 1.0)
    slant, wandered = slants(frame)
    direct, indirect = of_quads(slant), of_quads(wandered)
    leak = np.repeat(leak_of(realised, lit, opened, slant)[..., None], 3, axis=2)
    none = np.full(direct.shape, 1e-3)
    white = Picture(direct + indirect, none)
    found = light.take_out(Picture(indirect + leak, none), white)
    inside = np.s_[1:-1, 1:-1]  # the outermost quads have no neighbours that light could follow
    error = (found.image - indirect)[inside]
    assert np.sqrt(np.mean(leak**2)) > 0.1
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(leak**2))
    bars = light.error(found, white)[inside]
    ends = 0.29 / FINE * direct[inside] * (leak[inside] > 0.0)  # of strips, between points
    assert np.mean(np.abs(error) <= 1.96 * np.hypot(bars, ends + 1e-3)) > 0.95
    assert (found.sigma >= none).all()


@pytest.mark.parametrize("mask", BENCHES[1:])
def test_a_photo_of_strips_tells_detail_that_no_quad_shows(mask: dict[str, Any]) -> None:
    frame, reach = CAMERAS[0], (0.1, 0.1)
    panels, cells, lit, opened = setting_of(mask, frame)
    realised, light = light_between(panels, cells, 2.0)
    slant, wandered = slants(frame)
    # Stripes of five points, an eighth to all of the light: a quad sees twelve of them.
    stripes = np.where(np.add.outer(*map(np.arange, slant.shape)) // 5 % 2, 0.125, 1.0)
    direct, indirect = of_quads(slant * stripes), of_quads(wandered)
    apart = (lit != opened) & (lit >= 0) & (opened >= 0)
    seen = of_quads(np.where(apart.reshape(slant.shape), slant * stripes, 0.0))
    near = 0.01 * indirect * np.random.default_rng(2).uniform(0.7, 1.3, (*frame, 1))
    photo = AmbientLight(seen + near - 0.01 * indirect, np.full(seen.shape, 1e-6))
    borders = BorderMeasurement(photo, 0.01 * indirect, reach)
    leak = leak_of(realised, lit, opened, slant * stripes)[..., None] / 2.0
    none = np.full(direct.shape, 1e-3)
    taken, white = Picture(indirect + leak, none), Picture(direct + indirect, none)
    found = light.take_out(taken, white, borders)
    error = found.image - indirect
    # Pairs of cells that meet in one quad have weights of their own here; codes give all the same.
    assert np.sqrt(np.mean(error**2)) < 0.06 * np.sqrt(np.mean(leak**2))
    without = light.take_out(taken, white).image - indirect
    assert np.sqrt(np.mean(without**2)) > 2.0 * np.sqrt(np.mean(error**2))
    bars = light.error(found, white, borders)
    assert np.mean(np.abs(error) <= 1.96 * (bars + 1e-3)) > 0.95
    assert (found.sigma > none).any()


def test_what_nobody_knows_of_the_white_photo_stays() -> None:
    panels, cells, _, _ = setting_of(BENCHES[0], CAMERAS[0])
    _, light = light_between(panels, cells, 1.0)
    one = np.ones((*CAMERAS[0], 3))
    blown = one.copy()
    blown[:, 10] = np.inf
    found = light.take_out(Picture(2.0 * one, one), Picture(9.0 * one, blown))
    np.testing.assert_array_equal(found.image[:, 10], 2.0)
    assert (found.image < 2.0).any()


def test_panels_that_draw_all_borders_alike_have_no_such_light() -> None:
    for size_px, mask_px in (((48, 36), (80, 60)), ((50, 38), (50, 38))):
        panels = place_panels(PanelConfig(size_px=size_px), PanelConfig(size_px=mask_px))
        assert find_strips(panels.projector, panels.mask, GRID, 4) == ()
