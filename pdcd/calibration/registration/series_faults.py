"""Checks of photos of stripes: what can be wrong with them, each named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pdcd.arrays import Bools, Floats
from pdcd.calibration.registration.averaging import StripeAverager
from pdcd.calibration.window import WHOLE, Window
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

_Complex = NDArray[np.complex128]

_DIM = 0.1
"""Share of the brightest white below which quads are not used."""
_LEAST_LIGHT = 5.0
"""White, over its standard deviation in one quad, below which there was no light."""
_MOST_SATURATED = 0.001
"""Share of the lit quads that may be saturated: hot pixels and specks."""
_LEAST_DEPTH = 0.2
"""Modulation below which stripes cannot be used; 0.81 where all is sharp."""
_LEAST_SHARE = 0.6
"""Share of the field, as far as the camera sees it, that must be measured."""
_REACH = 2.5
"""Periods from a measured place within which the field counts as measured: 1.5 of them are averaged
over, 1 is half the way to the next place."""
_AMBIGUOUS = 0.4
"""Offsets beyond so many periods may be those of the next stripe."""
_OTHER_STRIPE_PX = 1.0
"""By how much two periods may disagree in offset: for neighbouring stripes of 16 px it is 2 px or
more."""
_CHANGED = 0.012
"""Part of the photos that no stripes explain, over the stripes' amplitude, from which the bench has
changed."""
_FOLLOWED = 0.3
"""Depth of the mask's stripes where the maps have them, over the depth of the product, below which
they run elsewhere; 1.57 with sharp photos."""
_CELLS = (12, 16)
"""Rows and columns of places of the field that are checked for coverage."""


def find_lit_quads(white: Floats, variance: Floats) -> Bools:
    """The quads that are lit in a white photo (h, w). Raises CalibrationError where there is no
    light."""
    finite = np.isfinite(white)
    brightest = np.quantile(white[finite], 0.98) if finite.any() else 0.0
    bright = finite & (white > _DIM * brightest)
    noise = np.sqrt(np.median(variance[bright])) if bright.any() else 0.0
    if not brightest > _LEAST_LIGHT * noise:
        raise CalibrationError(
            "there is no light: the photo with both panels white is black",
            device="camera",
            hint="take the lens cap off, switch the lamp on, and check that the shutter opens",
        )
    return bright


def check_stripe_saturation(saturated: Bools | None, lit: Bools) -> None:
    """Raise CalibrationError where too many lit quads (h, w) are saturated."""
    share = 0.0 if saturated is None else float(np.mean(saturated[lit]))
    if share > _MOST_SATURATED:
        raise CalibrationError(
            f"{share:.1%} of the lit part of a photo is saturated",
            device="camera",
            hint="expose less: fewer refreshes, a smaller aperture or a lower ISO",
        )


def check_window_coverage(
    places: Floats, camera: Map, period_quads: float, window: Window = WHOLE
) -> None:
    """Raise CalibrationError where the places (n, 2), in quads, cover too little of the field's
    window."""
    rows, cols = _CELLS
    x, y = window.x((np.arange(cols) + 0.5) / cols), window.y((np.arange(rows) + 0.5) / rows)
    cells = camera.from_field(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        in_photo = ((cells >= 0.0) & (cells <= camera.size_px)).all(axis=-1)
    share = 0.0
    if len(places) and in_photo.any():
        away = cKDTree(places).query(cells[in_photo])[0]
        share = float(np.mean(away <= _REACH * period_quads))
    if share < _LEAST_SHARE:
        raise CalibrationError(
            f"stripes could be measured on {share:.0%} of the field only; "
            f"{_LEAST_SHARE:.0%} are needed",
            device="camera",
            hint="clear the field, and put a flat bright card across all of it",
        )


def check_stripe_contrast(share: Floats, first: _Complex, sigma: Floats) -> None:
    """Raise CalibrationError where photos (n, S) over white hardly show stripes."""
    mean = share.mean(axis=1)
    level = float(np.median(mean))
    if level > 0.6:
        raise CalibrationError(
            f"stripes gave {level:.1f} times the light of the photo with both panels white",
            device="display",
            hint="check both panels: the white photo was not white, or had another exposure",
        )
    if level < 0.02:
        raise CalibrationError(
            "the photos of stripes are black",
            device="mask",
            hint="check that the mask opens, both panels show their picture, and the exposure is "
            "that of the white photo",
        )
    depth = 2.0 * np.abs(first) / np.maximum(mean, 1e-12)
    seen = (depth > _LEAST_DEPTH) & (np.abs(first) > _LEAST_LIGHT * sigma)
    if seen.mean() > 0.9:
        return
    if level > 0.4:
        cause, device = "one of the panels shows no stripes", "display"
        hint = "put a picture on each output (pdcd show), and look at both panels"
    else:
        cause = f"the stripes do not modulate ({np.median(depth):.2f}, at least {_LEAST_DEPTH})"
        device = "mask"
        hint = (
            "focus the scene on the mask and the projector on the scene; "
            "if both are sharp, calibrate the geometry again"
        )
    raise CalibrationError(cause, device=device, hint=hint)


def check_stripe_direction(
    turning: _Complex,
    carrier: _Complex,
    first: _Complex,
    averaging: StripeAverager,
    places: Floats,
) -> None:
    """Raise CalibrationError where the mask's stripes run against their map, or do not follow it.

    turning : first harmonic of each block over the photos, whose phase follows the mask's stripes.
    carrier : the same by the maps. first : (n,) averages at the places.
    """
    depths = []
    for way in (np.conj(carrier), carrier):
        met = turning * way
        depth = np.hypot(averaging.smooth(met.real), averaging.smooth(met.imag))
        depths.append(float(np.median(averaging.at(depth, places))))
    along, against = depths
    if against > 2.0 * along:
        raise CalibrationError(
            "the mask's stripes run the wrong way: it is mirrored or upside down",
            device="mask",
            hint="set mask.place.flip or turn_deg, or calibrate the geometry again",
        )
    if along < _FOLLOWED * float(np.median(np.abs(first))):
        raise CalibrationError(
            "the mask's stripes are not where the maps have them",
            device="mask",
            hint="calibrate the geometry first; check that the camera is focused on the mask",
        )


def check_series_consistency(share: Floats, first: _Complex, sigma: Floats) -> None:
    """Raise CalibrationError where the photos (n, S) of a series do not belong together."""
    steps = share.shape[1]
    # The product of two stripe patterns has only odd harmonics, however sharp it is; even ones show
    # everything else.
    even = (np.abs(np.fft.fft(share, axis=1)[:, 2::2] / steps) ** 2).sum(axis=1)
    noise = 2.0 * float(np.mean(sigma**2))
    left = (float(np.median(even)) / (steps / 2 - 1) - noise) * (steps - 3)
    amplitude = 2.0 * float(np.median(np.abs(first)))
    change = float(np.sqrt(max(0.0, left))) / amplitude
    if change > _CHANGED:
        raise CalibrationError(
            f"the bench moved during the series, or its light changed: {change:.1%} of the stripes "
            "is not explained",
            device="mask",
            hint="let the lamp warm up, touch nothing, and repeat the step",
        )


def check_offset_range(offset_px: Floats, period_px: int) -> None:
    """Raise CalibrationError where offsets (n, 2) come near half a period."""
    if np.mean(np.abs(offset_px).max(axis=-1) > _AMBIGUOUS * period_px) > 0.01:
        raise CalibrationError(
            f"mask and projector are {_AMBIGUOUS * period_px:.1f} px or more apart: stripes of "
            f"{period_px} px cannot tell which belong together",
            device="mask",
            hint="calibrate the geometry first",
        )


def check_same_stripe(beside_px: Floats, period_px: int) -> None:
    """Raise CalibrationError where offsets (n, 2) differ from those that a longer period gave."""
    apart = float(np.median(np.abs(beside_px), axis=0).max())
    if apart > _OTHER_STRIPE_PX:
        raise CalibrationError(
            f"stripes of {period_px} px have mask and projector {apart:.1f} px further apart than "
            "longer ones, which took neighbours for each other",
            device="mask",
            hint="calibrate the geometry first",
        )
