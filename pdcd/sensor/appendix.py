"""The numbers of the paper's appendix, each beside the one that `pdcd.sensor.snr` computes.

Source: O'Toole, Raskar, Kutulakos 2012, appendix, for the sensor of the profile "mark2". Two of its
numbers have a truncated last digit, and its thermal term is that of `pdcd.sensor.snr`'s "paper".
"""

from __future__ import annotations

import msgspec

from pdcd.sensor.profile import load_profile
from pdcd.sensor.snr import (
    EXPOSED_SHARE,
    THERMALS,
    Procedure,
    SnrPixel,
    compute_masked_sum,
    compute_primal_dual_photo,
    compute_short_photo,
)

_PRINTED_CODES = 512
EXPOSURE_S = 30.0
_HIGHEST_DN = 3135.9
"""Highest intensity of the body's 12 bits."""
_BITS = 12


class PrintedRow(msgspec.Struct, frozen=True):
    """One number of the appendix beside ours.

    `printed` keeps the paper's digits; `truncated` says that the last one was cut, not rounded.
    `shot` is ours with dark current as shot noise, None where dark current does not enter.
    """

    quantity: str
    printed: str
    ours: float
    shot: float | None = None
    truncated: bool = False
    note: str = ""


def make_appendix_pixel() -> SnrPixel:
    """The appendix' pixel: 13 % of the highest intensity of the profile "mark2" at ISO 50."""
    mark2 = load_profile("mark2")
    # The profile counts in finer steps than the paper, whose gain is 26.03 e- per 12-bit DN.
    gain_e_per_dn = mark2.row(50).gain_e_per_dn * float(2 ** (mark2.bits - _BITS))
    return SnrPixel(
        signal_e=EXPOSED_SHARE * _HIGHEST_DN * gain_e_per_dn,
        exposure_s=EXPOSURE_S,
        codes=_PRINTED_CODES,
        dark_e_per_s=mark2.dark_e_per_s,
    )


def _ratio(
    quantity: str,
    printed: str,
    procedure: Procedure,
    of: SnrPixel,
    read_noise_e: float,
    *,
    truncated: bool = False,
    note: str = "",
) -> PrintedRow:
    """A signal-to-noise ratio, with the thermal noise of the paper and with shot noise."""
    paper, shot = (procedure(of, read_noise_e, thermal).snr_db for thermal in THERMALS)
    return PrintedRow(quantity, printed, paper, shot, truncated, note)


def compute_appendix_rows() -> tuple[PrintedRow, ...]:
    """Every number that the appendix computes, in its order, for the profile "mark2"."""
    mark2 = load_profile("mark2")
    base_e, quiet_e = mark2.row(50).read_noise_e, mark2.row(1600).read_noise_e
    pixel = make_appendix_pixel()
    dim = pixel.dimmed()

    times = compute_masked_sum(pixel, 1.0, "paper").additive_e
    return (
        PrintedRow(
            "mean intensity, 12-bit DN",
            "407.66",
            EXPOSED_SHARE * _HIGHEST_DN,
            truncated=True,
            note="truncated; the electrons come from the unrounded value",
        ),
        PrintedRow("electrons of the photo", "10611.57", pixel.signal_e),
        _ratio(
            "photo, ISO 50, dB",
            "19.9",
            compute_primal_dual_photo,
            pixel,
            base_e,
            note="thermal term: (rate x time)^2 = 56.25 e-^2 printed, rate x time = 7.5 correct",
        ),
        PrintedRow("photos in the masked sum", "256", pixel.used_photos),
        PrintedRow(
            "electrons of a mask-less photo",
            "41.45",
            compute_short_photo(pixel, 0.0, "paper").signal_e,
        ),
        _ratio("mask-less photo, ISO 50, dB", "1.22", compute_short_photo, pixel, base_e),
        _ratio("mask-less photo, ISO 1600, dB", "7.4", compute_short_photo, pixel, quiet_e),
        PrintedRow("additive noise of the sum, times", "16", times),
        PrintedRow("additive noise, ISO 50, e-", "489.92", times * base_e),
        PrintedRow("additive noise, ISO 1600, e-", "62.4", times * quiet_e),
        _ratio(
            "masked sum, ISO 50, dB",
            "13.2",
            compute_masked_sum,
            pixel,
            base_e,
            truncated=True,
            note="truncated; it rounds to 13.3",
        ),
        _ratio(
            "masked sum, ISO 1600, dB",
            "19.4",
            compute_masked_sum,
            pixel,
            quiet_e,
            note="printed thermal term over all 30 s; the correct one over the summed 15 s",
        ),
        _ratio("photo, 1/10 light, ISO 1600, dB", "15.1", compute_primal_dual_photo, dim, quiet_e),
        _ratio("masked sum, 1/10 light, ISO 1600, dB", "11.8", compute_masked_sum, dim, quiet_e),
    )
