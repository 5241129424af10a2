"""Complement pairs: direct, indirect and all light out of two exposures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.planning.make import make_plan
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.sensor.cells import CellMap
from pdcd.verdict.answer import judge_pair_sum
from pdcd.verdict.causes import Grade
from tests import bench_rig
from tests.combined import combine_shots

GRID = (3, 4)
N = 12
SLOT_S = 0.05


def photographed(config: Config, *, drift: float = 1.0) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Pictures out of photos that are summed code by code, and the transport; the lamp of the
    second exposure is `drift` times as bright."""
    request = CaptureRequest(goal="indirect", codes=16, method="pairs", black_level="none")
    plan = make_plan(request, config, GRID)
    transport = bench_rig.transport(GRID)
    shots = {}
    for name in ("coded", "same"):
        primal, dual = (
            np.unpackbits(np.asarray(p, np.uint8), axis=1, count=N).astype(np.float64)
            for p in plan.patterns[name]
        )
        lamp = drift if name == "same" else 1.0
        light = SLOT_S * lamp * sum(m * (transport @ i) for i, m in zip(primal, dual, strict=True))
        coaxial = SLOT_S * (primal * dual).sum(axis=0)
        factors = Factors(SLOT_S * dual, primal, coaxial, SLOT_S * dual.sum(axis=0))
        shots[name] = exposed(light, factors)
    whole = np.full(N, SLOT_S)
    flood = Factors(whole[None], np.ones((1, N)), whole, whole)
    shots["white"] = exposed(SLOT_S * transport.sum(axis=1), flood)
    found = combine_shots(plan.recipe, shots, CellMap.block(GRID, GRID), normalise="scalar")
    return {name: picture.image[..., 0].ravel() for name, picture in found.items()}, transport


def exposed(light: np.ndarray, factors: Factors) -> ExposedShot:
    image = np.repeat(light.reshape(*GRID, 1), 3, axis=2)
    return ComputedShot(image, np.full_like(image, 1e-6), np.zeros(GRID, np.bool_), factors, {})


def test_two_exposures_make_direct_indirect_and_all_light(tmp_path: Path) -> None:
    """Hadamard codes, more of them than cells: exact, against the transport itself."""
    pictures, transport = photographed(bench_rig.config(tmp_path))
    assert list(pictures) == ["indirect", "white", "direct", "floodlit"]
    direct = np.diag(transport)
    np.testing.assert_allclose(pictures["direct"], direct, rtol=1e-9)
    np.testing.assert_allclose(pictures["indirect"], transport.sum(axis=1) - direct, rtol=1e-9)
    np.testing.assert_allclose(pictures["white"], pictures["floodlit"], rtol=1e-9)


def test_what_does_not_add_up_is_said(tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path)
    for drift, grade in ((1.0, None), (1.1, Grade.DOUBTFUL), (1.5, Grade.BAD)):
        pictures, _ = photographed(config, drift=drift)
        both, flood = (pictures[name][:, None] for name in ("white", "floodlit"))
        found = [f.grade for f in judge_pair_sum(both, flood, np.zeros_like(flood))]
        assert found == ([] if grade is None else [grade])


def test_noise_is_no_difference() -> None:
    rng = np.random.default_rng(0)
    flood = np.ones((4000, 3))
    noisy = flood + 0.1 * rng.standard_normal(flood.shape)
    assert not list(judge_pair_sum(noisy, flood, np.full_like(flood, 0.01)))


def test_the_check_may_be_left_out() -> None:
    target = Target(Goal(name="direct"), GRID)
    recipe = make_recipe(target, CaptureScheme(method="pairs", white=False))
    assert [shot.name for shot in recipe.shots] == ["coded", "same"]
    assert list(recipe.pictures) == ["direct", "indirect", "white"]


def test_black_exposures_and_parts_come_in_pairs() -> None:
    target = Target(Goal(name="indirect"), GRID)
    how = CaptureScheme(method="pairs", white=False, black_level="ambient", codes=16, parts=2)
    recipe = make_recipe(target, how)
    direct = next(photo for photo in recipe.photos if photo.name == "direct")
    assert {name: sign for sign, name in direct.shots} == {
        "same-1": 1.0, "same-1-black-primal": -1.0, "coded-1": -1.0, "coded-1-black-primal": 1.0,
        "same-2": 1.0, "same-2-black-primal": -1.0, "coded-2": -1.0, "coded-2-black-primal": 1.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    "target",
    [
        Target(Goal(name="fraction", p=0.25), GRID),
        Target(Goal(name="diagonal"), GRID),
        Target(Goal(name="indirect"), GRID, {"illumination": np.full(N, 0.5)}),
    ],
)
def test_other_goals_and_an_illumination_are_refused(target: Target) -> None:
    with pytest.raises(RequestError, match="method pairs"):
        make_recipe(target, CaptureScheme(method="pairs"))
