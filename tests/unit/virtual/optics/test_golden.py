"""The mock bench of pixels against a dense evaluation that shares nothing with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import BenchConfig, CameraConfig, Config, PanelConfig, SceneConfig
from pdcd.bench.truth import load_bench_truth
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, FrameLog, Frames
from pdcd.panels.patterns import Patterns, pack_bits
from pdcd.panels.placing import Placing
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.effects import DenseEffect, Effect, make_direct_effects, make_tint
from pdcd.virtual.scene.scene import Scene
from tests.dense_bench import DenseBench, DensePanel
from tests.sampled import sampled

GRID = (2, 3)
PROJECTOR_PX, MASK_PX, FRAME = (13, 10), (15, 12), (9, 12)
TRUTH = """
[projector]
rise_s = 0.0012
fall_s = 0.0021
contrast = 60.0
skew_s = 0.0007
gamma = 1.8
falloff = 0.3
scan_s = 0.006
scan_bands = 3
dead_columns = [4]
place = { turn_deg = 3.0, scale = 1.07, radial = [0.02, -0.004], tangential = [0.003, -0.002] }

[mask]
rise_s = 0.003
fall_s = 0.0005
contrast = 25.0
skew_s = -0.0011
gamma = 2.3
scan_s = -0.009
scan_bands = 12
offset_px = [0.31, -0.17]
dead_rows = [3, 11]
[mask.place]
flip = "horizontal"
turn_deg = -4.0
scale = 1.12
radial = [-0.015, 0.0]

[camera]
blur_quads = 0.6
falloff = 0.4
samples = 2
[camera.place]
turn_deg = 8.0
scale = 1.15
radial = [0.03, 0.002]

[scene]
ambient = 0.11
blur_px = 0.8
blur_taps = 3
"""
"""Everything at once; the mask's last row is dead, so that the dense bench has a black pixel."""


def frames_of(window: str, rng: np.random.Generator, *, grey: bool) -> Frames:
    """Random patterns, some refreshes black, some white, under all sub-shifts."""
    more = int(window not in ("whole", PIXEL_WINDOW))
    lattice = (GRID[0] + more, GRID[1] + more)
    sizes = [lattice[0] * lattice[1]] * 2
    if window == PIXEL_WINDOW:
        sizes = [size[0] * size[1] for size in (PROJECTOR_PX, MASK_PX)]
    patterns: list[Patterns]
    if grey:
        patterns = [rng.random((4, cells)).astype(np.float32) for cells in sizes]
    else:
        patterns = [pack_bits(rng.random((4, cells)) < 0.5) for cells in sizes]
    primal = np.array([0, 0, 1, 1, WHITE, 2, 3, 3, BLACK, 2, 1], dtype=np.int32)
    dual = np.array([BLACK, 0, 1, BLACK, 2, WHITE, BLACK, 3, 1, 0, 2], dtype=np.int32)
    count = primal.size
    shift = np.arange(count) % 4 if more else np.zeros(count)
    return Frames(
        patterns[0], patterns[1], primal, dual, shift.astype(np.uint8),
        np.arange(count, dtype=np.int32), dual == BLACK, GRID, lattice, window,
    )  # fmt: skip


def log_of(frames: Frames, rng: np.random.Generator) -> FrameLog:
    """Refreshes of 60 Hz that wobble; the panels are apart, one frame is stale, one is late."""
    count = len(frames)
    rows = np.arange(count, dtype=np.int32)
    at = 30_000_000 + np.arange(count + 1) * 16_666_667
    at[7:] += 16_666_667
    wobble = rng.integers(-900_000, 900_000, (2, count + 1))
    stale = rows.copy()
    stale[5] = 4
    primal, dual = at + wobble[0], at + wobble[1] + 2_000_000
    return FrameLog(
        rows, stale, primal[:-1], dual[:-1], np.array([primal[-1], dual[-1]]),
        np.zeros(count, dtype=np.int32), "mock", True,
    )  # fmt: skip


def config_of(folder: Path, truth: str) -> Config:
    """What is believed: devices that are placed, too, but elsewhere, and panels without faults."""
    path = folder / "truth.toml"
    path.write_text(truth)
    return Config(
        projector=PanelConfig(size_px=PROJECTOR_PX, place=Placing(scale=1.03, turn_deg=1.0)),
        mask=PanelConfig(
            size_px=MASK_PX, place=Placing(flip="horizontal", scale=1.06, turn_deg=-2.0)
        ),
        camera=CameraConfig(frame_quads=FRAME[::-1]),
        scene=SceneConfig(grid=GRID),
        bench=BenchConfig(truth=str(path)),
    )


def scene_of(rng: np.random.Generator, *, textured: bool) -> tuple[Scene, NDArray[np.float64]]:
    """Direct light, and four effects that send light anywhere, each with its colour."""
    cells = GRID[0] * GRID[1]
    direct = rng.random((cells, 3))
    matrices = [rng.random((cells, cells)) / cells for _ in range(4)]
    tints = [make_tint(*rng.random(3)) for _ in matrices]
    effects: list[Effect] = [*make_direct_effects(direct)]
    effects += [DenseEffect("all", m, tint=t) for m, t in zip(matrices, tints, strict=True)]
    transport = sum(t[:, None, None] * m for m, t in zip(matrices, tints, strict=True))
    texture = rng.random((8, 6, 3)) + 0.2 if textured else None
    assert not isinstance(transport, int)
    return Scene("random", GRID, tuple(effects), texture=texture), transport


