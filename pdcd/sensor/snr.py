"""Signal-to-noise ratio of primal-dual photos and of their rival, many photos without a mask.

Both get the same light in the same time. The rival takes one short photo for each code and weights
them in software, pixel by pixel; each photo brings its own read noise. Two kinds of goal:

``"masked"``
    Weights 0 and 1, as for indirect light: one primal-dual photo against the sum of the short
    photos in which the mask would have been open, half of them on average. This is the comparison
    of the paper's appendix.
``"signed"``
    Weights -1 and 1, as for direct light: two primal-dual photos with opposite masks and half of
    the time each against all short photos. The masks throw away half of the light, software none
    of it. The appendix leaves this out, which is kind to primal-dual coding.

The ratio is that of the appendix, 10 log10 of an amplitude ratio::

    SNR = 10 log10(signal / sqrt(signal + additive^2 + thermal))        dB, all in electrons

The signal of a signed goal is a difference. Its ratios are those of a difference as large as all
the light that enters; if it is a share c of that light, both procedures have 10 log10(1/c) less.

Two conventions for `thermal`, the variance of the dark current:

``"paper"``
    (rate x time)^2, as printed. For sums the time is the whole exposure: the paper does not say,
    and at its precision no other choice shows.
``"shot"``
    rate x time, the variance of a Poisson count, over the photos that are really summed.

Rounding to DN is left out, as in the paper: a read noise measured on black frames contains it. A
code here is one of the paper's printed codes, of which four make one independent code pair
(`SHIFTS_PER_CODE`). Times are in s, charges in photo-electrons of one pixel (e-), variances in
e-^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Literal

import msgspec

from pdcd.errors import ConfigError
from pdcd.sensor.profile import SensorProfile

Thermal = Literal["paper", "shot"]
THERMALS: tuple[Thermal, ...] = ("paper", "shot")
SnrGoal = Literal["masked", "signed"]
SNR_GOALS: tuple[SnrGoal, ...] = ("masked", "signed")

EXPOSED_SHARE = 0.13
"""Mean of a well exposed photo over the highest signal (appendix, after ISO 2721:1982)."""
SHIFTS_PER_CODE = 4
"""Printed codes for one independent code: each is shown once per quarter of the mask's cell."""
LCD_TRANSMISSION = 0.5
"""Light that the paper's LCD mask passes, relative to its appendix' ideal mask ("about half")."""
DIM = 0.1
"""Exposure of the appendix' second pair of procedures, relative to the first."""


class SnrPixel(msgspec.Struct, frozen=True, kw_only=True):
    """What both procedures share: one pixel, its light and its time.

    signal_e
        Electrons that the open codes bring in the whole exposure through an ideal mask.
    exposure_s
        Length of the primal-dual photo, and of all mask-less photos together.
    codes
        Printed codes; the number of mask-less photos.
    dark_e_per_s
        Dark current.

    Raises `ConfigError` naming every value that is wrong.
    """

    signal_e: float
    exposure_s: float
    codes: int
    dark_e_per_s: float

    def __post_init__(self) -> None:
        faults = [
            f"{name} = {value} is not a positive number"
            for name, value in (("signal", self.signal_e), ("exposure", self.exposure_s))
            if not (math.isfinite(value) and value > 0)
        ]
        if not (math.isfinite(self.dark_e_per_s) and self.dark_e_per_s >= 0):
            faults.append(f"dark current = {self.dark_e_per_s} is not a number from 0 on")
        if self.codes < 2:
            faults.append(f"codes = {self.codes} is not 2 or more")
        if faults:
            raise ConfigError("; ".join(faults), hint="correct the options of the comparison")

    @property
    def used_photos(self) -> float:
        """Mask-less photos that enter the masked sum, on average."""
        return self.codes / 2

    def dimmed(self, share: float = DIM) -> SnrPixel:
        """The same pixel after `share` of the exposure and so of the light."""
        return msgspec.structs.replace(
            self, signal_e=share * self.signal_e, exposure_s=share * self.exposure_s
        )


class SnrReading(msgspec.Struct, frozen=True):
    """Electrons of one photo or sum, its additive noise (standard deviation) and dark variance."""

    signal_e: float
    additive_e: float
    thermal_e2: float

    @property
    def snr_db(self) -> float:
        """The ratio defined in the module's docstring, dB."""
        variance_e2 = self.signal_e + self.additive_e**2 + self.thermal_e2
        return 10.0 * math.log10(self.signal_e / math.sqrt(variance_e2))


