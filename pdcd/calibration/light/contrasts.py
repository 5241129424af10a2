"""Contrasts of both panels, light of the room, and how bright one unit is.

A photo is named by what the projector and the mask show: WW, WB, BW, BB. Panels leak: a black
projector gives delta, a black mask lets through eps, of their full light. With L the light that a
white projector sends through an open mask in a second, A L that of the room, and D the time for
which the projector was white::

    WW - BW = (1 - delta) L D           WB - BB = eps (1 - delta) L D
    BW - C  = delta L M                 C = A L M

C is BW with the projector covered, M the time for which the mask was open. Differences take out
the black level of the sensor where it is the same in both photos; what is left of it is the largest
error, which is why all but WW last eight times as long. The mask opens before the projector's
light and closes after it, so that D and M are whole refreshes plus ``fall - rise`` of one panel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.figures import ROOM_GOOD, MeasuredFigure, Verdict
from pdcd.calibration.light.end_levels import EndLevels, measure_end_levels
from pdcd.calibration.light.light_plan import LightPlan, PulseEdges
from pdcd.calibration.light.light_series import LightSeries, LitMeans, make_light_series
from pdcd.calibration.photo import BlockMeans
from pdcd.errors import CalibrationError

_LAMP_GOOD = 0.01
_CONTRAST_LIMITS = {"projector": (500.0, 100.0), "mask": (200.0, 50.0)}
"""White over black from which a panel is good, and below which it is bad."""
_SEEN_SIGMAS = 3.0
_ROOM_MIDDLE = 0.2
"""Of the lit part's width and height: where the room's light is taken. Towards the corners a
projector's white is darker, and with it the unit of light; the room is not."""


@dataclass(frozen=True)
class _Share:
    """A share of white light, of all channels together, and its standard deviation."""

    value: float
    sigma: float

    @property
    def seen(self) -> bool:
        """Whether it clearly exceeds its error."""
        return self.value > _SEEN_SIGMAS * self.sigma

    @property
    def contrast(self) -> tuple[float, float]:
        """White over black and its standard deviation; where black is not seen, a lower limit with
        no deviation."""
        if not self.seen:
            return 1.0 / (max(self.value, 0.0) + _SEEN_SIGMAS * self.sigma), 0.0
        return 1.0 / self.value, self.sigma / self.value**2


@dataclass(frozen=True, eq=False)
class LightMeasurement:
    """What was measured.

    projector, mask : black over white: 1 / contrast of the configuration's tables.
    room : light of the room over the projector's white, on the card; None without a covered photo,
        and `projector` then includes it.
    mask_map : (rows, cols) black over white of the mask by blocks of 16 quads, NaN in the dark.
    rate : (C,) light of a white projector, units of the photos a second, where it is brightest.
    rate_sigma : relative, from the panels' edges and the photos' noise; without the lamp's drift.
    lamp, lamp_sigma : WW-again over WW, less 1, and its standard deviation.
    ends : light of levels next to black and white; empty where they were not shown.
    """

    projector: _Share
    mask: _Share
    room: _Share | None
    mask_map: Floats
    rate: Floats
    rate_sigma: float
    lamp: float
    lamp_sigma: float
    ends: tuple[EndLevels, ...] = ()

    def ambient(self, albedo: float) -> tuple[float, float] | None:
        """`scene.ambient` and its standard deviation: the room's light in scene units, that is over
        a perfect white under a white projector, on a card of that albedo."""
        if self.room is None:
            return None
        return self.room.value * albedo, self.room.sigma * albedo

    def figures(self, albedo: float = 1.0) -> tuple[MeasuredFigure, ...]:
        """The figures of this measurement."""
        found = [
            _contrast("projector", self.projector, self.room is None),
            _contrast("mask", self.mask, False),
            MeasuredFigure(
                "light.lamp_change",
                self.lamp,
                self.lamp_sigma,
                "",
                f"within {_LAMP_GOOD:g}",
                Verdict.GOOD if abs(self.lamp) <= _LAMP_GOOD else Verdict.DOUBTFUL,
            ),
        ]
        ambient = self.ambient(albedo)
        if ambient is not None and self.room is not None:
            good = self.room.value <= ROOM_GOOD
            found.append(
                MeasuredFigure(
                    "scene.ambient",
                    *ambient,
                    "scene units",
                    f"{ROOM_GOOD:g} of white",
                    Verdict.GOOD if good else Verdict.DOUBTFUL,
                )
            )
        return (*found, *(figure for one in self.ends for figure in one.figures()))


def _contrast(panel: str, share: _Share, with_room: bool) -> MeasuredFigure:
    value, sigma = share.contrast
    good, bad = _CONTRAST_LIMITS[panel]
    verdict = Verdict.GOOD if value >= good else Verdict.DOUBTFUL
    if value < bad:
        verdict = Verdict.BAD
    limit = f"{good:g} or more"
    if not share.seen:
        limit = "at least this: its black cannot be seen"
    if with_room:  # without it the contrast is higher: what is good is good
        verdict, limit = min(verdict, Verdict.DOUBTFUL), f"{good:g} or more; the room is in it"
    return MeasuredFigure(f"{panel}.contrast", value, sigma, "", limit, verdict)


