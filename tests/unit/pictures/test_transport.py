"""Entries of T out of photos of an S-matrix: exact without noise, and no noisier than told."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.transport import draw_transport_slice, solve_transport_slice
from pdcd.probing.panel import PanelOptics
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.recipe import Recipe
from pdcd.recipes.transport import count_slice_photos, make_s_matrix
from pdcd.recipes.transport import make_transport_recipe as recipe_of_slice
from pdcd.sensor.cells import CellMap
from tests import catalogue_rig

GRID = (4, 6)
N = 24
T = catalogue_rig.transport(N, seed=8)
ROWS = (1, 2)
PANELS = {
    "ideal": (PanelOptics(), PanelOptics()),
    "slow and leaking": (
        PanelOptics(0.002, 0.004, 1 / 200),
        PanelOptics(0.006, 0.003, 1 / 80, 2_000_000),
    ),
}


def recipe_of(rows: tuple[int, int] | None = ROWS, masked: bool | None = None) -> Recipe:
    return recipe_of_slice(
        Target(Goal(name="transport", rows=rows, masked=masked), GRID), CaptureScheme()
    )


def photos(
    recipe: Recipe, panels: tuple[PanelOptics, PanelOptics], ambient: float = 0.0
) -> dict[str, ExposedShot]:
    """What the panels do is the program's own; the light is that of a known matrix."""
    program = recipe.programs["lights"]
    lights, masks = program.projector, program.camera  # type: ignore[attr-defined]
    grid = recipe.target.grid
    scene = catalogue_rig.scene_of(T[: grid[0] * grid[1], : grid[0] * grid[1]], grid, ambient)
    found: dict[str, ExposedShot] = {}
    for k, shot in enumerate(recipe.shots):
        realised = catalogue_rig.show(
            lights[[k]], masks[[k]], grid, projector=panels[0], mask=panels[1]
        )
        seen = scene.photo(realised.left, realised.right, realised.coaxial, realised.open_s)
        light = seen.reshape(*grid, 3)
        found[shot.name] = ComputedShot(
            light, np.full(light.shape, 1e-4), np.zeros(grid, np.bool_), realised, {}
        )
    return found


@pytest.mark.parametrize("masked", [None, True])
@pytest.mark.parametrize("name", PANELS)
def test_a_slice_is_that_of_the_matrix(name: str, masked: bool | None) -> None:
    """Fig. 5: to round-off, light of the room and of black pixels included."""
    recipe = recipe_of(masked=masked)
    found = solve_transport_slice(
        recipe, photos(recipe, PANELS[name], ambient=0.3), CellMap.block(GRID, GRID)
    )
    wanted = T.reshape(*GRID, *GRID)[ROWS[1], :, ROWS[0], :]
    for colour in range(3):
        np.testing.assert_allclose(found.entries[..., colour], wanted, rtol=1e-9, atol=1e-11)
    assert found.uneven < 1e-12 and found.photos == len(recipe.shots) == 11
    truth = np.repeat(wanted[..., None], 3, axis=2)
    assert found.rms_error(truth) < 1e-9
    assert found.rms_error(1.1 * truth) == pytest.approx(0.1 / 1.1)


@pytest.mark.parametrize("ambient", [0.0, 0.3])
def test_the_share_of_light_that_comes_whatever_is_shown(ambient: float) -> None:
    """Against photos of the same patterns in the dark, over the row that is looked at."""
    recipe, ideal = recipe_of(), PANELS["ideal"]
    row = [shot.light[ROWS[1]].sum() for shot in photos(recipe, ideal, ambient).values()]
    dark = [shot.light[ROWS[1]].sum() for shot in photos(recipe, ideal).values()]
    found = solve_transport_slice(recipe, photos(recipe, ideal, ambient), CellMap.block(GRID, GRID))
    assert found.common == pytest.approx(1.0 - np.sum(dark) / np.sum(row), abs=1e-12)
    assert (found.common > 0.05) == (ambient > 0.0)


