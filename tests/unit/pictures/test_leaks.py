"""Leaks foreseen from dark photos, against a dense sum over a bench that leaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.leaks import (
    DarkPhotoLight,
    LeakAnswer,
    ShotMeans,
    make_leak_answers,
    predict_photo_variances,
)
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.sensor.cells import CellMap

GRID = (6, 8)
CELLS = CellMap.block(GRID, GRID)
N = GRID[0] * GRID[1]
CODES = 48
REFRESH_S = 1.0 / 60.0
LIT = 3
"""Refreshes in which the projector is lit for each one that the mask is open in: guards."""


def bench(
    ambient: float, leak: float, black: float, seed: int = 0
) -> tuple[
    dict[str, ExposedShot], dict[str, float], DarkPhotoLight, DarkPhotoLight, np.ndarray, np.ndarray
]:
    """White and coded photos summed refresh by refresh, without any of pdcd's optics; dark photos
    of the same bench; and the indirect photo as it is and as it should be."""
    rng = np.random.default_rng(seed)
    transport = 0.02 * rng.random((N, N)) + np.diag(0.5 + rng.random(N))
    around = ambient * (0.5 + rng.random((N, 1))) * np.ones(3)
    lit = rng.random((CODES, N)) < 0.5
    left, right, light = [], [], np.zeros((N, 3))
    true_off = transport - np.diag(np.diag(transport))
    for code in lit:
        shown = np.where(code, 1.0, black)
        for open_, refreshes in ((~code, 1), (np.zeros(N, bool), LIT - 1)):
            gate = np.where(open_, 1.0, leak)
            seconds = refreshes * REFRESH_S
            light += seconds * gate[:, None] * ((transport @ shown)[:, None] + around)
        left.append((~code) * REFRESH_S)
        right.append(code * 1.0)
    factors = Factors(np.array(left), np.array(right), np.zeros(N), np.sum(left, axis=0))
    shots = {"coded": exposed(light, factors)}
    weight = float(np.mean((factors.left.T @ factors.right)[~np.eye(N, dtype=bool)]))
    lit_s = {"coded": LIT * REFRESH_S * float(lit.sum(axis=1).mean()) * CODES / N}
    nothing = np.zeros((N, 3))
    everything = transport.sum(axis=1)[:, None] * np.ones(3)
    open_light = DarkPhotoLight(around + black * everything, nothing)
    closed_light = DarkPhotoLight(leak * everything, nothing)
    return shots, lit_s, open_light, closed_light, light / weight, true_off.sum(axis=1)


def exposed(light: np.ndarray, factors: Factors) -> ExposedShot:
    image = light.reshape(*GRID, 3)
    none = np.zeros(GRID, np.bool_)
    return ComputedShot(image, np.zeros_like(image), none, factors, {})


def answer(shots: dict[str, ExposedShot], lit_s: dict[str, float]) -> LeakAnswer:
    recipe = make_recipe(Target(Goal(name="indirect"), GRID), CaptureScheme(white=False))
    (found,) = make_leak_answers(
        recipe, ShotMeans.of(recipe, shots, CELLS), lit_s, normalise="scalar"
    )
    return found


def relative(image: np.ndarray, clean: np.ndarray) -> float:
    return float(np.sqrt(np.mean((image - clean) ** 2) / np.mean(clean**2)))


def test_ambient_light_is_foreseen_exactly() -> None:
    """L2: its part of a photo is that of the time for which the mask was open."""
    clean = bench(0.0, 0.0, 0.0)[4]
    shots, lit_s, ambient, _, image, _ = bench(0.3, 0.0, 0.0)
    foreseen = answer(shots, lit_s).ambient(ambient)
    assert foreseen == pytest.approx(relative(image, clean), rel=1e-9)
    assert foreseen > 0.5


@pytest.mark.parametrize(("leak", "black"), [(1 / 300, 0.0), (0.0, 1 / 300)])
def test_leaking_panels_are_foreseen_as_a_bound(leak: float, black: float) -> None:
    """L1 and L3: never less than it is, and not much more."""
    clean = bench(0.0, 0.0, 0.0)[4]
    shots, lit_s, ambient, mask, image, _ = bench(0.0, leak, black)
    found = answer(shots, lit_s)
    foreseen = found.mask(mask) if leak else found.ambient(ambient)
    other = found.ambient(ambient) if leak else found.mask(mask)
    assert other == 0.0
    assert 1.0 <= foreseen / relative(image, clean) < 1.5


def test_one_dark_photo_of_both_is_a_bound_of_either() -> None:
    shots, lit_s, ambient, mask, _, _ = bench(0.01, 1 / 300, 1 / 500)
    found = answer(shots, lit_s)
    whole = DarkPhotoLight(ambient.light + mask.light, ambient.variance + mask.variance)
    assert found.most(whole) > found.both(ambient, mask) > found.mask(mask) > 0.0


def test_noise_is_no_leak() -> None:
    """The square of noise does not vanish in a mean: it is taken off, and no bench without leaks is
    accused of one."""
    shots, lit_s, _, _, _, _ = bench(0.0, 0.0, 0.0)
    found = answer(shots, lit_s)
    rng = np.random.default_rng(1)
    for _ in range(20):
        noise = DarkPhotoLight(0.01 * rng.standard_normal((N, 3)), np.full((N, 3), 1e-4))
        assert found.ambient(noise) == 0.0
        assert found.floor(noise) > 0.0


@pytest.mark.parametrize("share", [1.0, -0.5])
def test_the_noise_of_ambient_light_is_that_of_a_photo_and_its_black_exposure(share: float) -> None:
    """Against the sum over cells: shot noise of a photo's light, and of its ambient part again."""
    electron = 1e-7
    shots, _, ambient, _, image, clean = bench(0.3, 0.0, 0.0)
    one = shots["coded"]
    assert isinstance(one, ComputedShot)
    noisy = replace(one, variance=electron * one.light)
    recipe = make_recipe(Target(Goal(name="indirect"), GRID), CaptureScheme(white=False))
    recipe = replace(recipe, pictures={"indirect": ((share, "coded"),)})
    found = predict_photo_variances(
        recipe, ShotMeans.of(recipe, {"coded": noisy}, CELLS), ambient, normalise="scalar"
    )
    light = one.light.reshape(N, 3)
    weight = float(np.mean(light / image))
    black = one.realised.open_s[:, None] * ambient.light
    wanted = electron * float(np.mean(light + black)) / weight**2 / float(np.mean(clean**2))
    assert list(found) == ["coded"]
    assert found["coded"] == pytest.approx(wanted, rel=0.05)


def test_an_answer_of_extremes_has_no_such_noise() -> None:
    ambient = bench(0.3, 0.0, 0.0)[2]
    recipe = make_recipe(Target(Goal(name="split", period=2), GRID), CaptureScheme())
    means = ShotMeans({}, {}, np.ones(N, np.bool_))
    assert predict_photo_variances(recipe, means, ambient, normalise="scalar") == {}
