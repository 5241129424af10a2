"""A mock bench stays what it was typed to be, whatever a calibration measured of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock.bench import MockBench
from drivers.mock.camera import BenchSensor
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.measured import with_values
from pdcd.bench.tables import BenchConfig, CameraConfig, Config, PanelConfig, SceneConfig
from pdcd.panels.frames import PIXEL_WINDOW, WHITE, FrameLog, Frames
from pdcd.panels.map import Map
from pdcd.panels.patterns import pack_bits
from pdcd.panels.placing import Placing

GRID = (6, 8)
PX, MASK_PX = (64, 48), (80, 60)
MEASURED: dict[str, Any] = {
    "projector.rise_s": 0.004,
    "projector.contrast": 300.0,
    "mask.fall_s": 0.009,
    "mask.skew_s": 0.003,
    "mask.scan_s": 0.012,
    "mask.scan_bands": 5,
    "mask.contrast": 90.0,
    "mask.gamma": 1.9,
    "mask.blur_px": 0.7,
    "mask.offset_px": (1.0, 0.5),
    "camera.blur_quads": 0.4,
    "camera.responsivity_e": (9e5, 8e5, 7e5),
    "camera.profile": "450d",
    "trigger.lag_s": 0.2,
    "rig.settle_s": 0.3,
    "display.mask_delay_refreshes": -1,
}
TRUTH = "[mask]\nfall_s = 0.006\nscan_s = 0.01\n[camera]\nblur_quads = 0.3\n"


def bench_of(folder: Path, truth: str | None, **camera: Any) -> Config:
    path = folder / "truth.toml"
    path.write_text(truth or "")
    return Config(
        projector=PanelConfig(size_px=PX, rise_s=0.002, contrast=500.0),
        mask=PanelConfig(size_px=MASK_PX, fall_s=0.005, gamma=2.2),
        camera=CameraConfig(noise="none", **camera),
        scene=SceneConfig(grid=GRID, ambient=0.1),
        bench=BenchConfig(truth=None if truth is None else str(path)),
    )


def shown(*, pixels: bool) -> Frames:
    """Ten rows of codes and of white."""
    rng = np.random.default_rng(2)
    sizes = (PX, MASK_PX) if pixels else ((8, 6), (8, 6))
    one, other = (pack_bits(rng.random((4, w * h)) < 0.5) for w, h in sizes)
    index = np.array([0, 1, 2, 3, WHITE, 0, 1, 2, 3, WHITE], dtype=np.int32)
    zero = np.zeros(10, dtype=np.uint8)
    return Frames(
        one, other, index, np.roll(index, 1), zero, index, zero.astype(np.bool_),
        (0, 0) if pixels else GRID, (0, 0) if pixels else GRID, PIXEL_WINDOW if pixels else "whole",
    )  # fmt: skip


def photo(config: Config, frames: Frames) -> tuple[NDArray[np.float64], bytes]:
    """Light at the quads, and the file of it."""
    bench = MockBench.of(DriverContext(config=config, clock=VirtualClock()))
    sensor = BenchSensor(bench, config.camera)
    bench.open_shutter(0)
    at = 400_000_000 + np.arange(10, dtype=np.int64) * 16_666_667
    bench.frames, rows = frames, np.arange(10, dtype=np.int32)
    bench.log = FrameLog(
        rows, rows, at, at + 1000,
        at[-1:].repeat(2) + 16_666_667, np.zeros(10, np.int32), "mock", True,
    )  # fmt: skip
    bench.close_shutter(1_500_000_000)
    return bench.quads(), sensor.dng(100, 8.0)


@pytest.mark.parametrize("truth", [None, TRUTH])
@pytest.mark.parametrize("pixels", [False, True])
def test_the_light_is_the_same_before_and_after_a_calibration(
    tmp_path: Path, truth: str | None, pixels: bool
) -> None:
    typed = bench_of(tmp_path, truth)
    # Where patterns of cells are drawn by another map they are other pixels, and other light.
    maps = {"mask": Map.filling(MASK_PX), "camera": Map.filling((8, 6))} if pixels else {}
    found = with_values(with_values(typed, MEASURED, {}), {"mask.contrast": 80.0}, maps)
    (before, file), (after, other) = (photo(c, shown(pixels=pixels)) for c in (typed, found))
    assert before.any() and after.tobytes() == before.tobytes()
    assert _samples(other) == _samples(file)


def test_a_typed_place_stays_where_a_map_was_measured(tmp_path: Path) -> None:
    placed = bench_of(tmp_path, None, place=Placing(turn_deg=3.0), frame_quads=(24, 18))
    maps = {"camera": Map.filling((24, 18)), "mask": Map.filling(MASK_PX)}
    found = with_values(placed, {"mask.offset_px": (0.0, 0.0)}, maps)
    before, after = (photo(config, shown(pixels=True))[0] for config in (placed, found))
    assert after.tobytes() == before.tobytes()


def test_a_wrong_scale_is_one_however_it_was_measured(tmp_path: Path) -> None:
    """A body gives as many electrons as was typed; who believes in more sees less light."""
    typed = bench_of(tmp_path, None, responsivity_e=(4e5, 5e5, 6e5))
    found = with_values(typed, {"camera.responsivity_e": (8e5, 1e6, 1.2e6)}, {})
    contexts = [DriverContext(config=config, clock=VirtualClock()) for config in (typed, found)]
    bodies = [BenchSensor(MockBench.of(context), context.config.camera) for context in contexts]
    for body in bodies:
        assert body.responsivity_e.tolist() == [4e5, 5e5, 6e5]
    assert found.camera.responsivity_e == (8e5, 1e6, 1.2e6)


def _samples(file: bytes) -> bytes:
    """The file but for its date."""
    return file[-2 * 4 * GRID[0] * GRID[1] :]
