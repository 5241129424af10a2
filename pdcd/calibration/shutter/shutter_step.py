"""How late the shutter is, and how evenly: photos of a running bar in which it opens and closes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pdcd.bench.devices import ShutterTiming
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.preview import PLOT_BLUE, PLOT_RED, label_plot
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    ConfigValue,
    PhotoRequest,
    StepOutcome,
    StepScript,
    take_photo,
)
from pdcd.calibration.shown import make_still_sequence
from pdcd.calibration.shutter.bars import BarLight, make_bar_sequence, read_bar
from pdcd.calibration.shutter.blades import (
    ShutterLag,
    ShutterTimes,
    choose_bar_cells,
    estimate_shutter_lag,
    fit_shutter,
)
from pdcd.calibration.window import find_shared_window
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE

_PHOTOS = 5
_CELLS = (24, 29), (35, 40)
"""Cells of the bar, alternating: a shutter that is a whole cycle later than believed looks right
with one of them, but not with both."""
_EXPOSED_S = 0.75
"""Exposure of a photo, about: a cycle and a half of the bar."""
_LEAST_OPEN_S = 0.2
_BEFORE_S, _AFTER_S = 0.5, 1.5
"""The bar runs before the shutter is told to open, and after it should have closed: a camera may
take long to answer."""
_BANDS = 1, 6
_QUADS_A_BAND = 60
_UNSURE = 0.3
"""Relative error of rise and fall of the projector where they were not measured."""
_LAG_LIMIT_S = 0.3e-3
_APART = 3.0
"""Standard errors by which opening and closing must differ to count as two lags; also for rows."""


@dataclass
class _Times:
    """Results of all exposures, on the clock of the log, in s: (opened, closed) each.

    rows : first and last row of the field, 0 to 1 over the camera's. told : when the shutter was
        commanded.
    """

    rows: tuple[float, float]
    told: list[tuple[float, float]] = field(default_factory=list)
    found: list[ShutterTimes] = field(default_factory=list)

    def lag(self, sides: tuple[int, ...]) -> ShutterLag:
        """Lag of opening (0), of closing (1), or of both, in the row where it is longest."""
        rows = [
            (when[side], told[side], sigma[side])
            for told, one in zip(self.told, self.found, strict=True)
            for when in [(one.opened_s, one.closed_s)]
            for sigma in [(one.opened_sigma_s, one.closed_sigma_s)]
            for side in sides
        ]
        found, told, sigmas = zip(*rows, strict=True)
        lag = estimate_shutter_lag(found, told, sigmas)
        return replace(lag, lag_s=lag.lag_s + self._last_row_s)

    @property
    def _last_row_s(self) -> float:
        """How much longer the longest lag of any row is than that of the middle row.

        With a projector that is set row by row, the first row has all of the shutter's lag, because
        its light comes when the log says; light of the other rows comes later, so that their lag
        seems shorter. With blades that travel, it is the row that they reach last. Zero where the
        rows do not clearly differ.
        """
        travels = np.array([one.travel_s for one in self.found]).ravel()
        travel_s = float(travels.mean())
        sigma_s = float(travels.std(ddof=1)) / travels.size**0.5
        if abs(travel_s) < _APART * sigma_s:
            return 0.0
        return max(travel_s * (row - 0.5) for row in self.rows)

    def check(self, cells: list[int], refresh_s: float) -> None:
        """Raise CalibrationError where lags depend on the number of cells: they are then wrong by a
        cycle. cells : of each exposure."""
        late = np.array([one.opened_s for one in self.found]) - np.array(self.told)[:, 0]
        short = np.array(cells) == min(cells)
        apart_s = abs(float(late[short].mean() - late[~short].mean()))
        if apart_s > 0.5 * (max(cells) - min(cells)) * refresh_s:
            raise CalibrationError(
                "the shutter's lag is more than a quarter of a second off what is configured",
                device="shutter",
                hint="set trigger.lag_s to what pdcd doctor trigger --click shows, and repeat this",
            )

    @property
    def sigma_s(self) -> float:
        """Standard deviation of one time, the largest."""
        return max(max(one.opened_sigma_s, one.closed_sigma_s) for one in self.found)


def calibrate_shutter(session: CalibrationSession) -> StepScript:
    """White, white with a black projector, and five exposures that begin and end while a bar runs:
    seven photos.

    The lag counts from when the driver says that it gave its command, as ``trigger.lag_s`` does, to
    the row that responds last. Raises CalibrationError as `read_bar` and `fit_shutter` do, and for
    a lag that is far from the configured one.
    """
    projector, camera = session.found("projector"), session.found("camera")
    window = find_shared_window(session.found("mask"), camera)
    trigger, refresh_s = session.config.trigger, session.refresh_s
    sure_s = trigger.sure_ns * 1e-9
    open_s = max(_EXPOSED_S - sure_s, _LEAST_OPEN_S)
    counts = [choose_bar_cells(sure_s + open_s, refresh_s, cells) for cells in _CELLS]
    cells = [counts[number % 2] for number in range(_PHOTOS)]
    before = round(_BEFORE_S / refresh_s)
    count = before + round((2.0 * sure_s + open_s + _AFTER_S) / refresh_s)
    taken = yield from take_photo(
        PhotoRequest(make_still_sequence("white", session.full, WHITE, WHITE))
    )
    white = session.photo(taken)
    taken = yield from take_photo(
        PhotoRequest(make_still_sequence("room", session.full, BLACK, WHITE))
    )
    room = session.photo(taken)
    bands = int(np.clip(camera.size_px[1] // _QUADS_A_BAND, *_BANDS))
    panel = session.config.projector
    ends = camera.from_field(np.array([[0.5, 0.0], [0.5, 1.0]]))[:, 1] / camera.size_px[1]
    times, light = _Times((float(ends[0]), float(ends[1]))), None
    for number in range(_PHOTOS):
        shown = make_bar_sequence(
            f"bar-{number + 1}", projector, count, cells=cells[number], window=window
        )
        taken = yield from take_photo(PhotoRequest(shown, moving=ShutterTiming(before, open_s)))
        light = read_bar(
            session.photo(taken), white, camera,
            cells=cells[number], bands=bands, window=window, room=room,
        )  # fmt: skip
        told = _told_s(taken, sure_s)
        times.told.append(told)
        times.found.append(
            fit_shutter(
                light,
                taken.log,
                (told[0] + trigger.lag_s, told[1] + trigger.lag_s),
                (panel.rise_s, panel.fall_s),
                tau_sigma=_tau_sigma(session),
            )
        )
    times.check(cells, refresh_s)
    return _outcome(session, times, light)


def _told_s(taken: CalibrationPhoto, sure_s: float) -> tuple[float, float]:
    """When the shutter was told to open, and to close."""
    return taken.open_ns * 1e-9 - sure_s, taken.close_ns * 1e-9 - sure_s


def _tau_sigma(session: CalibrationSession) -> float:
    """Relative standard deviation of the projector's rise and fall, the larger one."""
    taus, sigmas = (session.arrays.get(f"timing.{name}") for name in ("taus_s", "taus_sigma_s"))
    if taus is None or sigmas is None:
        return _UNSURE
    return float((sigmas[:2] / taus[:2]).max())


