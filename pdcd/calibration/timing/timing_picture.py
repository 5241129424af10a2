"""The picture of the timing step: what strips gave against what the times explain, lag by row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.charts import BLUE, GREEN, GREY, RED, Chart, sheet
from pdcd.calibration.timing.lag import Timing
from pdcd.calibration.timing.programmes import PULSES, TRAINS, Programme
from pdcd.calibration.timing.strips import Readings
from pdcd.calibration.timing.timing_model import Model, Ran, Times

Strip = tuple[Programme, float, float]
"""What it was asked for, its light over white, and what the times make of it."""
KINDS = (((1, 1), BLUE), ((2, 1), RED), ((1, 2), GREEN))
"""Refreshes that projector and mask are white, and the colour of such pulses."""


def picture(found: Timing, readings: Sequence[Readings], ran: Sequence[Ran]) -> NDArray[np.uint8]:
    """Light of the strips in the middle of the field and what the times make of it: of single
    pulses by the mask's delay, and of trains one by one. The lag of each band, with three sigmas,
    and the line through them."""
    drawn = sheet(1000, 800)
    model = Model(readings, ran, found.refresh_s)
    times = Times(found.taus_s, found.leaks, found.lag_s, found.tail, found.across_s)
    model.correct(times)
    past = np.stack([reading.past for reading in readings])
    shape = found.scale[..., None] * model.shape(times) + found.stray[..., None] * past
    middle = found.bands.size // 2
    strips = [
        (programme, float(reading.value[middle, k]), float(fitted[middle, k]))
        for reading, fitted in zip(readings, shape, strict=True)
        for k, programme in enumerate(reading.projector)
    ]
    _pulses(drawn, [strip for strip in strips if strip[0] in PULSES], found.chi2)
    _lags(drawn, found)
    _trains(drawn, [strip for strip in strips if strip[0] in TRAINS])
    return drawn


def _pulses(drawn: NDArray[np.uint8], strips: Sequence[Strip], chi2: float) -> None:
    highest = max((light for _, light, _ in strips), default=1.0)
    chart = Chart(drawn, (0, 0, 560, 500), (-3.5, 2.5), (0.0, 1.1 * highest))
    chart.frame(
        f"Single pulses in the middle of the field, reduced chi^2 of all {chi2:.2f}",
        "mask later than projector, as sent, in refreshes",
        "light over white",
        ticks=7,
    )
    for kind, colour in KINDS:
        own = [strip for strip in strips if PULSES[strip[0]][0] == kind]
        own.sort(key=lambda strip: PULSES[strip[0]][1])
        delays = [PULSES[programme][1] for programme, _, _ in own]
        chart.line(delays, [fitted for _, _, fitted in own], GREY)
        chart.points(delays, [light for _, light, _ in own], colour)
    chart.legend([(f"lit {p}, open {m}", colour) for (p, m), colour in KINDS])


def _trains(drawn: NDArray[np.uint8], strips: Sequence[Strip]) -> None:
    trains = list(dict.fromkeys(programme for programme, _, _ in strips))
    trains.sort(key=lambda programme: (programme.lit, programme.opened))
    highest = max((light for _, light, _ in strips), default=1.0)
    names = [f"{programme.lit}|{programme.opened}" for programme in trains]
    chart = Chart(drawn, (0, 500, 1000, 300), (0.4, len(trains) + 0.6), (0.0, 1.1 * highest))
    chart.frame(
        "Trains of pulses in the middle of the field",
        "refreshes for which projector|mask are white; a grey line is what the times make of it",
        "light over white",
        columns=names,
    )
    for programme, light, fitted in strips:
        at = trains.index(programme) + 1.0
        chart.line([at - 0.3, at + 0.3], [fitted, fitted], GREY)
        chart.points([at], [light], BLUE)


def _lags(drawn: NDArray[np.uint8], found: Timing) -> None:
    lags = 1e3 * found.lag_s
    spread = max(float(np.ptp(lags)), 0.5)
    middle = float(lags.mean())
    right = Chart(drawn, (560, 0, 440, 500), (0.0, 1.0), (middle - spread, middle + spread))
    right.frame("Lag of the mask by row", "field, top to bottom", "ms")
    ends = np.array([0.0, 1.0])
    right.line(ends, 1e3 * (found.line_s[0] + found.line_s[1] * ends), GREY)
    right.bars(found.bands, lags, 3e3 * found.lag_sigma_s, BLUE)
    right.points(found.bands, lags, BLUE)
