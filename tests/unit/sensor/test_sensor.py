"""The sensor model against the paper's appendix, Poisson statistics and its own file format."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import ConfigError, ExposureError
from pdcd.sensor.profile import (
    IsoRow,
    SensorProfile,
    compute_variance_dn2,
    expose_sensor,
    list_profiles,
    load_profile,
)

GOOD = """
name = "test"
description = "d"
source = "s"
estimated = false
bits = 14
black_dn = 512
white_dn = 16383
full_well_e = 50000
dark_e_per_s = 0.1
[[rows]]
iso = 100
gain_e_per_dn = 3.0
read_noise_e = 1.5
"""


def counting_profile(**changes: float) -> SensorProfile:
    """One DN an electron, next to no other noise: what `expose_sensor` draws can be read off."""
    numbers = {"full_well_e": 60000.0, "dark_e_per_s": 1e-9} | changes
    return SensorProfile(
        name="counting",
        description="",
        source="",
        estimated=True,
        bits=16,
        black_dn=100,
        white_dn=65535,
        full_well_e=numbers["full_well_e"],
        dark_e_per_s=numbers["dark_e_per_s"],
        rows=(IsoRow(iso=100, gain_e_per_dn=1.0, read_noise_e=1e-6),),
    )


def test_bundled_profiles_are_named_as_their_files() -> None:
    assert set(list_profiles()) >= {"mark2", "450d", "modern"}
    for name in list_profiles():
        assert load_profile(name).name == name


def test_profile_from_a_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    profile = load_profile(str(path))
    assert profile == load_profile(path)
    assert profile.isos == (100,)
    assert profile.saturation_dn(100) == 16383 - 512


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("dark_e_per_s", "dark_e_per_min", "dark_e_per_"),
        ("iso = 100", "iso = 100\ngain = 1", "gain"),
        ("full_well_e = 50000", "full_well_e = nan", "full_well_e = nan"),
        ("full_well_e = 50000", "full_well_e = inf", "full_well_e = inf"),
        ("gain_e_per_dn = 3.0", "gain_e_per_dn = 0.0", "gain_e_per_dn at ISO 100 = 0.0"),
        ("read_noise_e = 1.5", "read_noise_e = -1", "read_noise_e at ISO 100 = -1"),
        ("black_dn = 512", "black_dn = 16383", "black_dn < white_dn"),
        ("black_dn = 512", "black_dn = -1", "black_dn < white_dn"),
        ("white_dn = 16383", "white_dn = 16384", "black_dn < white_dn"),
        ("bits = 14", "bits = 17", "bits = 17"),
        ("bits = 14", 'bits = "14"', "bits"),
        ("iso = 100", "iso = 0", "ISOs"),
        ("iso = 100", "iso = 70000", "ISOs"),
        ("[[rows]]", "[[lines]]", "lines"),
        ("estimated", "=", "toml"),
    ],
)
def test_faulty_profiles_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        load_profile(path)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(electrons=st.floats(0.0, 1e6))
def test_ideal_sensor_only_scales_and_clips(electrons: float) -> None:
    mark2 = load_profile("mark2")
    sample = int(expose_sensor(np.full((2, 2), electrons), mark2, 50, 30.0, None)[0, 0])
    # Full well is reached below the white level at ISO 50.
    assert abs(sample - (512 + min(electrons, 80000.0) / 6.5075)) <= 0.5 + 1e-9


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1.0])
def test_impossible_light_is_refused(wrong: float) -> None:
    electrons = np.ones((2, 2))
    electrons[1, 0] = wrong
    with pytest.raises(ExposureError, match="finite"):
        expose_sensor(electrons, load_profile("modern"), 100, 1.0, None)


def test_expose_leaves_its_input_alone_and_repeats_with_the_seed() -> None:
    electrons = np.full((8, 8), 500.0)
    first = expose_sensor(electrons, load_profile("450d"), 400, 10.0, np.random.default_rng(5))
    again = expose_sensor(electrons, load_profile("450d"), 400, 10.0, np.random.default_rng(5))
    other = expose_sensor(electrons, load_profile("450d"), 400, 10.0, np.random.default_rng(6))
    assert np.all(electrons == 500.0)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.dtype == np.uint16


@pytest.mark.parametrize(("name", "iso", "exposure_s"), [("mark2", 50, 30.0), ("450d", 400, 600.0)])
@pytest.mark.parametrize("electrons", [0.0, 20.0, 990.0, 1010.0, 8000.0])
def test_photon_transfer(name: str, iso: int, exposure_s: float, electrons: float) -> None:
    """Mean and variance of many samples within 4 standard errors (1.6 % for the variance)."""
    profile = load_profile(name)
    row = profile.row(iso)
    shape = (360, 360)
    count = shape[0] * shape[1]
    rng = np.random.default_rng(int(electrons))
    photo = expose_sensor(np.full(shape, electrons), profile, iso, exposure_s, rng)
    signal = photo.astype(np.float64) - profile.black_dn
    noise_e2 = electrons + profile.dark_e_per_s * exposure_s + row.read_noise_e**2
    expected = noise_e2 / row.gain_e_per_dn**2 + 1 / 12
    assert signal.var() == pytest.approx(expected, rel=4 * math.sqrt(2 / count))
    assert signal.mean() == pytest.approx(
        electrons / row.gain_e_per_dn, abs=4 * math.sqrt(expected / count)
    )
    assert compute_variance_dn2(
        electrons / row.gain_e_per_dn, profile, iso, exposure_s
    ) == pytest.approx(expected, rel=1e-12)


def test_faint_light_is_poisson_distributed() -> None:
    shape = (400, 400)
    photo = expose_sensor(
        np.full(shape, 3.0), counting_profile(), 100, 1.0, np.random.default_rng(1)
    )
    counts = np.bincount(photo.ravel() - 100, minlength=30)
    for photons in range(8):
        share = math.exp(-3.0) * 3.0**photons / math.factorial(photons)
        error = math.sqrt(share * (1 - share) / photo.size)
        assert counts[photons] / photo.size == pytest.approx(share, abs=4 * error)


def test_dark_current_adds_noise_but_no_light() -> None:
    shape = (400, 400)
    rng = np.random.default_rng(2)
    photo = expose_sensor(np.zeros(shape), counting_profile(dark_e_per_s=0.5), 100, 60.0, rng)
    signal = photo.astype(np.float64) - 100
    assert abs(signal.mean()) < 4 * math.sqrt(30.0 / photo.size)
    # The count minus its mean, 30, is a whole number: nothing is added by rounding.
    assert signal.var() == pytest.approx(30.0, rel=4 * math.sqrt((2 + 1 / 30) / photo.size))


@pytest.mark.parametrize("name", ["mark2", "450d", "modern"])
def test_saturation_level_separates_full_samples_from_bright_ones(name: str) -> None:
    profile = load_profile(name)
    for row in profile.rows:
        limit_dn = profile.saturation_dn(row.iso)
        rng = np.random.default_rng(row.iso)
        full = expose_sensor(np.full((60, 60), 5e5), profile, row.iso, 30.0, rng)
        assert np.mean(full.astype(np.float64) - profile.black_dn >= limit_dn) > 0.999
        bright_e = 0.8 * limit_dn * row.gain_e_per_dn
        bright = expose_sensor(np.full((60, 60), bright_e), profile, row.iso, 30.0, rng)
        assert not np.any(bright.astype(np.float64) - profile.black_dn >= limit_dn)
