"""Where the light of a panel falls in a photo, and whether there is any that can be measured."""

from __future__ import annotations

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.calibration.photo import QuadPhoto
from pdcd.errors import CalibrationError

OFFSETS_QUADS = {
    "RGGB": ((-0.25, -0.25), (0.0, 0.0), (0.25, 0.25)),
    "BGGR": ((0.25, 0.25), (0.0, 0.0), (-0.25, -0.25)),
    "GRBG": ((0.25, -0.25), (0.0, 0.0), (-0.25, 0.25)),
    "GBRG": ((-0.25, 0.25), (0.0, 0.0), (0.25, -0.25)),
    "": ((0.0, 0.0),),
}
"""Where the samples of red, green (the mean of both) and blue lie relative to the middle of their
quad, (right, down), by the camera's mosaic. A sensor without colours has one, in the middle."""

_STEP = 4
"""Every so many quads are sampled when a photo is judged as a whole."""
_LEAST_SNR = 4.0
"""Signal over noise of one quad below which a panel's light is too dim."""
LIT_SIGMAS = 5.0
"""Standard deviations above which something is there."""
_LIT = 0.15
"""Share of the brightest light at which a quad counts as lit by the panel."""
_LEAST_LIT = 0.02
"""Share of the frame that a panel must light."""
_SATURATED = 0.002
"""Share of saturated quads that is accepted: hot pixels, a glint."""
_MOST_AMBIENT = 1.0
"""Light of the room over light of the panel that is accepted."""


def find_panel_light(white: QuadPhoto, black: QuadPhoto, panel: str) -> Bools:
    """Where the light of a panel falls, (h, w) bool: where white is brighter than black.

    Raises CalibrationError, which names the cause, where these photos cannot be used: no light at
    all, a panel that does not switch, too little light, too much, a lit room.
    """
    values = [photo.main[::_STEP, ::_STEP] for photo in (white, black)]
    if not all(np.isfinite(one).all() for one in values) or white.frame != black.frame:
        raise _untrusted(
            "the photos have numbers that are not finite, or differ in size",
            panel,
            "take them again, all with the same camera settings",
        )
    noise = np.sqrt(white.main_variance[::_STEP, ::_STEP] + black.main_variance[::_STEP, ::_STEP])
    light = values[0] - values[1]
    _check_saturated(white, panel)
    _check_light(values[0], light, noise, panel)
    brightest = float(np.percentile(light, 99.0))
    some = light > _LIT * brightest
    share, snr = float(some.mean()), float(np.median((light / noise)[some]))
    if snr < _LEAST_SNR:
        raise _untrusted(
            f"the {panel}'s light is too dim: {snr:.1f} times the noise of a pixel",
            panel,
            "expose longer, open the aperture, or raise the ISO",
        )
    if share < _LEAST_LIT:
        raise _untrusted(
            f"only {share:.1%} of the photo is lit by the {panel}",
            panel,
            "point the camera at the card; the panel's picture should fill most of the frame",
        )
    ambient = float(np.median(values[1][some]) / np.median(light[some]))
    if ambient > _MOST_AMBIENT:
        raise _untrusted(
            f"light that is not the {panel}'s is {ambient:.1f} times as strong as its own",
            panel,
            "switch off the room's lights, or shade the bench",
        )
    whole: Bools = white.main - black.main > _LIT * brightest
    return whole


def _check_light(white: Floats, light: Floats, noise: Floats, panel: str) -> None:
    """Raise CalibrationError where there is no light, or it is not the panel's."""
    mean_noise = float(np.median(noise)) / np.sqrt(light.size)
    if np.percentile(light / noise, 99.0) > LIT_SIGMAS:
        return
    if float(np.mean(white)) < LIT_SIGMAS * mean_noise:
        raise _untrusted(
            "no light reaches the camera",
            "camera",
            "take off the lens cap, see that the shutter opens and the projector's lamp is on",
        )
    if float(np.mean(light)) > LIT_SIGMAS * mean_noise:
        raise _untrusted(
            f"the {panel}'s light is too dim to tell white from black in one pixel",
            panel,
            "expose longer, open the aperture, or raise the ISO",
        )
    raise _untrusted(
        f"the {panel} looks the same when it shows white and black",
        panel,
        "see that it is on and its cable is that of the configured output: pdcd doctor display",
    )


def _check_saturated(white: QuadPhoto, panel: str) -> None:
    share = white.saturated_share()
    if share > _SATURATED:
        raise _untrusted(
            f"{share:.1%} of the photo is saturated",
            panel,
            "shorten the exposure, close the aperture, or lower the ISO",
        )


def _untrusted(what: str, device: str, hint: str) -> CalibrationError:
    return CalibrationError(what, device=device, hint=hint)
