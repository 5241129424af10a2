"""Error bars: what the spread of parts says, and what the model predicts for a single photo."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.pictures.bars import add_known_errors
from pdcd.pictures.picture import Picture
from pdcd.pictures.quad_samples import QuadSample
from pdcd.pictures.sigma import (
    estimate_quad_shares,
    measure_error_bars,
    to_quad_errors,
)
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.words import GoalName

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
        picture = measure_error_bars(mean(parts), parts)
        covered.append(np.mean(np.abs(picture.image - truth) <= 1.96 * picture.sigma))
    assert np.mean(covered) == pytest.approx(0.95, abs=0.012)


def test_what_the_sensor_explains_is_not_counted_twice() -> None:
    truth, noise = np.ones(SHAPE), 0.05
    parts = parts_of(truth, np.full(SHAPE, noise), 8, 0)
    picture = measure_error_bars(mean(parts, noise), parts)
    assert picture.kind == "measured"
    np.testing.assert_array_equal(picture.sensor, noise)
    assert np.sqrt(np.mean(picture.sigma**2)) == pytest.approx(noise, rel=0.15)
    np.testing.assert_allclose(picture.sigma, np.hypot(picture.sensor, picture.code))


def test_equal_parts_have_no_code_error() -> None:
    parts = parts_of(np.ones(SHAPE), np.zeros(SHAPE), 4, 0)
    assert np.all(measure_error_bars(mean(parts), parts).sigma == 0.0)


def test_parts_that_agree_by_chance_amid_others_that_do_not() -> None:
    """All parts miss the light of one pixel, in a patch that errs; the rest hardly does."""
    truth, error = np.ones(SHAPE), np.full(SHAPE, 0.001)
    error[8:13, 8:13] = 0.2
    parts = parts_of(truth, error, 4, 0)
    for part in parts:
        part[10, 10] = 0.0
    found = measure_error_bars(mean(parts), parts)
    assert np.all(np.std(parts, axis=0)[10, 10] == 0.0)
    assert np.all(np.abs(found.image - truth)[10, 10] < 20.0 * found.sigma[10, 10])
    away = np.ones(SHAPE[:2], np.bool_)
    away[7:14, 7:14] = False
    assert np.median(found.sigma[away]) < 0.005


def test_saturated_pixels_stay_unknown() -> None:
    parts = parts_of(np.ones(SHAPE), np.full(SHAPE, 0.1), 4, 0)
    whole = mean(parts)
    whole.sigma[3, 4] = np.inf
    picture = measure_error_bars(whole, parts)
    assert np.all(np.isinf(picture.sigma[3, 4]))
    assert np.isfinite(picture.sigma).sum() == picture.sigma.size - 3
    assert np.all(np.isfinite(picture.code))


@pytest.mark.parametrize(
    ("goal", "kinds"),
    [
        ("indirect", {"indirect": "sensor", "white": "whole", "direct": "sensor"}),
        ("white", {"white": "whole"}),
    ],
)
def test_one_exposure_has_the_noise_alone_and_says_whether_codes_err(
    goal: GoalName, kinds: dict[str, str]
) -> None:
    shape = (3, 4)
    recipe = make_recipe(Target(Goal(name=goal), shape), CaptureScheme(codes=8))
    image = np.full((*shape, 3), 0.5)
    whole = {name: Picture(image, 0.02 * image) for name in recipe.pictures}
    found = add_known_errors(recipe, whole)
    assert {name: one.kind for name, one in found.items() if name in kinds} == kinds
    for one in found.values():
        assert not one.code.any() and np.array_equal(one.sigma, one.sensor)


def test_cells_without_quads_that_tell_err_as_all_others_do() -> None:
    """Sums over squares of cells leave rounding there, and that over rounding is any number; with
    no error at all photos of two benches of a stranger were covered to 83 to 93 %."""
    rng, grid = np.random.default_rng(5), (12, 12)
    cell = np.repeat(np.flatnonzero(np.arange(144) % 12 < 4), 9)  # the left third is seen
    none = np.zeros(0, dtype=np.int64)
    picked = QuadSample(slice(0), none, np.zeros((0, 0), np.bool_), cell, none.reshape(2, 0), grid)
    light = [1e3 * rng.uniform(0.5, 1.5, (cell.size, 3)) for _ in range(5)]
    noise = [np.zeros((cell.size, 3))] * 5
    share = estimate_quad_shares(light, noise, picked)
    found = to_quad_errors(share / len(light), np.ones((*grid, 3)))
    assert 0.05 < found[:, :3].min() and found.max() < 0.3
    mean = np.sqrt(np.mean(found[:, :3] ** 2))
    np.testing.assert_allclose(found[:, 6:], mean, rtol=0.1)