def dense_of(config: Config, scene: Scene, transport: NDArray[np.float64]) -> DenseBench:
    """The dense bench of the same file; its blur is written down anew."""
    truth = load_bench_truth(config)
    true, drawn = truth.of(config), panels_of(config)
    placed = panels_of(true)
    panels = []
    for mask in (False, True):
        name = "mask" if mask else "projector"
        optics, said = getattr(true, name), getattr(truth, name)
        panels.append(
            DensePanel(
                mask, getattr(drawn, name).map, getattr(placed, name).map,
                optics.rise_s, optics.fall_s, 1.0 / optics.contrast if optics.contrast else 0.0,
                optics.skew_s, said.gamma or 1.0, said.lut, optics.scan_s, optics.scan_bands,
                said.falloff, said.dead_rows, said.dead_columns,
            )
        )  # fmt: skip
    direct = np.stack([e.albedo for e in scene.effects[:3]], axis=1)  # type: ignore[attr-defined]
    size = np.array(PROJECTOR_PX)
    spread = true.mask.blur_px
    taps = [((0.0, 0.0), 1.0)]
    if spread:
        place = np.array([-2.5, 0.0, 2.5])
        share = np.exp(-0.5 * place**2) / np.exp(-0.5 * place**2).sum()
        place = spread * place / np.sqrt((share * place**2).sum())
        taps = [
            ((place[i] / size[0], place[j] / size[1]), share[i] * share[j])
            for j in range(3)
            for i in range(3)
        ]
    return DenseBench(
        panels[0], panels[1], make_camera_map(true, FRAME), GRID, direct, transport,
        truth.camera.samples or 2, true.scene.ambient, scene.texture,
        (true.mask.offset_px[0] / size[0], true.mask.offset_px[1] / size[1]), taps,
        true.camera.blur_quads, truth.camera.falloff,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("window", "textured"),
    [("whole", False), pytest.param("quarter", False, marks=pytest.mark.long), ("quarter", True),
     ("side-3/4", False), pytest.param(PIXEL_WINDOW, False, marks=pytest.mark.long), (PIXEL_WINDOW,
     True)],
)  # fmt: skip
def test_everything_on_is_the_dense_bench_at_every_quad(
    tmp_path: Path, window: str, textured: bool
) -> None:
    rng = np.random.default_rng([7, textured])
    frames = frames_of(window, rng, grey=textured)
    log = log_of(frames, rng)
    scene, transport = scene_of(rng, textured=textured)
    config = config_of(tmp_path, TRUTH)
    close_ns = int(log.end_ns.max()) + 50_000_000
    found = OpticalBench(config, scene, FRAME).photo(PanelExposure(frames, log, 0, close_ns))
    dense = dense_of(config, scene, transport)
    dense = replace(dense, scattered=window == PIXEL_WINDOW)
    wanted = dense.photo(frames, log, 0, close_ns)
    assert wanted.max() > 10.0 * wanted.min() >= 0.0
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * wanted.max())


@pytest.mark.parametrize("window", sampled(["quarter", PIXEL_WINDOW], 2))
def test_a_table_of_lights_is_the_dense_bench_too(tmp_path: Path, window: str) -> None:
    """Grey levels of a projector with a file of lights, and of a mask that is believed to have
    another curve than it has. G-LUT."""
    (tmp_path / "lights.txt").write_text("# a bent panel\n0 0.02, 0.31\n0.8\n1.0\n")
    truth = TRUTH.replace("gamma = 1.8", 'lut = "lights.txt"')
    rng = np.random.default_rng(11)
    frames = frames_of(window, rng, grey=True)
    log = log_of(frames, rng)
    scene, transport = scene_of(rng, textured=False)
    config = config_of(tmp_path, truth)
    mask = msgspec.structs.replace(config.mask, gamma=None, lut=(0.0, 0.5, 1.0, 1.0))
    config = msgspec.structs.replace(config, mask=mask)
    close_ns = int(log.end_ns.max()) + 50_000_000
    found = OpticalBench(config, scene, FRAME).photo(PanelExposure(frames, log, 0, close_ns))
    dense = replace(dense_of(config, scene, transport), scattered=window == PIXEL_WINDOW)
    assert dense.projector.lut == (0.0, 0.02, 0.31, 0.8, 1.0) and dense.mask.gamma == 2.3
    wanted = dense.photo(frames, log, 0, close_ns)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * wanted.max())


def test_what_is_absent_is_the_dense_bench_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    frames = frames_of("quarter", rng, grey=False)
    log = log_of(frames, rng)
    scene, transport = scene_of(rng, textured=False)
    config = config_of(tmp_path, "[camera]\nsamples = 3\n")
    close_ns = int(log.end_ns.max()) + 50_000_000
    found = OpticalBench(config, scene, FRAME).photo(PanelExposure(frames, log, 0, close_ns))
    dense = dense_of(config, scene, transport)
    # Nothing leaks here, so that any dead pixel stands for what lies beside the mask.
    wanted = replace(dense, mask=replace(dense.mask, dead_rows=())).photo(frames, log, 0, close_ns)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * wanted.max())
