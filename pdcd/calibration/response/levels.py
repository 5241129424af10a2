"""How much light a grey level gives: gamma, and a table of levels.

The panel shows 17 strips of 17 levels, in two orders. Dividing by a white photo corrects for uneven
light. A black photo corrects for light that is not the panel's: divided by a white that falls off
to the corners, light of the room differs from strip to strip. The panels' maps locate the strips in
the photo. Two orders that agree confirm the maps, and their differences give the error. Codes need
none of this: they are black and white.

Panels that make grey by dithering show a level only on average over some refreshes, so that photos
last for whole cycles of it. A level that is shown for one refresh is another matter: a panel
changes more slowly from grey to grey than from black to white, and no static table describes that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize_scalar

from pdcd.arrays import Floats
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.photo import (
    NO_LIGHT_SIGMAS,
    QuadPhoto,
    check_brightness,
    check_clipping,
    find_inliers,
)
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, map_between

_Strips = NDArray[np.int32]

STRIP_LEVELS = tuple(round(255.0 * k / 16.0) for k in range(17))
_ORDERS = 2
_NAMES = ("steps-a", "steps-b")
NO_STRIP = -1
_MARGIN = 0.25
"""Share of a strip's width that is left out on either side, because blur mixes it with the next
strip."""
DITHER_CYCLE = 16
"""Refreshes after which every usual dithering repeats."""
_APART = 8.0
"""Quads between places at which the maps are evaluated."""
_LEAST_QUADS = 30
_LEAST_WHITE = 0.1
"""Least light of a strip in the white photo, over the mean of all."""
_AGREE = 0.05
"""Largest difference of the two orders, as a share of full light."""
_DRIFT = 0.03
_MOST_BLACK = 0.9
"""Largest black over white of a strip that is corrected for; a panel that shows no levels has 1."""
_DARK = 0.2
"""Black over white beyond which something other than the panel gives light."""
_SMOOTH = 0.01
"""Largest misfit of a power law, as a share of full light."""
_FALLS_SIGMAS = 5.0
_STEPS = (0.03, 0.97)
_GAMMAS = (0.1, 8.0)
_CLOSE = {"xatol": 1e-7}


def make_strip_orders() -> NDArray[np.int64]:
    """(2, 17): which level each strip shows, from left to right.

    The orders step by 7 and 5 levels, modulo 17, so that neighbours differ much. Seen mirrored or
    shifted, the two orders disagree on each level's light: they start so that neither is the mirror
    image of the other.
    """
    strips = np.arange(len(STRIP_LEVELS))
    return np.stack([7 * strips % len(STRIP_LEVELS), (5 * strips + 9) % len(STRIP_LEVELS)])


def draw_level_pictures(size_px: tuple[int, int]) -> dict[str, NDArray[np.uint8]]:
    """White, black, and two pictures of strips, by the names of their photos: (height, width) of a
    panel's own pixels.

    size_px : (width, height) of the panel.
    """
    width, height = size_px
    strip = find_level_strip(np.arange(width) + 0.5, width)
    levels = np.array(STRIP_LEVELS, np.uint8)
    pictures = {
        name: np.full((height, width), level, np.uint8)
        for name, level in (("white", 255), ("black", 0))
    }
    for name, order in zip(_NAMES, make_strip_orders(), strict=True):
        pictures[name] = np.tile(levels[order][strip], (height, 1))
    return pictures


def find_level_strip(x: ArrayLike, width: int) -> _Strips:
    """Strip of a place on the panel, in pixels from its left edge."""
    found = np.floor(np.asarray(x) * len(STRIP_LEVELS) / width)
    return np.clip(found, 0, len(STRIP_LEVELS) - 1).astype(np.int32)


def find_seen_strips(camera: Map, panel: Map) -> _Strips:
    """Which strip each quad sees, (h, w) int32; `NO_STRIP` off the panel and near edges of
    strips."""
    width, height = panel.size_px
    cols, rows = camera.size_px
    x, y = (np.append(np.arange(0.5, n - 0.5, _APART), n - 0.5) for n in (cols, rows))
    places = map_between(camera, panel, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    # Maps bend so little between these places that linear interpolation is enough.
    quads = [np.interp(np.arange(n) + 0.5, v, np.arange(v.size)) for n, v in ((rows, y), (cols, x))]
    found = np.full((rows, cols), NO_STRIP, np.int32)
    across, down = (places[:, axis].reshape(y.size, x.size) for axis in (0, 1))
    for row in range(rows):
        where = [np.full(cols, quads[0][row]), quads[1]]
        at = ndimage.map_coordinates(across, where, order=1) * len(STRIP_LEVELS) / width
        below = ndimage.map_coordinates(down, where, order=1)
        with np.errstate(invalid="ignore"):
            inside = (at >= 0.0) & (at < len(STRIP_LEVELS)) & (below > 0.0) & (below < height)
            inside &= np.abs(at - np.floor(at) - 0.5) < 0.5 - _MARGIN
        found[row, inside] = np.floor(at[inside]).astype(np.int32)
    return found


@dataclass(frozen=True, eq=False)
class GreyResponse:
    """Light of grey levels of one panel.

    panel : its name.
    levels : (17,) 0..255. light, sigma : (17,) of all channels, over full light: 0 is black.
    gamma, gamma_sigma : of the law ``(level / 255)^gamma``; `channel_gammas` of each channel.
    misfit : largest error of the law, as a share of full light.
    """

    panel: str
    levels: Floats
    light: Floats
    sigma: Floats
    gamma: float
    gamma_sigma: float
    channel_gammas: tuple[float, ...]
    misfit: float

    def light_of(self) -> Floats:
        """(256,) light of every level, 0..1: PCHIP between the measured ones, never falling."""
        rising = np.maximum.accumulate(np.clip(self.light, 0.0, 1.0))
        return np.asarray(PchipInterpolator(self.levels, rising)(np.arange(256.0)))

    def level_for(self) -> NDArray[np.uint8]:
        """(256,) uint8: the level whose light is nearest to k / 255 of full light."""
        light = self.light_of()
        wanted = np.arange(256) / 255.0
        above = np.clip(np.searchsorted(light, wanted), 1, 255)
        nearer = wanted - light[above - 1] < light[above] - wanted
        return np.asarray(above - nearer, np.uint8)

    def figures(self) -> tuple[MeasuredFigure, ...]:
        """The figures of this panel."""
        law = self.misfit <= _SMOOTH
        apart = max(self.channel_gammas) - min(self.channel_gammas)
        of_colours = MeasuredFigure(f"{self.panel}.gamma_colours", apart, self.gamma_sigma, "")
        return (
            MeasuredFigure(
                f"{self.panel}.gamma",
                self.gamma,
                self.gamma_sigma,
                "",
                f"a power law within {_SMOOTH:g}",
                Verdict.GOOD if law else Verdict.DOUBTFUL,
            ),
            MeasuredFigure(
                f"{self.panel}.gamma_misfit", self.misfit, float(self.sigma.max()), "of white"
            ),
            *((of_colours,) if len(self.channel_gammas) > 1 else ()),
        )


def measure_grey_response(
    photos: Mapping[str, QuadPhoto], strips: _Strips, panel: str = "projector"
) -> GreyResponse:
    """Light of the grey levels of one panel.

    Parameters
    ----------
    photos : "white", "black", "steps-a" and "steps-b" of `draw_level_pictures`, of one exposure.
    strips : (h, w) of `find_seen_strips`.
    panel : its name in the configuration.

    Raises CalibrationError: no light, saturated, too dim, strips that are not in view, orders that
    disagree (mirrored, swapped, moved), levels that fall (inverted) or do nothing, a lamp that
    changed.
    """
    for name in ("white", *_NAMES):
        share = photos[name].saturated_share()
        check_clipping(name, share, "close the aperture, or show fewer refreshes")
    by_strip, noise_of_strip = _ratios(photos, strips)
    check_brightness({name: float(r.max()) for name, r in zip(_NAMES, by_strip, strict=True)}, 0.05)
    # By level: (orders, levels, channels).
    of_level = [np.argsort(order) for order in make_strip_orders()]
    seen = np.stack([by_strip[n][strip] for n, strip in enumerate(of_level)])
    noise = np.stack([noise_of_strip[n][strip] for n, strip in enumerate(of_level)])
    _refuse(seen, noise)
    each = (seen - seen[:, :1]) / (seen[:, -1:] - seen[:, :1])
    flat = _uneven(each, noise)
    light = each.mean(axis=0).mean(axis=1)
    colours = each.shape[2]
    sigma = _errors(light, np.sqrt((noise**2).mean(axis=(0, 2)) / colours), flat)
    _refuse_shape(light, float(sigma.max()))
    levels = np.array(STRIP_LEVELS, np.float64)
    gamma, gamma_sigma, misfit = _power(
        levels, seen.mean(axis=2), np.sqrt((noise**2).mean(axis=2) / colours), flat
    )
    gammas = [_power(levels, seen[..., c], noise[..., c], flat)[0] for c in range(colours)]
    return GreyResponse(
        panel=panel,
        levels=levels,
        light=light,
        sigma=sigma,
        gamma=gamma,
        gamma_sigma=gamma_sigma,
        channel_gammas=tuple(gammas),
        misfit=misfit,
    )


def _ratios(photos: Mapping[str, QuadPhoto], strips: _Strips) -> tuple[Floats, Floats]:
    """Light over white of each strip, and its standard deviation by noise: (orders, 17, C)."""
    white = photos["white"]
    shape = 4, _ORDERS, len(STRIP_LEVELS), white.colours
    ratio, noise, black, of_black = np.full(shape, np.nan)
    inside = strips != NO_STRIP
    level = float(white.light[inside].mean())
    check_brightness(
        {"white": level},
        NO_LIGHT_SIGMAS
        * float(np.sqrt(white.variance[inside].mean()))
        / float(np.sqrt(inside.sum())),
    )
    if any(float(photos[name].light[inside].mean()) > 1.1 * level for name in _NAMES):
        raise _inverted()
    for strip in range(len(STRIP_LEVELS)):
        here = strips == strip
        if here.sum() < _LEAST_QUADS:
            raise CalibrationError(
                f"strip {strip + 1} of {len(STRIP_LEVELS)} is seen by {int(here.sum())} pixels",
                device="camera",
                hint="calibrate the geometry again; see that nothing covers the field",
            )
        whole = white.light[here]
        if float(whole.mean()) < _LEAST_WHITE * level:
            raise CalibrationError(
                f"strip {strip + 1} of {len(STRIP_LEVELS)} is dark in the white photo",
                device="camera",
                hint="take away what covers the field",
            )
        for n, name in enumerate(_NAMES):
            part = photos[name].light[here]
            kept = find_inliers(part.sum(axis=1) / np.maximum(whole.sum(axis=1), 1e-9))
            ratio[n][strip], noise[n][strip] = _over_white(photos[name], white, here, kept)
            black[n][strip], of_black[n][strip] = _over_white(photos["black"], white, here, kept)
    return _as_if_even(ratio, noise, black, of_black)


def _over_white(
    photo: QuadPhoto, white: QuadPhoto, here: NDArray[np.bool_], kept: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Light over white of the kept quads of a strip, and its standard deviation by noise: (C,)."""
    sums = white.light[here][kept].sum(axis=0)
    ratio = photo.light[here][kept].sum(axis=0) / sums
    variance = photo.variance[here][kept].sum(axis=0)
    variance = variance + ratio**2 * white.variance[here][kept].sum(axis=0)
    return ratio, np.sqrt(variance) / sums


