"""When light really comes: lag of the mask by rows, rise and fall of both panels.

Photos of strips (`timing.programmes`), read band by band (`timing.strips`), are fitted by pulses in
closed form. There are three rounds: the second and third take from the fit so far how exposures
begin and end, the lag's slope within a band, and the strips' errors in addition to noise.

Only differences show: a delay that both panels share changes nothing, and of two panels that are
set row by row only the mask's time minus the projector's at the same place is found. The least
certain direction is a later mask against a slower projector, (0.62, 0.55, 0.55) of lag, rise and
fall; the light that a schedule lets through hardly depends on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.figures import ROOM_GOOD, MeasuredFigure, Verdict
from pdcd.calibration.timing.programmes import COARSE
from pdcd.calibration.timing.strips import StripReadings
from pdcd.calibration.timing.timing_faults import (
    PEAK,
    STRAY,
    check_panel_speed,
    check_reference_strips,
    check_timing_fit,
    explain_misfit,
    make_room_light_error,
    measure_room_light,
)
from pdcd.calibration.timing.timing_fit import FittedTiming, TimingFitter
from pdcd.calibration.timing.timing_model import COMMON_PARAMETERS, TAUS, PhotoLog, StripModel, Tail
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from pdcd.probing.pulses import CodeSeparation, PanelResponse, compute_code_separation
from pdcd.words import ScheduleName

_ROUNDS = 3
_CHI2 = 2.0
"""Largest reduced chi^2 of a fit that is good."""
_MENDS = 0.7
"""Largest share of chi^2 that a second response may leave to be accepted."""
_STEEP_S = 2e-4
"""Change of the lag over a band from which it is also modelled within bands."""
_LAG_LIMIT_S = 0.15e-3
_TAU_LIMIT = 0.06


@dataclass(frozen=True, eq=False)
class MeasuredTiming:
    """The result. All times in s; sigma is one standard deviation.

    bands : (B,) middle of each band on the field, y from 0 to 1.
    lag_s, lag_sigma_s : (B,) delay of the mask's light behind the projector's, in addition to what
        the frame log says, in the middle of the rows; positive: the mask comes later.
    across_s : growth of the lag from x = 0 to x = 1.
    line_s : lag at y = 0, and its growth to y = 1. line_covariance : (2, 2).
    taus_s, taus_sigma_s : (4,) rise and fall of the projector, then of the mask.
    leaks : (2,) over white: light on the mask other than the projector's white (leak and ambient
        light), in addition to what the room's photo showed at each place; and what the mask's black
        lets through. room : what that photo showed, median over the places.
    tail : a second, slower response of one panel, where one was needed.
    chi2 : reduced, of the whole fit. causes : possible reasons, where it is too large.
    light : (photos, B, K) light of the strips by the fit.
    apart_s : how much later the mask was sent its rows, according to the log.
    """

    bands: Floats
    lag_s: Floats
    lag_sigma_s: Floats
    across_s: float
    line_s: tuple[float, float]
    line_covariance: Floats
    taus_s: Floats
    taus_sigma_s: Floats
    leaks: Floats
    room: float
    tail: Tail | None
    chi2: float
    causes: tuple[str, ...]
    light: Floats
    apart_s: float
    refresh_s: float
    answers: tuple[PanelResponse, PanelResponse]

    @property
    def beside_s(self) -> float:
        """Largest distance of a band's lag from the line through all."""
        line = self.line_s[0] + self.line_s[1] * self.bands
        return float(np.abs(self.lag_s - line).max())

    @property
    def noise_over_limit(self) -> float:
        """Standard deviation of the least certain time, over the limit of a good one; 0 where
        strips have errors beyond their noise, which more photos would not reduce."""
        if self.tail is not None or self.chi2 > _CHI2:
            return 0.0
        taus = (self.taus_sigma_s / (_TAU_LIMIT * self.taus_s)).max()
        return float(max(taus, (self.lag_sigma_s / _LAG_LIMIT_S).max()))

    @property
    def delay_refreshes(self) -> int:
        """What to add to ``display.mask_delay_refreshes`` so that less than half a refresh of lag
        remains in the middle of the field."""
        middle = self.line_s[0] + 0.5 * self.line_s[1]
        return -round((self.apart_s + middle) / self.refresh_s)

    def kept(self, schedule: ScheduleName, late_s: float) -> CodeSeparation:
        """What a schedule lets through at a lag `late_s`, which includes that of the log."""
        return compute_code_separation(schedule, *self.answers, late_s, self.refresh_s)

    def panel_words(self, mask: Map) -> tuple[float, float]:
        """``skew_s`` and ``scan_s`` of [mask] in the configuration, the whole lag attributed to the
        mask: delay of the row that comes first, and time from its first row to its last.

        mask : its map; on a mask that is mounted upside down the lag grows the other way.
        """
        width, height = mask.size_px
        ends = mask.to_field(np.array([[0.5 * width, 0.5], [0.5 * width, height - 0.5]]))[:, 1]
        first, last = (self.line_s[0] + self.line_s[1] * float(y) for y in ends)
        return min(first, last), last - first

    def figures(self) -> list[MeasuredFigure]:
        """The figures of the fit, with limits and verdicts. A lag of more than half a refresh is no
        fault, because it is compensated."""
        found = []
        for name, value, sigma in zip(TAUS, self.taus_s, self.taus_sigma_s, strict=True):
            good = sigma < _TAU_LIMIT * value
            verdict = Verdict.GOOD if good else Verdict.DOUBTFUL
            found.append(
                MeasuredFigure(name, float(value), float(sigma), "s", "known to 6 %", verdict)
            )
        at = np.array([1.0, 0.5])
        middle, sigma = float(at @ self.line_s), float(np.sqrt(at @ self.line_covariance @ at))
        known = bool((self.lag_sigma_s < _LAG_LIMIT_S).all())
        found += [
            MeasuredFigure(
                "mask.skew_s", middle, sigma, "s", "each band known to 0.15 ms",
                Verdict.GOOD if known else Verdict.DOUBTFUL,
            ),
            MeasuredFigure(
                "mask.scan_s", self.line_s[1], float(np.sqrt(self.line_covariance[1, 1])), "s",
                "each band within 0.15 ms of a line",
                Verdict.GOOD if self.beside_s < _LAG_LIMIT_S else Verdict.DOUBTFUL,
            ),
            MeasuredFigure(
                "timing.chi2", self.chi2, 0.0, "", f"below {_CHI2:g}, without a second answer",
                Verdict.DOUBTFUL if self.tail is not None or self.chi2 > _CHI2 else Verdict.GOOD,
            ),
            MeasuredFigure(
                "timing.room", self.room, 0.0, "of white", f"at most {ROOM_GOOD:g}",
                Verdict.GOOD if self.room <= ROOM_GOOD else Verdict.DOUBTFUL,
            ),
        ]  # fmt: skip
        return found


