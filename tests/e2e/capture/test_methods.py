"""The ways without a mask through the whole chain, on scenes that suit them and that do not."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.sampled import sampled
from tests.taken import take_with

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]
GRID = (4, 6)
ROWS, COLS = GRID
N = ROWS * COLS


def scene(folder: Path, transport: Floats) -> SceneConfig:
    np.savez(folder / "t.npz", transport=transport, grid=np.array(GRID))
    return SceneConfig(kind="matrix", path=str(folder / "t.npz"))


def engine_on(folder: Path, transport: Floats, **tables: Any) -> Engine:
    """Pixels of both panels end where cells end, so that no quad sees parts of others."""
    tables = {**bench_rig.fitting(GRID), **tables}
    engine = Engine.from_config(bench_rig.config(folder, scene=scene(folder, transport), **tables))
    engine.start()
    return engine


def take(engine: Engine, **fields: Any) -> tuple[Floats, CaptureResult]:
    made = take_with(engine, make_job_id(), **fields)
    return made.image, made.result


def relative(image: Floats, truth: Floats) -> float:
    error = image - truth.reshape(*GRID, 1)
    return float(np.sqrt(np.mean(error**2) / np.mean(truth**2)))


def test_a_code_that_lights_no_cell(tmp_path: Path) -> None:
    """Grids of four cells have one among eight codes."""
    t = bench_rig.transport((1, 4))
    np.savez(tmp_path / "t.npz", transport=t, grid=np.array((1, 4)))
    where = SceneConfig(kind="matrix", path=str(tmp_path / "t.npz"))
    engine = Engine.from_config(bench_rig.config(tmp_path, scene=where))
    engine.start()
    image, _ = take(engine, goal="indirect", method="multi-image", codes=8)
    truth = t.sum(axis=1) - np.diag(t)
    np.testing.assert_allclose(image[..., 1].ravel(), truth, rtol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("goal", ["indirect", "direct", "fraction"])
def test_multi_image_is_exact_with_more_codes_than_cells(goal: str, tmp_path: Path) -> None:
    t = bench_rig.transport(GRID)
    direct = np.diag(t)
    indirect = t.sum(axis=1) - direct
    p = {"p": 0.25} if goal == "fraction" else {}
    truth = {"indirect": indirect, "direct": direct, "fraction": direct + 0.25 * indirect}[goal]
    engine = engine_on(tmp_path, t)
    image, result = take(engine, goal=goal, method="multi-image", codes=32, **p)
    assert relative(image, truth) < 1e-3
    assert result.summary["rms_error_quads"] == pytest.approx(relative(image, truth), rel=1e-6)
    assert result.summary["shots"] == 32 and result.folder is not None
    assert decode_folder(Path(result.folder)).identical
    for name, deviation in read_manifest(Path(result.folder)).realised.items():
        assert deviation["off_rms"] < 1e-6, name


@pytest.mark.long
def test_multi_image_survives_leaking_and_drifting_panels(tmp_path: Path) -> None:
    """Photos of one refresh each differ in time; each is scaled by what its panels really did."""
    t = bench_rig.transport(GRID)
    panels = {name: bench_rig.DEFECTS[name] for name in ("projector", "mask")}
    engine = engine_on(tmp_path, t, **panels)
    image, result = take(engine, goal="direct", method="multi-image", codes=32)
    assert relative(image, np.diag(t)) < 5e-3
    assert result.folder is not None and decode_folder(Path(result.folder)).identical


@pytest.mark.long
def test_sigma_of_multi_image_is_what_noise_does(tmp_path: Path) -> None:
    t = bench_rig.transport(GRID)
    clean = engine_on(tmp_path, t)
    exact, _ = take(clean, goal="indirect", method="multi-image", codes=32)
    noisy = engine_on(tmp_path, t, camera=CameraConfig(noise="full"))
    image, result = take(noisy, goal="indirect", method="multi-image", codes=32)
    assert result.folder is not None
    with np.load(Path(result.folder) / "probe.npz") as data:
        z = (image - exact) / data["sigma_sensor"]
    assert np.std(z) == pytest.approx(1.0, abs=0.2)


@pytest.mark.long
def test_the_papers_masked_sum_is_a_further_picture(tmp_path: Path) -> None:
    t = bench_rig.transport(GRID)
    engine = engine_on(tmp_path, t)
    fields = {"goal": "indirect", "method": "multi-image", "codes": 32, "family": "bernoulli"}
    errors = []
    for seed in range(4):
        _, result = take(engine, seed=seed, **fields)
        assert result.folder is not None
        pictures = (
            Darkroom(Path(result.folder), read_manifest(Path(result.folder)).run).decoded().pictures
        )
        assert list(pictures) == ["indirect", "white", "direct", "masked"]
        truth = t.sum(axis=1) - np.diag(t)
        errors.append([relative(pictures[n].image, truth) for n in ("indirect", "masked")])
    fitted, masked = np.mean(errors, axis=0)
    assert fitted < 0.7 * masked


def test_nayar_is_exact_for_constant_indirect_light(tmp_path: Path) -> None:
    """All cells light all cells alike, their own included: what comes back into the own cell is
    light that left it, to this method, and one part in N of all indirect light."""
    rng = np.random.default_rng(2)
    glow = 0.01
    t = np.diag(0.2 + 0.5 * rng.random(N)) + glow
    engine = engine_on(tmp_path, t)
    image, result = take(engine, goal="indirect", method="nayar", codes=32)
    assert result.summary["shots"] == 8 and result.folder is not None
    assert relative(image, np.full(N, N * glow)) < 1e-3
    image, _ = take(engine, goal="direct", method="nayar", codes=32)
    assert relative(image, np.diag(t) - glow) < 1e-3
    assert decode_folder(Path(result.folder)).identical


@pytest.mark.long
def test_nayar_loses_all_of_the_light_of_a_mirror(tmp_path: Path) -> None:
    """A mirror that lights every cell from one other: the error is all of that light (100 %),
    where codes on both panels and multi-image have none."""
    partner = np.arange(N).reshape(GRID)[:, ::-1].ravel()
    t = 0.5 * np.eye(N)
    t[np.arange(N), partner] = 0.2
    truth = np.full(N, 0.2)
    engine = engine_on(tmp_path, t)
    errors = {}
    for method in ("coded", "multi-image", "nayar"):
        # Windows that cut cells would lose light that goes from cell to cell.
        image, result = take(engine, goal="indirect", method=method, codes=32, window="whole")
        errors[method] = relative(image, truth)
        assert result.summary["rms_error_quads"] == pytest.approx(errors[method], rel=1e-6)
    assert errors["nayar"] == pytest.approx(1.0, abs=0.01)
    assert max(errors["coded"], errors["multi-image"]) < 2e-3


@pytest.mark.parametrize(
    ("method", "window"),
    sampled(list(product(["multi-image", "nayar"], ["whole", "quarter"])), 3),
)
def test_the_plan_says_what_the_run_takes(method: str, window: str, tmp_path: Path) -> None:
    engine = engine_on(tmp_path, bench_rig.transport(GRID))
    fields = {"goal": "indirect", "method": method, "codes": 16, "window": window}
    request = msgspec.convert({**fields, "exposure_s": 1.7}, CaptureRequest)
    plan = engine.plan(request)
    result = bench_rig.capture(engine, request)
    assert result.folder is not None, result.error
    assert plan.raw_files == result.summary["shots"] == {"multi-image": 16, "nayar": 8}[method]
    assert plan.refreshes == result.summary["refreshes"] == 96  # two passes over 16 codes of three
    assert plan.seconds == pytest.approx(result.summary["exposure_s"], rel=0.6)
    assert plan.light_share == pytest.approx(0.5 / 3.0, abs=1e-3)


def test_black_exposures_of_checkers(tmp_path: Path) -> None:
    """Ambient light is in all photos and would be taken for indirect light."""
    t = bench_rig.transport(GRID)
    lit = msgspec.structs.replace(scene(tmp_path, t), ambient=0.3)
    images = {}
    for name, level, where in (("dark", "none", scene(tmp_path, t)), ("lit", "ambient", lit)):
        (tmp_path / name).mkdir()
        engine = Engine.from_config(bench_rig.config(tmp_path / name, scene=where))
        engine.start()
        images[name], result = take(engine, goal="indirect", method="nayar", black_level=level)
        assert result.summary["shots"] == (8 if level == "none" else 16)
    np.testing.assert_allclose(images["lit"], images["dark"], atol=5e-3)