Procedure = Callable[[SnrPixel, float, Thermal], SnrReading]
"""Takes the pixel, the read noise of one photo in e-, and the convention of the dark variance."""


def compute_primal_dual_photo(
    pixel: SnrPixel, read_noise_e: float, thermal: Thermal, transmission: float = 1.0
) -> SnrReading:
    """The one photo of a masked goal (the appendix' PDC).

    `transmission` is the share of the light that the open mask lets through; the appendix takes 1.
    Raises `ConfigError` when it is not in (0, 1].
    """
    if not 0.0 < transmission <= 1.0:
        raise ConfigError(
            f"mask transmission = {transmission} is not above 0 and at most 1",
            hint="give the share of the light that the open mask lets through",
        )
    dark_e2 = _thermal_e2(pixel, pixel.exposure_s, thermal)
    return SnrReading(transmission * pixel.signal_e, read_noise_e, dark_e2)


def compute_primal_dual_pair(
    pixel: SnrPixel, read_noise_e: float, thermal: Thermal, transmission: float = 1.0
) -> SnrReading:
    """Difference of the two photos of a signed goal, half of the exposure each.

    With the appendix' even light, both together hold as much charge as one photo. Raises as
    `compute_primal_dual_photo`.
    """
    photo = compute_primal_dual_photo(pixel, read_noise_e, thermal, transmission)
    return msgspec.structs.replace(photo, additive_e=math.sqrt(2.0) * read_noise_e)


def compute_short_photo(pixel: SnrPixel, read_noise_e: float, thermal: Thermal) -> SnrReading:
    """One mask-less photo (the appendix' MI), among those that contain the pixel's signal."""
    dark_e2 = _thermal_e2(pixel, pixel.exposure_s / pixel.codes, thermal)
    return SnrReading(pixel.signal_e / pixel.used_photos, read_noise_e, dark_e2)


def compute_masked_sum(pixel: SnrPixel, read_noise_e: float, thermal: Thermal) -> SnrReading:
    """Sum of the mask-less photos whose code is open at the pixel: the appendix' masked sum."""
    summed_s = pixel.exposure_s if thermal == "paper" else pixel.exposure_s / 2
    additive_e = math.sqrt(pixel.used_photos) * read_noise_e
    return SnrReading(pixel.signal_e, additive_e, _thermal_e2(pixel, summed_s, thermal))


def compute_signed_sum(pixel: SnrPixel, read_noise_e: float, thermal: Thermal) -> SnrReading:
    """Sum of all mask-less photos with weights 1 and -1; its noise does not depend on the signs."""
    dark_e2 = _thermal_e2(pixel, pixel.exposure_s, thermal)
    return SnrReading(2.0 * pixel.signal_e, math.sqrt(pixel.codes) * read_noise_e, dark_e2)


def compute_opening_limit_db(codes: int) -> float:
    """SNR, dB, that unequal opening allows a pixel of indirect light, whatever the sensor.

    With independent random codes each pixel is open in its own number of codes, which scales its
    indirect light S by a random gain: the S^2 / K part of the variance (S^2 + 2 Q) / K of the
    one-shot estimate, K = codes / `SHIFTS_PER_CODE` independent codes. Balanced and Hadamard codes
    are free of it, and so is software that divides by the number of openings.
    """
    return 10.0 * math.log10(math.sqrt(codes / SHIFTS_PER_CODE))


def break_even_read_noise_e(
    pixel: SnrPixel, goal: SnrGoal, thermal: Thermal, transmission: float = 1.0
) -> float:
    """Read noise, e-, at which primal-dual and mask-less photos have the same SNR.

    Both have that read noise. Above it the mask pays, below it mask-less photos are as good or
    better. 0.0: the mask pays at any read noise. inf: it never pays.

    With S and R the signals, v and w the dark variances, m and n the numbers of photos read,
    squaring ``S / sqrt(S + m a^2 + v) = R / sqrt(R + n a^2 + w)`` gives an equation linear in a^2.
    Raises `ConfigError` when `transmission` is not in (0, 1].
    """
    if goal == "masked":
        ours = compute_primal_dual_photo(pixel, 0.0, thermal, transmission)
        other, photos, others = compute_masked_sum(pixel, 0.0, thermal), 1, pixel.used_photos
    else:
        ours = compute_primal_dual_pair(pixel, 0.0, thermal, transmission)
        other, photos, others = compute_signed_sum(pixel, 0.0, thermal), 2, float(pixel.codes)
    gain = other.signal_e / ours.signal_e
    slope = others - gain**2 * photos
    if slope <= 0.0:
        return math.inf
    offset_e2 = other.signal_e * (gain - 1.0) + gain**2 * ours.thermal_e2 - other.thermal_e2
    return math.sqrt(max(offset_e2, 0.0) / slope)


