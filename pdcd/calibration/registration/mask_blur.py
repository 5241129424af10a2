"""Blur of the projector's light on the mask, from the depth of stripes of two periods.

Blur by a Gaussian of standard deviation s leaves exp(-2 pi^2 s^2 n^2 / P^2) of the n-th harmonic of
stripes. Whatever else makes stripes shallow (contrast, ambient and global light) is the same for
all periods and drops out of their ratio; the attenuation by the mask's pixels is known
(`registration.stripes.compute_pixel_attenuation`). With S photos, a triangle's harmonics n = S - 1,
S + 1 and so on cannot be separated from the first: they are part of the model, too.

The blur between mask and camera does not count: photos are averaged over whole stripes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.registration.offsets import StripeSeries, find_nearest
from pdcd.calibration.registration.stripes import (
    StripePlan,
    compute_map_slope,
    compute_pixel_attenuation,
)
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, map_between

_CELLS = (3, 4)
"""Rows and columns of parts of the field for which blur is given."""
_HARMONICS = 31
"""Highest harmonic of the model."""
_VARIANCES_PX2 = np.concatenate([np.arange(-0.3, 2.0, 0.01), np.geomspace(2.0, 64.0, 120)])
"""Squared blurs for which the model is computed; noise may take that of a sharp bench below
zero."""
_SURE = 5.0
"""Least depth of the fine stripes, over its error, for blur to be measured."""


@dataclass(frozen=True, eq=False)
class MaskBlur:
    """Standard deviation of the blur, in projector pixels.

    blur_px, sigma_px : (2,) to the right and down, over the field.
    by_cell_px : (rows, cols, 2) blur of each part of the field; NaN where nothing was measured.
    """

    blur_px: Floats
    sigma_px: Floats
    by_cell_px: Floats

    @property
    def both_px(self) -> float:
        """One blur for both axes: their root mean square."""
        return float(np.sqrt(np.mean(self.blur_px**2)))

    @property
    def both_sigma_px(self) -> float:
        """Its standard deviation."""
        both = max(self.both_px, 1e-6)
        return float(np.hypot(*(self.blur_px * self.sigma_px)) / (2.0 * both))

    @property
    def worst_px(self) -> float:
        """The largest blur of any part of the field."""
        return float(np.nanmax(self.by_cell_px))


def measure_mask_blur(
    coarse: Sequence[StripeSeries],
    fine: Sequence[StripeSeries],
    camera: Map,
    projector: Map,
    mask: Map,
) -> MaskBlur:
    """The blur on the mask.

    coarse, fine : (right, down), series of a long period and of a short one.
    camera, projector, mask : maps in use when the stripes were shown; the fine ones may have been
        shown with a mask's map that was corrected in between.

    Raises CalibrationError where the fine stripes are blurred away.
    """
    squares = [
        _squares(one, other, camera, projector, mask)
        for one, other in zip(coarse, fine, strict=True)
    ]
    values, sigmas, cells = [], [], []
    for series, square in zip(coarse, squares, strict=True):
        mean, sigma = _robust_mean(square)
        value = float(np.sqrt(max(0.0, mean)))
        values.append(value)
        # d(s) = d(s^2) / 2 s; a blur that does not differ from zero has an error of its own size.
        sigmas.append(sigma / (2.0 * max(value, np.sqrt(sigma))))
        cells.append(_by_cell(square, camera.to_field(series.quads)))
    return MaskBlur(np.array(values), np.array(sigmas), np.stack(cells, axis=-1))


def _squares(
    coarse: StripeSeries, fine: StripeSeries, camera: Map, projector: Map, mask: Map
) -> Floats:
    """Squared blur at each place, (n,) in projector pixels^2; may be below zero by noise."""
    if coarse.stripes.axis != fine.stripes.axis:
        raise ValueError("blur needs two periods of the same stripes")
    there = find_nearest(coarse.quads, fine.quads)
    depth, error = fine.modulation[there], (2.0 * fine.sigma / fine.share.mean(axis=1))[there]
    if np.median(depth) < _SURE * np.median(error):
        raise CalibrationError(
            f"stripes of {fine.stripes.period_px} px are blurred away on the mask",
            device="mask",
            hint="focus the scene on the mask and the projector on the scene",
        )
    axis = coarse.stripes.axis
    points = map_between(camera, mask, coarse.quads)
    slope = compute_map_slope(axis, projector, mask, points)
    # The two series may have been shown with different maps: what counts is each one's own phase.
    own = coarse.offset_px, fine.offset_px[there]
    models = [_model(each.stripes, slope, at) for each, at in zip((coarse, fine), own, strict=True)]
    ratio = np.log(models[1] / models[0])
    seen = np.log(np.maximum(depth, 1e-9) / coarse.modulation)
    # With more blur less of the fine stripes is left: the model falls.
    return np.array(
        [np.interp(-one, -row, _VARIANCES_PX2) for one, row in zip(seen, ratio, strict=True)]
    )


def _model(stripes: StripePlan, slope: Floats, offset_px: Floats) -> Floats:
    """Depth of the stripes by the model, up to one factor: (n, squared blurs)."""
    steps, period = stripes.steps, stripes.period_px
    phase = 2.0 * np.pi * offset_px[:, None] / period
    found = np.zeros((len(slope), _VARIANCES_PX2.size), dtype=np.complex128)
    for n in range(1, _HARMONICS + 1, 2):
        side = (n % steps == 1) - float(n % steps == steps - 1)
        if side == 0.0:
            continue
        # Below zero only the first harmonic may grow: the others would have no sensible value.
        square = _VARIANCES_PX2 if n == 1 else np.maximum(_VARIANCES_PX2, 0.0)
        left = np.exp(-2.0 * np.pi**2 * square * n**2 / period**2) / n**2
        found += (
            compute_pixel_attenuation(stripes, slope, n)[:, None]
            * left
            * np.exp(1j * side * n * phase)
        )
    return np.abs(found)


def _robust_mean(values: Floats) -> tuple[float, float]:
    """Mean of values (n,) without outliers, and its standard deviation."""
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    near = values[np.abs(values - middle) <= 4.0 * spread + 1e-12]
    return float(near.mean()), float(near.std() / np.sqrt(max(1, near.size - 1)))


def _by_cell(squares: Floats, field: Floats) -> Floats:
    """Blur of each part of the field, (rows, cols)."""
    rows, cols = _CELLS
    cell = np.clip((field * (cols, rows)).astype(np.int64), 0, (cols - 1, rows - 1))
    found = np.full(_CELLS, np.nan)
    for row in range(rows):
        for col in range(cols):
            inside = squares[(cell[:, 0] == col) & (cell[:, 1] == row)]
            if inside.size:
                found[row, col] = np.sqrt(max(0.0, float(np.median(inside))))
    return found
