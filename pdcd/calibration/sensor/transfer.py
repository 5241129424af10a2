"""Photon transfer: gain and read noise from what photos of the same light differ by.

Photon noise is known: its variance in electrons is their number. In DN, with K = 1 / gain, a plane
of signal m has the variance ``var = var_dark + K m``. Two photos of the same light give var by
their difference, in which scene, vignetting and pixels of unequal sensitivity cancel.

With two photos a and b of a block, r = mean(a) / mean(b), lamp flicker included::

    d = a - r b        var(d) = (1 + r^2) var_dark + (1 + r) mean(a) K
    var = var(d) / (1 + r^2)          m = mean(a) (1 + r) / (1 + r^2)

so that `var` and `m` lie on the line exactly, whatever the flicker. The line is fitted over all
blocks with the weights of a sample variance, ``(n - 1) / (2 var^2)``. Rows that are brighter as a
whole (banding) are taken out of d, and told of apart.

After EMVA 1288 "Linear", section on the photon transfer method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.photo import block_means
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

SIDE = 32
"""Samples along a block: 1024 of them tell a variance to 4.4 %, and hardly see vignetting."""
LEAST_BLOCKS = 12
PARTS, UNEVEN = 4, 0.5
"""Parts of a block's side, and the difference of their light over its mean that is borne."""
UNLIT = 0.02
"""Share of the brightest light below which a block of a lit photo is beside the card. What its rows
have in common is mostly noise of brighter blocks, and it tells no more than a dark photo."""
CLIP_SIGMAS = 6.0
ROUNDING_DN2 = 1.0 / 12.0
LEAST_DARK_DN2 = 0.24
"""Below it rounding to whole DN hides the read noise (EMVA 1288)."""
DIM = 2.0
"""Photon noise in the brighter pair, over that of the dark, from which a gain can be told."""
REJECT_SIGMAS = 5.0
REJECT_SHARE = 0.1
EXCESS_CHI2 = 0.3
"""Variance of the blocks about the line, over what samples allow, beyond 1."""
MOST_CORRELATION = 0.03
"""Of neighbouring samples' noise: 0 for samples as the sensor gave them."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Two photos of the same light, by blocks of one plane.

    mean, variance : (blocks,) float64, DN above black and DN^2, of one photo.
    samples : (blocks,) float64, how many the variance is of; 0 where the light is uneven.
    peak : (blocks,) float64, highest mean of the two.
    banding_dn2, banding_sigma : variance of whole rows, of one photo, and its standard deviation.
    correlation : of neighbouring samples' noise.
    """

    mean: Floats
    variance: Floats
    samples: Floats
    peak: Floats
    banding_dn2: float
    banding_sigma: float
    correlation: float


