"""The split of indirect light into sharp and smooth (Figure 10), and its error bar."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import RequestError
from pdcd.pictures.exposed import ComputedShot
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target, check_target
from pdcd.recipes.make import make_recipe
from pdcd.sensor.cells import CellMap
from tests import bench_rig
from tests.combined import combine_shots
from tests.taken import Taken, take

GRID = (3, 8)
N = GRID[0] * GRID[1]


def parts() -> tuple[Any, Any, Any]:
    """Direct light (N,), a permutation with weights (N, N), and smooth light (N, N).

    Smooth rows are constant over every 4 columns; a cell's own block gets none, as its own light
    is not indirect.
    """
    rng = np.random.default_rng(7)
    direct = 0.3 + rng.random(N)
    sharp = np.zeros((N, N))
    sharp[np.arange(N), np.roll(rng.permutation(N), 1)] = 0.2 + rng.random(N)
    np.fill_diagonal(sharp, 0.0)
    blocks = rng.random((N, N // 4)) * 0.05
    blocks[np.arange(N), np.arange(N) // 4] = 0.0
    return direct, sharp, blocks.repeat(4, axis=1)


def capture(folder: Path, **fields: Any) -> Taken:
    direct, sharp, smooth = parts()
    path = folder / "split.npz"
    np.savez(path, transport=np.diag(direct) + sharp + smooth, grid=np.array(GRID))
    scene = SceneConfig(kind="matrix", path=str(path))
    rig = bench_rig.config(folder, grid=GRID, scene=scene)
    return take(rig, goal="split", codes=64, period=4, **fields)


@pytest.mark.parametrize("black_level", ["none", "mask"])
def test_split_is_exact_for_a_permutation_and_smooth_light(
    black_level: Any, tmp_path: Path
) -> None:
    made = capture(tmp_path, black_level=black_level)
    _, sharp, smooth = parts()
    truths = {"high": sharp, "low": smooth, "indirect": sharp + smooth}
    scale = (sharp + smooth).sum(axis=1).max()
    for name, matrix in truths.items():
        truth = matrix.sum(axis=1).reshape(*GRID, 1)
        assert np.abs(made.picture(name) - truth).max() < 2e-3 * scale, name
    assert made.error < 1e-3
    assert made.summary["shots"] == (4 if black_level == "none" else 8)
    assert made.decodes_the_same()


def test_split_under_an_illumination_keeps_its_share_of_the_light(tmp_path: Path) -> None:
    """Half light everywhere halves both pictures."""
    made = capture(tmp_path, illumination=((0.5,) * 8,) * 3)
    _, sharp, smooth = parts()
    for name, matrix in (("high", sharp), ("low", smooth)):
        truth = 0.5 * matrix.sum(axis=1).reshape(*GRID, 1)
        assert np.abs(made.picture(name) - truth).max() < 2e-3 * truth.max(), name


@pytest.mark.parametrize("period", [None, 2, 6, 12])
def test_periods_that_cannot_be_quartered_are_refused(period: int | None) -> None:
    with pytest.raises(RequestError, match="period"):
        check_target(Target(Goal(name="split", period=period), GRID))


def test_sigma_of_the_split_is_that_of_the_chosen_photos() -> None:
    """high = max - min: sqrt(var_max + var_min); low = 2 min: 2 sigma_min; inf if any is blown."""
    recipe = make_recipe(Target(Goal(name="split", period=4), (1, 4)), CaptureScheme())
    values, variances = (3.0, 1.0, 2.0, 2.5), (9.0, 4.0, 100.0, 100.0)
    shots = {}
    for photo, value, variance in zip(recipe.photos, values, variances, strict=True):
        pi = photo.wanted.dense()
        light = np.full((1, 4, 3), value)
        blown = np.array([[False, False, False, photo.name == "stripes-2"]])
        factors = Factors(np.eye(4), pi, np.diag(pi).copy(), np.ones(4))
        shots[photo.name] = ComputedShot(light, np.full((1, 4, 3), variance), blown, factors, {})
    pictures = combine_shots(recipe, shots, CellMap.block((1, 4), (1, 4)))
    np.testing.assert_allclose(pictures["high"].image[:, :3], 2.0)
    np.testing.assert_allclose(pictures["high"].sigma[:, :3], np.sqrt(9.0 + 4.0))
    np.testing.assert_allclose(pictures["low"].image[:, :3], 2.0)
    np.testing.assert_allclose(pictures["low"].sigma[:, :3], 4.0)
    for name in ("high", "low", "indirect"):
        assert np.all(np.isinf(pictures[name].sigma[:, 3]))