def test_all_of_a_matrix_on_a_small_grid() -> None:
    recipe = recipe_of(rows=None)
    found = solve_transport_slice(
        recipe, photos(recipe, PANELS["ideal"]), CellMap.block(GRID, GRID)
    )
    np.testing.assert_allclose(found.entries[..., 1], T, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("name", PANELS)
@pytest.mark.parametrize("grid", [(3, 1), (2, 2), (4, 3)])
def test_patterns_of_few_cells_of_which_some_are_dark(grid: tuple[int, int], name: str) -> None:
    """S-matrices have more rows than these slices have cells: one lights none of them."""
    assert not make_s_matrix(grid[1]).any(axis=1).all()
    recipe = recipe_of_slice(Target(Goal(name="transport", rows=(0, 1)), grid), CaptureScheme())
    found = solve_transport_slice(
        recipe, photos(recipe, PANELS[name], ambient=0.3), CellMap.block(grid, grid)
    )
    wanted = T[grid[1] : 2 * grid[1], : grid[1]]
    np.testing.assert_allclose(found.entries[..., 1], wanted, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("cells", [6, 32, 57, 64])
def test_noise_is_that_of_an_s_matrix(cells: int) -> None:
    """Harwit and Sloane: a variance of 4 K / (K + 1)^2 of one photo's, K being the photos. What all
    have in common is fitted too: with s columns left over, of 4 / (K + 1) times 1 + 1 / s."""
    lit = make_s_matrix(cells)
    count = len(lit)
    assert count == count_slice_photos(cells) and np.all(lit.sum(axis=0) == (count + 1) // 2)
    grid = (1, cells)
    target = Target(Goal(name="transport", rows=(0, 0)), grid)
    recipe = recipe_of_slice(target, CaptureScheme())
    shots = {}
    for k, shot in enumerate(recipe.shots):
        realised = catalogue_rig.show(lit[[k]], np.ones((1, cells)), grid, guards=False)
        light, variance = np.zeros((*grid, 3)), np.full((*grid, 3), 2.0)
        shots[shot.name] = ComputedShot(light, variance, np.zeros(grid, np.bool_), realised, {})
    found = solve_transport_slice(recipe, shots, CellMap.block(grid, grid))
    variance = (found.sigma * catalogue_rig.REFRESH_S) ** 2 / 2.0
    np.testing.assert_allclose(variance, 4.0 / (count + 1) * (1.0 + 1.0 / (count - cells)))
    assert variance.max() <= 1.25 * 4.0 / (count + 1) * (1.0 + 1e-9)


def test_a_saturated_cell_is_unknown_and_black_in_the_picture() -> None:
    recipe = recipe_of()
    shots = photos(recipe, PANELS["ideal"])
    blown = np.zeros(GRID, np.bool_)
    blown[ROWS[1], 3] = True
    first = recipe.shots[0].name
    shots[first] = ComputedShot(
        shots[first].light, shots[first].variance, blown, shots[first].realised, {}
    )
    found = solve_transport_slice(recipe, shots, CellMap.block(GRID, GRID))
    assert np.isinf(found.sigma[3]).all() and np.isfinite(np.delete(found.sigma, 3, axis=0)).all()
    drawn = draw_transport_slice(found, "T")
    side = 107  # 640 px over 6 cells, rounded up
    assert drawn.shape[1] == 6 * side and not drawn[3 * side : 4 * side].any()
    assert drawn[:side].any()


def test_photos_without_light_are_no_slice() -> None:
    recipe = recipe_of()
    shots = photos(recipe, PANELS["ideal"])
    dark = catalogue_rig.show(np.zeros((1, N)), np.ones((1, N)), GRID)
    shots[recipe.shots[2].name] = ComputedShot(
        np.zeros((*GRID, 3)), np.ones((*GRID, 3)), np.zeros(GRID, np.bool_), dark, {}
    )
    with pytest.raises(DecodeError, match="no light"):
        solve_transport_slice(recipe, shots, CellMap.block(GRID, GRID))