def _as_if_even(
    ratio: Floats, noise: Floats, black: Floats, of_black: Floats
) -> tuple[Floats, Floats]:
    """What strips would show if black over white were the same everywhere: (orders, 17, C) each.

    A level that gives the share l of the panel's light shows l + (1 - l) b, with b the black there.
    """
    left = (1.0 - ratio) / (1.0 - np.minimum(black, _MOST_BLACK))  # 1 - l
    even = 1.0 - np.minimum(black, _MOST_BLACK).mean(axis=(0, 1))
    return 1.0 - left * even, np.hypot(noise, left * of_black)


def _uneven(each: Floats, noise: Floats) -> float:
    """Relative error of the flat field: the difference of the two orders of bright strips, beyond
    noise and beyond what all strips have in common."""
    bright = (each.mean(axis=(0, 2)) > 0.2) & (np.arange(len(STRIP_LEVELS)) < len(STRIP_LEVELS) - 1)
    middle = each[:, bright].mean(axis=0)
    apart = ((each[0] - each[1])[bright] / middle).mean(axis=1)
    by_noise = float(np.mean((noise[:, bright] / middle) ** 2)) * 2.0 / each.shape[2]
    return float(np.sqrt(max(float(np.var(apart, ddof=1)) - by_noise, 0.0) / 2.0))


