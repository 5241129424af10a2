"""Shots averaged over cells, for the parts of a photo, against sums written out."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.bars import add_part_errors
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.picture import Picture, PictureWithErrors
from pdcd.pictures.to_cells import average_shots, average_with_errors, choose_part_cells
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

GRID, SIDE = (3, 4), 5
FRAME = (GRID[0] * SIDE, GRID[1] * SIDE)
NOTHING = Factors(np.zeros((0, 12)), np.zeros((0, 12)), np.zeros(12), np.zeros(12))


def shot(light: np.ndarray, saturated: np.ndarray | None = None) -> ComputedShot:
    blown = np.zeros(light.shape[:2], np.bool_) if saturated is None else saturated
    return ComputedShot(light, np.ones_like(light), blown, NOTHING, {"iso": 100}, 3)


def placed(frame: tuple[int, int], grid: tuple[int, int] = GRID, **place: Any) -> CellMap:
    """Cells of a camera of so many quads that lies as `place` says."""
    of_field = (10 * grid[1], 10 * grid[0])
    map_ = make_placed_map(Placing(**place), (frame[1], frame[0]), of_field, "camera")
    return CellMap(grid=grid, frame=frame, map=map_)


def test_cells_have_the_mean_of_quads_that_no_shot_has_saturated() -> None:
    rng = np.random.default_rng(5)
    one, two = rng.standard_normal((2, *FRAME, 3))
    blown, more = np.zeros((2, *FRAME), np.bool_)
    blown[0, 0] = True  # of a cell a twenty-fifth: it does not count in either shot
    more[SIDE : 2 * SIDE, :SIDE] = True  # of another cell all
    taken = {"one": shot(one, blown), "two": shot(two, more)}
    averaged = average_shots(taken, CellMap.block(GRID, FRAME))
    shots, alike = averaged.shots, averaged.cells
    for name, light in (("one", one), ("two", two)):
        blocks = light.reshape(GRID[0], SIDE, GRID[1], SIDE, 3)
        expected = blocks.mean(axis=(1, 3))
        expected[0, 0] = np.delete(light[:SIDE, :SIDE].reshape(-1, 3), 0, axis=0).mean(axis=0)
        np.testing.assert_allclose(shots[name].light, expected, atol=1e-14)
        assert not shots[name].saturated.any()
        assert shots[name].exif == {"iso": 100} and shots[name].missed == 3
    assert alike.frame == alike.grid == GRID


def test_of_a_cell_with_a_quad_full_of_light_nothing_is_known() -> None:
    """One that is unknown by chance is left out."""
    image = np.random.default_rng(7).random((*FRAME, 3))
    sensor, full = np.full(image.shape, 0.1), np.zeros(FRAME, np.bool_)
    full[2, 7] = True
    sensor[2, 7] = sensor[2, 2] = np.inf
    picture = PictureWithErrors(image, sensor, sensor, np.zeros_like(sensor), "whole")
    blocks = image.reshape(GRID[0], SIDE, GRID[1], SIDE, 3).swapaxes(1, 2).reshape(*GRID, -1, 3)
    expected = blocks.mean(axis=2)  # all as measured, where nothing is known
    expected[0, 0] = np.delete(blocks[0, 0], 12, axis=0).mean(axis=0)
    means = average_with_errors(picture, CellMap.block(GRID, FRAME), full)
    np.testing.assert_allclose(means.image, expected, atol=1e-14)
    unknown = np.argwhere(np.isinf(means.sigma).all(axis=-1))
    assert unknown.tolist() == [[0, 1]] and np.isfinite(means.sigma).sum() == 3 * 11


def test_cells_that_no_quad_sees_are_as_bright_as_the_others() -> None:
    cells = placed(FRAME, scale=0.3)
    halves = choose_part_cells(cells)
    seen = halves.seen().reshape(halves.grid)
    assert 0 < seen.sum() < seen.size
    light = np.random.default_rng(6).random((*FRAME, 3))
    found = average_shots({"one": shot(light)}, cells).shots["one"].light
    np.testing.assert_allclose(
        found[~seen], np.tile(found[seen].mean(axis=0), (sum(~seen.ravel()), 1))
    )


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_light_that_is_the_same_everywhere_is_so_where_quads_see_past_the_border(
    turn_deg: float,
) -> None:
    """Quads there get less of it, by the blur."""
    cells = msgspec.structs.replace(placed(FRAME, turn_deg=turn_deg, scale=1.3), blur_quads=0.8)
    assert cells.inside is not None
    light = np.tile((cells.spread(np.ones(12)) * cells.inside)[..., None], (1, 1, 3))
    assert cells.known.any() and light[cells.known].min() < 0.95
    found = average_shots({"one": shot(light)}, cells).shots["one"].light
    np.testing.assert_allclose(found, 1.0, atol=1e-6)


def test_a_camera_that_sees_halves_of_cells_averages_over_halves() -> None:
    """Quads that see two of them do not count where each has enough that see it alone."""
    cells = placed((31, 41))  # 10.3 quads a cell each way
    halves = choose_part_cells(cells)
    assert halves.grid == (6, 8)
    # Too few quads, or too much blur, for halves.
    few = msgspec.structs.replace(cells, frame=(9, 12), map=None)
    assert choose_part_cells(few) is few
    few = placed((8, 11))
    assert choose_part_cells(few) is few
    blurred = msgspec.structs.replace(cells, blur_quads=1.3)
    assert choose_part_cells(blurred) is blurred
    values = np.random.default_rng(7).random((48, 3))
    averaged = average_shots({"one": shot(halves.spread(values))}, cells)
    found, alike = averaged.shots, averaged.cells
    assert alike.grid == GRID and alike.frame == (6, 8) and alike.map is not None
    np.testing.assert_allclose(found["one"].light.reshape(-1, 3), values, atol=1e-12)


@pytest.mark.parametrize(("frame", "halves"), [((31, 41), True), ((8, 11), False)])
def test_cells_whose_quads_see_others_too_have_an_error_of_their_own(
    frame: tuple[int, int], halves: bool
) -> None:
    """Errors by chance of cells, seen by quads that see two and four of them."""
    grid, count = (16, 20), 8
    frame = (frame[0] * 16 // 3, frame[1] * 5)
    cells = placed(frame, grid)
    assert (choose_part_cells(cells).grid != grid) is halves
    rng = np.random.default_rng(8)
    errors = 0.05 * rng.standard_normal((count, grid[0] * grid[1], 3))
    shots = {f"{k}": shot(cells.spread(1.0 + one)) for k, one in enumerate(errors)}
    picture = Picture(cells.spread(1.0 + errors.mean(axis=0)), np.full((*frame, 3), 1e-6))
    parts = [one.light for one in average_shots(shots, cells).shots.values()]
    made = add_part_errors({"it": picture}, {"it": parts}, cells, {})["it"]
    found = float(np.sqrt(np.mean(made.sigma[cells.single] ** 2)))
    assert found == pytest.approx(0.05 / np.sqrt(count), rel=0.06)


def test_what_single_quads_err_by_is_no_error_of_the_mean_of_their_cell() -> None:
    cells = CellMap.block(GRID, GRID)
    image = np.ones((*GRID, 3))
    parts = [image + 0.1 * k for k in range(4)]
    picture = Picture(image, np.full(image.shape, 0.01))
    more = {"it": np.full(image.shape, 0.3)}
    without, made = (
        add_part_errors({"it": picture}, {"it": parts}, cells, one) for one in ({}, more)
    )
    np.testing.assert_allclose(made["it"].code, np.hypot(without["it"].code, 0.3), rtol=1e-12)
    means = average_with_errors(made["it"], cells)
    np.testing.assert_allclose(means.code, without["it"].code, rtol=1e-12)


def test_what_halves_of_a_cell_get_wrong_by_chance_is_half_of_it_in_the_mean() -> None:
    grid, count = (16, 20), 8
    frame = (16 * 11, 20 * 11)
    cells = placed(frame, grid)
    halves = choose_part_cells(cells)
    rng = np.random.default_rng(9)
    errors = 0.05 * rng.standard_normal((count, 4 * grid[0] * grid[1], 3))
    parts = [halves.spread(1.0 + one) for one in errors]
    light = average_shots({f"{k}": shot(one) for k, one in enumerate(parts)}, cells).shots
    picture = Picture(np.mean(parts, axis=0), np.full((*frame, 3), 1e-6))
    averaged = [one.light for one in light.values()]
    made = add_part_errors({"it": picture}, {"it": averaged}, cells, {})["it"]
    true = 0.05 / np.sqrt(count)
    assert np.sqrt(np.mean(made.code**2)) == pytest.approx(true, rel=0.06)
    means = average_with_errors(made, cells)
    assert means.code.shape == (*grid, 3)
    assert np.sqrt(np.mean(means.code**2)) == pytest.approx(true / 2.0, rel=0.06)


@pytest.mark.parametrize(
    ("quads", "turn_deg", "halved"),
    [(5, 0.0, True), (3, 0.0, True), (2, 0.0, False), (3, 20.0, False), (5, 20.0, True)],
)
def test_parts_are_told_of_half_cells_where_quads_see_one_half_alone(
    quads: int, turn_deg: float, halved: bool
) -> None:
    """Of three upright quads a cell those at its sides do; of turned ones too few."""
    grid = (6, 8)
    cells = placed((quads * grid[0], quads * grid[1]), grid, turn_deg=turn_deg)
    assert (choose_part_cells(cells).grid != grid) == halved
