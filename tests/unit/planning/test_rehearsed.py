"""What a rehearsal comes to before scenes that are simple enough to count by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.errors import Cancelled
from pdcd.pictures.learn import PilotFindings
from pdcd.planning.make import make_plan
from pdcd.planning.metering import TARGET, choose_test_pairs
from pdcd.planning.outlook import RigSetting
from pdcd.planning.plan import Plan
from pdcd.planning.rehearse import PlanSimulation, predict_probing_matrix, simulate_plan
from pdcd.protocol.request import CaptureRequest
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.scene import Scene
from tests import bench_rig

GRID = (3, 4)
CELLS = 12
TRANSPORT = bench_rig.transport(GRID)
MIRROR = 0.5 * np.eye(CELLS) + 0.5 * np.eye(CELLS)[::-1]
"""Half of the light comes from the cell opposite."""
EVEN = 0.5 * np.eye(CELLS) + 0.5 / CELLS
SCENE = Scene("small", GRID, split_into_effects(TRANSPORT))


def setting(folder: Path, **tables: Any) -> RigSetting:
    camera = CameraConfig(noise="none", f_number=8.0)
    panels = {name: PanelConfig(size_px=(1600, 1200)) for name in ("projector", "mask")}
    config = bench_rig.config(folder, **{"camera": camera, **panels, **tables})
    engine = Engine.from_config(config)
    return RigSetting(config, engine._rig.look_at_camera(), engine._profile)


def plan_of(rig: RigSetting, **fields: Any) -> Plan:
    whole = {"codes": 8, "window": "whole", "guards": "none", "black_level": "none", **fields}
    return make_plan(msgspec.convert(whole, CaptureRequest), rig.config, GRID)


def rehearsed(rig: RigSetting, plan: Plan, scene: Scene = SCENE, **more: Any) -> PlanSimulation:
    return simulate_plan(plan, rig, scene, **{"normalise": "auto", "seed": 0, **more})


def rounding(rig: RigSetting, iso: int, f_number: float) -> NDArray[np.float64]:
    """Variance of developed light of a quad, (3,): a twelfth DN squared, half of it in green."""
    unit_dn = rig.camera.responsivity_e / (f_number**2 * rig.profile.row(iso).gain_e_per_dn)
    return np.asarray(np.array([1.0, 0.5, 1.0]) / 12.0 / unit_dn**2)


@pytest.mark.parametrize("passes", [1, 3])
@pytest.mark.parametrize("iso", [100, 400])
def test_a_white_photo_errs_by_rounding_alone(tmp_path: Path, iso: int, passes: int) -> None:
    rig = setting(tmp_path)
    plan = plan_of(rig, goal="white")
    view = rehearsed(rig, plan)
    white = TRANSPORT.sum(axis=1)
    seconds = plan.white_slots / 60.0
    np.testing.assert_allclose(
        view.light["white"].reshape(CELLS, 3), np.repeat(white[:, None], 3, axis=1) * seconds
    )
    np.testing.assert_allclose(view.truth.reshape(CELLS, 3)[:, 1], white)
    found = view.judge(iso, passes)
    total = 3.0 * float(np.sum(white**2))
    squares = rounding(rig, iso, 8.0) / (passes * seconds) ** 2
    assert found.code == pytest.approx(0.0, abs=1e-9)
    assert found.sensor == pytest.approx(np.sqrt(CELLS * squares.sum() / total))
    assert found.code_var == 0.0 and found.cross_var == pytest.approx(0.0, abs=1e-15)
    assert found.sensor_var == pytest.approx(2.0 * CELLS * np.sum(squares**2) / total**2)
    peak_e = passes * seconds * white.max() * rig.camera.responsivity_e.max()
    assert found.headroom == pytest.approx(TARGET * rig.full_e(iso) * 64.0 / peak_e)


def test_the_brightest_shot_decides_on_the_headroom(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    view = rehearsed(rig, plan_of(rig, goal="direct"))
    assert set(view.light) == {"white", "coded"}
    peaks = [float((x * rig.camera.responsivity_e).max()) for x in view.light.values()]
    wanted = TARGET * rig.full_e(100) * 64.0 / max(peaks)
    assert view.judge(100, 1).headroom == pytest.approx(wanted)


def test_codes_err_by_what_their_own_matrix_makes_of_the_scene(tmp_path: Path) -> None:
    """Panels at once and in step: the photo is the sum over codes of mask times light."""
    rig = setting(tmp_path)
    plan = replace(plan_of(rig, goal="indirect"), smooth=False)
    view = rehearsed(rig, plan)
    assert set(view.light) == {"coded"} and view.added == {}
    lit = np.unpackbits(np.asarray(plan.patterns["coded"][0]).astype(np.uint8), axis=1, count=CELLS)
    matrix = (1.0 - lit).T @ lit.astype(float)
    np.testing.assert_allclose(
        view.light["coded"].reshape(CELLS, 3)[:, 0],
        (matrix * TRANSPORT).sum(axis=1) / 60.0,
    )
    off = 1.0 - np.eye(CELLS)
    weight = float((matrix * off).sum() / off.sum())
    truth = (off * TRANSPORT).sum(axis=1)
    wrong = (matrix * TRANSPORT).sum(axis=1) / weight - truth
    found = view.judge(100, 1)
    code = float(np.sqrt(np.sum(wrong**2) / np.sum(truth**2)))
    assert found.code == pytest.approx(code, rel=1e-6) and code > 0.01
    total = 3.0 * float(np.sum(truth**2))
    squares = rounding(rig, 100, 8.0) * (60.0 / weight) ** 2
    assert found.sensor == pytest.approx(np.sqrt(CELLS * squares.sum() / total))
    cross = 4.0 * float(np.sum(wrong**2)) * squares.sum() / total**2
    assert found.cross_var == pytest.approx(cross)
    smooth = rehearsed(rig, replace(plan, smooth=True))
    assert set(smooth.added) == {"coded"}
    assert smooth.judge(100, 1).code != pytest.approx(code)


def test_a_dark_scene_is_no_error(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    dark = Scene("dark", GRID, split_into_effects(np.zeros((CELLS, CELLS))))
    found = rehearsed(rig, plan_of(rig, goal="white"), dark).judge(100, 1)
    assert found.code == 0.0 and np.isfinite(found.sensor)
    assert found.headroom == pytest.approx(TARGET * rig.full_e(100) * 64.0 / 1e-9)


def test_metering_expects_what_its_test_exposure_tells(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    plan = plan_of(rig, goal="indirect", codes=64)
    view = rehearsed(rig, plan)
    assert list(view.metered_e) == ["coded"]
    shot = next(shot for shot in plan.recipe.shots if shot.name == "coded")
    pairs, ratio = choose_test_pairs(plan.sequence(shot))
    primal, dual = (
        np.unpackbits(np.asarray(side[:pairs]).astype(np.uint8), axis=1, count=CELLS).astype(float)
        for side in plan.patterns["coded"]
    )
    test = (dual.T @ primal * TRANSPORT).sum(axis=1) / 60.0
    peak = float((test * ratio.ravel()).max()) * rig.camera.responsivity_e.max()
    assert pairs == 16 and view.metered_e["coded"] == pytest.approx(peak)


def test_only_what_the_answer_rests_on_is_taken_and_each_shot_is_heard(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    heard: list[int] = []
    plan = plan_of(rig, goal="indirect")
    view = rehearsed(rig, plan, alive=lambda: heard.append(1))
    assert [shot.name for shot in view.recipe.shots] == ["coded"]
    assert [photo.name for photo in view.recipe.photos] == ["coded"]
    assert list(view.recipe.pictures) == ["indirect"] and len(heard) >= 1

    def ended() -> None:
        raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        rehearsed(rig, plan, alive=ended)


@pytest.mark.parametrize(
    ("scene", "sharp"),
    [
        (Scene("mirror", GRID, split_into_effects(MIRROR)), True),
        (Scene("even", GRID, split_into_effects(EVEN)), False),
    ],
)
def test_what_a_short_pilot_finds_holds_for_other_plans(
    tmp_path: Path, scene: Scene, sharp: bool
) -> None:
    rig = setting(tmp_path)
    known: dict[tuple[int, str], PilotFindings] = {}
    plan = plan_of(rig, goal="indirect", codes=32, pilot=16)
    first = rehearsed(rig, plan, scene, known=known)
    assert list(known) == [(16, "none")]
    learned = known[16, "none"]
    assert learned.promising is sharp
    photos = [name for name in first.light if name.startswith("pilot")]
    assert photos[:4] == [f"pilot-{n:04d}" for n in (1, 2, 3, 4)]
    assert len(photos) == (16 if learned.promising else 4)
    again = rehearsed(rig, plan, scene, known=known)
    assert known[16, "none"] is learned
    assert not any(name.startswith("pilot") for name in again.light)
    alone = rehearsed(rig, plan, scene)
    assert set(alone.light) == set(first.light)
    if not learned.promising:
        assert first.plan.how.pilot == 4 and first.plan.how.coded == 28
        assert again.plan.how.coded == 28
    found = first.judge(100, 1), again.judge(100, 1)
    assert found[0].code == pytest.approx(found[1].code)


def test_shots_are_foreseen_as_long_as_they_are_planned(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    plan = plan_of(rig, goal="indirect")
    coded = next(shot for shot in plan.recipe.shots if shot.name == "coded")
    whole, first = (
        predict_probing_matrix(plan, coded, rig.config),
        predict_probing_matrix(plan, coded, rig.config, 3),
    )
    lit, opened = (
        np.unpackbits(np.asarray(side).astype(np.uint8), axis=1, count=CELLS).astype(float)
        for side in plan.patterns["coded"]
    )
    for found, count in ((whole, 8), (first, 3)):
        matrix = opened[:count].T @ lit[:count] / 60.0
        np.testing.assert_allclose(found.left.T @ found.right, matrix, atol=1e-12)
        np.testing.assert_allclose(found.open_s, opened[:count].sum(axis=0) / 60.0, atol=1e-12)
        np.testing.assert_allclose(found.coaxial, np.diag(matrix), atol=1e-12)
