"""What a bench keeps from photo to photo, what it works out anew, and which way it takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import BenchConfig, CameraConfig
from pdcd.panels.frames import PIXEL_WINDOW, Frames
from pdcd.virtual.optics import bench as benches
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.scene.effects import DenseEffect, make_direct_effects, make_tint
from pdcd.virtual.scene.scene import Scene
from tests.unit.virtual.optics.test_bench import GRID, PX, config_of, exposure_of, scene_of, white


def bench_of(scene: Scene, **more: Any) -> OpticalBench:
    return OpticalBench(config_of(camera=CameraConfig(frame_quads=(8, 6)), **more), scene, (6, 8))


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, str], list[int]]:
    """Counts the calls of a function or method from now on."""

    def count(owner: Any, name: str) -> list[int]:
        calls: list[int] = []
        real = getattr(owner, name)

        def noted(*args: Any, **named: Any) -> Any:
            calls.append(1)
            return real(*args, **named)

        monkeypatch.setattr(owner, name, noted)
        return calls

    return count


def of_pixels(grey: bool = False) -> Frames:
    """Stripes across, and stripes down; or as many histories as pixels."""
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(np.arange(PX[0]), np.arange(PX[1]))
    stripes = np.stack([(x // 3) % 2, (y // 2) % 2]).reshape(2, -1).astype(np.float32)
    if grey:
        stripes = rng.random(stripes.shape).astype(np.float32)
    index = np.array([0, 1, 1], np.int32)
    return Frames(
        stripes, stripes, index, index[::-1].copy(), np.zeros(3, np.uint8), index,
        np.zeros(3, np.bool_), GRID, GRID, PIXEL_WINDOW,
    )  # fmt: skip


def test_a_table_of_all_pairs_is_the_same_photo(
    monkeypatch: pytest.MonkeyPatch, counted: Callable[[Any, str], list[int]]
) -> None:
    """Made where it is no larger than it may be: here four histories of either panel, black among
    them, and twelve cells that send light to others."""
    bench, exposure = bench_of(scene_of()), exposure_of(of_pixels())
    made = counted(benches, "render_by_lookup")
    found = bench.photo(exposure)
    assert len(made) == 1 and found.max() > 1.5 * found.min() > 0.0
    size = next(n for n in range(12, 99, 12) if _fits(bench, exposure, n, monkeypatch, made))
    assert 36 <= size <= 72 and not _fits(bench, exposure, size - 1, monkeypatch, made)
    other = bench_of(scene_of()).photo(exposure)
    np.testing.assert_allclose(other, found, rtol=1e-10)


def _fits(
    bench: OpticalBench, exposure: Any, size: int, patch: pytest.MonkeyPatch, made: list[int]
) -> bool:
    patch.setattr(benches, "MOST_PAIRS", size)
    made.clear()
    bench.photo(exposure)
    return bool(made)


@pytest.mark.parametrize("frames", [white(), of_pixels()])
@pytest.mark.parametrize("said", [None, 0.0, 0.3])
def test_ambient_light_is_the_scenes_or_what_is_true(
    tmp_path: Path, frames: Frames, said: float | None
) -> None:
    """It falls on the scene all the time, and through the mask while that is open."""
    path = tmp_path / "truth.toml"
    path.write_text("" if said is None else f"[scene]\nambient = {said}\n", encoding="utf-8")
    lights = np.random.default_rng(3).random((12, 3))
    more = {"bench": BenchConfig(truth=str(path))}
    dark = bench_of(scene_of(), **more).photo(exposure_of(frames))
    scene = Scene("s", GRID, scene_of().effects, ambient=lights)
    lit = bench_of(scene, **more).photo(exposure_of(frames))
    if said is not None:
        np.testing.assert_allclose(lit, dark, rtol=1e-12)
        return
    quads = lights.reshape(3, 4, 3).repeat(2, axis=0).repeat(2, axis=1)
    open_s = (lit - dark) / quads
    np.testing.assert_allclose(open_s, open_s[..., :1] * np.ones(3), rtol=1e-9)
    assert 0.0 < open_s.min() and open_s.max() < 0.06


@pytest.mark.parametrize("grey", [True, False])
def test_light_of_one_colour_is_looked_up_once_and_of_three_thrice(grey: bool) -> None:
    """A grey scene is that of its three channels, which are alike."""
    rng = np.random.default_rng(8)
    albedo = np.repeat(rng.random((12, 1)), 3, axis=1) if grey else rng.random((12, 3))
    direct = bench_of(Scene("s", GRID, tuple(make_direct_effects(albedo))))
    found = direct.photo(exposure_of(of_pixels()))
    channels = []
    for channel in range(3):
        one = np.zeros((12, 3))
        one[:, channel] = albedo[:, channel]
        part = bench_of(Scene("s", GRID, tuple(make_direct_effects(one))))
        channels.append(part.photo(exposure_of(of_pixels()))[..., channel])
    np.testing.assert_allclose(found, np.stack(channels, axis=-1), rtol=1e-12)
    glow = DenseEffect("g", rng.random((12, 12)), tint=make_tint(1.0, 0.5, 0.0))
    both = bench_of(Scene("s", GRID, (*make_direct_effects(albedo), glow)))
    sent = both.photo(exposure_of(of_pixels())) - found
    np.testing.assert_allclose(sent[..., 1], 0.5 * sent[..., 0], rtol=1e-9)
    np.testing.assert_allclose(sent[..., 2], 0.0, atol=1e-12)
    assert sent[..., 0].min() > 0.0
