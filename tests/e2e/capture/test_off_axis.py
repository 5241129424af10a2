"""Depths through the whole chain: a bench whose camera is off the projector's axis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.api.run import open_run
from pdcd.bench.tables import CameraConfig, PanelConfig, RigConfig, SceneConfig, ScheduleConfig
from pdcd.capture.engine import Engine
from pdcd.panels.placing import Placing
from pdcd.pictures.decode import decode_folder
from pdcd.runs.folder import read_manifest
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.scene import Scene
from pdcd.words import WindowName
from tests import bench_rig
from tests.sampled import sampled
from tests.taken import take_with

GRID = (12, 16)
N = 192


def engine_of(folder: Path, kind: str, options: dict[str, Any], **tables: Any) -> Engine:
    given = {
        "rig": RigConfig(arrangement="off-axis"),
        "scene": SceneConfig(kind=kind, grid=GRID, options=options),
        **tables,
    }
    engine = Engine.from_config(bench_rig.config(folder, **given))
    engine.start()
    return engine


def run(engine: Engine, job: str = "job", **fields: Any) -> tuple[Array, Path, dict[str, Any]]:
    made = take_with(engine, job, **fields)
    return made.image, made.folder, made.summary


def parts(scene: Scene) -> tuple[Array, Array, Array]:
    """Direct and indirect pictures (rows, cols, 3), and the disparity of each cell, by the dense
    transport of the scene."""
    direct = sum(e.tint[:, None, None] * e.dense() for e in scene.effects[:3])
    shape = (*GRID, 3)
    one = np.asarray(direct).sum(axis=2).T.reshape(shape)
    whole = scene.dense().sum(axis=2).T.reshape(shape)
    assert scene.displacement is not None
    return one, whole - one, scene.displacement[:, 1].reshape(GRID)


@pytest.mark.parametrize("window", sampled(["whole", "quarter"], 2))
def test_fig11_a_box_at_the_keyed_depth_is_gone_and_the_wall_stays(
    window: WindowName, tmp_path: Path
) -> None:
    disparity = 1
    engine = engine_of(
        tmp_path, "off-axis-box", {"disparity": disparity}, schedule=ScheduleConfig(window=window)
    )
    image, folder, summary = run(
        engine, goal="keyed", codes=128, disparity=[disparity, disparity], seed=1
    )
    direct, indirect, moved = parts(bench_rig.bench_of(engine).scene)
    front = np.isclose(moved, disparity)
    assert front.sum() > 8
    left = np.abs((image - indirect)[front]).sum() / direct[front].sum()
    assert left < 0.005
    away = moved < disparity - 1
    assert away.sum() > 60
    kept = (image - direct - indirect)[away]
    assert np.sqrt(np.mean(kept**2) / np.mean((direct + indirect)[away] ** 2)) < 0.02
    assert decode_folder(folder).identical
    goal = read_manifest(folder).run.goal
    assert goal.name == "keyed" and goal.disparity == (disparity, disparity)
    # Quarter windows keep a quarter cell dark where the floor passes through the depth.
    assert summary["rms_error_quads"] < (0.02 if window == "whole" else 0.08)


def test_light_that_leaking_panels_leave_of_the_blocked_is_told(tmp_path: Path) -> None:
    sizes = {"projector": (1024, 768), "mask": (1600, 1200)}
    panels = {name: PanelConfig(size_px=size, contrast=30.0) for name, size in sizes.items()}
    engine = engine_of(
        tmp_path,
        "off-axis-box",
        {"disparity": 1},
        schedule=ScheduleConfig(window="whole"),
        **panels,
    )
    image, _, summary = run(
        engine, goal="keyed", codes=128, disparity=[1, 1], black_level="none", seed=1
    )
    direct, indirect, moved = parts(bench_rig.bench_of(engine).scene)
    wanted = indirect + direct * ~np.isclose(moved, 1.0)[..., None]
    left = np.sqrt(np.sum((image - wanted)[np.isclose(moved, 1.0)] ** 2) / np.sum(image**2))
    assert left > 0.1
    assert summary["quality"].verdict != "good"
    assert any("light that should be blocked" in text for text in summary["quality"].reasons)


def test_k5_the_rigs_plane_keys_a_wall_that_is_elsewhere(tmp_path: Path) -> None:
    """The wall has a disparity of -2 cells here: the homography of its plane moves by as much."""
    plane = (1.0, 0.0, -2.0 / 16.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    engine = engine_of(
        tmp_path, "off-axis-box", {}, rig=RigConfig(arrangement="off-axis", plane=plane)
    )
    image, folder, _ = run(engine, goal="keyed", codes=128)
    direct, indirect, moved = parts(bench_rig.bench_of(engine).scene)
    wall = np.isclose(moved, -2.0)
    assert wall.sum() > 30
    assert np.abs((image - indirect)[wall]).sum() < 0.005 * direct[wall].sum()
    box = np.isclose(moved, 0.0)
    np.testing.assert_allclose(image[box], (direct + indirect)[box], rtol=0.03, atol=2e-3)
    # The run knows its plane itself, and is decoded without the configuration.
    assert read_manifest(folder).run.goal.plane == plane
    assert decode_folder(folder).identical


@pytest.mark.long
def test_stereo_and_epipolar_through_the_chain(tmp_path: Path) -> None:
    engine = engine_of(tmp_path, "off-axis-shelf", {})
    scene = bench_rig.bench_of(engine).scene
    dense = scene.dense()
    row = np.arange(N) // GRID[1]
    same = row[:, None] == row[None]
    for keep, mask in (("in", same), ("out", ~same)):
        truth = (dense * mask).sum(axis=2).T.reshape(*GRID, 3)
        image, folder, _ = run(engine, keep, goal="epipolar", keep=keep, codes=12)
        # What is left is the rounding of two RAW files.
        assert np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)) < 2e-3
        assert decode_folder(folder).identical
    near = np.zeros((N, N))
    for n in range(N):
        for d in (1, 2):
            if n % GRID[1] + d < GRID[1]:
                near[n, n + d] = 1.0
    truth = (dense * near).sum(axis=2).T.reshape(*GRID, 3)
    image, folder, summary = run(engine, goal="stereo", disparity=[1, 2], codes=128)
    error = float(np.sqrt(np.mean((image - truth) ** 2)))
    assert error < 0.01 * np.sqrt(np.mean(dense.sum(axis=2) ** 2))
    own = summary["rms_error_quads"] * np.sqrt(np.mean(truth**2))
    assert own == pytest.approx(error, rel=1e-6)
    assert decode_folder(folder).identical


@pytest.mark.long
def test_error_bars_of_parts_cover_off_axis_goals(tmp_path: Path) -> None:
    engine = engine_of(tmp_path, "off-axis-box", {}, camera=CameraConfig(noise="full"))
    goals: tuple[dict[str, Any], ...] = (
        {"goal": "keyed"},
        {"goal": "stereo", "disparity": [-2, -2]},
        {"goal": "epipolar"},
    )
    for number, fields in enumerate(goals):
        _, folder, summary = run(engine, f"job{number}", codes=96, parts=4, **fields)
        assert summary["sigma_kind"] == "measured"
        shares = {row.name: row.share for row in open_run(folder).error_budget()}
        # That stops may differ is part of the error bars, too; those of this camera do not.
        sigma = np.hypot(shares["codes"] or 0.0, shares["noise"] or 0.0)
        assert 0.7 < sigma / summary["rms_error_quads"] < 1.5


@pytest.mark.long
def test_fig11_holds_where_no_two_devices_share_a_grid(tmp_path: Path) -> None:
    """A camera that is turned and sees cells with many quads, and a mask beside by an eighth of a
    cell: the front still lies within the quarter cell that windows leave."""
    engine = engine_of(
        tmp_path,
        "off-axis-box",
        {},
        camera=CameraConfig(
            noise="none", frame_quads=(65, 49), place=Placing(turn_deg=3.0, scale=1.1)
        ),
        mask=PanelConfig(size_px=(1600, 1200), offset_px=(8.0, 0.0)),
        schedule=ScheduleConfig(window="quarter"),
    )
    image, folder, _ = run(engine, goal="keyed", codes=32)
    direct, indirect, moved = parts(bench_rig.bench_of(engine).scene)
    front, wall = (inner(mask) for mask in (np.isclose(moved, 0.0), moved < -1.5))
    assert front.sum() >= 6 < wall.sum()
    assert np.abs((image - indirect)[front]).mean() < 0.01 * direct[front].mean()
    truth = (direct + indirect)[wall]
    assert np.sqrt(np.mean((image[wall] - truth) ** 2) / np.mean(truth**2)) < 0.03
    assert decode_folder(folder).identical


def test_light_that_slow_panels_do_not_block_is_told(tmp_path: Path) -> None:
    """Each shot of rows is followed by its inverse: a panel that is slow shows both at once."""
    slow = PanelConfig(size_px=(1024, 768), rise_s=0.006, fall_s=0.008)
    engine = engine_of(tmp_path, "off-axis-box", {}, projector=slow, mask=slow)
    made = take_with(engine, goal="epipolar", keep="out", codes=32)
    error = made.error
    assert error > 1.0 and made.quality.verdict == "bad"
    said = next(reason for reason in made.quality.reasons if "should be blocked" in reason)
    # Of the picture, leak included: as much as the error says.
    assert float(said.split(" %")[0]) == pytest.approx(100.0 * error / (1.0 + error), abs=15.0)


def inner(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with all eight around them: quads of a turned camera see a little of these."""
    padded = np.pad(mask, 1)
    around = [padded[r : r + GRID[0], c : c + GRID[1]] for r in (0, 1, 2) for c in (0, 1, 2)]
    return np.asarray(np.all(around, axis=0))
