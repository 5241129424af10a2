"""How far light of slow panels is off, as parts tell: photos of a dense transport."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.arrays import Floats
from pdcd.bench.tables import PanelConfig
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


def averaged_of(recipe: Recipe, real: Floats | float, halves: int = 1) -> AveragedShots:
    """The photos of a recipe where that share is really `real`, on a scene with ten times more
    direct than indirect light; each cell is seen by so many quads, across and down."""
    random = np.random.default_rng(3)
    transport = random.gamma(0.3, size=(CELLS, CELLS)) / CELLS
    direct = 10.0 * 0.3 * random.uniform(0.2, 1.8, CELLS)
    np.fill_diagonal(transport, 0.0)
    frame = GRID[0] * halves, GRID[1] * halves

    def shot(light: Floats, left: Floats, right: Floats, coaxial: Floats) -> ComputedShot:
        image = np.repeat(np.repeat(light.reshape(GRID), halves, 0), halves, 1)[..., None]
        dark = np.zeros(frame, np.bool_)
        factors = Factors(left, right, coaxial, left.sum(axis=0))
        return ComputedShot(image, np.zeros_like(image), dark, factors, {})

    shots = {}
    for photo in recipe.photos:
        for _, name in photo.shots:
            if photo.wanted.uniform == (1.0, 1.0):
                one = np.ones((1, CELLS))
                shots[name] = shot(transport.sum(axis=1) + direct, one, one, one[0])
                continue
            lit = random.integers(0, 2, (CODES, CELLS)).astype(np.float64)
            shut = 1.0 - lit
            after = np.sum(lit[1:] * shut[:-1], axis=0)
            light = np.sum(shut * (lit @ transport.T), axis=0) + real * after * direct
            light *= 1.0 + 0.002 * random.normal(size=CELLS)
            shots[name] = shot(light, shut, lit, BELIEVED * after)
    return AveragedShots(
        shots, CellMap(grid=GRID, frame=frame, map=Map.filling(frame[::-1])), np.array([], int)
    )


def told(
    real: Floats | float, *, recipe: Recipe | None = None, halves: int = 1, **panel: Any
) -> float | None:
    mask = PanelConfig(size_px=(64, 48), **panel)
    record: Any = SimpleNamespace(mask=mask, projector=PanelConfig(size_px=(64, 48)), room=None)
    recipe = recipe or recipe_of()
    found = estimate_slow_light_errors(record, recipe, averaged_of(recipe, real, halves))
    return found.get(next(p.name for p in recipe.photos if p.wanted.uniform == (0.0, 1.0)))


@pytest.mark.parametrize("halves", [1, 2])
def test_light_that_is_as_believed_is_told_to_be_so(halves: int) -> None:
    error = told(BELIEVED, halves=halves)
    assert error is not None and error < 0.1


@pytest.mark.parametrize("times", [0.6, 1.4, 2.5, 0.0])
def test_light_that_is_off_is_told_by_how_much(times: float) -> None:
    assert told(times * BELIEVED) == pytest.approx(abs(times - 1.0), rel=0.3)


def test_light_that_is_off_in_some_rows_alone_is_not_lost_in_the_mean() -> None:
    real = np.full(GRID, BELIEVED)
    real[:4], real[8:] = 1.4 * BELIEVED, 0.6 * BELIEVED
    rms = np.sqrt(np.mean((real / BELIEVED - 1.0) ** 2))
    assert told(real.ravel()) == pytest.approx(rms, rel=0.3)


def test_parts_say_nothing_of_black_that_is_not_black_or_without_a_white_photo() -> None:
    none, some, all_of_it = (told(BELIEVED, contrast=one) for one in (None, 10.0, 1.0))
    assert none is not None and some is not None and none < some
    assert all_of_it == UNSURE_SLOW_LIGHT
    assert told(BELIEVED, recipe=recipe_of(white=False)) is None
