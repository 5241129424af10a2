"""Error bars: what the spread of parts says, and what the model predicts for a single photo."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.special
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.pictures.bars import barred_by_model
from pdcd.pictures.combine import scaled_photos
from pdcd.pictures.exposed import Print
from pdcd.pictures.picture import Picture, pictures_of
from pdcd.pictures.sigma import _inverse_trigamma, code_error, measured
from pdcd.probing.deviation import row_deviations
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import Goal, How
from pdcd.recipes.goals import Target
from pdcd.recipes.make import recipe_of
from pdcd.recipes.programs import Far
from pdcd.sensor.cells import CellMap
from tests import bench_rig

SHAPE = (24, 32, 3)


def parts_of(
    truth: np.ndarray, error: np.ndarray, count: int, seed: int
) -> list[NDArray[np.float64]]:
    """Independent normal estimates of `truth`; the mean of all has the standard error `error`."""
    rng = np.random.default_rng(seed)
    spread = error * np.sqrt(count)
    return [truth + spread * rng.normal(size=truth.shape) for _ in range(count)]


def mean(parts: list[NDArray[np.float64]], sensor: float = 0.0) -> Picture:
    image = np.mean(parts, axis=0)
    return Picture(image, np.full(image.shape, sensor))


@pytest.mark.parametrize("count", [4, 8, 16])
@pytest.mark.parametrize("kind", ["even", "uneven", "edge"])
def test_measured_sigma_covers_the_truth(kind: str, count: int) -> None:
    """Errors alike everywhere, of every size side by side, and with a jump in the light."""
    rng = np.random.default_rng(1)
    truth = np.ones(SHAPE)
    error = np.full(SHAPE, 0.1)
    if kind == "uneven":
        error *= np.sqrt(6.0 / rng.chisquare(6.0, size=SHAPE))
    if kind == "edge":
        truth[:, 16:] = 0.01
        error[:, 16:] = 0.001
    covered = []
    for seed in range(10):
        parts = parts_of(truth, error, count, seed)
        picture = measured(mean(parts), parts)
        covered.append(np.mean(np.abs(picture.image - truth) <= 1.96 * picture.sigma))
    assert np.mean(covered) == pytest.approx(0.95, abs=0.012)


def test_what_the_sensor_explains_is_not_counted_twice() -> None:
    truth, noise = np.ones(SHAPE), 0.05
    parts = parts_of(truth, np.full(SHAPE, noise), 8, 0)
    picture = measured(mean(parts, noise), parts)
    assert picture.kind == "measured"
    np.testing.assert_array_equal(picture.sensor, noise)
    assert np.sqrt(np.mean(picture.sigma**2)) == pytest.approx(noise, rel=0.15)
    np.testing.assert_allclose(picture.sigma, np.hypot(picture.sensor, picture.code))


def test_equal_parts_have_no_code_error() -> None:
    parts = parts_of(np.ones(SHAPE), np.zeros(SHAPE), 4, 0)
    assert np.all(measured(mean(parts), parts).sigma == 0.0)


def test_parts_that_agree_by_chance_amid_others_that_do_not() -> None:
    """All parts miss the light of one pixel, in a patch that errs; the rest hardly does."""
    truth, error = np.ones(SHAPE), np.full(SHAPE, 0.001)
    error[8:13, 8:13] = 0.2
    parts = parts_of(truth, error, 4, 0)
    for part in parts:
        part[10, 10] = 0.0
    found = measured(mean(parts), parts)
    assert np.all(np.std(parts, axis=0)[10, 10] == 0.0)
    assert np.all(np.abs(found.image - truth)[10, 10] < 20.0 * found.sigma[10, 10])
    away = np.ones(SHAPE[:2], np.bool_)
    away[7:14, 7:14] = False
    assert np.median(found.sigma[away]) < 0.005


def test_saturated_pixels_stay_unknown() -> None:
    parts = parts_of(np.ones(SHAPE), np.full(SHAPE, 0.1), 4, 0)
    whole = mean(parts)
    whole.sigma[3, 4] = np.inf
    picture = measured(whole, parts)
    assert np.all(np.isinf(picture.sigma[3, 4]))
    assert np.isfinite(picture.sigma).sum() == picture.sigma.size - 3
    assert np.all(np.isfinite(picture.code))


@pytest.mark.parametrize("value", [1e-3, 0.1, 1.0, 30.0, 1e4])
def test_inverse_trigamma(value: float) -> None:
    assert scipy.special.polygamma(1, _inverse_trigamma(value)) == pytest.approx(value)


def test_row_deviations_are_those_of_the_dense_matrix() -> None:
    rng = np.random.default_rng(3)
    left, right, coaxial = rng.random((5, 12)), rng.random((5, 12)), rng.random(12)
    realised = Factors(left, right, coaxial, np.ones(12))
    rows = row_deviations(realised, bench_rig.uniform((3, 4), 0.0, 1.0), 2.0)
    dense = left.T @ right / 2.0 - 1.0
    off = [np.delete(dense[n], n) for n in range(12)]
    np.testing.assert_allclose(rows[0], [np.mean(o) for o in off])
    np.testing.assert_allclose(rows[1], [np.var(o) for o in off])
    np.testing.assert_allclose(rows[2], coaxial / 2.0)


@pytest.mark.parametrize("sources", [4, 16])
def test_the_model_finds_the_variance_of_random_codes(sources: int) -> None:
    """Light of each cell from `sources` others at random: (S^2 + 2 Q) / K, Q = S^2 / sources."""
    grid, count = (24, 24), 64
    n = grid[0] * grid[1]
    rng = np.random.default_rng(sources)
    codes = make_codes("bernoulli", grid, count, dual="complement", seed=5).primal
    left, right = (~codes).astype(np.float64), codes.astype(np.float64)
    weight = 0.25 * count
    realised = Factors(left, right, np.zeros(n), np.ones(n))
    mean_, variance, _ = row_deviations(realised, bench_rig.uniform(grid, 0.0, 1.0), weight)
    transport = np.zeros((n, n))
    for cell in range(n):
        others = np.delete(np.arange(n), cell)
        transport[cell, rng.choice(others, sources, replace=False)] = 1.0 / sources
    image = np.sum(left.T @ right / weight * transport, axis=1).reshape(*grid, 1)
    picture = Picture(image, np.zeros_like(image))
    fixed, spread = (a.reshape(*grid, 1) for a in (mean_**2, variance))
    predicted = code_error(picture, fixed, spread, n)
    theory = np.sqrt((1.0 + 2.0 / sources) / count)
    assert np.sqrt(np.mean(predicted**2)) == pytest.approx(theory, rel=0.15)
    assert np.sqrt(np.mean((image - 1.0) ** 2)) == pytest.approx(theory, rel=0.15)


def test_the_model_is_silent_where_codes_are_exact() -> None:
    image = np.random.default_rng(0).random(SHAPE)
    nothing = np.zeros((*SHAPE[:2], 1))
    assert not code_error(Picture(image, 0 * image), nothing, nothing, 768).any()


def test_texture_that_a_white_photo_shows_is_no_error() -> None:
    rng = np.random.default_rng(0)
    paper = rng.choice([0.2, 1.0], size=SHAPE)
    picture = Picture(0.3 * paper, np.zeros(SHAPE))
    fixed, spread = np.zeros((*SHAPE[:2], 1)), np.full((*SHAPE[:2], 1), 0.1)
    alone = code_error(picture, fixed, spread, 768)
    beside = code_error(picture, fixed, spread, 768, white=paper)
    # Texture alone looks like light from few cells; without it nothing speaks against all of them.
    assert np.mean(alone**2) == pytest.approx(768 / 4 * np.mean(beside**2))


def test_direct_light_left_by_the_codes_counts_by_its_square() -> None:
    """Every cell is to see the others alone, and sees 0.3 of itself: an error of 0.3 of the light
    that it has."""
    shape = (1, 3)
    matrix = np.ones((3, 3)) - 0.7 * np.eye(3)
    realised = Factors(np.eye(3), matrix, np.full(3, 0.3), np.ones(3))
    image = np.full((*shape, 3), 2.0)
    shots = {"coded": Print(image, 0.0 * image, image[..., 0] < 0.0, realised, {})}
    recipe = recipe_of(Target(Goal(name="indirect"), shape), How(white=False))
    cells = CellMap.block(shape, shape)
    photos = scaled_photos(recipe, shots, cells)
    weight = float(image[0, 0, 0] / photos["coded"].image[0, 0, 0])
    found = barred_by_model(recipe, shots, photos, pictures_of(recipe, photos), cells)["indirect"]
    light = float(photos["coded"].image[0, 0, 0])
    mean, variance, diagonal = row_deviations(realised, recipe.photos[0].wanted, weight)
    assert diagonal == pytest.approx(0.3 / weight) and variance.max() < 1e-15
    np.testing.assert_allclose(found.code, light * np.hypot(mean[0], diagonal[0]), rtol=1e-6)


def test_a_photo_that_keeps_a_share_of_direct_light_shows_no_more_of_it() -> None:
    """Fig. 8 with a shift, of a scene of direct light alone: sigma is the true error of weights
    that codes gave it by chance."""
    grid, p, count = (12, 16), 0.125, 48
    n = grid[0] * grid[1]
    partner = np.roll(np.arange(n), 5)
    bits = make_codes("balanced", grid, count, dual="same", p=p, seed=1).primal
    right, left = bits.astype(np.float64), bits[:, partner].astype(np.float64)
    light = np.repeat((left * right).sum(axis=0)[:, None], 3, axis=1)
    shape = (*grid, 3)
    realised = Factors(left, right, (left * right).sum(axis=0), left.sum(axis=0))
    shot = Print(light.reshape(shape), np.zeros(shape), np.zeros(grid, np.bool_), realised, {})
    goal = Target(Goal(name="fraction", p=p), grid, planes={"warp": partner.astype(np.float64)})
    recipe = recipe_of(goal, How(family="balanced", white=False))
    shots, cells = {"coded": shot}, CellMap.block(grid, grid)
    photos = scaled_photos(recipe, shots, cells)
    whole = pictures_of(recipe, photos)
    truth = float(recipe.photos[0].wanted.diagonal()[0])
    error = np.sqrt(np.mean((whole["fraction"].image - truth) ** 2))
    found = barred_by_model(recipe, shots, photos, whole, cells)["fraction"]
    assert 0.7 < float(np.sqrt(np.mean(found.sigma**2)) / error) < 1.5


@pytest.mark.parametrize("sources", [1, 96])
def test_bars_of_far_light_by_the_weight_of_each_cell(sources: int) -> None:
    """T2.3 by its own codes, single sharp paths and light of many cells: sigma is the true error,
    held against a dense sum."""
    grid, radius = (18, 24), 1
    n = grid[0] * grid[1]
    row, col = np.divmod(np.arange(n), grid[1])
    beyond = np.maximum(abs(row[:, None] - row), abs(col[:, None] - col)) > radius
    rng = np.random.default_rng(3)
    transport = np.zeros((n, n))
    for cell in range(n):
        away = np.flatnonzero(beyond[cell])
        transport[cell, rng.choice(away, sources, replace=False)] = 1.0 / sources
    bits = make_codes("balanced", grid, 120, dual="same", p=0.1, seed=1).primal
    primal, dual = Far(radius).pairs(bits, Lattice(grid, "whole"))
    left, right = dual.astype(np.float64), primal.astype(np.float64)
    light = np.repeat(((left.T @ right) * transport).sum(axis=1)[:, None], 3, axis=1)
    shape = (*grid, 3)
    realised = Factors(left, right, np.zeros(n), left.sum(axis=0))
    shot = Print(light.reshape(shape), np.zeros(shape), np.zeros(grid, np.bool_), realised, {})
    how = How(family="balanced")
    recipe = recipe_of(Target(Goal(name="long-range", radius=radius), grid), how)
    shots, cells = {"far": shot}, CellMap.block(grid, grid)
    photos = scaled_photos(recipe, shots, cells)
    whole = pictures_of(recipe, photos)
    error = np.sqrt(np.mean((whole["long-range"].image - 1.0) ** 2))
    found = barred_by_model(recipe, shots, photos, whole, cells)["long-range"]
    assert 0.8 < float(np.sqrt(np.mean(found.sigma**2)) / error) < 1.3
