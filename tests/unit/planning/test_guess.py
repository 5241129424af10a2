"""Guesses for unknown scenes against codes made and applied to a scene that is as guessed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.planning.guess import ScenePrior, guess_plan
from pdcd.planning.make import make_plan
from pdcd.planning.outlook import RigSetting
from pdcd.planning.plan import Plan
from pdcd.planning.rehearse import simulate_plan
from pdcd.protocol.request import CaptureRequest
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.scene import Scene
from tests import bench_rig

GRID = (24, 32)
PATHS = 20
INDIRECT = 0.3


def random_scene() -> Scene:
    """Every cell alike: direct light 0.7, and 0.3 from 20 cells drawn at random."""
    rng = np.random.default_rng(5)
    cells = GRID[0] * GRID[1]
    transport = np.zeros((cells, cells))
    for n in range(cells):
        others = np.delete(np.arange(cells), n)
        transport[n, rng.choice(others, PATHS, replace=False)] = INDIRECT / PATHS
        transport[n, n] = 1.0 - INDIRECT
    return Scene("random", GRID, split_into_effects(transport))


def setting(folder: Path, **tables: Any) -> RigSetting:
    config: Config = bench_rig.config(folder, camera=CameraConfig(noise="full"), **tables)
    engine = Engine.from_config(config)
    return RigSetting(config, engine._rig.look_at_camera(), engine._profile)


def compare(rig: RigSetting, **fields: Any) -> tuple[float, float]:
    """Errors of the codes, guessed and rehearsed (means over three seeds)."""
    prior = ScenePrior(paths=PATHS, indirect=INDIRECT)
    scene = random_scene()
    found = []
    for seed in range(3):
        request = CaptureRequest(seed=seed, **fields)
        plan: Plan = make_plan(request, rig.config, GRID)
        known = simulate_plan(plan, rig, scene, normalise="auto", seed=seed).judge(100, 1)
        found.append((guess_plan(plan, rig, prior).judge(100, 1).code, known.code))
    guessed, rehearsed = np.mean(found, axis=0)
    return float(guessed), float(rehearsed)


@pytest.mark.parametrize("family", ["bernoulli", "balanced", "hadamard"])
@pytest.mark.parametrize("goal", ["indirect", "direct"])
def test_formulas_for_indirect_light(goal: str, family: str, tmp_path: Path) -> None:
    rig = setting(tmp_path)
    code, known = compare(rig, goal=goal, codes=64, family=family)
    assert code == pytest.approx(known, rel=0.1)


@pytest.mark.parametrize(
    ("family", "p"),
    [
        ("bernoulli", 0.25),
        ("balanced", 0.25),
        ("balanced", 0.5),
        ("hadamard", 0.5),
        ("hadamard", 0.25),
        ("rademacher", 0.5),
    ],
)
def test_formulas_for_a_fraction(family: str, p: float, tmp_path: Path) -> None:
    rig = setting(tmp_path)
    code, known = compare(rig, goal="fraction", p=p, codes=64, family=family)
    assert code == pytest.approx(known, rel=0.1)


@pytest.mark.parametrize(("goal", "program"), [("indirect", "coded"), ("white", "")])
def test_sensor_noise_at_a_known_contrast(goal: str, program: str, tmp_path: Path) -> None:
    """Metering rounds the aperture by 1/3 stop, so the noise by up to an eighth."""
    rig = setting(tmp_path)
    request = CaptureRequest(goal=goal, codes=256, white=False)  # type: ignore[arg-type]
    plan = make_plan(request, rig.config, GRID)
    known = simulate_plan(plan, rig, random_scene(), normalise="auto", seed=0)
    shot = next(s for s in plan.recipe.shots if s.program == program)
    brightest_e = known.light[shot.name] * rig.camera.responsivity_e.max()
    contrast = known.metered_e[program] / float(np.sqrt(np.mean(brightest_e**2)))
    guessed = guess_plan(plan, rig, ScenePrior(PATHS, INDIRECT, contrast)).judge(100, 1)
    assert guessed.sensor == pytest.approx(known.judge(100, 1).sensor, rel=0.13)


def test_direct_light_that_slow_panels_let_in(tmp_path: Path) -> None:
    slow = PanelConfig(size_px=(1600, 1200), rise_s=0.002, fall_s=0.006)
    rig = setting(tmp_path, mask=slow)
    code, known = compare(rig, goal="indirect", codes=64, guards=False)
    assert known > 0.1  # far more than the codes alone
    assert code == pytest.approx(known, rel=0.15)


@pytest.mark.parametrize(
    ("goal", "leaks"),
    [("indirect", True), ("direct", True), ("fraction", False), ("white", False)],
)
def test_only_photos_without_direct_light_are_spoilt_by_some(
    goal: str, leaks: bool, tmp_path: Path
) -> None:
    slow = PanelConfig(size_px=(1600, 1200), rise_s=0.002, fall_s=0.006)
    rig = setting(tmp_path, mask=slow)
    fields: dict[str, Any] = {"p": 0.25} if goal == "fraction" else {}
    request = CaptureRequest(goal=goal, codes=64, guards=False, **fields)  # type: ignore[arg-type]
    found = guess_plan(make_plan(request, rig.config, GRID), rig, ScenePrior())
    assert found.leak > 0.05 if leaks else found.leak == 0.0


def test_black_exposures_take_a_leak_off_what_is_guessed(tmp_path: Path) -> None:
    rig = setting(tmp_path, mask=PanelConfig(size_px=(1600, 1200), contrast=100.0))
    leaks = {}
    for level in ("none", "ambient", "mask", "both"):
        request = CaptureRequest(goal="indirect", codes=16, black_level=level)
        leaks[level] = guess_plan(make_plan(request, rig.config, (6, 8)), rig, ScenePrior()).leak
    assert leaks["none"] > 0.05 and leaks["ambient"] == leaks["none"]
    assert leaks["mask"] < 1e-9 and leaks["both"] < 1e-9