def pair_of(first: Floats, second: Floats, dark: Floats | None = None) -> Pair:
    """Compare two photos of one plane.

    Parameters
    ----------
    first, second : (h, w), DN above black.
    dark : (h, w) or None
        The same without light: `mean` is above it. None for a dark pair.

    Raises CalibrationError where the plane has no block.
    """
    side = SIDE
    a, b = (_whole(np.asarray(plane, np.float64), side) for plane in (first, second))
    means = [block_means(plane, side) for plane in (a, b)]
    if dark is None:
        base, ratio = np.zeros_like(means[0]), np.ones_like(means[0])
    else:
        base = block_means(_whole(np.asarray(dark, np.float64), side), side)
        ratio = np.maximum(means[0] - base, 1e-3) / np.maximum(means[1] - base, 1e-3)
        ratio = np.clip(ratio, 0.2, 5.0)
    rows, cols = ratio.shape
    d = a.reshape(rows, side, cols, side) - ratio[:, None, :, None] * b.reshape(
        rows, side, cols, side
    )
    kept, clean = _unclipped(d)
    d, banding, of_rows = _without_rows(clean, kept)
    count = kept.sum(axis=(1, 3)).astype(np.float64)
    centre = d.sum(axis=(1, 3)) / np.maximum(count, 1.0)
    d = np.where(kept, d - centre[:, None, :, None], 0.0)
    variance = (d**2).sum(axis=(1, 3)) / np.maximum(count - 1.0, 1.0)
    variance = _rows_paid_back(variance, a.shape[1])
    square = float((d**2).sum())
    beside = float((d[..., 1:] * d[..., :-1]).sum()) * side / (side - 1)
    both = 1.0 + ratio**2
    if dark is not None:
        even = _even(a, np.sqrt(np.maximum(variance / both, 0.0)), side)
        light = means[0] - base
        lit = light > UNLIT * np.quantile(light, 0.98)
        count = np.where(even & lit, count, 0.0)
    return Pair(
        mean=((means[0] - base) * (1.0 + ratio) / both).ravel(),
        variance=(variance / both).ravel(),
        samples=count.ravel(),
        peak=np.maximum(*means).ravel(),
        banding_dn2=banding / float(both.mean()),
        banding_sigma=float(np.sqrt(2.0 / a.shape[0])) * of_rows / float(both.mean()),
        correlation=beside / square if square else 0.0,
    )


