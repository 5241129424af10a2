"""The SNR comparison against the printed appendix, simulated photos and a root finder."""

from __future__ import annotations

import math
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import brentq

from pdcd.errors import ConfigError
from pdcd.sensor.appendix import PrintedRow, compute_appendix_rows
from pdcd.sensor.profile import IsoRow, SensorProfile, expose_sensor
from pdcd.sensor.snr import (
    SNR_GOALS,
    THERMALS,
    SnrGoal,
    SnrPixel,
    Thermal,
    break_even_read_noise_e,
    compute_masked_sum,
    compute_primal_dual_pair,
    compute_primal_dual_photo,
    compute_short_photo,
    compute_signed_sum,
)


def paper_db(electrons: float, additive_e: float, thermal_e: float) -> float:
    """The appendix's formula as printed."""
    return 10 * math.log10(electrons / math.sqrt(electrons + additive_e**2 + thermal_e**2))


def appendix_row(quantity: str) -> PrintedRow:
    return next(row for row in compute_appendix_rows() if row.quantity == quantity)


# --- the appendix -------------------------------------------------------------------------------

ELECTRONS = 0.13 * 3135.9 * 26.03

# quantity, printed, is its last digit cut rather than rounded, our value, how far that is known
APPENDIX: list[tuple[str, str, bool, float, float]] = [
    ("mean intensity, 12-bit DN", "407.66", True, 407.667, 1e-9),
    ("electrons of the photo", "10611.57", False, ELECTRONS, 1e-9),
    ("photo, ISO 50, dB", "19.9", False, paper_db(ELECTRONS, 30.62, 0.25 * 30), 1e-9),
    ("photos in the masked sum", "256", False, 512 / 2, 0.0),
    ("electrons of a mask-less photo", "41.45", False, 41.4515, 5e-5),
    ("mask-less photo, ISO 50, dB", "1.22", False, 1.2214, 5e-5),
    ("mask-less photo, ISO 1600, dB", "7.4", False, 7.409, 5e-4),
    ("additive noise of the sum, times", "16", False, 16.0, 0.0),
    ("additive noise, ISO 50, e-", "489.92", False, 16 * 30.62, 1e-9),
    ("additive noise, ISO 1600, e-", "62.4", False, 16 * 3.9, 1e-9),
    ("masked sum, ISO 50, dB", "13.2", True, 13.262, 5e-4),
    ("masked sum, ISO 1600, dB", "19.4", False, 19.442, 5e-4),
    ("photo, 1/10 light, ISO 1600, dB", "15.1", False, 15.097, 5e-4),
    ("masked sum, 1/10 light, ISO 1600, dB", "11.8", False, 11.782, 5e-4),
]


@pytest.mark.parametrize("row", APPENDIX, ids=[row[0] for row in APPENDIX])
def test_printed_number_of_the_appendix(row: tuple[str, str, bool, float, float]) -> None:
    quantity, printed, truncated, value, tolerance = row
    ours = appendix_row(quantity)
    assert (ours.printed, ours.truncated) == (printed, truncated)
    assert ours.ours == pytest.approx(value, abs=tolerance)
    digits = Decimal(printed)
    way = ROUND_DOWN if truncated else ROUND_HALF_EVEN
    assert Decimal(ours.ours).quantize(digits, way) == digits
    if truncated:  # else it would not be an oddity of the paper
        assert Decimal(ours.ours).quantize(digits, ROUND_HALF_EVEN) != digits


def test_table_holds_these_numbers_in_the_order_of_the_appendix() -> None:
    assert [row.quantity for row in compute_appendix_rows()] == [row[0] for row in APPENDIX]


# --- against simulated photos -------------------------------------------------------------------

PIXELS = 4000
HOT = SensorProfile(
    name="hot",
    description="dark current that shows, rounding that does not",
    source="made up",
    estimated=True,
    bits=16,
    black_dn=1000,
    white_dn=65535,
    full_well_e=60000.0,
    dark_e_per_s=20.0,
    rows=(
        IsoRow(iso=100, gain_e_per_dn=0.1, read_noise_e=30.0),
        IsoRow(iso=200, gain_e_per_dn=0.1, read_noise_e=3.0),
    ),
)
PIXEL = SnrPixel(signal_e=2000.0, exposure_s=30.0, codes=64, dark_e_per_s=20.0)


def simulated_e(
    electrons: float, exposure_s: float, iso: int, photos: int, seed: int
) -> NDArray[np.float64]:
    """Charge read from `photos` photos of `PIXELS` equal pixels: (photos, PIXELS) float64, e-."""
    scene = np.full((photos, PIXELS), electrons)
    raw = expose_sensor(scene, HOT, iso, exposure_s, np.random.default_rng(seed))
    return (raw.astype(np.float64) - HOT.black_dn) * HOT.rows[0].gain_e_per_dn


def simulated_db(sums_e: NDArray[np.float64], signal_e: float) -> float:
    return 10 * math.log10(signal_e / float(np.std(sums_e)))


# A standard deviation from 4000 samples is good to 1.1 %, 0.05 dB; four of those:
SIMULATED = 0.2