def fit_timing(
    readings: Sequence[StripReadings], ran: Sequence[PhotoLog], refresh_s: float
) -> MeasuredTiming:
    """Times of both panels, from one photo or more.

    Parameters
    ----------
    readings : of each photo, of the same bands. ran : what the display did in each.
    refresh_s : of both panels.

    Raises CalibrationError: room light, panels that do not respond as first-order panels do, or
    strips that do not pulse.
    """
    check_reference_strips(readings)
    model, found = _fitted(readings, ran, refresh_s)
    if found.chi2 > _CHI2:
        check_panel_speed(found)
        model, found = _with_tail(model, found)
    check_panel_speed(found)
    check_timing_fit(readings, found)
    if float(np.abs(found.stray).max()) > STRAY:
        raise make_room_light_error(float(np.abs(found.stray).max()))
    return _timing(model, found)


def find_coarse_delay(reading: StripReadings) -> int:
    """What to add to ``display.mask_delay_refreshes``, from a photo of the programmes `COARSE`:
    whole refreshes, for a mask that is up to 12 of them early or late.

    Raises CalibrationError where hardly any light gets through at any delay.
    """
    if set(reading.programmes) != set(COARSE):
        raise ValueError("not the coarse programmes")
    delays = np.array([COARSE[p] for p in reading.programmes])
    level = np.median(reading.value, axis=0)
    floor = float(np.median(level))
    net = np.maximum(level - floor, 0.0)
    best = int(np.argmax(net))
    if net[best] < PEAK:
        raise CalibrationError(
            f"at no delay of the mask does more than {100.0 * net[best]:.1f} % of the light get "
            "through",
            device="display",
            hint="both panels must be 1:1, and show what they are sent at every refresh",
        )
    # Centre of the triangle of the pulse that gets through best and its neighbours.
    angle = 2.0j * np.pi * (delays - delays[best]) / delays.size
    near = np.abs((delays - delays[best] + 12) % 24 - 12) <= 2
    shift = np.angle(np.sum(net[near] * np.exp(angle[near]))) * delays.size / (2.0 * np.pi)
    delay = round(float(delays[best] + shift))
    return (delay + 12) % 24 - 12


