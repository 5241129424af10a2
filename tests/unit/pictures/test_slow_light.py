"""How far light of slow panels is off, as parts tell: photos of a dense transport."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from pdcd.arrays import Floats
from pdcd.panels.map import Map
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.slow_light import UNSURE_SLOW_LIGHT, estimate_slow_light_errors
from pdcd.pictures.to_cells import AveragedShots
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap

GRID, PARTS, CODES = (12, 16), 6, 24
CELLS = GRID[0] * GRID[1]
BELIEVED = 0.1
"""Share of a code's time for which slow panels are believed to let the direct light of the code
before through."""


def recipe_of(parts: int = PARTS, *, white: bool = True) -> Recipe:
    how = CaptureScheme(codes=parts * CODES, parts=parts, family="bernoulli", white=white)
    return make_recipe(Target(Goal(name="indirect"), GRID), how)


@dataclass(frozen=True)
class Photos:
    averaged: AveragedShots
    slow: dict[str, Floats]


def photos_of(
    recipe: Recipe,
    real: Floats | float,
    *,
    halves: int = 1,
    black: tuple[float, float] = (0.0, 0.0),
    room: float = 0.0,
    uneven: bool = False,
    bright: tuple[int, ...] = (),
    full: tuple[int, ...] = (),
) -> Photos:
    """The photos of a recipe where that share is really `real`, in front of a scene with ten times
    more direct than indirect light; each cell is seen by so many quads, across and down.

    black : share that a black mask lets through, as believed and really. room : light in a second.
    uneven : whether codes open cells unequally often. bright, full : cells that are a hundred times
    brighter, and cells that saturate the camera.
    """
    random = np.random.default_rng(3)
    transport = random.gamma(0.3, size=(CELLS, CELLS)) / CELLS
    direct = 10.0 * 0.3 * random.uniform(0.2, 1.8, CELLS)
    direct[list(bright)] *= 100.0
    np.fill_diagonal(transport, 0.0)
    frame = GRID[0] * halves, GRID[1] * halves

    def shot(light: Floats, left: Floats, right: Floats, coaxial: Floats) -> ComputedShot:
        light[list(full)] = 1.0
        image = np.repeat(np.repeat(light.reshape(GRID), halves, 0), halves, 1)[..., None]
        dark = np.zeros(frame, np.bool_)
        factors = Factors(left, right, coaxial, left.sum(axis=0))
        return ComputedShot(image, np.zeros_like(image), dark, factors, {})

    shots, slow = {}, {}
    for photo in recipe.photos:
        for _, name in photo.shots:
            if photo.wanted.uniform == (1.0, 1.0):
                one = np.ones((1, CELLS))
                light = transport.sum(axis=1) + direct + room
                shots[name] = shot(light, one, one, one[0])
                continue
            shut = np.zeros((CODES, CELLS))
            for cell in range(CELLS):
                count = CODES // 2 + uneven * int(random.integers(-5, 6))
                shut[random.permutation(CODES)[:count], cell] = 1.0
            lit = 1.0 - shut
            after = np.sum(lit[1:] * shut[:-1], axis=0)
            through = real * after + black[1] * lit.sum(axis=0)
            light = np.sum(shut * (lit @ transport.T), axis=0) + through * direct
            light += room * shut.sum(axis=0)
            light *= 1.0 + 0.002 * random.normal(size=CELLS)
            slow[name] = BELIEVED * after
            shots[name] = shot(light, shut, lit, slow[name] + black[0] * lit.sum(axis=0))
    cells = CellMap(grid=GRID, frame=frame, map=Map.filling(frame[::-1]))
    lost = [
        number
        for number in range(frame[0] * frame[1])
        if (number // frame[1] // halves) * GRID[1] + number % frame[1] // halves in full
    ]
    return Photos(AveragedShots(shots, cells, np.array([], int), np.array(lost, int)), slow)


def told(
    real: Floats | float,
    *,
    recipe: Recipe | None = None,
    seen_room: float | None = None,
    **scene: Any,
) -> float | None:
    recipe = recipe or recipe_of()
    photos = photos_of(recipe, real, **scene)
    room = None if seen_room is None else np.full((CELLS, 1), seen_room)
    found = estimate_slow_light_errors(recipe, photos.averaged, photos.slow, room)
    return found.get(next(p.name for p in recipe.photos if p.wanted.uniform == (0.0, 1.0)))


@pytest.mark.parametrize(
    "scene",
    [
        {},
        {"halves": 2},
        {"room": 1.0, "seen_room": 1.0},
        {"uneven": True},
        {"full": (30, 31), "halves": 2},
        {"bright": (0, 77, 105, 150)},
    ],
)
def test_light_that_is_as_believed_is_told_to_be_so(scene: dict[str, Any]) -> None:
    error = told(BELIEVED, **scene)
    assert error is None or error < 0.15


@pytest.mark.parametrize("scene", [{}, {"room": 1.0, "seen_room": 1.0}, {"uneven": True}])
@pytest.mark.parametrize("times", [0.6, 1.4, 2.5, 0.0])
def test_light_that_is_off_is_told_by_how_much(times: float, scene: dict[str, Any]) -> None:
    assert told(times * BELIEVED, **scene) == pytest.approx(abs(times - 1.0), rel=0.35)


def test_light_that_is_off_in_some_rows_alone_is_not_lost_in_the_mean() -> None:
    real = np.full(GRID, BELIEVED)
    real[:4], real[8:] = 1.4 * BELIEVED, 0.6 * BELIEVED
    rms = np.sqrt(np.mean((real / BELIEVED - 1.0) ** 2))
    assert told(real.ravel()) == pytest.approx(rms, rel=0.3)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("black", [0.002, 0.02, 0.1])
def test_light_through_black_is_as_unsure_as_without_parts(black: float, uneven: bool) -> None:
    """Parts say nothing of it, however large a part of all light that gets through it is."""
    light, slow = (one * CODES / 4.0 for one in (2.0 * black, BELIEVED))
    error = told(BELIEVED, black=(black, 1.5 * black), uneven=uneven)
    assert error is not None
    assert 0.7 * UNSURE_SLOW_LIGHT * light / (light + slow) < error < 0.6


def test_one_cell_that_is_much_brighter_does_not_decide() -> None:
    real = np.full(CELLS, 1.4 * BELIEVED)
    real[100] = BELIEVED
    error = told(real, bright=(100,))
    assert error is None or error > 0.3


def test_codes_that_follow_each_other_alike_in_all_parts_tell_nothing() -> None:
    recipe = recipe_of()
    photos = photos_of(recipe, BELIEVED)
    alike = {name: np.full(CELLS, 0.5) for name in photos.slow}
    assert not estimate_slow_light_errors(recipe, photos.averaged, alike)
    assert not estimate_slow_light_errors(recipe, photos.averaged, {})


def test_without_a_white_photo_or_enough_parts_nothing_is_told() -> None:
    assert told(BELIEVED, recipe=recipe_of(white=False)) is None
    assert told(BELIEVED, recipe=recipe_of(2)) is None