def _thermal_e2(pixel: SnrPixel, time_s: float, thermal: Thermal) -> float:
    dark_e = pixel.dark_e_per_s * time_s
    return dark_e**2 if thermal == "paper" else dark_e


# --- the same for any sensor ----------------------------------------------------------------------


class SensorRow(msgspec.Struct, frozen=True):
    """One procedure on one sensor: its charge, its noise, and its SNR in both conventions."""

    procedure: str
    light: float
    iso: int
    signal_e: float
    additive_e: float
    paper_db: float
    shot_db: float


def highest_signal_e(profile: SensorProfile, iso: int) -> float:
    """Electrons from which a pixel counts as saturated. Raises `ConfigError`: no such ISO."""
    return profile.saturation_dn(iso) * profile.row(iso).gain_e_per_dn


def make_sensor_pixel(
    profile: SensorProfile, iso: int, *, codes: int, exposure_s: float, signal_e: float | None
) -> SnrPixel:
    """A pixel of this sensor; without `signal_e` it is as well exposed as the appendix' pixel.

    Raises `ConfigError` when a number makes no sense, the profile has no such ISO, or the signal
    saturates it.
    """
    highest_e = highest_signal_e(profile, iso)
    if signal_e is None:
        signal_e = EXPOSED_SHARE * highest_e
    if signal_e > highest_e:
        raise ConfigError(
            f"a signal of {signal_e:.6g} e- saturates {profile.name!r} at ISO {iso}",
            hint=f"give at most {highest_e:.0f} e-, or choose a lower ISO",
        )
    return SnrPixel(
        signal_e=signal_e, exposure_s=exposure_s, codes=codes, dark_e_per_s=profile.dark_e_per_s
    )


def find_quiet_iso(profile: SensorProfile, signal_e: float) -> int:
    """The ISO of least read noise at which the signal does not saturate; the lowest of equals.

    Raises `ConfigError` when it saturates at every ISO.
    """
    rows = [row for row in profile.rows if highest_signal_e(profile, row.iso) >= signal_e]
    if not rows:
        raise ConfigError(
            f"a signal of {signal_e:.6g} e- saturates {profile.name!r} at every ISO",
            hint="give a lower signal",
        )
    return min(rows, key=lambda row: row.read_noise_e).iso


def compute_sensor_rows(
    profile: SensorProfile, iso: int, pixel: SnrPixel, transmission: float = 1.0
) -> tuple[SensorRow, ...]:
    """The appendix' procedures on any sensor.

    The photo is taken at `iso`; mask-less photos at that ISO and at the quietest one where they do
    not saturate; with a tenth of the light, all at the quietest ISO where the photo does not.
    Raises `ConfigError` when the profile has no such ISO, the pixel saturates it, or `transmission`
    is not in (0, 1].
    """
    dim = pixel.dimmed()
    photo = partial(compute_primal_dual_photo, transmission=transmission)
    pair = partial(compute_primal_dual_pair, transmission=transmission)
    dim_iso = find_quiet_iso(profile, dim.signal_e)
    short_isos = sorted({iso, find_quiet_iso(profile, pixel.signal_e / pixel.used_photos)})

    def row(name: str, procedure: Procedure, of: SnrPixel, at: int) -> SensorRow:
        read_noise_e = profile.row(at).read_noise_e
        paper, shot = (procedure(of, read_noise_e, thermal) for thermal in THERMALS)
        return SensorRow(
            procedure=name,
            light=DIM if of is dim else 1.0,
            iso=at,
            signal_e=shot.signal_e,
            additive_e=shot.additive_e,
            paper_db=paper.snr_db,
            shot_db=shot.snr_db,
        )

    return (
        row("photo", photo, pixel, iso),
        *(row("mask-less photo", compute_short_photo, pixel, at) for at in short_isos),
        *(row("masked sum", compute_masked_sum, pixel, at) for at in short_isos),
        row("signed pair", pair, pixel, iso),
        *(row("signed sum", compute_signed_sum, pixel, at) for at in short_isos),
        row("photo", photo, dim, dim_iso),
        row("masked sum", compute_masked_sum, dim, dim_iso),
        row("signed pair", pair, dim, dim_iso),
        row("signed sum", compute_signed_sum, dim, dim_iso),
    )
