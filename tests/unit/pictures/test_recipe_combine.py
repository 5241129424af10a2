"""Goals, recipes and the arithmetic of photos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.picture import Picture, combine_photos
from pdcd.probing.deviation import weight_s
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Extremes, Rule
from pdcd.sensor.cells import CellMap
from tests.combined import combine_shots

GRID = (1, 3)
CELLS = CellMap.block(GRID, GRID)
INDIRECT = Target(Goal(name="indirect"), GRID)
OFF = np.ones((3, 3)) - np.eye(3)


def exposed(matrix: np.ndarray, light: float, *, blown: bool = False) -> ExposedShot:
    n = matrix.shape[0]
    factors = Factors(np.eye(n), matrix.astype(float), np.diag(matrix).astype(float), np.ones(n))
    image = np.full((1, n, 3), light)
    return ComputedShot(image, np.full((1, n, 3), 4.0), np.full((1, n), blown), factors, {})


def test_direct_scales_each_photo_by_its_own_weight() -> None:
    """Erratum X9: the indirect photo weighs a quarter as much; unscaled subtraction is wrong."""
    shots = {"white": exposed(np.ones((3, 3)) * 2.0, 10.0), "coded": exposed(OFF * 0.5, 2.0)}
    pictures = combine_shots(
        make_recipe(Target(Goal(name="direct"), GRID), CaptureScheme()), shots, CELLS
    )
    assert list(pictures) == ["direct", "white", "indirect"]
    np.testing.assert_allclose(pictures["white"].image, 5.0)
    np.testing.assert_allclose(pictures["indirect"].image, 4.0)
    np.testing.assert_allclose(pictures["direct"].image, 1.0)
    # sigma 2 over weights 2 and 0.5, added in squares
    np.testing.assert_allclose(pictures["direct"].sigma, np.hypot(1.0, 4.0))


def test_saturated_pixels_have_infinite_sigma() -> None:
    shots = {
        "white": exposed(np.ones((3, 3)), 1.0, blown=True),
        "coded": exposed(OFF, 1.0),
    }
    pictures = combine_shots(make_recipe(INDIRECT, CaptureScheme()), shots, CELLS)
    assert np.all(np.isinf(pictures["white"].sigma))
    assert np.all(np.isfinite(pictures["indirect"].sigma))
    assert np.all(np.isinf(pictures["direct"].sigma))


def test_no_light_at_all_is_an_error() -> None:
    with pytest.raises(DecodeError, match="no light"):
        combine_shots(
            make_recipe(INDIRECT, CaptureScheme(white=False)),
            {"coded": exposed(np.zeros((3, 3)), 0.0)},
            CELLS,
        )


def test_row_weights_divide_each_cell_by_its_own() -> None:
    recipe = make_recipe(Target(Goal(name="long-range", radius=0), GRID), CaptureScheme())
    uneven = OFF * np.array([[1.0], [2.0], [4.0]])
    shot = exposed(uneven, 0.0)
    shot.light[...] = uneven.sum(axis=1)[None, :, None]
    image = combine_shots(recipe, {"far": shot}, CELLS)["long-range"].image
    np.testing.assert_allclose(image, 2.0)


def single(image: float, sigma: float) -> Picture:
    return Picture(np.full((1, 2, 3), image), np.full((1, 2, 3), sigma))


def pictures_by(rule: Rule, photos: dict[str, Picture]) -> Picture:
    """What a rule makes of scaled photos."""
    recipe = make_recipe(INDIRECT, CaptureScheme(white=False))
    return combine_photos(replace(recipe, pictures={"it": rule}), photos)["it"]


def test_errors_grow_with_the_factors_of_a_sum() -> None:
    """Variances with their squares: 0.5 x 4 and -3 x 1 make sqrt(2^2 + 3^2)."""
    got = pictures_by(((0.5, "a"), (-3.0, "b")), {"a": single(2.0, 4.0), "b": single(1.0, 1.0)})
    np.testing.assert_allclose(got.image, -2.0)
    np.testing.assert_allclose(got.sigma, np.sqrt(13.0))


def test_extremes_are_unknown_where_any_photo_is_saturated() -> None:
    """Also one that was neither the largest nor the smallest: it may have been brighter."""
    photos = {"a": single(1.0, 0.1), "b": single(3.0, 0.1), "c": single(2.0, 0.1)}
    photos["c"].sigma[0, 1] = np.inf
    got = pictures_by(Extremes(1.0, -1.0, ("a", "b", "c")), photos)
    np.testing.assert_allclose(got.image, 2.0)
    np.testing.assert_allclose(got.sigma[0, 0], np.hypot(0.1, 0.1))
    assert np.all(np.isinf(got.sigma[0, 1]))


def test_cells_without_a_weight_of_their_own_are_divided_by_the_common_one() -> None:
    """The mask over the last cell never opened: noise, by the weight of all, not by nothing."""
    matrix = OFF * np.array([[2.0], [2.0], [0.0]])
    shots = {"coded": exposed(matrix, 4.0)}
    recipe = make_recipe(INDIRECT, CaptureScheme(white=False))
    common = weight_s(shots["coded"].realised, recipe.photos[0].wanted)
    image = combine_shots(recipe, shots, CELLS, normalise="row")["indirect"].image
    np.testing.assert_allclose(image[0, :2], 2.0)
    np.testing.assert_allclose(image[0, 2], 4.0 / common)