def _errors(light: Floats, noise: Floats, flat: float) -> Floats:
    """Standard deviations of scaled light, (17,): of the strip itself, and of the black and the
    white one that it is scaled by."""
    own = noise**2 + (flat * light) ** 2
    variance = own + light**2 * own[-1] + (1.0 - light) ** 2 * own[0]
    variance[[0, -1]] = 0.0
    return np.asarray(np.sqrt(variance / _ORDERS))


def _refuse(by_level: Floats, noise: Floats) -> None:
    """Raise CalibrationError where the strips are not those of the two orders."""
    mean = by_level.mean(axis=2)
    if float(np.median(noise)) > 0.02:
        raise CalibrationError(
            f"too dim: a strip is known to {100.0 * float(np.median(noise)):.2g} % of white only",
            device="camera",
            hint="open the aperture, or hold the picture for longer",
        )
    if float(np.ptp(mean)) < 0.1:
        raise CalibrationError(
            "all strips are equally bright: the panel does not show grey levels",
            device="projector",
            hint="see that this panel gets the picture, and that outputs are not swapped",
        )
    if float(mean[:, -1].mean()) < float(mean[:, 0].mean()):
        raise _inverted()
    bright = mean[0] > 0.3 * mean[0].max()
    scale = float(np.median(mean[1][bright] / mean[0][bright]))
    apart = np.abs(mean[1] / scale - mean[0])
    noisy = _FALLS_SIGMAS * np.sqrt(2.0) * float(noise.mean())
    if float(np.median(apart)) > _AGREE or np.mean(apart > _AGREE + noisy) > 0.2:
        raise CalibrationError(
            f"the two orders of strips disagree by {100.0 * float(apart.max()):.0f} % of white",
            device="projector",
            hint="the picture is mirrored or turned, out of focus, or not where the geometry has "
            "it: focus, and calibrate the geometry again",
        )
    if abs(scale - 1.0) > _DRIFT:
        raise CalibrationError(
            f"the lamp changed by {100.0 * (scale - 1.0):+.2g} % between the photos",
            device="projector",
            hint="let it warm up for half an hour; switch eco mode, automatic iris and dynamic "
            "contrast off",
        )
    _refuse_black(mean)


