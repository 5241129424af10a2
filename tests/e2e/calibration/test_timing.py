"""The steps of timing and of the shutter, on benches whose times nobody told."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.bench.truth import load_bench_truth
from pdcd.panels.schedule import SLOTS
from pdcd.probing.pulses import PanelResponse
from tests.e2e.calibration.timing_rig import REFRESH_S, bench, calibrated, late_s, leaks_of

pytestmark = pytest.mark.whole

STRIPS = tuple(f"rhythms-{number}" for number in (1, 2, 3, 4))
TAUS = """
[projector]
contrast = 900.0
rise_s = 0.0031
fall_s = 0.0022
{projector}
[mask]
contrast = 450.0
rise_s = 0.0045
fall_s = 0.0071
{mask}
"""


def lags_s(config: Config, rows: np.ndarray) -> np.ndarray:
    """When the mask's light of a row of the field comes after the projector's; panels are upright.
    What the display delays on purpose is in it."""
    delay_s = config.display.mask_delay_refreshes * REFRESH_S
    return np.asarray(delay_s + late_s(config.mask, rows) - late_s(config.projector, rows))


def leaks(config: Config, late_s: np.ndarray) -> dict[str, float]:
    """`leaks_of` a configuration, the mean of all rows."""
    light, opening = (PanelResponse(p.rise_s, p.fall_s) for p in (config.projector, config.mask))
    return leaks_of(light, opening, late_s)


def check_found(believed: Config, found: Config, *, rows: int = 40) -> None:
    """The words say what is true, as far as it counts: time constants, lag by row, leaks."""
    true = load_bench_truth(believed).of(believed)
    true = msgspec.structs.replace(true, display=found.display)
    for name in ("projector", "mask"):
        said, real = getattr(found, name), getattr(true, name)
        assert said.rise_s == pytest.approx(real.rise_s, rel=0.06)
        assert said.fall_s == pytest.approx(real.fall_s, rel=0.06)
    at = (np.arange(rows) + 0.5) / rows
    said_s, real_s = lags_s(found, at), lags_s(true, at)
    if not true.mask.scan_s:  # a bench that is set in bands has steps that a straight line has not
        assert np.abs(said_s - real_s).max() < 0.15e-3
    said_leaks, real_leaks = leaks(found, said_s), leaks(true, real_s)
    for schedule in SLOTS:
        assert said_leaks[schedule] == pytest.approx(real_leaks[schedule], abs=1e-3)


def test_lag_rise_and_fall_and_whole_refreshes(tmp_path: Path) -> None:
    """A mask that is seven refreshes and some late; the display then sends it all seven earlier."""
    believed = bench(tmp_path, TAUS.format(projector="", mask="skew_s = 0.1204"))
    done, found = calibrated(believed, "timing")
    check_found(believed, found)
    assert found.display.mask_delay_refreshes == -7
    assert found.mask.scan_s == 0.0
    assert (found.projector.skew_s, found.projector.scan_s) == (0.0, 0.0)
    step = done.step("timing")
    assert [photo.name for photo in step.photos] == [
        f"timing-{name}"
        for name in ("white", "coarse", "white-again", "coarse-again", "room", *STRIPS)
    ]
    assert step.verdict == "good" and any("7 refreshes earlier" in text for text in step.advice)
    entry = done.record.measured["mask.skew_s"]
    assert abs(entry.value - 0.1204) < 4.0 * float(entry.sigma)  # type: ignore[arg-type]
    assert (done.folder / "preview" / "timing.png").stat().st_size > 1000


@pytest.mark.long
def test_a_noisy_sensor_takes_more_strips(tmp_path: Path) -> None:
    """Small pixels before a fast projector: four photos leave its times unsure, and its leaks."""
    believed = bench(
        tmp_path,
        "[projector]\nrise_s = 0.00093\nfall_s = 0.00054\n"
        "[mask]\nskew_s = 0.0051\nrise_s = 0.0064\nfall_s = 0.0032\n",
    )
    camera = msgspec.structs.replace(believed.camera, profile="mono", f_number=64.0)
    done, found = calibrated(msgspec.structs.replace(believed, camera=camera), "timing")
    photos = done.step("timing").photos
    assert sum("rhythms" in photo.name for photo in photos) > len(STRIPS)
    at = (np.arange(40) + 0.5) / 40
    true = load_bench_truth(believed).of(believed)
    true = msgspec.structs.replace(true, display=found.display)
    real, said = leaks(true, lags_s(true, at)), leaks(found, lags_s(found, at))
    for schedule in SLOTS:  # without black refreshes before its code the mask shares its light
        assert said[schedule] == pytest.approx(real[schedule], abs=1e-3, rel=0.01), schedule


@pytest.mark.long
def test_twice_in_a_row_gives_the_same(tmp_path: Path) -> None:
    """The truth says nothing of bands: they are as typed, not as the first time found them."""
    believed = bench(tmp_path, TAUS.format(projector="", mask="skew_s = 0.002\nscan_s = 0.0158"))
    (done, found), (again, _) = (calibrated(believed, "timing") for _ in range(2))
    first, second = done.record.measured, again.record.measured
    assert found.mask.scan_bands != believed.mask.scan_bands
    assert load_bench_truth(found).of(found).mask == load_bench_truth(believed).of(believed).mask
    for key, entry in first.items():
        if isinstance(entry.sigma, float):
            sigma = np.hypot(entry.sigma, float(second[key].sigma))  # type: ignore[arg-type]
            assert abs(second[key].value - entry.value) < 4.0 * sigma + 1e-9, key
        else:
            assert second[key].value == entry.value, key


@pytest.mark.long
def test_panels_that_scan_against_each_other(tmp_path: Path) -> None:
    scan = "skew_s = 0.002\nscan_s = -0.0316\nscan_bands = 24"
    believed = bench(tmp_path, TAUS.format(projector="skew_s = 0.001", mask=scan))
    done, found = calibrated(believed, "timing")
    step = done.step("timing")
    true = load_bench_truth(believed).of(believed)
    bands = np.load(done.folder / "arrays.npz")["timing.lag_s"]
    rows = (np.arange(1200) + 0.5) / 1200
    real = lags_s(true, rows).reshape(bands.size, -1).mean(axis=1)
    np.testing.assert_allclose(bands, real, rtol=0, atol=0.15e-3)
    said = lags_s(found, rows).reshape(bands.size, -1).mean(axis=1)
    np.testing.assert_allclose(said, real - REFRESH_S, rtol=0, atol=0.15e-3)
    assert found.display.mask_delay_refreshes == -1  # for the middle of the field
    assert found.mask.scan_bands > 100
    assert found.rig.settle_s > abs(found.mask.scan_s) + abs(found.mask.skew_s)
    assert any("top and bottom: the panels are set in oppos" in text for text in step.advice)
    assert any("Mount one of them turned by 180 degrees" in text for text in step.advice)


@pytest.mark.long
def test_times_are_found_again_once_the_delay_is_taken_out(tmp_path: Path) -> None:
    """The display delays the mask by itself now: what is measured says so, and is as before."""
    believed = bench(tmp_path, TAUS.format(projector="", mask="skew_s = -0.0287"))
    display = msgspec.structs.replace(believed.display, mask_delay_refreshes=2)
    believed = msgspec.structs.replace(believed, display=display)
    done, found = calibrated(believed, "timing")
    assert len(done.step("timing").photos) == 3 + len(STRIPS)
    check_found(believed, found)
    assert found.display.mask_delay_refreshes == 2
    assert found.mask.skew_s == pytest.approx(-0.0287, abs=0.15e-3)


def test_timing_wants_maps(tmp_path: Path) -> None:
    for step in ("timing", "shutter"):
        done, found = calibrated(bench(tmp_path, "", placed=False), step)
        assert "has not been measured yet" in done.error
        assert found.mask.skew_s == 0.0


TRIGGER = "[trigger]\nlag_s = {}\njitter_s = {}\n"


def test_lag_and_jitter_of_the_shutter(tmp_path: Path) -> None:
    truth = TRIGGER.format(0.1163, 0.0012)
    believed = bench(tmp_path, truth, rise_s=0.0031, fall_s=0.0022)
    done, found = calibrated(believed, "shutter")
    # The bench draws two times a photo, for it opens and closes; one was metered, one was white,
    # and one was of the room.
    drawn = np.random.default_rng([believed.camera.seed, 2]).standard_normal(16)[6:]
    late_s = 0.1163 + 0.0012 * drawn
    assert found.trigger.lag_s == pytest.approx(late_s.mean(), abs=0.3e-3)
    assert found.trigger.jitter_s == pytest.approx(late_s.std(ddof=1), abs=0.2e-3)
    assert done.record.measured["trigger.lag_s"].step == "shutter"
    # Rise and fall of the projector were typed in: nobody knows how well.
    step = done.step("shutter")
    assert step.verdict == "doubtful" and any("run timing" in text for text in step.advice)


def test_the_lag_of_the_shutter_is_that_of_the_projectors_first_row(tmp_path: Path) -> None:
    """The others have their light later, which looks as if the shutter were earlier."""
    # Set row by row: of 32 bands, the last 15.5 ms late, the line through them spans 16.0 ms.
    truth = "[projector]\nscan_s = 0.0155\nscan_bands = 96\n" + TRIGGER.format(0.0863, 0.0)
    believed = bench(tmp_path, truth, rise_s=0.0031, fall_s=0.0022)
    done, found = calibrated(believed, "shutter")
    assert done.value("shutter.travel_opening_s") == pytest.approx(-0.0155, abs=0.5e-3)
    assert found.trigger.lag_s == pytest.approx(0.0863, abs=0.4e-3)
