"""Sensor, light and grey levels of mock benches, found by the bench itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.mock.camera import F_NUMBERS, MockReadout
from pdcd.bench.calibration import CALIBRATION_ARRAYS, PROFILE
from pdcd.bench.measured import apply_calibration
from pdcd.capture.again import recompute_calibration
from pdcd.capture.engine import Engine
from pdcd.capture.rig import Rig
from pdcd.capture.worker.calibrating import read_arrays
from pdcd.sensor.profile import load_profile
from tests.e2e.calibration.steps_rig import SmallBench
from tests.taken import Calibrated, calibrate, started

pytestmark = pytest.mark.whole

TRUTH = """
[projector]
contrast = 900.0
rise_s = 0.0031
fall_s = 0.0052
gamma = 2.1
falloff = 0.2
[mask]
contrast = 450.0
skew_s = 0.0037
rise_s = 0.0045
fall_s = 0.0071
gamma = 1.6
[camera]
blur_quads = 0.7
falloff = 0.3
[scene]
ambient = 0.002
[sensor]
gain = 1.07
read_noise = 0.9
full_well = 0.7
responsivity_e = [5.3e6, 9.1e6, 5.1e6]
"""
TRUE_STOPS = {
    f: 2.0 ** (round(6.0 * math.log2(f)) / 6.0) * (1.0 + 0.02 * math.sin(7.0 * f))
    for f in F_NUMBERS
}
"""A lens that is true to 2^(k/6) within 2 %."""
TRUTH += "".join(
    f"[[sensor.stops]]\nf_number = {f}\ntrue = {true}\n" for f, true in TRUE_STOPS.items()
)
GAIN, READ_E = 2.96 / 1.07, 16.8 * 0.9
"""Of the profile "450d" at ISO 100, with the truth's factors."""
SMALL = (160, 120)
"""Quads of photos of which nothing fine is asked."""


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    """A bench that went on by its calibration."""
    with started(SmallBench(tmp_path_factory.mktemp("light"), TRUTH).config) as engine:
        yield engine


@pytest.fixture(scope="module")
def done(engine: Engine) -> Calibrated:
    return calibrate(engine, "sensor", "light")


@pytest.mark.long
def test_the_sensor_is_found(done: Calibrated) -> None:
    assert done.value("sensor.gain_e_per_dn") == pytest.approx(GAIN, rel=0.005)
    assert done.value("sensor.read_noise_e") == pytest.approx(READ_E, rel=0.01)
    full_dn = 0.7 * 41400.0 / GAIN
    assert done.value("sensor.saturation_dn") == pytest.approx(full_dn, rel=0.01)
    # It is full sooner than was believed: later photos are shorter.
    before, after = (done.step(name).settings["full_refreshes"] for name in ("sensor", "light"))
    assert after / before == pytest.approx(full_dn / (14605 - 1024), rel=0.01)
    assert done.value("sensor.linearity") < 0.002
    assert done.step("sensor").verdict == "good"
    assert done.record.measured["camera.profile"].value == PROFILE
    profile = load_profile(done.folder / PROFILE)
    assert profile.row(100).gain_e_per_dn == pytest.approx(GAIN, rel=0.005)
    assert not profile.estimated
    # What the projector's edges add to any time of white.
    edge = read_arrays(done.folder / CALIBRATION_ARRAYS)["sensor.edge_s"]
    assert edge[0] == pytest.approx(0.0052 - 0.0031, abs=4.0 * edge[1] + 1e-4)


@pytest.mark.long
def test_contrasts_room_and_brightness_are_found(done: Calibrated) -> None:
    measured = done.record.measured
    for panel, contrast in (("projector", 900.0), ("mask", 450.0)):
        entry = measured[f"{panel}.contrast"]
        assert entry.value == pytest.approx(contrast, rel=0.02)
        assert isinstance(entry.sigma, float)
    assert done.value("scene.ambient") == pytest.approx(0.002, rel=0.02)
    assert "scene.ambient" not in measured  # of the room while it was measured, not of a capture
    # Stops beside each other, and the brightness at any of them.
    first, *others = measured["camera.stops"].value
    assert first["sigma"] == 0.0 and len(others) > 10
    for stop in others:
        ratio = TRUE_STOPS[stop["f_number"]] / TRUE_STOPS[first["f_number"]]
        wrong = (stop["true"] / first["true"] / ratio) ** 2 - 1.0
        assert abs(wrong) < max(4.0 * stop["sigma"], 1e-4) and stop["sigma"] < 0.004
    found = np.array(measured["camera.responsivity_e"].value) / first["true"] ** 2
    true = np.array([5.3e6, 9.1e6, 5.1e6]) / TRUE_STOPS[first["f_number"]] ** 2
    assert found == pytest.approx(true, rel=0.01)
    assert done.step("light").verdict == "good"
    for name in ("sensor", "light"):
        assert (done.folder / "preview" / f"{name}.png").stat().st_size > 1000