def _inverted() -> CalibrationError:
    return CalibrationError(
        "black is brighter than white: the panel is inverted",
        device="projector",
        hint="switch its inverted picture off; of a mask, turn a polariser by 90 degrees",
    )


def _refuse_black(mean: Floats) -> None:
    """Raise CalibrationError where black strips are bright."""
    share = float((mean[:, 0] / mean[:, -1]).mean())
    if share > _DARK:
        raise CalibrationError(
            f"black strips have {100.0 * share:.0f} % of the light of white ones",
            device="camera",
            hint="switch the room lights off; see that the panel's black is dark",
        )


def _refuse_shape(light: Floats, sigma: float) -> None:
    """Raise CalibrationError where levels do not rise from black to white."""
    limit = max(_FALLS_SIGMAS * sigma, 0.02)
    if np.any(np.diff(light) < -limit):
        at = int(np.argmin(np.diff(light)))
        raise CalibrationError(
            f"light falls from level {STRIP_LEVELS[at]} to level {STRIP_LEVELS[at + 1]}",
            device="projector",
            hint="switch dynamic contrast and picture modes off; see that the panel is not "
            "inverted",
        )
    between_ends = light[1:-1]
    if np.mean((between_ends < _STEPS[0]) | (between_ends > _STEPS[1])) > 0.9:
        raise CalibrationError(
            "the panel shows black and white only, no grey",
            device="projector",
            hint="a panel in a pattern mode of one bit has no grey levels: none are needed there",
        )


def _power(
    levels: Floats, by_level: Floats, noise: Floats, flat: float
) -> tuple[float, float, float]:
    """Gamma, its standard deviation and the largest misfit of ``black + span (level/255)^gamma``,
    with black and span free in both orders: (orders, levels)."""
    grey = levels / 255.0
    error = np.sqrt(noise**2 + (flat * by_level) ** 2 + 1e-10)

    def fitted(gamma: float) -> tuple[Floats, Floats]:
        """The law at its best black and span, (orders, levels), and the spans."""
        law, spans = np.empty_like(by_level), np.empty(_ORDERS)
        for n in range(_ORDERS):
            columns = np.stack([np.ones_like(grey), grey**gamma], axis=1)
            best = np.linalg.lstsq(columns / error[n][:, None], by_level[n] / error[n], rcond=None)
            law[n], spans[n] = columns @ best[0], best[0][1]
        return law, spans

    def misfits(log_gamma: float) -> float:
        return float(np.sum(((by_level - fitted(np.exp(log_gamma))[0]) / error) ** 2))

    found = minimize_scalar(misfits, bounds=np.log(_GAMMAS), method="bounded", options=_CLOSE)
    gamma = float(np.exp(found.x))
    law, spans = fitted(gamma)
    # How the best law moves with gamma, beyond what black and span can absorb.
    step = 1e-4
    slope = (fitted(gamma + step)[0] - fitted(gamma - step)[0]) / (2.0 * step)
    freedom = by_level.size - 1 - 2 * _ORDERS
    chi2 = max(float(found.fun) / freedom, 1.0)
    sigma = float(np.sqrt(chi2 / np.sum((slope / error) ** 2)))
    return gamma, sigma, float(np.abs((by_level - law).mean(axis=0)).max() / spans.mean())