def _whole(plane: Floats, side: int) -> Floats:
    """Cut to whole blocks."""
    return plane[: plane.shape[0] // side * side, : plane.shape[1] // side * side]


def _even(light: Floats, noise: Floats, side: int) -> NDArray[np.bool_]:
    """Blocks of one light: where half of a block is dark, as at the picture's edge, variances of
    unlike samples are mixed, and the mix scatters more than either.

    light : samples. noise : standard deviation of one, by blocks.
    """
    part = side // PARTS
    rows, cols = light.shape[0] // side, light.shape[1] // side
    parts = block_means(light, part).reshape(rows, PARTS, cols, PARTS)
    apart = parts.max(axis=(1, 3)) - parts.min(axis=(1, 3))
    return np.asarray(apart <= UNEVEN * parts.mean(axis=(1, 3)) + CLIP_SIGMAS * noise / part)


def _unclipped(d: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Which differences are no hot pixels or cosmic rays, (rows, side, cols, side), and them with
    others at 0, each block about its median."""
    middle = np.median(d, axis=(1, 3))
    d = d - middle[:, None, :, None]
    away = np.abs(d)
    spread = np.maximum(1.4826 * np.median(away, axis=(1, 3)), 1.0)
    kept = away <= CLIP_SIGMAS * spread[:, None, :, None]
    return kept, np.where(kept, d, 0.0)


def _without_rows(d: Floats, kept: NDArray[np.bool_]) -> tuple[Floats, float, float]:
    """Differences without what whole rows have in common, the variance of that, and the variance
    that the means of rows have in all, by noise and by banding.

    Along a row a block's own mean goes out first, so that a slope of the light is no banding.
    """
    count = np.maximum(kept.sum(axis=(2, 3)), 1).astype(np.float64)
    row = d.sum(axis=(2, 3)) / count
    row = row - row.mean(axis=1, keepdims=True)
    samples = (d**2).sum(axis=(2, 3)) / count**2  # what the mean of noise alone would vary by
    side = d.shape[1]
    banding = float((row**2).mean()) * side / (side - 1) - float(samples.mean())
    clean = np.where(kept, d - row[:, :, None, None], 0.0)
    return clean, max(banding, 0.0), max(banding, 0.0) + float(samples.mean())


def _rows_paid_back(variance: Floats, width: int) -> Floats:
    """Variance that went out with the means of rows: a sample of variance s loses 2 s / width and
    gets the row's mean variance / width."""
    mean = variance.mean(axis=1, keepdims=True)
    return np.asarray((variance - mean / (width - 1)) / (1.0 - 2.0 / width))


@dataclass(frozen=True)
class Transfer:
    """Gain and noise of one plane.

    gain_e_per_dn, read_noise_e and their standard deviations. The read noise holds neither
    rounding nor banding.
    chi2 : of the blocks about the line, over their number: 1 is pure photon noise.
    rounded : whether rounding hides the read noise, which is then an upper bound.
    """

    gain_e_per_dn: float
    gain_sigma: float
    read_noise_e: float
    read_sigma: float
    banding_e: float
    banding_sigma: float
    chi2: float
    rounded: bool


def transfer_of(
    plane: str,
    dark: Pair,
    lit: tuple[Pair, ...],
    *,
    highest_dn: float,
    dark_e: float = 0.0,
    leaked_dn: float = 0.0,
) -> Transfer:
    """Fit the line of one plane.

    Parameters
    ----------
    plane : its name, for what is raised.
    dark, lit : pairs without and with light.
    highest_dn : blocks above it are left out: 70 % of saturation.
    dark_e : electrons of dark current in a dark photo, whose noise is no read noise.
    leaked_dn : light in a dark photo on average, whose noise is none either.

    Raises CalibrationError: no noise, saturated, too dim, moved between two photos, or filtered
    samples.
    """
    # Light that the panels leak is uneven too, and has its noise in every photo.
    leak = np.maximum(dark.mean - dark.mean.mean() + leaked_dn, 0.0)
    mean = np.concatenate([leak, *(pair.mean + leak for pair in lit)])
    variance = np.concatenate([dark.variance, *(pair.variance for pair in lit)])
    samples = np.concatenate([dark.samples, *(pair.samples for pair in lit)])
    of_dark = np.arange(mean.size) < dark.mean.size
    peak = np.concatenate([dark.peak, *(pair.peak for pair in lit)])
    good = (samples > 0.5 * samples.max()) & (of_dark | (peak <= highest_dn))
    _refuse(plane, dark, lit, good & ~of_dark, highest_dn)
    if not variance[good].any():
        raise CalibrationError(
            f"plane {plane}: photos of the same light are equal to the last digit: no noise",
            device="camera",
            hint='of a mock bench set camera.noise = "full"; see that two photos were taken',
        )
    fit, covariance, chi2 = _settled_line(plane, mean, variance, samples, good)
    level = max(float(np.median(pair.mean[pair.samples > 0])) for pair in lit)
    if fit[1] * level < DIM * fit[0]:
        raise CalibrationError(
            f"plane {plane}: the flat photos are too dim: {level:.3g} DN, of whose noise half is "
            "the camera's own",
            device="camera",
            hint="open the aperture, or show more refreshes",
        )
    gain = float(1.0 / fit[1])
    read_dn2 = fit[0] - ROUNDING_DN2 - dark_e / gain**2
    return _transfer(fit, covariance, chi2, read_dn2, dark)


def _settled_line(
    plane: str, mean: Floats, variance: Floats, samples: Floats, good: NDArray[np.bool_]
) -> tuple[Floats, Floats, float]:
    """The line through the `good` blocks but for a few far from it: its two numbers, their
    covariance, and chi squared. Raises CalibrationError where too many are far."""
    for _ in range(2):
        fit, covariance = _line(mean[good], variance[good], samples[good])
        model = fit[0] + fit[1] * mean
        away = (variance - model) / (np.abs(model) * np.sqrt(2.0 / np.maximum(samples - 1.0, 1.0)))
        keep = good & (np.abs(away) <= REJECT_SIGMAS)
        lost = 1.0 - keep.sum() / good.sum()
        chi2 = float(np.mean(away[good] ** 2))
        good = keep
        if lost > REJECT_SHARE or fit[1] <= 0.0:
            raise _moved(plane, chi2)
    chi2 = float(np.mean(away[good] ** 2))
    if chi2 > 1.0 + max(EXCESS_CHI2, 5.0 * float(np.sqrt(2.0 / good.sum()))):
        raise _moved(plane, chi2)
    return fit, covariance, chi2


def _transfer(
    fit: Floats, covariance: Floats, chi2: float, read_dn2: float, dark: Pair
) -> Transfer:
    """What the line says of the camera. read_dn2 : variance of a dark photo that is read noise."""
    gain = float(1.0 / fit[1])
    gain_sigma = gain**2 * float(np.sqrt(covariance[1, 1]))
    rounded = fit[0] < LEAST_DARK_DN2
    read_dn = float(np.sqrt(max(read_dn2, 1e-6)))
    band_dn = float(np.sqrt(dark.banding_dn2))
    # read = sqrt(v0 - 1/12) / K: how it moves with either number of the line.
    slope = np.array([0.5 / (read_dn * fit[1]), -read_dn / fit[1] ** 2])
    return Transfer(
        gain_e_per_dn=gain,
        gain_sigma=gain_sigma,
        read_noise_e=gain * read_dn,
        read_sigma=float(np.sqrt(slope @ covariance @ slope)),
        banding_e=gain * band_dn,
        banding_sigma=gain * dark.banding_sigma / (2.0 * max(band_dn, dark.banding_sigma**0.5)),
        chi2=chi2,
        rounded=bool(rounded),
    )


def _line(mean: Floats, variance: Floats, samples: Floats) -> tuple[Floats, Floats]:
    """(var_dark, K) and their covariance, weights taken from the line itself."""
    columns = np.stack([np.ones_like(mean), mean], axis=1)
    fit: Floats = np.zeros(2)
    covariance: Floats = np.zeros((2, 2))
    for step in range(6):
        model = np.maximum(columns @ fit if step else variance, 0.05)
        weights = (samples - 1.0) / (2.0 * model**2)
        inverse = np.linalg.inv(columns.T @ (weights[:, None] * columns))
        covariance = np.asarray(inverse, np.float64)
        fit = covariance @ (columns.T @ (weights * variance))
    return fit, covariance


def _refuse(
    plane: str, dark: Pair, lit: tuple[Pair, ...], used: NDArray[np.bool_], highest_dn: float
) -> None:
    """Raise CalibrationError where pairs cannot tell a gain."""
    parts = sum(pair.samples.size for pair in lit)
    if parts < LEAST_BLOCKS:
        raise CalibrationError(
            f"the frame is too small to tell a gain: {len(lit)} flat photos have {parts} parts to "
            f"look at, and {LEAST_BLOCKS} are needed",
            device="camera",
            hint="read out the whole sensor; a mock camera gets a finer frame by "
            "[camera] frame_quads",
        )
    many = sum(int((pair.samples > 0).sum()) for pair in lit)
    if many < LEAST_BLOCKS:
        raise CalibrationError(
            f"plane {plane}: only {many} parts of the flat photos are evenly lit",
            device="camera",
            hint="put a white card before the camera, so that it fills the picture; focus",
        )
    if used.sum() < 0.2 * many:
        raise CalibrationError(
            f"plane {plane}: {100.0 * (1.0 - used.sum() / many):.0f} % of the flat photos lie "
            "above 70 % of saturation",
            device="camera",
            hint="close the aperture, or show fewer refreshes",
        )
    worst = max(
        (pair.correlation - 5.0 / np.sqrt(pair.samples.sum()) for pair in (dark, *lit)), default=0.0
    )
    if worst > MOST_CORRELATION:
        raise CalibrationError(
            f"plane {plane}: noise of neighbouring samples is alike ({worst:.2g}): the samples "
            "were filtered",
            device="camera",
            hint="switch the camera's noise reduction off; take full-size RAW, no sRAW",
        )


def _moved(plane: str, chi2: float) -> CalibrationError:
    return CalibrationError(
        f"plane {plane}: two photos of the same light differ by more than noise (chi^2 {chi2:.2g})",
        device="camera",
        hint="camera, card or lamp moved or flickered between the two photos: fix them and repeat",
    )
