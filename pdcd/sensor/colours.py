"""Planes of a decoded photo -> colours, and the variance of their light by the sensor's noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.arrays import Floats
from pdcd.sensor.profile import SensorProfile, compute_variance_dn2

OF_COLOURS = {4: ((0,), (1, 2), (3,)), 1: ((0,),)}
"""The planes of each colour, by the number of planes."""


def to_colours(planes: NDArray[np.float32], factors: ArrayLike = 1.0) -> Floats:
    """(4, h, w) planes R, G1, G2, B -> (h, w, 3) float64, the two greens averaged, each channel
    times its factor; (1, h, w) -> (h, w, 1). Channels lie one after the other in memory."""
    of_colours = OF_COLOURS[len(planes)]
    out = np.empty((len(of_colours), *planes.shape[1:]))
    each = np.broadcast_to(np.asarray(factors, np.float64), len(of_colours))
    for light, (first, *more), factor in zip(out, of_colours, each, strict=True):
        if not more:
            np.multiply(planes[first], factor, out=light)
            continue
        np.add(planes[first], planes[more[0]], out=light, dtype=np.float64)
        light *= 0.5 * factor
    return np.moveaxis(out, 0, -1)


def compute_colour_variance(
    planes: NDArray[np.float32],
    profile: SensorProfile,
    iso: int,
    exposure_s: float,
    factors: ArrayLike = 1.0,
    dtype: type[np.floating] = np.float64,
) -> NDArray[np.floating]:
    """Variance of `to_colours(planes, factors)` by the sensor's noise model, (h, w, C) of `dtype`.

    The measured samples stand in for the expected ones, so the photon part is itself noisy (and a
    little high where there is no light). Raises `ConfigError` for an unknown ISO.
    """
    of_colours = OF_COLOURS[len(planes)]
    out = np.empty((len(of_colours), *planes.shape[1:]), dtype)
    each = np.broadcast_to(np.asarray(factors), len(of_colours))
    for channel, (which, factor) in enumerate(zip(of_colours, each, strict=True)):
        if dtype is np.float32:
            _variance_single(planes, which, profile, iso, exposure_s, factor, out[channel])
            continue
        found = compute_variance_dn2(planes[which[0]], profile, iso, exposure_s)
        for more in which[1:]:
            found += compute_variance_dn2(planes[more], profile, iso, exposure_s)
            found /= 4.0
        np.multiply(found, factor * factor, out=out[channel])
    return np.moveaxis(out, 0, -1)


def _variance_single(
    planes: NDArray[np.float32],
    which: tuple[int, ...],
    profile: SensorProfile,
    iso: int,
    exposure_s: float,
    factor: float,
    out: NDArray[np.floating],
) -> None:
    """The same for one channel, in single precision: the model is a straight line above black."""
    dark, unit = (
        compute_variance_dn2([0.0, 1.0], profile, iso, exposure_s) * (factor / len(which)) ** 2
    )
    np.maximum(planes[which[0]], np.float32(0.0), out=out)
    for more in which[1:]:
        out += np.maximum(planes[more], np.float32(0.0))
    out *= np.float32(unit - dark)
    out += np.float32(dark * len(which))
