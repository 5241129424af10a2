"""The mock bench of pixels: when it is needed, what it agrees with, what it wants to be seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ScheduleConfig,
)
from pdcd.panels.frames import WHITE, Frames
from pdcd.panels.patterns import make_empty_patterns, pack_bits
from pdcd.panels.placing import Placing
from pdcd.probing.realised import compute_bench_factors
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.needed import choose_optics
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.effects import DenseEffect, make_direct_effects
from pdcd.virtual.scene.scene import Scene
from tests.frame_logs import REFRESH_NS, make_log

GRID = (3, 4)
PX = (48, 36)


def config_of(**more: Any) -> Config:
    """A small bench on squared paper: 12 pixels a cell, of both panels."""
    panel = PanelConfig(size_px=PX)
    given = {"projector": panel, "mask": panel, "scene": SceneConfig(grid=GRID), **more}
    return msgspec.structs.replace(Config(), **given)


def scene_of(texture: NDArray[np.float64] | None = None) -> Scene:
    rng = np.random.default_rng(2)
    cells = GRID[0] * GRID[1]
    direct = make_direct_effects(rng.random((cells, 3)))
    return Scene(
        "s", GRID, (*direct, DenseEffect("all", rng.random((cells, cells)))), texture=texture
    )


def exposure_of(frames: Frames) -> PanelExposure:
    log = make_log(len(frames))
    return PanelExposure(frames, log, 0, int(log.end_ns[0]) + 50_000_000)


def white(count: int = 3) -> Frames:
    index = np.full(count, WHITE, dtype=np.int32)
    return Frames(
        make_empty_patterns(), make_empty_patterns(), index, index, np.zeros(count, np.uint8),
        np.arange(count, dtype=np.int32),
        np.zeros(count, np.bool_), GRID, GRID, "whole",
    )  # fmt: skip


def coded(rng: np.random.Generator) -> Frames:
    lattice = (GRID[0] + 1, GRID[1] + 1)
    patterns = [pack_bits(rng.random((5, lattice[0] * lattice[1])) < 0.5) for _ in range(2)]
    index = np.repeat(np.arange(5, dtype=np.int32), 4)
    shift = np.tile(np.arange(4, dtype=np.uint8), 5)
    return Frames(
        patterns[0], patterns[1], index, index, shift, index, np.zeros(20, np.bool_),
        GRID, lattice, "quarter",
    )  # fmt: skip


def test_a_bench_is_made_once_for_whoever_asks_while_it_is_held() -> None:
    config, scene = config_of(camera=CameraConfig(quads_per_cell=3)), scene_of()
    bench = choose_optics(config, scene, ("quarter",))
    assert bench is not None
    assert choose_optics(config, scene, ("quarter",)) is bench
    assert choose_optics(config, scene_of(), ("quarter",)) is not bench


@pytest.mark.parametrize(
    "more",
    [
        {"camera": CameraConfig(frame_quads=(20, 15))},
        {"camera": CameraConfig(place=Placing(turn_deg=1.0))},
        {"projector": PanelConfig(size_px=PX, place=Placing(flip="vertical"))},
        {"mask": PanelConfig(size_px=PX, place=Placing(scale=1.1))},
        {"schedule": ScheduleConfig(grid=(6, 8))},
    ],
)
def test_a_bench_of_pixels_is_for_what_cells_cannot_say(more: dict[str, Any]) -> None:
    assert choose_optics(config_of(), scene_of()) is None
    assert choose_optics(config_of(**more), scene_of()) is not None


def test_a_bench_with_a_truth_is_one_of_pixels(tmp_path: Path) -> None:
    truth = tmp_path / "truth.toml"
    truth.touch()
    assert choose_optics(config_of(bench=BenchConfig(truth=str(truth))), scene_of()) is not None


@pytest.mark.parametrize(
    ("quads", "cut", "textured", "needed"),
    [
        (1, True, True, False), (2, False, False, False), (2, True, False, True),
        (2, False, True, True),
    ],
)  # fmt: skip
def test_finer_quads_are_needed_where_there_is_something_finer(
    quads: int, cut: bool, textured: bool, needed: bool
) -> None:
    texture = np.random.default_rng(0).random((6, 8, 3)) + 0.1 if textured else None
    config = config_of(camera=CameraConfig(quads_per_cell=quads))
    bench = choose_optics(config, scene_of(texture), ("quarter" if cut else "whole",))
    assert (bench is not None) is needed
    if bench is not None:
        assert bench.frame == (6, 8)


def test_on_squared_paper_it_is_the_bench_of_cells() -> None:
    """Panels whose pixels divide the cells, slow and leaking: to rounding."""
    slow = PanelConfig(size_px=PX, rise_s=0.002, fall_s=0.005, contrast=80.0, skew_s=0.003)
    config = config_of(projector=slow, mask=slow, camera=CameraConfig(frame_quads=(4, 3)))
    scene, exposure = scene_of(), exposure_of(coded(np.random.default_rng(1)))
    cells = np.zeros((12, 3))
    for part in compute_bench_factors(
        exposure.frames, exposure.log, slow, slow, open_ns=0, close_ns=exposure.close_ns
    ):
        cells += scene.photo(part.left, part.right, part.coaxial, part.open_s)
    bench = choose_optics(config, scene)
    assert bench is not None
    found = bench.photo(exposure)
    np.testing.assert_allclose(found, cells.reshape(3, 4, 3), rtol=1e-12)
    np.testing.assert_array_equal(bench.photo(exposure), found)  # what is kept serves as well


def test_a_white_photo_is_the_wanted_white_picture(tmp_path: Path) -> None:
    """Through the same optics, where everything is bent, uneven and blurred and nothing leaks."""
    truth = tmp_path / "truth.toml"
    truth.write_text(
        """
        [projector]
        falloff = 0.3
        place = { turn_deg = 5.0, scale = 1.3, radial = [0.02, 0.0] }
        [mask]
        place = { turn_deg = 180.0, scale = 1.4 }
        [camera]
        blur_quads = 0.8
        falloff = 0.5
        place = { scale = 1.2, turn_deg = -3.0 }
        [scene]
        blur_px = 0.7
        """
    )
    camera = CameraConfig(frame_quads=(21, 16))
    config = config_of(camera=camera, bench=BenchConfig(truth=str(truth)))
    drawn_larger = msgspec.structs.replace(config.mask, place=Placing(scale=1.2))
    config = msgspec.structs.replace(config, mask=drawn_larger)
    scene = scene_of(np.random.default_rng(4).random((12, 16, 3)) + 0.1)
    bench = OpticalBench(config, scene, (16, 21))
    wanted = bench.wanted(lambda part: part.white())
    found = bench.photo(exposure_of(white())) / (3 * REFRESH_NS * 1e-9)
    assert 150 < bench.inside.sum() < 250
    assert bench.share is not None
    seen = wanted * bench.share[..., None]  # a photo has no light from beyond the field
    known = bench.share > 0.0
    np.testing.assert_allclose(found[known], seen[known], rtol=1e-9, atol=1e-12)


def test_codes_may_have_other_cells_than_the_scene() -> None:
    """Of white light nothing says which cells the codes have."""
    camera = CameraConfig(frame_quads=(4, 3))
    fine = config_of(camera=camera, schedule=ScheduleConfig(grid=(6, 8)))
    frames = white()
    finer = Frames(**{**vars(frames), "grid": (6, 8), "lattice": (6, 8)})
    scene = scene_of()
    found = OpticalBench(fine, scene, (3, 4)).photo(exposure_of(finer))
    plain = OpticalBench(config_of(camera=camera), scene, (3, 4)).photo(exposure_of(frames))
    np.testing.assert_allclose(found, plain, rtol=1e-12)
    np.testing.assert_allclose(found, 0.05 * scene.white().reshape(3, 4, 3), rtol=1e-6)
