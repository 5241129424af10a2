"""Product stripes on a bench that nobody told the step about: maps and blur come out."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import SceneConfig
from pdcd.bench.truth import load_bench_truth
from pdcd.calibration.registration.registration_step import calibrate_registration
from pdcd.calibration.script import CalibrationSession
from pdcd.panels.map import Map, map_between
from pdcd.panels.placing import Placing
from tests.e2e.calibration.hands import Hands
from tests.e2e.calibration.steps_rig import make_config
from tests.unit.calibration.scripted import preview_of

pytestmark = pytest.mark.whole

TRUTH = """
[mask]
contrast = 450.0
skew_s = 0.0037
rise_s = 0.0045
fall_s = 0.0071
[mask.place]
turn_deg = 0.7
scale = 1.02
offset_px = [1.3, -0.7]
[camera]
blur_quads = 0.5
[camera.place]
turn_deg = -1.4
scale = 1.06
"""
AMBIENT = """
[scene]
ambient = 0.002
"""


QUADS, COARSE_QUADS = (230, 172), (64, 48)


def hands(
    folder: Path,
    more: str = AMBIENT,
    *,
    quads: tuple[int, int] = QUADS,
) -> Hands:
    """A small bench whose maps are known, as after geometry."""
    config = make_config(
        folder, TRUTH + more, projector_px=(192, 144), mask_px=(288, 216), quads=quads,
        scene=SceneConfig(kind="card", grid=(12, 18)),
    )  # fmt: skip
    found = Hands(config, folder, full=80, f_number=22.0)
    found.knows_maps()
    return found


def misplace(session: CalibrationSession, right_px: float, *, flip: bool = False) -> None:
    """Believe the mask to lie elsewhere, by pixels of the projector, and turned a little."""
    map_ = session.found("mask")
    width, _ = session.config.projector.size_px
    angle = 0.004
    moved = np.array([[1.0, -angle, right_px / width], [angle, 1.0, 0.0], [0.0, 0.0, 1.0]])
    if flip:
        moved = np.array([[-1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ moved
    place = Placing(map=map_.then(moved))
    mask = msgspec.structs.replace(session.config.mask, place=place)
    session.config = msgspec.structs.replace(session.config, mask=mask)


def apart_px(one: Hands, mask: Map) -> np.ndarray:
    """How far a map of the mask is from the true one, in projector pixels."""
    true = panels_of(load_bench_truth(one.config).of(one.config))
    x, y = ((np.arange(20) + 0.5) / 20 * side for side in mask.size_px)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    where = map_between(true.mask.map, true.projector.map, points)
    inside = ((where > 4.0) & (where < np.array(true.projector.size_px) - 4.0)).all(axis=-1)
    found = map_between(mask, one.session.found("projector"), points)
    return np.asarray(np.hypot(*(found - where)[inside].T))


@pytest.mark.parametrize("quads", [(160, 120), (192, 144)])
def test_a_camera_that_looks_straight_on_is_not_called_one_that_moved(
    quads: tuple[int, int], tmp_path: Path
) -> None:
    """All three devices on one raster, where quads and pixels may fall into step."""
    size = (256, 192)
    config = make_config(tmp_path, projector_px=size, mask_px=size, quads=quads)
    one = Hands(config, tmp_path, full=80, f_number=22.0)
    one.knows_maps()
    told = {f.name: f for f in one.run("registration", calibrate_registration(one.session)).figures}
    assert told["mask.offset_px"].value < 0.1


@pytest.mark.long
def test_the_mask_is_found_where_it_is(tmp_path: Path) -> None:
    one = hands(tmp_path)
    misplace(one.session, 1.5)
    assert np.median(apart_px(one, one.session.found("mask"))) > 1.0
    outcome = one.run("registration", calibrate_registration(one.session))
    assert one.photos == 29
    # A panel of 192 pixels has few stripes: at full size, 95 % are within 0.06.
    wrong = apart_px(one, outcome.maps["mask"])
    assert np.quantile(wrong, 0.95) < 0.12
    assert np.median(wrong) < 0.05
    told = {figure.name: figure for figure in outcome.figures}
    assert told["mask.offset_px"].value == pytest.approx(1.5, abs=0.4)
    # What is said of the map is what is true of it, or worse: its own error at the worst places.
    assert 0.7 < told["rig.misregistration_px"].value / np.quantile(wrong, 0.95) < 6.0
    config = one.session.config
    assert config.mask.offset_px == (0.0, 0.0)
    assert config.rig.misregistration_px == told["rig.misregistration_px"].value
    assert config.mask.blur_px < 0.2
    assert told["leak_2px"].value > told["leak_4px"].value > told["leak_8px"].value
    assert all(np.isfinite(array).all() for array in outcome.arrays.values())
    assert preview_of(outcome)[:4] == b"\x89PNG"


def test_a_coarse_camera_makes_the_map_better_and_its_picture_says_so(tmp_path: Path) -> None:
    """Of 6 px stripes it has two quads a period: single offsets scatter, the map does not."""
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    one = hands(tmp_path, quads=COARSE_QUADS)
    misplace(one.session, 0.3)
    believed = float(np.quantile(apart_px(one, one.session.found("mask")), 0.95))
    outcome = one.run("registration", calibrate_registration(one.session))
    left = float(np.quantile(apart_px(one, outcome.maps["mask"]), 0.95))
    assert left < 0.2 * believed
    figure = Figure()
    assert outcome.picture is not None
    outcome.picture(figure)
    drawn = [float(axes.get_title().split("below ")[1].split()[0]) for axes in figure.axes[:2]]
    assert drawn[0] == pytest.approx(believed, rel=0.25)
    assert drawn[1] < 2.0 * left
