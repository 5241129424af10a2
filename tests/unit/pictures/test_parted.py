"""Shots averaged over cells, for the parts of a photo, against sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.maps.placing import Placing, placed
from pdcd.pictures.exposed import Print
from pdcd.pictures.parted import averaged
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

GRID, SIDE = (3, 4), 5
FRAME = (GRID[0] * SIDE, GRID[1] * SIDE)
NOTHING = Factors(np.zeros((0, 12)), np.zeros((0, 12)), np.zeros(12), np.zeros(12))


def shot(light: np.ndarray, saturated: np.ndarray | None = None) -> Print:
    blown = np.zeros(light.shape[:2], np.bool_) if saturated is None else saturated
    return Print(light, np.ones_like(light), blown, NOTHING, {"iso": 100}, 3)


def test_cells_have_the_mean_of_quads_that_no_shot_has_saturated() -> None:
    rng = np.random.default_rng(5)
    one, two = rng.standard_normal((2, *FRAME, 3))
    blown, more = np.zeros((2, *FRAME), np.bool_)
    blown[0, 0] = True  # of a cell a twenty-fifth: it does not count in either shot
    more[SIDE : 2 * SIDE, :SIDE] = True  # of another cell all
    shots, alike = averaged(
        {"one": shot(one, blown), "two": shot(two, more)}, CellMap.block(GRID, FRAME)
    )
    for name, light in (("one", one), ("two", two)):
        blocks = light.reshape(GRID[0], SIDE, GRID[1], SIDE, 3)
        expected = blocks.mean(axis=(1, 3))
        expected[0, 0] = np.delete(light[:SIDE, :SIDE].reshape(-1, 3), 0, axis=0).mean(axis=0)
        np.testing.assert_allclose(shots[name].light, expected, atol=1e-14)
        assert not shots[name].saturated.any()
        assert shots[name].exif == {"iso": 100} and shots[name].missed == 3
    assert alike.frame == alike.grid == GRID


def test_cells_that_no_quad_sees_are_as_bright_as_the_others() -> None:
    place = placed(Placing(scale=0.3), (FRAME[1], FRAME[0]), (40, 30), "camera")
    cells = CellMap(grid=GRID, frame=FRAME, map=place)
    seen = cells.seen().reshape(GRID)
    assert 0 < seen.sum() < seen.size
    light = np.random.default_rng(6).random((*FRAME, 3))
    found = averaged({"one": shot(light)}, cells)[0]["one"].light
    np.testing.assert_allclose(
        found[~seen], np.tile(found[seen].mean(axis=0), (sum(~seen.ravel()), 1))
    )


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_light_that_is_the_same_everywhere_is_so_where_quads_see_past_the_border(
    turn_deg: float,
) -> None:
    """Quads there get less of it, by the blur."""
    place = placed(Placing(turn_deg=turn_deg, scale=1.3), (FRAME[1], FRAME[0]), (40, 30), "camera")
    cells = CellMap(grid=GRID, frame=FRAME, map=place, blur_quads=0.8)
    assert cells.inside is not None
    light = np.tile((cells.spread(np.ones(12)) * cells.inside)[..., None], (1, 1, 3))
    assert cells.known.any() and light[cells.known].min() < 0.95
    found = averaged({"one": shot(light)}, cells)[0]["one"].light
    np.testing.assert_allclose(found, 1.0, atol=1e-6)
