"""Gain and read noise from the differences of photos of the same light: the line of variance over
mean.

Photon noise is known: its variance in electrons is their number. In DN, with K = 1 / gain, a plane
of signal m has the variance ``var = var_dark + K m``. Two photos of the same light give var by
their difference, in which scene, vignetting and pixels of unequal sensitivity cancel.

With two photos a and b of a block, r = mean(a) / mean(b), lamp flicker included::

    d = a - r b        var(d) = (1 + r^2) var_dark + (1 + r) mean(a) K
    var = var(d) / (1 + r^2)          m = mean(a) (1 + r) / (1 + r^2)

so that `var` and `m` lie on the line exactly, whatever the flicker. The line is fitted over the
blocks of all pairs with the weights of a sample variance, ``(n - 1) / (2 var^2)``. What whole rows
have in common (banding) is subtracted from d in the dark, where it matters.

After EMVA 1288 "Linear", section on the photon transfer method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.photo import average_blocks
from pdcd.errors import CalibrationError

VARIANCE_BLOCK_SIDE = 32
"""Samples along a block: 1024 of them give a variance to 4.4 %, and vignetting hardly matters."""
_LEAST_BLOCKS = 12
_PARTS, _UNEVEN = 4, 0.5
"""Parts of a block's side, and the largest difference of their light over its mean that is
accepted."""
_UNLIT = 0.02
"""Share of the brightest light below which a block of a lit photo is beside the card, and no better
than one of a dark photo."""
_CLIP_SIGMAS = 6.0
_ROUNDING_DN2 = 1.0 / 12.0
_LEAST_DARK_DN2 = 0.24
"""Variance in the dark below which rounding to whole DN hides the read noise (EMVA 1288)."""
_DIM = 2.0
"""Variance by photons in the brighter pair, over that in the dark, from which a gain can be
measured."""
_ROUNDS = 6
"""Solves of the line, each weighted by the result of the one before."""
_REJECT_SIGMAS, _REJECT_SHARE = 5.0, 0.1
_EXCESS_CHI2 = 0.3
"""Largest excess of chi^2 over 1: variance of the blocks about the line, over what samples
allow."""
_MOST_CORRELATION = 0.03
"""Largest correlation of neighbouring samples' noise; it is 0 for samples as the sensor gave
them."""


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two photos of the same light, by blocks of one plane.

    mean, variance : (blocks,) float64, DN above black and DN^2, of one photo.
    samples : (blocks,) float64, number of samples of the variance; 0 where the light is uneven.
    peak : (blocks,) float64, highest mean of the two.
    correlation : of neighbouring samples' noise.
    """

    mean: Floats
    variance: Floats
    samples: Floats
    peak: Floats
    correlation: float


def compare_plane_pair(first: Floats, second: Floats, dark: Floats | None = None) -> _Pair:
    """Compare two photos of one plane.

    Parameters
    ----------
    first, second : (h, w), DN above black.
    dark : (h, w) or None
        The same plane without light, which is subtracted for `mean`. None for a dark pair.

    Raises CalibrationError where the plane has no block.
    """
    a, b = (np.asarray(plane, np.float64) for plane in (first, second))
    means = [average_blocks(plane, VARIANCE_BLOCK_SIDE) for plane in (a, b)]
    base, ratio = np.zeros_like(means[0]), np.ones_like(means[0])
    if dark is not None:
        base = average_blocks(np.asarray(dark, np.float64), VARIANCE_BLOCK_SIDE)
        light = [np.maximum(mean - base, 1e-3) for mean in means]
        ratio = np.clip(light[0] / light[1], 0.2, 5.0)
    d = split_blocks(a) - ratio[:, None, :, None] * split_blocks(b)
    d -= np.median(d, axis=(1, 3), keepdims=True)
    # Hot pixels and cosmic rays are left out.
    spread = 1.4826 * np.median(np.abs(d), axis=(1, 3), keepdims=True)
    kept = np.abs(d) <= _CLIP_SIGMAS * np.maximum(spread, 1.0)
    count = kept.sum(axis=(1, 3)).astype(np.float64)
    if dark is None:
        d = _centred(d, kept, (2, 3))
        count *= 1.0 - 1.0 / (VARIANCE_BLOCK_SIDE * d.shape[2])
    d = _centred(d, kept, (1, 3))
    both = 1.0 + ratio**2
    variance = (d**2).sum(axis=(1, 3)) / np.maximum(count - 1.0, 1.0) / both
    square = float((d**2).sum()) / VARIANCE_BLOCK_SIDE
    beside = float((d[..., 1:] * d[..., :-1]).sum()) / (VARIANCE_BLOCK_SIDE - 1)
    if dark is not None:
        light_a = means[0] - base
        lit = light_a > _UNLIT * np.quantile(light_a, 0.98)
        count = np.where(lit & _even(a, np.sqrt(variance)), count, 0.0)
    return _Pair(
        mean=((means[0] - base) * (1.0 + ratio) / both).ravel(),
        variance=variance.ravel(),
        samples=count.ravel(),
        peak=np.maximum(*means).ravel(),
        correlation=beside / square if square else 0.0,
    )


