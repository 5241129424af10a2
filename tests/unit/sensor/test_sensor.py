"""The sensor model against Poisson statistics, at the edges of its numbers, and its own file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.errors import ConfigError, ExposureError
from pdcd.sensor import profile as profiles
from pdcd.sensor.profile import (
    IsoRow,
    SensorProfile,
    compute_variance_dn2,
    expose_sensor,
    list_profiles,
    load_profile,
    responsivity_e,
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
        ("bits = 14", 'bits = "14"', "bits"),
        ("[[rows]]", "[[lines]]", "lines"),
        ("estimated", "=", "toml"),
    ],
)
def test_faulty_profiles_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        load_profile(path)


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


BASE: dict[str, Any] = {
    "name": "test", "description": "", "source": "", "estimated": True, "bits": 14,
    "black_dn": 512, "white_dn": 16383, "full_well_e": 50000.0, "dark_e_per_s": 0.1,
    "rows": (IsoRow(100, 2.0, 4.0), IsoRow(200, 1.0, 3.0)),
}  # fmt: skip
MODERN = (profiles.PROFILE_FOLDERS[1] / "modern.toml").read_text(encoding="utf-8")


def made(**changes: Any) -> SensorProfile:
    return SensorProfile(**{**BASE, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"bits": 1, "black_dn": 0, "white_dn": 1},
        {"bits": 16, "white_dn": 65535},
        {"black_dn": 0},
        {"black_dn": 16382},
        {"frame_quads": (1, 1)},
        {"rows": (IsoRow(1, 1.0, 1.0), IsoRow(65535, 1.0, 1.0))},
        {"full_well_e": 1e-9, "dark_e_per_s": 1e-9},
    ],
)
def test_numbers_that_just_make_a_sensor(changes: dict[str, Any]) -> None:
    profile = made(**changes)
    assert profile.isos == tuple(row.iso for row in profile.rows)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"bits": 0}, "bits = 0 is not in 1..16"),
        ({"bits": 17}, "bits = 17 is not in 1..16"),
        ({"black_dn": -1}, "0 <= black_dn < white_dn < 2^14 does not hold"),
        ({"black_dn": 16383}, "0 <= black_dn < white_dn < 2^14 does not hold"),
        ({"white_dn": 16384}, "0 <= black_dn < white_dn < 2^14 does not hold"),
        ({"frame_quads": (0, 5)}, "frame_quads = [0, 5] is no picture"),
        ({"frame_quads": (5, 0)}, "frame_quads = [5, 0] is no picture"),
        ({"rows": ()}, "ISOs [] are not one or more ascending values in 1..65535"),
        ({"rows": (IsoRow(0, 1.0, 1.0),)}, "ISOs [0] are not"),
        ({"rows": (IsoRow(65536, 1.0, 1.0),)}, "ISOs [65536] are not"),
        ({"rows": (IsoRow(5, 1.0, 1.0), IsoRow(5, 1.0, 1.0))}, "ISOs [5, 5] are not"),
        ({"rows": (IsoRow(5, 1.0, 1.0), IsoRow(4, 1.0, 1.0))}, "ISOs [5, 4] are not"),
        ({"dark_e_per_s": 0.0}, "dark_e_per_s = 0.0 is not a positive number"),
        ({"full_well_e": -math.inf}, "full_well_e = -inf is not a positive number"),
        ({"rows": (IsoRow(5, 1.0, math.nan),)}, "read_noise_e at ISO 5 = nan is not a positive"),
        ({"rows": (IsoRow(5, -1.0, 1.0),)}, "gain_e_per_dn at ISO 5 = -1.0 is not a positive"),
    ],
)
def test_numbers_that_make_none(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        made(**changes)
    assert caught.value.message.startswith(f"sensor profile 'test': {says}")
    assert caught.value.hint == "correct the profile's TOML file"


def test_a_row_is_found_by_its_iso() -> None:
    assert made().row(200) == IsoRow(200, 1.0, 3.0)
    with pytest.raises(ConfigError) as caught:
        made().row(150)
    assert caught.value.message == "sensor profile 'test' has no ISO 150"
    assert caught.value.hint == "choose one of 100, 200"


def test_saturation_is_the_lower_of_white_and_the_full_well() -> None:
    profile = made(full_well_e=10016.0)
    assert profile.saturation_dn(100) == 5000.0  # four times 4 e- below the well, 2 e- a DN
    assert profile.saturation_dn(200) == 10004.0
    assert made(full_well_e=1e6).saturation_dn(100) == 16383.0 - 512.0


def test_what_a_camera_tells_of_its_light() -> None:
    assert responsivity_e(CameraConfig()).tolist() == [4.8e6, 8.6e6, 5.6e6]
    told = msgspec.structs.replace(CameraConfig(), responsivity_e=(1.0, 2.0, 3.0))
    assert responsivity_e(told).tolist() == [1.0, 2.0, 3.0]


def test_profiles_are_named_in_order_and_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = tmp_path / "one", tmp_path / "two"
    for folder, names in zip(folders, ("b a", "c a"), strict=True):
        folder.mkdir()
        for name in names.split():
            text = MODERN.replace('name = "modern"', f'name = "{name} of {folder.name}"')
            (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    (folders[0] / "notes.txt").write_text("x", encoding="utf-8")
    monkeypatch.setattr(profiles, "PROFILE_FOLDERS", folders)
    assert list_profiles() == ("a", "b", "c")
    assert load_profile("a").name == "a of one" and load_profile("c").name == "c of two"
    assert load_profile(str(folders[1] / "a.toml")).name == "a of two"
    for unknown in ("d", "notes", "a.txt", "one/a"):
        with pytest.raises(ConfigError) as caught:
            load_profile(unknown)
        assert caught.value.message == f"unknown sensor profile {unknown!r}"
        assert caught.value.hint == "give the path of a .toml file, or one of: a, b, c"


def test_a_file_that_cannot_be_a_profile(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    for content in (b"\xff\xfe", b"name = 'x'\nbits =", b"name = 3"):
        path.write_bytes(content)
        with pytest.raises(ConfigError) as caught:
            load_profile(path)
        assert caught.value.message.startswith(f"sensor profile {path}: ")
        assert caught.value.hint == "compare with config/sensors/modern.toml"
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(ConfigError, match=r"cannot read sensor profile .*: it is a folder"):
        load_profile(tmp_path / "folder.toml")


def ideal(electrons: float, **changes: Any) -> int:
    return int(expose_sensor(np.full((1, 1), electrons), made(**changes), 100, 10.0, None)[0, 0])


def test_an_ideal_photo_is_gain_black_and_two_limits() -> None:
    assert ideal(0.0) == 512 and ideal(100.0) == 562 and ideal(101.1) == 563
    assert ideal(4e4) == 16383  # white
    assert ideal(4e4, full_well_e=20000.0) == 512 + 10000
    assert ideal(1e3, dark_e_per_s=1e6) == 1012  # no dark current where there is no chance


def test_light_may_end_a_little_below_zero_by_rounding() -> None:
    assert ideal(-1e-3) == 512
    for wrong in (-1.5e-3, -math.inf, math.inf, math.nan):
        with pytest.raises(ExposureError):
            ideal(wrong)


def test_faint_light_comes_in_whole_electrons_and_bright_light_does_not() -> None:
    """Fifty DN an electron, and next to no read noise."""
    fine = made(bits=16, black_dn=0, white_dn=65535, rows=(IsoRow(100, 0.02, 1e-9),))
    rng = np.random.default_rng(3)
    for electrons, whole in ((999.0, True), (1001.0, False)):
        photo = expose_sensor(np.full((8, 8), electrons), fine, 100, 0.0, rng)
        assert bool((photo % 50 == 0).all()) is whole
        assert abs(photo.mean() / 50 - electrons) < 4 * math.sqrt(electrons) / 8


def test_read_noise_comes_behind_the_well_and_ends_at_zero() -> None:
    rng = np.random.default_rng(4)
    full = made(full_well_e=2000.0, rows=(IsoRow(100, 2.0, 40.0),))
    photo = expose_sensor(np.full((60, 60), 1e5), full, 100, 1.0, rng).astype(np.float64)
    assert photo.mean() == pytest.approx(1512.0, abs=4 * 20.0 / 60)
    assert photo.std() == pytest.approx(20.0, rel=0.05)
    dark = made(black_dn=0, rows=(IsoRow(100, 1.0, 40.0),))
    assert expose_sensor(np.zeros((60, 60)), dark, 100, 1.0, rng).min() == 0


def test_the_variance_by_hand() -> None:
    found = compute_variance_dn2([-5.0, 0.0, 10.0], made(), 100, 20.0)
    # (20 e-^2 of ten DN) + 2 e-^2 of dark current + 16 e-^2 of reading, over 2 x 2, and rounding.
    assert found == pytest.approx([4.5 + 1 / 12, 4.5 + 1 / 12, 9.5 + 1 / 12], rel=1e-14)


def test_the_variance_of_single_precision_is_worked_out_in_double() -> None:
    assert compute_variance_dn2(np.ones(2, np.float32), made(), 100, 20.0).dtype == np.float64
