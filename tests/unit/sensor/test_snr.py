"""The SNR comparison against the printed appendix, simulated photos and a root finder."""

from __future__ import annotations

import math
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal
from typing import Any

import msgspec
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
    compute_opening_limit_db,
    compute_primal_dual_pair,
    compute_primal_dual_photo,
    compute_sensor_rows,
    compute_short_photo,
    compute_signed_sum,
    find_quiet_iso,
    highest_signal_e,
    make_sensor_pixel,
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


@settings(max_examples=50)
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


LIT = SnrPixel(signal_e=1000.0, exposure_s=8.0, codes=16, dark_e_per_s=3.0)
# At ISO 100 a pixel holds 10 000 e-, at 200 and 400 half and a quarter.
SENSOR = SensorProfile(
    name="made", description="", source="", estimated=True, bits=14, black_dn=383,
    white_dn=10383, full_well_e=1e6, dark_e_per_s=3.0,
    rows=(IsoRow(100, 1.0, 8.0), IsoRow(200, 0.5, 4.0), IsoRow(400, 0.25, 4.0)),
)  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"signal_e": 1e-9}, ""),
        ({"exposure_s": 1e-9}, ""),
        ({"dark_e_per_s": 0.0}, ""),
        ({"codes": 2}, ""),
        ({"signal_e": 0.0}, "signal = 0.0 is not a positive number"),
        ({"signal_e": math.inf}, "signal = inf is not a positive number"),
        ({"exposure_s": 0.0}, "exposure = 0.0 is not a positive number"),
        ({"exposure_s": math.nan}, "exposure = nan is not a positive number"),
        ({"dark_e_per_s": -1e-9}, "dark current = -1e-09 is not a number from 0 on"),
        ({"dark_e_per_s": math.inf}, "dark current = inf is not a number from 0 on"),
        ({"codes": 1}, "codes = 1 is not 2 or more"),
    ],
)
def test_what_a_pixel_may_be(changes: dict[str, Any], says: str) -> None:
    told: dict[str, Any] = {**msgspec.to_builtins(LIT), **changes}
    if not says:
        assert msgspec.to_builtins(SnrPixel(**told)) == told
        return
    with pytest.raises(ConfigError) as caught:
        SnrPixel(**told)
    assert caught.value.message == says
    assert caught.value.hint == "correct the options of the comparison"


def test_unequal_opening_allows_ten_decibels_of_400_codes() -> None:
    assert compute_opening_limit_db(400) == pytest.approx(10.0)


@pytest.mark.parametrize("procedure", [compute_primal_dual_photo, compute_primal_dual_pair])
def test_a_mask_lets_through_some_light_and_at_most_all(procedure: Any) -> None:
    assert procedure(LIT, 5.0, "shot", 1.0).signal_e == 1000.0
    assert procedure(LIT, 5.0, "shot", 1e-6).signal_e == pytest.approx(1e-3)
    for wrong in (0.0, -0.1, 1.0 + 1e-9, math.nan):
        with pytest.raises(ConfigError, match="is not above 0 and at most 1") as caught:
            procedure(LIT, 5.0, "shot", wrong)
        assert "open mask lets through" in (caught.value.hint or "")
        with pytest.raises(ConfigError, match="is not above 0 and at most 1"):
            break_even_read_noise_e(LIT, "signed", "shot", wrong)


def test_a_sensor_holds_a_signal_up_to_its_highest() -> None:
    assert [highest_signal_e(SENSOR, iso) for iso in (100, 200, 400)] == [10000.0, 5000.0, 2500.0]
    common: dict[str, Any] = {"codes": 16, "exposure_s": 8.0}
    assert make_sensor_pixel(SENSOR, 200, signal_e=5000.0, **common).signal_e == 5000.0
    assert make_sensor_pixel(SENSOR, 200, signal_e=None, **common) == SnrPixel(
        signal_e=0.13 * 5000.0, exposure_s=8.0, codes=16, dark_e_per_s=3.0
    )
    with pytest.raises(ConfigError) as caught:
        make_sensor_pixel(SENSOR, 200, signal_e=5000.5, **common)
    assert caught.value.message == "a signal of 5000.5 e- saturates 'made' at ISO 200"
    assert caught.value.hint == "give at most 5000 e-, or choose a lower ISO"


@pytest.mark.parametrize(
    ("signal_e", "iso"), [(1.0, 200), (2500.0, 200), (5000.0, 200), (5000.5, 100), (10000.0, 100)]
)
def test_the_quietest_iso_holds_the_signal(signal_e: float, iso: int) -> None:
    assert find_quiet_iso(SENSOR, signal_e) == iso
    with pytest.raises(ConfigError) as caught:
        find_quiet_iso(SENSOR, 10000.5)
    assert caught.value.message == "a signal of 10000.5 e- saturates 'made' at every ISO"
    assert caught.value.hint == "give a lower signal"


@pytest.mark.parametrize(("iso", "short"), [(100, (100, 200)), (200, (200,)), (400, (200, 400))])
def test_procedures_at_the_isos_that_suit_them(iso: int, short: tuple[int, ...]) -> None:
    rows = compute_sensor_rows(SENSOR, iso, LIT, 0.5)
    assert [(row.procedure, row.light, row.iso) for row in rows] == [
        ("photo", 1.0, iso),
        *(("mask-less photo", 1.0, at) for at in short),
        *(("masked sum", 1.0, at) for at in short),
        ("signed pair", 1.0, iso),
        *(("signed sum", 1.0, at) for at in short),
        *((name, 0.1, 200) for name in ("photo", "masked sum", "signed pair", "signed sum")),
    ]
    noise = SENSOR.row(iso).read_noise_e
    for thermal, found in (("paper", rows[0].paper_db), ("shot", rows[0].shot_db)):
        assert found == compute_primal_dual_photo(LIT, noise, thermal, 0.5).snr_db  # type: ignore[arg-type]
    assert (rows[0].signal_e, rows[0].additive_e) == (500.0, noise)
    assert rows[-2].signal_e == pytest.approx(50.0)
    assert rows[-2].additive_e == pytest.approx(math.sqrt(2.0) * 4.0)