def _fitted(
    readings: Sequence[StripReadings], ran: Sequence[PhotoLog], refresh_s: float
) -> tuple[StripModel, FittedTiming]:
    model = StripModel(readings, ran, refresh_s)
    fit = TimingFitter(model)
    found = min((fit.solve(start) for start in fit.starts()), key=lambda f: f.chi2)
    for _ in range(_ROUNDS - 1):
        found = _again(model, found)
    return model, found


def _again(model: StripModel, found: FittedTiming) -> FittedTiming:
    """Another round, which uses the times of the last one."""
    _, slope = _line(model, found)[0]
    model.slope_s = slope if abs(slope) * model.height > _STEEP_S else 0.0
    model.correct(found.times)
    return TimingFitter(model, found.floors).solve(found.times)


def _with_tail(model: StripModel, found: FittedTiming) -> tuple[StripModel, FittedTiming]:
    """The better of the fits with a second response of either panel; `found` where neither improves
    it enough."""
    best = found
    for mask in (True, False):
        fitted = TimingFitter(model, found.floors).solve(found.times, tail=mask)
        if fitted.chi2 < min(_MENDS * found.chi2, best.chi2):
            best = fitted
    if best is found:
        return model, found
    model.correct(best.times)
    again = TimingFitter(model, best.floors).solve(best.times)
    return model, again


def _line(model: StripModel, found: FittedTiming) -> tuple[tuple[float, float], Floats]:
    """`fit_lag_line` for a fit."""
    bands = model.readings[0].bands
    part = slice(COMMON_PARAMETERS, COMMON_PARAMETERS + bands.size)
    covariance = found.covariance[part, part] * model.refresh_s**2
    return fit_lag_line(bands, found.times.lags_s, covariance)


def fit_lag_line(
    bands: Floats, lags_s: Floats, covariance: Floats
) -> tuple[tuple[float, float], Floats]:
    """Lag over y as a straight line: value at 0 and slope, and their covariance.

    bands, lags_s : (B,). covariance : (B, B), of the lags.
    """
    if bands.size == 1:
        return (float(lags_s[0]), 0.0), np.diag([float(covariance[0, 0]), 0.0])
    # All bands have equal weight. With weights by the covariance the line could lie outside of all
    # lags where these share most of their error (times that trade off against the lag) and are not
    # on a straight line.
    design = np.stack([np.ones(bands.size), bands], axis=1)
    solve = np.linalg.pinv(design)
    line, spread = solve @ lags_s, solve @ covariance @ solve.T
    return (float(line[0]), float(line[1])), spread


def _timing(model: StripModel, found: FittedTiming) -> MeasuredTiming:
    line, spread = _line(model, found)
    bands = model.readings[0].bands
    sigma = np.sqrt(np.diag(found.covariance))
    times = found.times
    return MeasuredTiming(
        bands=bands,
        lag_s=times.lags_s,
        lag_sigma_s=sigma[COMMON_PARAMETERS : COMMON_PARAMETERS + bands.size] * model.refresh_s,
        across_s=times.across_s,
        line_s=line,
        line_covariance=spread,
        taus_s=times.taus_s,
        taus_sigma_s=times.taus_s * sigma[:4],
        leaks=times.leaks,
        room=measure_room_light(model.readings[0]),
        tail=times.tail,
        chi2=found.chi2,
        causes=explain_misfit(model.readings, found) if found.chi2 > _CHI2 else (),
        light=found.light,
        apart_s=model.apart_s,
        refresh_s=model.refresh_s,
        answers=times.answers,
    )