def measure_light(
    photos: Mapping[str, BlockMeans],
    plan: LightPlan,
    *,
    edges: PulseEdges,
    black_sigma: float,
    field: NDArray[np.bool_] | None = None,
) -> LightMeasurement:
    """Contrasts and room light out of a series.

    Parameters
    ----------
    photos : by the names of `plan.photos()`, all of one aperture and ISO, by blocks of 16 quads;
        those of `light_plan.COVERED` and of `plan.levels` may be missing.
    plan : what was shown. edges : of the panels.
    black_sigma : standard deviation of one photo's black level, in the units of the photos: 0.3 DN
        by a number of the file, less by its masked border.
    field : (h, w) where the projector's picture lies, where that is known: it must be lit.

    Raises CalibrationError: no light, a shutter that did not open, saturated, too dim, room lights,
    light that changed, a mask or a projector that does not block.
    """
    series = make_light_series(photos, plan, edges, black_sigma, field)
    mask = _mask(series)
    room = _room(series, mask.value)
    projector = _projector(series, mask.value)
    series.refuse_room(projector.value + (0.0 if room is None else room.value))
    brightest, noise = series.brightest()
    return LightMeasurement(
        projector=projector,
        mask=mask,
        room=room,
        mask_map=series.mask_map,
        rate=np.asarray(brightest / series.lit_s / (1.0 - projector.value)),
        rate_sigma=float(np.hypot(series.edge_error, noise)),
        lamp=series.lamp,
        lamp_sigma=float(np.sqrt(2.0) * np.hypot(black_sigma, series.whole.sigma[-1]))
        / float(series.whole.mean[-1]),
        ends=measure_end_levels(series, photos, mask.value),
    )


def _mask(series: LightSeries) -> _Share:
    """eps = (WB - BB) / (WW - BW), each over the time of its light."""
    through, white = series.through, series.whole
    times = series.lit_s / series.lit_long_s
    ratio = times * through.mean / white.mean
    black = np.hypot(series.black_sigma / np.sqrt(2.0), series.black_sigma)
    return _share(series, ratio, times * np.hypot(black, through.sigma), white)


def _projector(series: LightSeries, eps: float) -> _Share:
    """delta of (BW - C) / M = delta L, or with the room's light of (BW - BB) / M."""
    left, white = series.left, series.whole
    times = series.lit_s / series.open_long_s
    ratio = times * left.mean / white.mean
    if series.covered is None:
        ratio = ratio / (1.0 - eps)
    error = series.black_sigma * np.sqrt(0.5 + (1.0 if series.covered is None else 0.5))
    return _share(series, ratio / (1.0 + ratio), times * np.hypot(error, left.sigma), white)


def _room(whole: LightSeries, eps: float) -> _Share | None:
    """A of (C - BB) / M = A L; a black mask hardly dims it. None where nothing was covered."""
    series = replace(whole, lit=whole.middle(_ROOM_MIDDLE))
    covered, white = series.covered, series.whole
    if covered is None:
        return None
    delta = _projector(series, eps).value
    times = series.lit_s / series.open_long_s
    ratio = (times * covered.mean / white.mean * (1.0 - delta) + eps * delta) / (1.0 - eps)
    error = series.black_sigma * np.sqrt(1.5)
    return _share(series, ratio, times * np.hypot(error, covered.sigma), white)


def _share(series: LightSeries, ratio: Floats, error: Floats, white: LitMeans) -> _Share:
    """The share of all colours together. error : in units of the photos, common to all quads;
    errors that scale every share alike are added."""
    value = float(ratio[-1])
    scale = np.hypot(series.edge_error, abs(series.lamp) / 2.0)
    sigma = float(np.hypot(error[-1] / white.mean[-1], value * scale))
    return _Share(value, sigma)


def compute_responsivity(
    light: LightMeasurement,
    *,
    gain_e_per_dn: tuple[float, float],
    f_number: float,
    albedo: Floats | float,
    albedo_sigma: float,
) -> tuple[Floats, Floats]:
    """`camera.responsivity_e` and its standard deviation, (C,) float64 each.

    Electrons a second at f/1 of what a perfect white gives under a white projector, in the scene's
    plane where that is brightest: ``gain rate N^2 / albedo``.

    Parameters
    ----------
    light : of photos in DN.
    gain_e_per_dn : and its standard deviation.
    f_number : of the stop that was set, by its light (`pdcd.bench.stops.Stop.true`).
    albedo, albedo_sigma : of the card, one or (C,): 0.99 for Spectralon, 0.85 to 0.9 for paper.

    Raises CalibrationError for an albedo that no card has.
    """
    reflects = np.broadcast_to(np.asarray(albedo, np.float64), light.rate.shape)
    if not np.all((reflects > 0.05) & (reflects <= 1.0)):
        raise CalibrationError(
            f"the card's albedo of {albedo} is not between 0.05 and 1",
            device="camera",
            hint="give what the card's maker says; 0.88 for white paper",
        )
    value = gain_e_per_dn[0] * light.rate * f_number**2 / reflects
    relative = np.sqrt(
        (gain_e_per_dn[1] / gain_e_per_dn[0]) ** 2
        + light.rate_sigma**2
        + (0.5 * light.lamp) ** 2
        + (albedo_sigma / reflects) ** 2
    )
    return np.asarray(value), np.asarray(value * relative)
