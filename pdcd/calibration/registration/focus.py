"""Focus: how deep fine stripes are in a photo, over the field.

The choice of stripes decides what is focused: the mask's alone, the camera on the mask (the relay);
the projector's alone, the projector on the scene, or the scene on a diffuser at the mask.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.photo import QuadPhoto
from pdcd.errors import CalibrationError

_PARTS = (3, 4)
"""Rows and columns of parts of the photo whose depths are measured separately."""
_LEAST_DEPTH = 0.02
"""Depth of stripes, over the mean light, below which there are none."""
_SURE = 10.0
"""How far stripes must exceed noise and texture, in standard deviations."""
_NEAR = 1.8
"""Factor by which the real period may differ from the given one."""


@dataclass(frozen=True, eq=False)
class StripeDepth:
    """How deep stripes are: amplitude over mean light, 0 to about 1.27 for sharp ones.

    parts, sigma : (rows, cols) over the photo; NaN where there is no light.
    """

    parts: Floats
    sigma: Floats

    @property
    def number(self) -> float:
        """The number to maximise: the mean over the field."""
        return float(np.nanmean(self.parts))

    @property
    def number_sigma(self) -> float:
        """Its standard deviation."""
        seen = self.sigma[np.isfinite(self.parts)]
        return float(np.sqrt(np.sum(seen**2)) / seen.size)

    @property
    def slope(self) -> tuple[float, float]:
        """How much the logarithm of the depth grows from the left edge to the right one, and from
        the top to the bottom: large where the plane of focus is tilted. NaN where a part of the
        field is dark."""
        logs = np.log(np.maximum(self.parts, 1e-6))
        down, right = ((np.arange(n) + 0.5) / n - 0.5 for n in _PARTS)
        return (
            float((logs.mean(axis=0) * right).sum() / (right**2).sum()),
            float((logs.mean(axis=1) * down).sum() / (down**2).sum()),
        )


def measure_stripe_depth(photo: QuadPhoto, period_quads: float) -> StripeDepth:
    """Depth of stripes in one photo, whichever way they run; their period is roughly known.

    Raises CalibrationError for a photo without light, saturated, or without stripes.
    """
    seen, noise = photo.main, photo.main_variance
    if not np.mean(seen) > 5.0 * np.sqrt(np.mean(noise) / seen.size) or not np.mean(seen) > 0.0:
        raise CalibrationError(
            "there is no light in the photo",
            device="camera",
            hint="take the lens cap off, switch the lamp on, and check that the shutter opens",
        )
    if photo.saturated is not None and np.mean(photo.saturated) > 0.001:
        raise CalibrationError(
            "the photo is saturated", device="camera", hint="expose less, or lower the ISO"
        )
    cycles = _cycles(seen, period_quads)
    height, width = (side // parts for side, parts in zip(seen.shape, _PARTS, strict=True))
    found = np.full((2, *_PARTS), np.nan)
    for at in np.ndindex(_PARTS):
        part = np.s_[at[0] * height :, at[1] * width :]
        light = seen[part][:height, :width]
        if light.mean() > 0.1 * seen.mean():
            found[:, *at] = _depth(light, noise[part][:height, :width], cycles)
    depths = StripeDepth(found[0], found[1])
    if not depths.number > max(_LEAST_DEPTH, _SURE * depths.number_sigma):
        raise CalibrationError(
            f"no stripes of about {period_quads:.1f} pixels are seen: their depth is "
            f"{depths.number:.3f}",
            device="camera",
            hint="check that the panel shows stripes, then turn the focus through its range",
        )
    return depths


def _windowed(light: Floats) -> tuple[Floats, Floats]:
    """A window that falls off to the edges, and the light through it less its mean, both over the
    mean light: so the mean and other periods do not leak in."""
    window = np.outer(*(np.hanning(side + 2)[1:-1] for side in light.shape))
    window /= window.sum()
    mean = float((window * light).sum())
    return window / mean, window * (light / mean - 1.0)


def _cycles(light: Floats, period_quads: float) -> tuple[float, float]:
    """Cycles per quad, down and right, of the strongest stripes of about that period."""
    power = np.abs(np.fft.rfft2(_windowed(light)[1]))
    down, right = np.fft.fftfreq(light.shape[0]), np.fft.rfftfreq(light.shape[1])
    ratio = period_quads * np.hypot(down[:, None], right)
    power[(ratio < 1.0 / _NEAR) | (ratio > _NEAR)] = 0.0
    row, col = np.unravel_index(int(power.argmax()), power.shape)
    return float(down[row]), float(right[col])


def _depth(light: Floats, variance: Floats, cycles: tuple[float, float]) -> tuple[float, float]:
    """Depth of stripes in a part of a photo, and its standard deviation: the highest of finely
    spaced frequencies near `cycles`, those of the whole photo."""
    window, centred = _windowed(light)

    def amplitudes(times: float, spread: Floats) -> Floats:
        """Amplitudes of frequencies around `times` the stripes' own."""
        down, right = (
            np.exp(2j * np.pi * np.outer(times * own + spread / side, np.arange(side)))
            for own, side in zip(cycles, light.shape, strict=True)
        )
        return 2.0 * np.abs(down @ centred @ right.T)

    best = float(amplitudes(1.0, np.linspace(-1.0, 1.0, 17)).max())
    # Noise of any kind is as strong at nearby frequencies, where no harmonic of the stripes lies.
    floors = [amplitudes(times, np.arange(-1.0, 2.0)) for times in (0.6, 0.7, 1.4, 1.6)]
    floor = float(np.sqrt(np.mean(np.square(floors))))
    return best, max(2.0 * float(np.sqrt((window**2 * variance).sum())), floor)
