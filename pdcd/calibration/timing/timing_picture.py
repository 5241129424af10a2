"""The picture of the timing step: what strips gave against what the times explain, lag by row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pdcd.calibration.preview import BLUE, GREEN, GREY, RED, label
from pdcd.calibration.timing.lag import Timing
from pdcd.calibration.timing.programmes import PULSES, TRAINS, Programme
from pdcd.calibration.timing.strips import Readings
from pdcd.calibration.timing.timing_model import Model, Ran, Times

Strip = tuple[Programme, float, float]
"""What it was asked for, its light over white, and what the times make of it."""
KINDS = (((1, 1), BLUE), ((2, 1), RED), ((1, 2), GREEN))
"""Refreshes that projector and mask are white, and the colour of such pulses."""


def draw_timing(
    figure: Any, found: Timing, readings: Sequence[Readings], ran: Sequence[Ran]
) -> None:
    """Light of the strips in the middle of the field and what the times make of it: of single
    pulses by the mask's delay, and of trains one by one. The lag of each band, with three sigmas,
    and the line through them."""
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
    axes = figure.subplot_mosaic("PL;TT")
    _draw_pulses(axes["P"], [strip for strip in strips if strip[0] in PULSES], found.chi2)
    _draw_lags(axes["L"], found)
    _draw_trains(axes["T"], [strip for strip in strips if strip[0] in TRAINS])


def _draw_pulses(axes: Any, strips: Sequence[Strip], chi2: float) -> None:
    for kind, colour in KINDS:
        own = [strip for strip in strips if PULSES[strip[0]][0] == kind]
        own.sort(key=lambda strip: PULSES[strip[0]][1])
        delays = [PULSES[programme][1] for programme, _, _ in own]
        axes.plot(delays, [fitted for _, _, fitted in own], color=GREY)
        name = "lit {}, open {}".format(*kind)
        axes.plot(delays, [light for _, light, _ in own], "o", color=colour, label=name)
    axes.legend(fontsize=8)
    label(
        axes, f"Single pulses in the middle of the field, reduced chi^2 of all {chi2:.2f}",
        "mask later than projector, as sent, in refreshes", "light over white",
    )  # fmt: skip


def _draw_trains(axes: Any, strips: Sequence[Strip]) -> None:
    trains = list(dict.fromkeys(programme for programme, _, _ in strips))
    trains.sort(key=lambda programme: (programme.lit, programme.opened))
    at = [trains.index(programme) for programme, _, _ in strips]
    axes.plot(at, [fitted for _, _, fitted in strips], "_", color=GREY, markersize=16)
    axes.plot(at, [light for _, light, _ in strips], "o", color=BLUE)
    axes.set_xticks(range(len(trains)), [f"{one.lit}|{one.opened}" for one in trains], fontsize=7)
    label(
        axes, "Trains of pulses in the middle of the field",
        "refreshes for which projector|mask are white; a grey line is what the times make of it",
        "light over white",
    )  # fmt: skip


def _draw_lags(axes: Any, found: Timing) -> None:
    ends = np.array([0.0, 1.0])
    axes.plot(ends, 1e3 * (found.line_s[0] + found.line_s[1] * ends), color=GREY)
    axes.errorbar(found.bands, 1e3 * found.lag_s, 3e3 * found.lag_sigma_s, fmt="o", color=BLUE)
    label(axes, "Lag of the mask by row", "field, top to bottom", "ms")