def _centred(d: Floats, kept: NDArray[np.bool_], axis: tuple[int, int]) -> Floats:
    """The kept samples of blocks less their mean along some axes; the others are 0."""
    some = np.where(kept, d, 0.0)
    mean = some.sum(axis=axis, keepdims=True) / np.maximum(kept.sum(axis=axis, keepdims=True), 1)
    return np.where(kept, d - mean, 0.0)


def split_blocks(plane: Floats) -> Floats:
    """A plane as whole blocks, (rows, SIDE, cols, SIDE)."""
    rows, cols = (length // VARIANCE_BLOCK_SIDE for length in plane.shape)
    return plane[: rows * VARIANCE_BLOCK_SIDE, : cols * VARIANCE_BLOCK_SIDE].reshape(
        rows, VARIANCE_BLOCK_SIDE, cols, VARIANCE_BLOCK_SIDE
    )


def average_block_parts(plane: Floats) -> Floats:
    """Means of the parts of a plane's whole blocks, (rows, PARTS, cols, PARTS)."""
    rows, cols = (length // VARIANCE_BLOCK_SIDE for length in plane.shape)
    whole = plane[: rows * VARIANCE_BLOCK_SIDE, : cols * VARIANCE_BLOCK_SIDE]
    return average_blocks(whole, VARIANCE_BLOCK_SIDE // _PARTS).reshape(rows, _PARTS, cols, _PARTS)


def _even(light: Floats, noise: Floats) -> NDArray[np.bool_]:
    """Blocks with even light. Where half of a block is dark, as at the picture's edge, samples of
    unlike variance are mixed, and the mix scatters more than either.

    light : samples. noise : standard deviation of a sample, by blocks.
    """
    parts = average_block_parts(light)
    apart = parts.max(axis=(1, 3)) - parts.min(axis=(1, 3))
    noise = noise / (VARIANCE_BLOCK_SIDE // _PARTS)
    return np.asarray(apart <= _UNEVEN * parts.mean(axis=(1, 3)) + _CLIP_SIGMAS * noise)


@dataclass(frozen=True)
class PhotonTransfer:
    """Gain and noise of one plane.

    gain_e_per_dn, read_noise_e and their standard deviations. The read noise includes neither
    rounding nor what rows have in common.
    chi2 : of the blocks about the line, over their number: 1 is pure photon noise.
    rounded : whether rounding hides the read noise, which is then an upper bound.
    """

    gain_e_per_dn: float
    gain_sigma: float
    read_noise_e: float
    read_sigma: float
    chi2: float
    rounded: bool


def fit_photon_transfer(
    plane: str,
    dark: _Pair,
    lit: tuple[_Pair, ...],
    *,
    highest_dn: float,
    dark_e: float = 0.0,
    leaked_dn: float = 0.0,
) -> PhotonTransfer:
    """Fit the line of one plane.

    Parameters
    ----------
    plane : its name, for error messages.
    dark, lit : pairs without and with light.
    highest_dn : blocks above it are left out: 70 % of saturation.
    dark_e : electrons of dark current in a dark photo; their noise is not read noise.
    leaked_dn : mean light in a dark photo; its noise is not read noise either.

    Raises CalibrationError: no noise, saturated, too dim, moved between two photos, or filtered
    samples.
    """
    # Light that the panels leak is uneven, too, and its noise is in every photo.
    leak = np.maximum(dark.mean - dark.mean.mean() + leaked_dn, 0.0)
    mean = np.concatenate([leak, *(pair.mean + leak for pair in lit)])
    variance, samples, peak = (
        np.concatenate([getattr(pair, name) for pair in (dark, *lit)])
        for name in ("variance", "samples", "peak")
    )
    of_dark = np.arange(mean.size) < dark.mean.size
    good = (samples > 0.5 * samples.max()) & (of_dark | (peak <= highest_dn))
    _refuse(plane, dark, lit, good & ~of_dark)
    if not variance[good].any():
        raise CalibrationError(
            f"plane {plane}: photos of the same light are equal to the last digit: no noise",
            device="camera",
            hint='for a mock bench, set camera.noise = "full"; see that two photos were taken',
        )
    (dark_dn2, slope), covariance, chi2 = _line(plane, mean, variance, samples, good)
    level = max(float(np.median(pair.mean[pair.samples > 0])) for pair in lit)
    if slope * level < _DIM * dark_dn2:
        raise CalibrationError(
            f"plane {plane}: the flat photos are too dim: {level:.3g} DN, and half of their "
            "noise is the camera's own",
            device="camera",
            hint="open the aperture, or show more refreshes",
        )
    read_dn = float(np.sqrt(max(dark_dn2 - _ROUNDING_DN2 - dark_e * slope**2, 1e-6)))
    # read = sqrt(dark - 1/12) / K: its derivatives by both numbers of the line.
    moves = np.array([0.5 / (read_dn * slope), -read_dn / slope**2])
    return PhotonTransfer(
        gain_e_per_dn=1.0 / slope,
        gain_sigma=float(np.sqrt(covariance[1, 1])) / slope**2,
        read_noise_e=read_dn / slope,
        read_sigma=float(np.sqrt(moves @ covariance @ moves)),
        chi2=chi2,
        rounded=dark_dn2 < _LEAST_DARK_DN2,
    )


def _line(
    plane: str, mean: Floats, variance: Floats, samples: Floats, good: NDArray[np.bool_]
) -> tuple[tuple[float, float], Floats, float]:
    """The line through the `good` blocks, outliers left out: variance of the dark and slope, their
    covariance, and chi squared. Raises CalibrationError where there are too many outliers."""
    columns = np.stack([np.ones_like(mean), mean], axis=1)
    free, asked = np.maximum(samples - 1.0, 1.0), int(good.sum())
    for _ in range(2):
        model = np.maximum(variance, 0.05)
        for _ in range(_ROUNDS):
            weights = np.where(good, 0.5 * free / model**2, 0.0)
            covariance = np.asarray(np.linalg.inv(columns.T @ (weights[:, None] * columns)))
            dark_dn2, slope = (covariance @ (columns.T @ (weights * variance))).tolist()
            model = np.maximum(dark_dn2 + slope * mean, 0.05)
        away = (variance - model) / (model * np.sqrt(2.0 / free))
        chi2 = float(np.mean(away[good] ** 2))
        good = good & (np.abs(away) <= _REJECT_SIGMAS)
        if good.sum() < (1.0 - _REJECT_SHARE) * asked or slope <= 0.0:
            raise _moved(plane, chi2)
    chi2 = float(np.mean(away[good] ** 2))
    if chi2 > 1.0 + max(_EXCESS_CHI2, 5.0 * float(np.sqrt(2.0 / good.sum()))):
        raise _moved(plane, chi2)
    return (dark_dn2, slope), covariance, chi2


def _refuse(plane: str, dark: _Pair, lit: tuple[_Pair, ...], used: NDArray[np.bool_]) -> None:
    """Raise CalibrationError where a gain cannot be measured from these pairs."""
    parts = sum(pair.samples.size for pair in lit)
    if parts < _LEAST_BLOCKS:
        raise CalibrationError(
            f"the frame is too small to tell a gain: {len(lit)} flat photos have {parts} parts to "
            f"look at, and {_LEAST_BLOCKS} are needed",
            device="camera",
            hint="read out the whole sensor; a mock camera gets a finer frame by "
            "[camera] frame_quads",
        )
    many = sum(int((pair.samples > 0).sum()) for pair in lit)
    if many < _LEAST_BLOCKS:
        raise CalibrationError(
            f"plane {plane}: only {many} parts of the flat photos are evenly lit",
            device="camera",
            hint="put a white card in front of the camera, so that it fills the picture; focus",
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
    if worst > _MOST_CORRELATION:
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
