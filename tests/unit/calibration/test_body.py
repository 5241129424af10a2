"""Gain, read noise, saturation and linearity of a sensor whose numbers are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import RawSettings, make_quad_photo
from pdcd.calibration.sensor.body import (
    SensorMeasurement,
    SensorPlan,
    format_profile,
    make_measured_profile,
    measure_sensor,
)
from pdcd.calibration.sensor.transfer import compare_plane_pair, fit_photon_transfer
from pdcd.errors import CalibrationError
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import RawFrame
from tests.unit.calibration.light_bench import LightBench, TrueSensor

Floats = NDArray[np.float64]
Planes = NDArray[np.float32]
Spoil = Callable[[str, Floats], Floats]

PLAN = SensorPlan(full=80)
COLOURS = np.array([0.7, 1.0, 1.0, 0.8])


def keep(name: str, electrons: Floats) -> Floats:
    return electrons


@cache
def seconds(name: str) -> tuple[float, float]:
    """Light of each photo of the plan, in seconds of white."""
    return LightBench().seconds(next(shown for shown in PLAN.photos() if shown.name == name))


def series(
    seed: int = 0,
    sensor: TrueSensor | None = None,
    *,
    shape: tuple[int, int] = (128, 160),
    flicker: float = 0.0,
    texture: float = 0.0,
    before: Spoil = keep,
    bend: float = 0.0,
) -> dict[str, Planes]:
    """All photos of the plan; `before` spoils the light of one by its name."""
    sensor = sensor or TrueSensor()
    bench = LightBench(sensor=sensor, shape=shape)
    rng = np.random.default_rng(seed)
    paper = np.random.default_rng(3).random(shape)
    card = 1.0 - texture * paper
    full_e = min((sensor.white - sensor.black) * sensor.gain, sensor.full_well_e)
    photos = {}
    for shown in PLAN.photos():
        lit_s, _ = seconds(shown.name)
        lamp = 1.0 + flicker * rng.standard_normal()
        per_s = full_e / (PLAN.full / 60.0)
        light = per_s * lamp * lit_s * card * bench.vignetting()[..., 0]
        light = before(shown.name, light)
        planes = [
            sensor.samples(light * colour * (1.0 - bend * light / full_e), rng, fixed=plane)
            for plane, colour in enumerate(COLOURS)
        ]
        photos[shown.name] = np.array(planes, np.float32)
    return photos


def measured(photos: dict[str, Planes], plan: SensorPlan = PLAN) -> SensorMeasurement:
    return measure_sensor(photos, plan, iso=100, black_dn=np.full(4, 1024.0))


def test_a_card_that_fills_half_of_the_picture_is_no_bench_that_moved() -> None:
    """Noise of bright samples in what a row has in common is much beside its dark ones."""
    gain, read_dn, shape = 2.0, 4.0, (416, 288)
    light = np.zeros(shape)
    light[:, 96:192] = 6000.0

    def photo(level: float, rng: np.random.Generator) -> Floats:
        electrons = rng.poisson(light * level * gain)
        return np.asarray(electrons / gain + read_dn * rng.standard_normal(shape))

    chi2 = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        first, second = (photo(0.0, rng) for _ in range(2))
        pairs = [
            compare_plane_pair(photo(level, rng), photo(level, rng), first)
            for level in (0.3, 0.6, 1.0)
        ]
        found = fit_photon_transfer(
            "R", compare_plane_pair(first, second), tuple(pairs), highest_dn=9000.0
        )
        assert found.gain_e_per_dn == pytest.approx(gain, rel=0.02)
        chi2.append(found.chi2)
    assert np.mean(chi2) < 1.1 and max(chi2) < 1.25


def test_finds_the_numbers_of_the_sensor() -> None:
    body = measured(series(1, TrueSensor(prnu=0.01, hot=3e-4)))
    gain, sigma = body.gain
    assert gain == pytest.approx(2.96, abs=4 * sigma)
    assert sigma < 0.005 * 2.96
    read, sigma = body.read_noise
    assert read == pytest.approx(16.8, abs=4 * sigma)
    assert sigma < 0.008 * 16.8
    assert body.saturation_dn == pytest.approx(14605 - 1024, abs=1.0)
    assert all(line.error < 0.005 for line in body.lines)
    assert body.black_dn == pytest.approx(np.full(4, 1024.0), abs=0.2)
    assert max(f.verdict for f in body.figures()) == Verdict.GOOD


def test_errors_are_those_it_tells() -> None:
    pulls = []
    for seed in range(5):
        for plane in measured(series(100 + seed, shape=(96, 128))).transfer:
            pulls.append((plane.gain_e_per_dn - 2.96) / plane.gain_sigma)
            pulls.append((plane.read_noise_e - 16.8) / plane.read_sigma)
    assert 0.7 < float(np.std(pulls)) < 1.4
    assert abs(float(np.mean(pulls))) < 0.6


def test_a_frame_too_small_to_tell_a_gain_is_called_that() -> None:
    """Two pairs of photos of 64 x 48 quads a plane: two parts each."""
    with pytest.raises(CalibrationError, match=r"frame is too small .* have 4 parts") as caught:
        measured(series(2, shape=(48, 64)))
    assert "frame_quads" in str(caught.value)


def test_light_that_panels_leak_is_no_read_noise() -> None:
    """12 e- in every photo: their photon noise would make the read noise 2 % higher."""
    photos = series(3, shape=(192, 192), before=lambda _, electrons: electrons + 12.0)
    black = np.full(4, 1024.0)
    known = measure_sensor(photos, PLAN, iso=100, black_dn=black, masked=True).read_noise
    assert known[0] == pytest.approx(16.8, rel=0.01)
    # A number of the file may be wrong by as much: it is believed less.
    believed = measure_sensor(photos, PLAN, iso=100, black_dn=black).read_noise
    assert believed[0] > 1.005 * known[0]


def test_quads_beyond_the_field_do_not_count() -> None:
    """The frame sees past the field by eight quads on all sides, as far as a quarter of a block."""

    def beside(name: str, light: Floats) -> Floats:
        inside = np.zeros_like(light)
        inside[8:-8, 8:-8] = light[8:-8, 8:-8]
        return inside

    body = measured(series(5, before=beside, shape=(192, 256)))
    assert max(line.error for line in body.lines) < 0.005
    assert body.gain[0] == pytest.approx(2.96, rel=0.02)


def test_flicker_texture_and_banding_do_not_move_it() -> None:
    sensor = TrueSensor(prnu=0.01, banding_e=6.0)
    body = measured(series(2, sensor, flicker=0.03, texture=0.4))
    gain, sigma = body.gain
    assert gain == pytest.approx(2.96, abs=4 * sigma)
    read, sigma = body.read_noise
    assert read == pytest.approx(16.8, abs=4 * sigma)  # banding would add 6 %
    # A lamp that flickers by 3 % is no ruler: linearity is doubtful then, and said to be.
    assert body.lamp > 0.01
    linearity = next(f for f in body.figures() if f.name == "sensor.linearity")
    assert linearity.verdict == Verdict.DOUBTFUL


def test_blocks_near_saturation_do_not_count() -> None:
    body = measured(series(13, before=lambda name, light: 1.8 * light))
    for plane in body.transfer:
        assert plane.gain_e_per_dn == pytest.approx(2.96, abs=4 * plane.gain_sigma)
        assert plane.chi2 < 1.4


def test_a_full_well_is_told_from_the_end_of_the_converter() -> None:
    body = measured(series(3, TrueSensor(full_well_e=30000.0)))
    assert body.saturation_dn == pytest.approx(30000.0 / 2.96, rel=0.002)
    known = load_profile("450d")
    profile = make_measured_profile(body, known, name="x", description="d", source="s")
    assert profile.full_well_e == pytest.approx(30000.0, rel=0.01)
    assert profile.white_dn == known.white_dn


def test_a_bent_response_is_bad() -> None:
    body = measured(series(4, bend=0.05))
    linearity = next(f for f in body.figures() if f.name == "sensor.linearity")
    assert linearity.value > 0.01
    assert linearity.verdict == Verdict.BAD


def test_profile_is_a_file_that_can_be_read(tmp_path: Path) -> None:
    body = measured(series(6, shape=(96, 128)))
    known = load_profile("450d")
    profile = make_measured_profile(
        body, known, name="my-450d", description='the "bench"', source="here"
    )
    path = tmp_path / "my.toml"
    path.write_text(format_profile(profile))
    assert load_profile(path) == profile
    assert not profile.estimated
    assert profile.isos == (100,)  # the estimates of other ISOs are not taken over
    assert (profile.black_dn, profile.white_dn) == (1024, 14605)
    assert profile.row(100).gain_e_per_dn == pytest.approx(2.96, rel=0.02)
    again = make_measured_profile(body, profile, name="a", description="", source="")
    assert again.isos == (100,)


def of_one(names: tuple[str, ...], factor: float) -> Spoil:
    return lambda name, light: light * (factor if name in names else 1.0)


@pytest.mark.parametrize(
    ("before", "words"),
    [
        (lambda name, light: 0.0 * light, "lens cap"),
        (of_one(("dose-88",), 0.0), "dose-88 is dark.*shutter"),
        (of_one(("dose-48-again",), 0.1), "48 refreshes lacks light.*shutter"),
        (lambda name, light: 8.0 * light, "saturat|doses"),
        (lambda name, light: 0.02 * light, "dim"),
        (lambda name, light: light + 500.0 * name.startswith("dark"), "light comes in"),
        (lambda name, light: light * (np.arange(light.shape[1]) // 12 % 2), "evenly lit"),
        (lambda name, light: light + 9000.0 * (not name.startswith("dark")), "room lights"),
    ],
)
def test_bad_input_has_a_named_cause(before: Spoil, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        measured(series(7, shape=(96, 128), before=before))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda of, name: of[name.replace("-again", "").replace("dark-b", "dark-a")], "no noise"),
        (lambda of, name: np.roll(of[name], int("again" in name), axis=2), "moved"),
        (lambda of, name: of[name] + 4.0 * (name == "dark-b"), "black level moves"),
        (lambda of, name: 0.8 * of[name] + 0.2 * np.roll(of[name], 1, axis=2), "filtered"),
    ],
)
def test_photos_that_are_not_what_a_sensor_gave(
    spoil: Callable[[dict[str, Planes], str], Planes], words: str
) -> None:
    photos = series(8, shape=(96, 128), texture=0.5)
    with pytest.raises(CalibrationError, match=words):
        measured({name: spoil(photos, name) for name in photos})


def test_plan_counts_refreshes() -> None:
    photos = {shown.name: shown for shown in PLAN.photos()}
    assert {shown.refreshes for shown in photos.values()} == {PLAN.refreshes}
    for name, count in PLAN.doses.items():
        assert (photos[name].projector_index == -2).sum() == count
        assert (photos[name].mask_index == -2).all()
        # The mask is open before the light comes and after it is gone.
        lit = np.flatnonzero(photos[name].projector_index == -2)
        assert lit[0] == PLAN.lead
        assert lit[-1] < PLAN.refreshes - PLAN.lead


def test_a_decoded_file_as_a_photo() -> None:
    samples = np.stack([np.full((4, 6), level, np.uint16) for level in (1034, 1044, 1064, 1074)])
    saturated = np.zeros((4, 6), np.bool_)
    saturated[1, 2] = True
    black = np.array([1024.25, 1024.0, 1024.0, 1023.75])
    raw = RawFrame(
        samples, saturated, black, black, True, 14605.0, 100, 2.0, 8.0, "EOS", "", 0, "RGGB"
    )
    photo = make_quad_photo(raw, load_profile("450d"), 100)
    assert photo.light[0, 0] == pytest.approx([9.75, 30.0, 50.25])
    fixed = (16.8**2 + 0.25 * 2.0) / 2.96**2 + 1.0 / 12.0
    assert photo.variance[0, 0] == pytest.approx(
        [9.75 / 2.96 + fixed, (30 / 2.96 + fixed) / 2.0, 50.25 / 2.96 + fixed]
    )
    assert photo.saturated is not None and photo.saturated[1, 2]
    assert RawSettings.of(raw) == RawSettings(100, 2.0, 8.0, (1024.25, 1024.0, 1024.0, 1023.75))
    assert RawSettings.of(replace(raw, masked=False)).black_dn == ()


def test_light_that_leaks_unevenly_has_its_noise_where_it_is() -> None:
    """A quiet sensor, over which half a DN of leaked light falls off to nothing."""
    gain, read_dn, shape = 3.0, 0.55, (256, 384)
    leaked = 0.5 * np.linspace(0.0, 2.0, shape[1])[None] * np.ones(shape)

    def photo(level: float, rng: np.random.Generator) -> Floats:
        electrons = rng.poisson((leaked + level) * gain)
        return np.rint(electrons / gain + read_dn * rng.standard_normal(shape))

    chi2, read = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        dark, again = (photo(0.0, rng) for _ in range(2))
        pairs = [
            compare_plane_pair(photo(level, rng), photo(level, rng), dark)
            for level in (1500.0, 4000.0)
        ]
        found = fit_photon_transfer(
            "R", compare_plane_pair(dark, again), tuple(pairs), highest_dn=9000.0, leaked_dn=0.5
        )
        chi2.append(found.chi2)
        read.append(found.read_noise_e)
    assert np.mean(chi2) < 1.1 and max(chi2) < 1.3
    assert np.mean(read) == pytest.approx(gain * read_dn, rel=0.01)


def test_a_lamp_of_very_different_light_gives_the_same_gain() -> None:
    rng, sensor = np.random.default_rng(11), TrueSensor()
    dark, again, first, second = (
        sensor.samples(np.full((256, 256), light), rng) for light in (0.0, 0.0, 20000.0, 9000.0)
    )
    first[::37, ::41] += 4000.0  # what particles of cosmic rays leave
    lit = compare_plane_pair(first, second, dark)
    found = fit_photon_transfer("G1", compare_plane_pair(dark, again), (lit,), highest_dn=9000.0)
    assert found.gain_e_per_dn == pytest.approx(2.96, abs=4 * found.gain_sigma)
    assert found.gain_sigma < 0.03
