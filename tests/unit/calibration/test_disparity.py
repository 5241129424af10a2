"""Correspondences by codes on a scene with depth, and planes by two cards."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import CameraConfig, Config, PanelConfig, SceneConfig
from pdcd.calibration.geometry.disparity import fit_card_plane, measure_disparities
from pdcd.calibration.geometry.xor import XorCode
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import pack_frames
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.partners import find_match_places, find_matched_cells
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.build import build_scene
from tests.frame_logs import make_log
from tests.unit.calibration.decoding import decode_xor

GRID = (12, 16)
SIZE = (128, 96)
FRAME = (144, 192)


def photos(bench: OpticalBench, code: XorCode) -> Iterator[QuadPhoto]:
    for shown in code.shown(1):
        frames = pack_frames(shown)
        log = make_log(len(frames), start_ns=0, refresh_ns=1_000_000)
        light = bench.photo(PanelExposure(frames, log, 0, int(log.end_ns[0]))) * 2e5
        yield QuadPhoto(light, np.full(light.shape, 1.0), np.zeros(light.shape[:2], np.bool_))


def test_k5_codes_on_the_scene_tell_the_disparity_of_its_cells() -> None:
    camera = CameraConfig(frame_quads=FRAME[::-1], place=Placing(turn_deg=1.0, scale=1.05))
    config = Config(
        projector=PanelConfig(size_px=SIZE),
        mask=PanelConfig(size_px=SIZE),
        camera=camera,
        scene=SceneConfig(kind="off-axis-shelf", grid=GRID),
    )
    scene = build_scene(config.scene)
    bench = OpticalBench(config, scene, FRAME)
    code = XorCode("projector", SIZE, base_px=4)
    decoded = decode_xor(photos(bench, code), code)
    maps = make_camera_map(config, FRAME), panels_of(config).projector.map
    found = measure_disparities(decoded, *maps, GRID)
    true = scene.displacement
    assert true is not None
    right = true[:, 1].reshape(GRID)
    both = found.known & np.isfinite(right)
    assert both.sum() > 0.5 * np.isfinite(right).sum()
    off = np.abs(found.right - right)[both]
    # A cell's displacement is one number, so inner quads see it to a part of a pixel of 16.
    assert np.median(off) < 0.05
    assert np.mean(off < 0.1) > 0.9
    assert found.off_rows_cells < 0.05
    place = find_match_places(Goal(name="keyed"), GRID, {"disparities": found.as_asked().ravel()})
    partner = find_matched_cells(place, 0, GRID)
    assert (partner[~found.known.ravel()] == -1).all()
    wall = np.isclose(right.ravel(), right[np.isfinite(right)].min()) & both.ravel()
    column = np.arange(GRID[0] * GRID[1])
    expected = column + round(float(np.nanmin(right)))
    assert np.mean(partner[wall] == expected[wall]) > 0.9


def test_k5_a_card_at_another_depth_gives_its_plane() -> None:
    """The same camera on two cards: the second map is the first, and then the plane."""
    now = make_placed_map(Placing(turn_deg=-3.0, scale=1.1), (300, 200), SIZE, "camera")
    plane = np.array([[1.02, 0.01, -0.05], [0.005, 0.99, 0.0], [0.03, 0.0, 1.0]])
    then = now.then(plane)
    assert isinstance(then, Map)
    found, left = fit_card_plane(now, then)
    np.testing.assert_allclose(np.reshape(found, (3, 3)), plane, atol=1e-6)
    assert left < 1e-7
