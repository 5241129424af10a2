"""The comparison at the edges of its numbers: which pixel, ISO and sensor are just allowed."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from pdcd.errors import ConfigError
from pdcd.sensor.profile import IsoRow, SensorProfile
from pdcd.sensor.snr import (
    LCD_TRANSMISSION,
    SnrPixel,
    SnrReading,
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

PIXEL = SnrPixel(signal_e=1000.0, exposure_s=8.0, codes=16, dark_e_per_s=3.0)
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
    told: dict[str, Any] = {**msgspec.to_builtins(PIXEL), **changes}
    if not says:
        assert msgspec.to_builtins(SnrPixel(**told)) == told
        return
    with pytest.raises(ConfigError) as caught:
        SnrPixel(**told)
    assert caught.value.message == says
    assert caught.value.hint == "correct the options of the comparison"


def test_a_dimmer_pixel_has_less_light_and_less_time() -> None:
    assert PIXEL.dimmed() == SnrPixel(signal_e=100.0, exposure_s=0.8, codes=16, dark_e_per_s=3.0)
    assert PIXEL.dimmed(0.5) == SnrPixel(signal_e=500.0, exposure_s=4.0, codes=16, dark_e_per_s=3.0)
    assert PIXEL.used_photos == 8.0


def test_each_procedure_by_hand() -> None:
    """Dark current of 3 e- a second gathers 24 e- in 8 s."""
    root = math.sqrt
    both: tuple[tuple[Thermal, float, float, float], ...] = (
        ("paper", 24.0**2, 1.5**2, 24.0**2),
        ("shot", 24.0, 1.5, 12.0),
    )
    for thermal, whole, short, half in both:
        for found, wanted in (
            (compute_primal_dual_photo(PIXEL, 5.0, thermal), SnrReading(1000.0, 5.0, whole)),
            (compute_primal_dual_photo(PIXEL, 5.0, thermal, 0.5), SnrReading(500.0, 5.0, whole)),
            (compute_primal_dual_pair(PIXEL, 5.0, thermal), SnrReading(1000.0, root(2) * 5.0,
            whole)),
            (compute_primal_dual_pair(PIXEL, 5.0, thermal, 0.5), SnrReading(500.0, root(2) * 5.0,
            whole)),
            (compute_short_photo(PIXEL, 5.0, thermal), SnrReading(125.0, 5.0, short)),
            (compute_masked_sum(PIXEL, 5.0, thermal), SnrReading(1000.0, root(8) * 5.0, half)),
            (compute_signed_sum(PIXEL, 5.0, thermal), SnrReading(2000.0, 20.0, whole)),
        ):  # fmt: skip
            assert msgspec.to_builtins(found) == pytest.approx(msgspec.to_builtins(wanted))
    assert LCD_TRANSMISSION == 0.5
    # 10 log10 of 100 over the root of 100 + 25 + 75.
    assert SnrReading(100.0, 5.0, 75.0).snr_db == pytest.approx(5.0 * math.log10(50.0))
    assert compute_opening_limit_db(400) == pytest.approx(10.0)


@pytest.mark.parametrize("procedure", [compute_primal_dual_photo, compute_primal_dual_pair])
def test_a_mask_lets_through_some_light_and_at_most_all(procedure: Any) -> None:
    assert procedure(PIXEL, 5.0, "shot", 1.0).signal_e == 1000.0
    assert procedure(PIXEL, 5.0, "shot", 1e-6).signal_e == pytest.approx(1e-3)
    for wrong in (0.0, -0.1, 1.0 + 1e-9, math.nan):
        with pytest.raises(ConfigError, match="is not above 0 and at most 1") as caught:
            procedure(PIXEL, 5.0, "shot", wrong)
        assert "open mask lets through" in (caught.value.hint or "")
        with pytest.raises(ConfigError, match="is not above 0 and at most 1"):
            break_even_read_noise_e(PIXEL, "signed", "shot", wrong)


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
    rows = compute_sensor_rows(SENSOR, iso, PIXEL, 0.5)
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
        assert found == compute_primal_dual_photo(PIXEL, noise, thermal, 0.5).snr_db  # type: ignore[arg-type]
    assert (rows[0].signal_e, rows[0].additive_e) == (500.0, noise)
    assert rows[-2].signal_e == pytest.approx(50.0)
    assert rows[-2].additive_e == pytest.approx(math.sqrt(2.0) * 4.0)