def test_photo_agrees_with_simulation() -> None:
    photo = simulated_e(2000.0, 30.0, 100, 1, seed=1)
    ours = compute_primal_dual_photo(PIXEL, 30.0, "shot")
    assert ours.snr_db == pytest.approx(simulated_db(photo, 2000.0), abs=SIMULATED)
    # The printed thermal term would be far off here.
    assert compute_primal_dual_photo(PIXEL, 30.0, "paper").snr_db < ours.snr_db - 10


def test_masked_sum_agrees_with_simulation() -> None:
    photos = simulated_e(2000.0 / 32, 30.0 / 64, 200, 32, seed=3)
    ours = compute_masked_sum(PIXEL, 3.0, "shot")
    assert ours.snr_db == pytest.approx(simulated_db(photos.sum(axis=0), 2000.0), abs=SIMULATED)
    one = compute_short_photo(PIXEL, 3.0, "shot")
    assert one.snr_db == pytest.approx(simulated_db(photos[0], 62.5), abs=SIMULATED)


def test_signed_sum_has_the_noise_of_all_photos_whatever_the_signs() -> None:
    photos = simulated_e(2000.0 / 32, 30.0 / 64, 200, 64, seed=4)
    ours = compute_signed_sum(PIXEL, 3.0, "shot")
    signs = np.random.default_rng(5).choice([-1.0, 1.0], size=64)
    for weights in (np.ones(64), signs):
        assert ours.snr_db == pytest.approx(
            simulated_db(weights @ photos, photos.sum(axis=0).mean()), abs=SIMULATED
        )


def test_signed_pair_agrees_with_simulation() -> None:
    positive, negative = simulated_e(2000.0 / 2, 30.0 / 2, 100, 2, seed=7)
    ours = compute_primal_dual_pair(PIXEL, 30.0, "shot")
    light = float((positive + negative).mean())
    assert ours.snr_db == pytest.approx(simulated_db(positive - negative, light), abs=SIMULATED)


# --- break-even ---------------------------------------------------------------------------------


def gap_db(
    pixel: SnrPixel, goal: SnrGoal, thermal: Thermal, transmission: float, read_noise_e: float
) -> float:
    """How much better the photo is, dB, written out from the definitions."""
    ours, dark_e = transmission * pixel.signal_e, pixel.dark_e_per_s * pixel.exposure_s
    if goal == "masked":
        photos, others, light_e, open_time = 1.0, pixel.codes / 2, pixel.signal_e, 0.5
    else:
        photos, others, light_e, open_time = 2.0, float(pixel.codes), 2 * pixel.signal_e, 1.0
    ours_dark_e2, other_dark_e2 = dark_e, dark_e * open_time
    if thermal == "paper":
        ours_dark_e2 = other_dark_e2 = dark_e**2
    photo = ours / math.sqrt(ours + photos * read_noise_e**2 + ours_dark_e2)
    other = light_e / math.sqrt(light_e + others * read_noise_e**2 + other_dark_e2)
    return 10 * math.log10(photo / other)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    signal_e=st.floats(1.0, 1e5),
    codes=st.integers(2, 4096),
    dark_e_per_s=st.floats(0.0, 5.0),
    transmission=st.floats(0.05, 1.0),
    goal=st.sampled_from(SNR_GOALS),
    thermal=st.sampled_from(THERMALS),
)
def test_break_even_is_where_a_root_finder_puts_it(
    signal_e: float,
    codes: int,
    dark_e_per_s: float,
    transmission: float,
    goal: SnrGoal,
    thermal: Thermal,
) -> None:
    pixel = SnrPixel(signal_e=signal_e, exposure_s=30.0, codes=codes, dark_e_per_s=dark_e_per_s)

    def gap(read_noise_e: float) -> float:
        return gap_db(pixel, goal, thermal, transmission, read_noise_e)

    ours = break_even_read_noise_e(pixel, goal, thermal, transmission)
    if ours == math.inf:
        assert max(gap(read_noise_e) for read_noise_e in (0.0, 1.0, 1e3, 1e6)) <= 1e-6
    elif ours == 0.0:
        assert gap(0.0) == pytest.approx(0.0, abs=1e-12)
        assert min(gap(read_noise_e) for read_noise_e in (1.0, 1e3, 1e6)) > 0.0
    else:
        assume(1e-3 < ours < 1e6)
        assert gap(0.0) < 0.0 < gap(1e7)
        assert ours == pytest.approx(brentq(gap, 0.0, 1e7, xtol=1e-9, rtol=1e-12), rel=1e-6)


def test_mask_never_pays_where_its_rival_has_as_few_photos() -> None:
    two = SnrPixel(signal_e=1e4, exposure_s=1.0, codes=2, dark_e_per_s=0.1)
    assert break_even_read_noise_e(two, "masked", "shot") == math.inf
    eight = SnrPixel(signal_e=1e4, exposure_s=1.0, codes=8, dark_e_per_s=0.1)
    assert break_even_read_noise_e(eight, "signed", "shot") == math.inf


# --- any sensor ---------------------------------------------------------------------------------


def test_every_fault_of_a_pixel_is_named_at_once() -> None:
    with pytest.raises(ConfigError, match=r"signal = nan.*exposure = -1.*dark.*codes = 1 "):
        SnrPixel(signal_e=math.nan, exposure_s=-1.0, codes=1, dark_e_per_s=math.inf)