@pytest.mark.long
def test_both_are_computed_again_bit_for_bit(done: Calibrated) -> None:
    found = recompute_calibration(done.folder)
    assert found.identical, found.items
    assert {"step light", "camera.profile", PROFILE, CALIBRATION_ARRAYS} <= {
        item.name for item in found.items
    }


@pytest.mark.long
def test_a_mock_body_stays_what_it_is_when_its_profile_was_measured(
    engine: Engine, done: Calibrated
) -> None:
    assert engine._config.camera.profile == str(done.folder / PROFILE)
    assert load_profile(done.folder / PROFILE).base == "450d"
    readout = engine._rig.readout
    assert isinstance(readout, MockReadout)
    row = readout._sensor._true.row(100)
    assert row.gain_e_per_dn == pytest.approx(GAIN)
    assert row.read_noise_e == pytest.approx(READ_E)


def test_grey_levels_of_both_panels_are_found(tmp_path: Path) -> None:
    bench = SmallBench(tmp_path / "bench", TRUTH, placed=True, quads=SMALL)
    done = bench.calibrate("response")
    for panel, gamma in (("projector", 2.1), ("mask", 1.6)):
        assert done.value(f"{panel}.gamma") == pytest.approx(gamma, abs=0.01)
        arrays = read_arrays(done.folder / CALIBRATION_ARRAYS)
        levels, light = arrays[f"{panel}.grey.levels"], arrays[f"{panel}.grey.light"][0]
        assert light == pytest.approx((levels / 255.0) ** gamma, abs=0.01)
        half = int(arrays[f"{panel}.grey.level_for"][128])
        assert half == pytest.approx(255.0 * (128 / 255) ** (1.0 / gamma), abs=2)
    assert done.step("response").verdict == "good"
    used = apply_calibration(bench.config)
    assert (used.projector.gamma, used.mask.gamma) == pytest.approx((2.1, 1.6), abs=0.01)
    assert used.projector.lut is used.mask.lut is None


@pytest.mark.long
def test_nobody_covers_the_projector_and_something_covers_half_of_the_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The room is then in the projector's black, and both are told of."""
    monkeypatch.setattr(Rig, "mock", property(lambda rig: False))
    dead = ", ".join(map(str, range(128)))
    truth = f"[projector]\ncontrast = 900.0\ndead_columns = [{dead}]\n[scene]\nambient = 0.002\n"
    done = SmallBench(tmp_path / "bench", truth, placed=True).calibrate("light")
    both = 1.0 / (1.0 / 900.0 + 0.002 / 0.9)
    assert done.value("projector.contrast") == pytest.approx(both, rel=0.02)
    assert done.value("light.field_lit") == pytest.approx(0.5, abs=0.03)
    step = done.step("light")
    assert step.verdict == "doubtful"
    assert "scene.ambient" not in {figure.name for figure in step.figures}
    assert not any(photo.name.startswith("light-C") for photo in step.photos)
    for advice in ("cover the projector's lens", "take away what covers it"):
        assert any(advice in text for text in step.advice)


@pytest.mark.long
def test_a_range_that_the_projector_clips_is_found_with_the_camera(tmp_path: Path) -> None:
    """It is in the truth only: levels 16 to 235 for black and white, then gamma."""
    truth = "[projector]\nclipped = [16, 235]\ngamma = 2.2\n[mask]\ngamma = 1.8\n"
    done = SmallBench(tmp_path, truth, quads=SMALL).calibrate("light")
    found = done.figures("light")
    states = {name: found[name].verdict for name in found if ".level_" in name}
    assert states == {
        "projector.level_16": "doubtful", "projector.level_239": "doubtful",
        "mask.level_16": "good", "mask.level_239": "good",
    }  # fmt: skip
    assert found["mask.level_16"].value == pytest.approx((16 / 255) ** 1.8, rel=0.02)
    assert found["mask.level_239"].value == pytest.approx((239 / 255) ** 1.8, rel=0.005)
    (dark, light) = [text for text in done.result.warnings if "full range" in text]
    assert "level 16 of the projector gives the light of 0:" in dark
    assert "level 239 of the projector gives the light of 255:" in light
