"""Forecasts of errors against codes that are made and applied, and noise that is drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.codes.make import make_codes
from pdcd.planning.predict import (
    PhotoCodes,
    PredictedError,
    RigSetting,
    SceneLight,
    measure_scene_light,
    predict_error,
)
from pdcd.sensor.profile import expose_sensor, load_profile
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.presets import find_builder
from pdcd.virtual.scene.scene import Scene
from pdcd.words import FamilyName
from tests.unit.planning.test_measured import config

GRID = (12, 16)
CELLS = 192
PATHS, INDIRECT = 2, 0.3
COUNT = 32


def random_transport() -> NDArray[np.float64]:
    """Every cell alike: direct light 0.7, and 0.3 from two cells drawn at random."""
    rng = np.random.default_rng(5)
    transport = (1.0 - INDIRECT) * np.eye(CELLS)
    for n in range(CELLS):
        others = np.delete(np.arange(CELLS), n)
        transport[n, rng.choice(others, PATHS, replace=False)] = INDIRECT / PATHS
    return transport


TRANSPORT = random_transport()
ALIKE = SceneLight(
    "alike",
    np.full((CELLS, 3), 1.0 - INDIRECT),
    np.full((CELLS, 3), INDIRECT),
    squares=INDIRECT**2 / PATHS,
)


def rig(tables: Config | None = None) -> RigSetting:
    camera = CameraInfo("", "", "modern", np.array([40.0, 10.0, 20.0]), (100,), ())
    return RigSetting(
        tables or config(camera={"noise": "full"}), camera, load_profile("modern"), 0.0
    )


def shown(goal: str, family: FamilyName = "hadamard", p: float = 0.5, **more: bool) -> PhotoCodes:
    return PhotoCodes(goal, family, p, GRID, COUNT, exposure_s=2.0, lit_s=1.0, **more)


def error_of_codes(goal: str, family: FamilyName, p: float) -> float:
    """RMS error over the RMS of the truth, by sums over codes, cells and 24 seeds."""
    own = np.diag(TRANSPORT)
    others = TRANSPORT.sum(axis=1) - own
    squares = []
    for seed in range(24):
        dual: Literal["same", "complement"] = "same" if goal == "fraction" else "complement"
        codes = make_codes(family, GRID, COUNT, dual=dual, p=p, seed=seed)
        image = (codes.dual * (codes.primal @ TRANSPORT.T)).sum(axis=0)
        weight = p * COUNT if goal == "fraction" else p * (1.0 - p) * COUNT
        truth = own + p * others if goal == "fraction" else others
        squares.append(np.mean((image / weight - truth) ** 2) / np.mean(truth**2))
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.parametrize(
    ("goal", "family", "p"),
    [
        ("indirect", "bernoulli", 0.5), ("indirect", "rademacher", 0.5),
        ("indirect", "balanced", 0.5), ("indirect", "hadamard", 0.5),
        ("fraction", "bernoulli", 0.25), ("fraction", "balanced", 0.25),
        ("fraction", "hadamard", 0.5),
    ],
)  # fmt: skip
def test_codes_err_as_the_formulas_say(goal: str, family: FamilyName, p: float) -> None:
    found = predict_error(shown(goal, family, p), ALIKE, rig(), 100)
    assert found.code == pytest.approx(error_of_codes(goal, family, p), rel=0.1)


def test_as_many_columns_as_cells_are_never_shared() -> None:
    assert predict_error(replace(shown("indirect"), count=256), ALIKE, rig(), 100).code == 0.0


def test_white_light_has_no_codes_and_direct_light_the_error_of_the_indirect() -> None:
    white, direct, indirect = (
        predict_error(shown(goal), ALIKE, rig(), 100) for goal in ("white", "direct", "indirect")
    )
    assert white.code == 0.0
    assert direct.code == pytest.approx(indirect.code * INDIRECT / (1.0 - INDIRECT))
    # Both photos are metered alike, and each is as noisy as it is bright.
    noise = np.hypot(white.sensor, INDIRECT * indirect.sensor)
    assert direct.sensor == pytest.approx(noise / (1.0 - INDIRECT))


def test_noise_is_that_of_a_picture_with_its_brightest_sample_metered() -> None:
    """Half of the wanted light, or all of it, as stops of a third have it: 0.89 on average."""
    picture = np.linspace(0.2, 1.0, CELLS)[:, None] * np.array([1.0, 0.8, 0.9])
    light = replace(ALIKE, indirect=picture)
    setting = rig()
    profile, gain = setting.profile, setting.profile.row(100).gain_e_per_dn
    seen = picture * setting.camera.responsivity_e
    spread = []
    for stop in 2.0 ** -np.linspace(0.0, 1.0 / 3.0, 9):
        dn = stop * 0.6 * profile.saturation_dn(100) / seen.max() * seen
        mosaic = np.repeat(dn[:, [0, 1, 1, 2]].T * gain, 64, axis=1)
        drawn = expose_sensor(mosaic, profile, 100, 2.0, np.random.default_rng(3)).astype(float)
        red, green, green2, blue = drawn.reshape(4, CELLS, 64)
        quads = np.stack([red, 0.5 * (green + green2), blue], axis=1)
        spread.append(np.mean(quads.var(axis=2) * (picture / dn) ** 2) / np.mean(picture**2))
    found = predict_error(shown("indirect"), light, setting, 100)
    assert found.sensor == pytest.approx(np.sqrt(np.mean(spread)), rel=0.02)


def test_a_camera_without_noise_rounds() -> None:
    quiet = predict_error(shown("white"), ALIKE, rig(config(camera={"noise": "none"})), 100)
    assert 0.0 < quiet.sensor < 0.1 * predict_error(shown("white"), ALIKE, rig(), 100).sensor


def scene_of(name: str) -> Scene:
    build = find_builder(name)
    assert build is not None
    return build(GRID, {})


def test_figures_of_a_scene_are_sums_over_all_its_paths() -> None:
    light = measure_scene_light(Scene("r", GRID, split_into_effects(TRANSPORT)), "random")
    paths = TRANSPORT - np.diag(np.diag(TRANSPORT))
    assert light.squares == pytest.approx(INDIRECT**2 / PATHS)
    np.testing.assert_allclose(light.indirect, np.tile(paths.sum(axis=1)[:, None], 3))
    assert light.rough is not None and light.smooth is not None and light.weak is not None
    assert light.rough[0] + light.smooth[0] == pytest.approx(np.mean(paths**2))
    row, column = np.divmod(np.arange(CELLS), GRID[1])
    apart = np.rint(np.hypot(row[:, None] - row, column[:, None] - column))
    beyond = np.mean(paths[apart >= 6.0] ** 2)
    assert light.rough[6] + light.smooth[6] == pytest.approx(beyond)
    strongest = -np.sort(-(paths**2), axis=0)  # by the cell that is lit
    assert light.weak[15] == pytest.approx(strongest[15:].mean())


def test_smooth_light_errs_less_than_sharp_light_and_least_in_parts() -> None:
    even = Scene("even", GRID, split_into_effects(np.full((CELLS, CELLS), 1e-3) + np.eye(CELLS)))
    smooth, mirror = (
        measure_scene_light(scene, "") for scene in (even, scene_of("mirror-and-vase"))
    )
    for light, left in ((smooth, 0.4), (mirror, 1.0)):
        assert light.rough is not None and light.smooth is not None
        whole = replace(light, rough=light.rough + light.smooth, smooth=0.0 * light.smooth)
        all_of_it = predict_error(shown("indirect"), whole, rig(), 100).code
        single = predict_error(shown("indirect"), light, rig(), 100).code
        parts = predict_error(shown("indirect", split=True), light, rig(), 100).code
        assert single == pytest.approx(left * all_of_it, rel=0.03)
        assert parts <= single
    assert predict_error(shown("indirect", split=True), smooth, rig(), 100).code < 1e-6


def test_codes_that_follow_a_prior_spare_the_strongest_paths() -> None:
    light = measure_scene_light(scene_of("mirror-and-vase"), "")
    plain, guided = (
        predict_error(shown("indirect", guided=guided), light, rig(), 100).code
        for guided in (False, True)
    )
    assert guided < 0.1 * plain


def test_errors_of_exposures_fall_as_they_add_up() -> None:
    one = PredictedError(0.03, 0.04, CELLS)
    assert one.error == pytest.approx(0.05)
    assert one.repeated(4).error == pytest.approx(np.hypot(0.03, 0.02))
    assert replace(one, split=True).repeated(4).error == pytest.approx(0.025)
    assert one.bound(0.5) == pytest.approx(0.05)
    assert one.bound(0.9) < one.bound(0.99)
