"""Benches whose devices lie anywhere, with maps that are given exactly: is the full-resolution
indirect photo as good as on an aligned bench, and is a flat scene flat?

Drawing, the mock bench of pixels and decoding take part; the sensor does not: there is no noise and
no rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from pdcd.bench.placed import compute_mock_frame, make_camera_map
from pdcd.bench.tables import CameraConfig, Config, SceneConfig
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.photos import make_corrected_photos
from pdcd.pictures.picture import Picture, combine_photos
from pdcd.pictures.truth import compute_true_answer
from pdcd.planning.make import plan_with_prior
from pdcd.planning.plan import Plan
from pdcd.probing.realised import collect_factors, compute_bench_factors
from pdcd.protocol.request import CaptureRequest
from pdcd.sensor.cells import CellMap
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import LowRankEffect, make_direct_effects
from pdcd.virtual.scene.scene import Scene
from tests.frame_logs import make_log

PARTS = 4
"""Parts of a cell along an axis in which a pattern at cell pitch is looked for."""


@dataclass(frozen=True)
class Found:
    """RMS error of the indirect photo, over the RMS of the truth, in quads inside the field, and
    the largest mean of one part of all cells of a flat scene, less the mean of all."""

    rms_error: float
    at_pitch: float


def aligned(grid: tuple[int, int], frame: tuple[int, int]) -> Config:
    """A bench on squared paper; `frame` is width and height of the camera's quads."""
    return Config(
        camera=CameraConfig(frame_quads=frame, noise="none"), scene=SceneConfig(grid=grid)
    )


def anywhere(config: Config, seed: int) -> Config:
    """The bench with its three devices turned, mirrored, seen from aside, bent and shifted. Both
    panels cover the field, and the camera sees all of it."""
    rng = np.random.default_rng([seed, 13])
    field_px, frame = config.projector.size_px, config.camera.frame_quads or (1, 1)
    places = [place(rng, px, field_px) for px in (field_px, config.mask.size_px, frame)]
    replace = msgspec.structs.replace
    return replace(
        config,
        projector=replace(config.projector, place=places[0]),
        mask=replace(config.mask, place=places[1]),
        camera=replace(config.camera, place=places[2]),
    )


def place(rng: np.random.Generator, size_px: tuple[int, int], field_px: tuple[int, int]) -> Placing:
    """A device that is turned by some degrees, or upside down as well, mirrored or not, seen
    aslant, and bent, and that reaches beyond the field all the same."""
    upright = Placing(
        flip=("none", "horizontal", "vertical")[int(rng.integers(3))],
        turn_deg=float(rng.choice([0.0, 180.0]) + rng.uniform(-2.0, 2.0)),
        scale=float(rng.uniform(1.16, 1.2)),
        offset_px=(float(rng.uniform(-5.0, 5.0)), float(rng.uniform(-5.0, 5.0))),
    )
    to_centre = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    aslant = np.eye(3)
    aslant[2, :2] = rng.uniform(-0.03, 0.03, 2)
    keystone = np.linalg.inv(to_centre) @ aslant @ to_centre
    return Placing(
        homography=make_placed_map(upright, size_px, field_px, "device").then(keystone).homography,
        radial=(float(rng.uniform(-0.01, 0.02)), float(rng.uniform(-0.002, 0.002))),
        tangential=(float(rng.uniform(-0.002, 0.002)), float(rng.uniform(-0.002, 0.002))),
    )


def flat(grid: tuple[int, int]) -> Scene:
    """The same direct and the same indirect light everywhere."""
    cells = grid[0] * grid[1]
    even = np.ones((cells, 1))
    direct = make_direct_effects(np.full((cells, 3), 0.5))
    return Scene("flat", grid, (*direct, LowRankEffect("even", 0.5 * even, even / cells)))


def judge(config: Config, codes: int = 128) -> Found:
    """Take and decode the indirect photo of the configured scene and of a flat one."""
    scene = build_scene(config.scene)
    plan = plan_with_prior(CaptureRequest(goal="indirect", codes=codes, window="quarter",
    white=False),
                    config, scene.grid)  # fmt: skip
    picture, bench = indirect(config, plan, scene)
    inside = bench.inside & np.isfinite(picture.sigma).all(axis=-1)
    recipe = plan.recipe
    truth = bench.wanted(lambda part: compute_true_answer(part, recipe), recipe.wanted)[inside]
    error = np.sqrt(np.sum((picture.image[inside] - truth) ** 2) / np.sum(truth**2))
    even, bench = indirect(config, plan, flat(scene.grid))
    return Found(float(error), at_pitch(config, even, bench))


def indirect(config: Config, plan: Plan, scene: Scene) -> tuple[Picture, OpticalBench]:
    """The answer of a plan at the camera's own quads, decoded by what is believed."""
    frame = compute_mock_frame(config, plan.grid)
    bench = OpticalBench(config, scene, frame)
    shots = {}
    for shot in plan.recipe.shots:
        frames = plan.frames(shot)
        log = make_log(len(frames))
        exposure = PanelExposure(frames, log, 0, int(log.end_ns.max()) + 50_000_000)
        realised = collect_factors(
            compute_bench_factors(
                frames, log, config.projector, config.mask,
                open_ns=0, close_ns=exposure.close_ns, fine=True,
            )
        )  # fmt: skip
        light = bench.photo(exposure)
        none = np.zeros(frame, dtype=np.bool_)
        shots[shot.name] = ComputedShot(light, np.full(light.shape, 1e-12), none, realised, {})
    cells = CellMap(grid=plan.grid, frame=frame, map=make_camera_map(config, frame))
    photos = make_corrected_photos(
        plan.recipe, shots, None, cells, normalise="auto", smooth=plan.smooth
    )
    return combine_photos(plan.recipe, photos)[plan.recipe.answer_name], bench


def at_pitch(config: Config, picture: Picture, bench: OpticalBench) -> float:
    """Largest mean of a part of the cells less the mean of all, over that."""
    cells = config.scene.grid or (1, 1)
    known = bench.inside & np.isfinite(picture.sigma).all(axis=-1)
    places = make_camera_map(config, bench.frame).centres()[known] * (cells[1], cells[0])
    part = np.floor((places - np.floor(places)) * PARTS).astype(np.int64)
    folded = part[:, 1] * PARTS + part[:, 0]
    light = picture.image[..., 1][known]
    count = np.bincount(folded, minlength=PARTS**2)
    sums = np.bincount(folded, light, minlength=PARTS**2)
    return float(np.abs(sums[count > 0] / count[count > 0] / light.mean() - 1.0).max())
