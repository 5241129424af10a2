"""Photos by tables of pairs of histories or of sites: the same sum of effects, ambient light and
colours, whichever way a bench takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import BenchConfig, CameraConfig
from pdcd.panels.frames import PIXEL_WINDOW, Frames
from pdcd.panels.placing import Placing
from pdcd.virtual.optics import bench as benches
from pdcd.virtual.optics import products, render
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.effects import DenseEffect, make_direct_effects, make_tint
from pdcd.virtual.scene.scene import Scene
from tests.unit.virtual.optics.test_bench import (
    GRID,
    PX,
    coded,
    config_of,
    exposure_of,
    scene_of,
    white,
)

RNG = np.random.default_rng(6)


def bench_of(scene: Scene, **more: Any) -> OpticalBench:
    return OpticalBench(config_of(camera=CameraConfig(frame_quads=(8, 6)), **more), scene, (6, 8))


def of_pixels() -> Frames:
    """Stripes across, and stripes down."""
    x, y = np.meshgrid(np.arange(PX[0]), np.arange(PX[1]))
    stripes = np.stack([(x // 3) % 2, (y // 2) % 2]).reshape(2, -1).astype(np.float32)
    index = np.array([0, 1, 1], np.int32)
    return Frames(
        stripes, stripes, index, index[::-1].copy(), np.zeros(3, np.uint8), index,
        np.zeros(3, np.bool_), GRID, GRID, PIXEL_WINDOW,
    )  # fmt: skip


def test_a_table_of_all_pairs_is_the_same_photo(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here of four histories of either panel, and of twelve cells that send light to others."""
    exposure = exposure_of(of_pixels())
    found = bench_of(scene_of()).photo(exposure)
    monkeypatch.setattr(benches, "MOST_PAIRS", 0)
    np.testing.assert_allclose(bench_of(scene_of()).photo(exposure), found, rtol=1e-10)
    assert found.max() > 1.5 * found.min() > 0.0


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


def test_a_covered_lens_lets_nothing_out_and_ambient_light_in() -> None:
    scene = scene_of()
    lights = RNG.random((12, 3))
    dim = Scene("s", scene.grid, scene.effects, ambient=lights)
    frames = white()
    given = exposure_of(frames)
    covered = PanelExposure(frames, given.log, given.open_ns, given.close_ns, covered=True)
    for one, ambient in ((scene, 0.0 * lights), (dim, lights)):
        bench = bench_of(one)
        found = bench.photo(covered) / (given.log.end_ns[0] - given.log.primal_ns[0]) * 1e9
        quads = ambient.reshape(3, 4, 3).repeat(2, axis=0).repeat(2, axis=1)
        np.testing.assert_allclose(found, quads, atol=1e-9)
        assert bench.photo(given).min() > found.min()


@pytest.mark.parametrize("effects", [0, 1, 3, 4, 6])
@pytest.mark.parametrize("room", [48 * 2**20, 1])
def test_light_of_any_number_of_effects_comes_together(
    effects: int, room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A photo is the sum of those of its effects, however much is worked on at a time."""
    direct = make_direct_effects(RNG.random((12, 3)))
    more = [
        DenseEffect(f"d{n}", RNG.random((12, 12)), tint=make_tint(*RNG.random(3)))
        for n in range(effects)
    ]
    exposure = exposure_of(coded(np.random.default_rng(1)))
    parts = bench_of(Scene("s", (3, 4), tuple(direct))).photo(exposure)
    for effect in more:
        parts = parts + bench_of(Scene("s", (3, 4), (effect,))).photo(exposure)
    monkeypatch.setattr(products, "SPAN_CHUNK_BYTES", room)
    monkeypatch.setattr(render, "WEIGHT_CACHE_BYTES", room)
    whole = bench_of(Scene("s", (3, 4), (*direct, *more)))
    found = whole.photo(exposure)
    np.testing.assert_allclose(found, parts, rtol=1e-10)
    np.testing.assert_array_equal(whole.photo(exposure), found)


@pytest.mark.parametrize(("beyond", "inside"), [(0.5e-9, True), (1.5e-9, False)])
def test_quads_lie_inside_up_to_the_border_by_rounding(beyond: float, inside: bool) -> None:
    larger = CameraConfig(frame_quads=(8, 6), place=Placing(scale=1.0 + 2.0 * beyond))
    found = OpticalBench(config_of(camera=larger), scene_of(), (6, 8)).inside
    assert found[1:-1, 1:-1].all()
    for edge in (found[0], found[-1], found[:, 0], found[:, -1]):
        assert edge.all() == inside and edge.any() == inside