def _outcome(session: CalibrationSession, times: _Times, light: BarLight | None) -> StepOutcome:
    """Both lags as one where they do not differ; the longer one where they do."""
    opening, closing, both = times.lag((0,)), times.lag((1,)), times.lag((0, 1))
    advice = []
    apart_s = abs(opening.lag_s - closing.lag_s)
    if apart_s > _APART * float(np.hypot(opening.sigma_s, closing.sigma_s)) + _LAG_LIMIT_S:
        both = max(opening, closing, key=lambda one: one.lag_s)
        advice.append(
            f"the shutter takes {1e3 * opening.lag_s:.1f} ms to open and "
            f"{1e3 * closing.lag_s:.1f} ms to close: trigger.lag_s is the longer of both"
        )
    if "timing.taus_s" not in session.arrays:
        advice.append("rise and fall of the projector are not measured: run timing, then shutter")
    jitter_s = max(both.jitter_s, times.sigma_s)
    samples = 2 * len(times.found)
    good = times.sigma_s < _LAG_LIMIT_S
    travel_s = np.mean([one.travel_s for one in times.found], axis=0)
    figures = (
        MeasuredFigure(
            "trigger.lag_s", both.lag_s, both.sigma_s, "s", "each exposure known to 0.3 ms",
            Verdict.GOOD if good else Verdict.DOUBTFUL,
        ),
        MeasuredFigure("trigger.jitter_s", jitter_s, jitter_s / (2.0 * samples - 2.0) ** 0.5, "s"),
        MeasuredFigure("shutter.opening_s", opening.lag_s, opening.sigma_s, "s"),
        MeasuredFigure("shutter.closing_s", closing.lag_s, closing.sigma_s, "s"),
        MeasuredFigure("shutter.travel_opening_s", float(travel_s[0]), 0.0, "s"),
        MeasuredFigure("shutter.travel_closing_s", float(travel_s[1]), 0.0, "s"),
        MeasuredFigure("shutter.chi2", max(one.chi2 for one in times.found), 0.0, "", "below 3"),
    )  # fmt: skip
    return StepOutcome(
        figures=figures,
        words={
            "trigger.lag_s": ConfigValue(max(both.lag_s, 0.0), both.sigma_s),
            "trigger.jitter_s": ConfigValue(jitter_s, figures[1].sigma),
        },
        advice=tuple(advice),
        picture=lambda figure: _draw(figure, times, light),
    )


def _draw(figure: Any, times: _Times, light: BarLight | None) -> None:
    """Left: lag of each exposure, opening and closing. Right: the cells of the last bar."""
    left, right = figure.subplots(1, 2)
    found = np.array([(one.opened_s, one.closed_s) for one in times.found])
    lags = 1e3 * (found - np.array(times.told))
    number = np.arange(1, len(lags) + 1)
    left.plot(number, lags[:, 0], "o-", color=PLOT_BLUE, label="opening")
    left.plot(number, lags[:, 1], "s--", color=PLOT_RED, label="closing")
    left.set_xticks(number)
    left.legend()
    label_plot(left, "Lag of the shutter, exposure by exposure", "exposure", "lag in ms")
    if light is not None:
        value = light.value.mean(axis=0)
        right.plot(np.arange(value.size) + 0.5, value, "o-", color=PLOT_BLUE)
        right.set_ylim(bottom=0.0)
        label_plot(right, "The bar in the last photo", "cell", "light over white")
