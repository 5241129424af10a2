"""Tables of what pairs of sites did, light under an uneven projector, and which bench is needed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.panels.placing import Placing
from pdcd.virtual.optics import products, render
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.needed import choose_optics
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.effects import DenseEffect, make_direct_effects, make_tint
from pdcd.virtual.scene.scene import Scene
from tests.unit.virtual.optics.test_bench import coded, config_of, exposure_of, scene_of, white

RNG = np.random.default_rng(6)


def bench_of(scene: Scene, **more: Any) -> OpticalBench:
    return OpticalBench(config_of(camera=CameraConfig(frame_quads=(8, 6)), **more), scene, (6, 8))


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


@pytest.mark.parametrize(
    ("quads", "cut", "textured", "needed"),
    [
        (1, False, False, False), (1, True, False, False), (1, True, True, False),
        (2, False, False, False), (2, True, False, True), (2, False, True, True),
    ],
)  # fmt: skip
def test_finer_quads_are_needed_where_there_is_something_finer(
    quads: int, cut: bool, textured: bool, needed: bool
) -> None:
    texture = RNG.random((6, 8, 3)) + 0.1 if textured else None
    config = config_of(camera=CameraConfig(quads_per_cell=quads))
    bench = choose_optics(config, scene_of(texture), ("quarter" if cut else "whole",))
    assert (bench is not None) is needed
    if bench is not None:
        assert bench.frame == (6, 8)
