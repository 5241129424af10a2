"""The picture of the timing step: what strips gave against what the times explain, lag by row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.charts import BLUE, GREEN, GREY, RED, Chart, sheet
from pdcd.calibration.strips import Readings
from pdcd.calibration.timing import Timing
from pdcd.calibration.timing_model import Model, Ran, Times

KINDS = (((1, 1), BLUE), ((2, 1), RED), ((1, 2), GREEN))
"""Refreshes that projector and mask are white, and the colour of such strips."""


def picture(found: Timing, readings: Sequence[Readings], ran: Sequence[Ran]) -> NDArray[np.uint8]:
    """Left: light of the strips in the middle of the field by the mask's delay, and the fit through
    it. Right: the lag of each band, with three sigmas, and the line through them."""
    drawn = sheet(1000, 560)
    model = Model(readings, ran, found.refresh_s)
    times = Times(found.taus_s, found.leaks, found.lag_s, found.tail, found.across_s)
    model.correct(times)
    shape = found.scale[..., None] * model.shape(times) + found.stray[..., None]
    middle = found.bands.size // 2
    highest = max(float(r.value[middle][_pulsing(r)].max()) for r in readings)
    left = Chart(drawn, (0, 0, 560, 560), (-3.5, 2.5), (0.0, 1.1 * highest))
    left.frame(
        f"Strips in the middle of the field, reduced chi^2 {found.chi2:.2f}",
        "mask later than projector, as sent, in refreshes",
        "light over white",
        ticks=7,
    )
    for reading, fitted in zip(readings, shape, strict=True):
        for kind, colour in KINDS:
            part = [k for k in _pulsing(reading) if _kind(reading, k) == kind]
            part.sort(key=lambda k: reading.mask[k].delay)
            delay = [reading.mask[k].delay for k in part]
            left.line(delay, fitted[middle][part], GREY)
            left.points(delay, reading.value[middle][part], colour)
    left.legend([(f"lit {p}, open {m}", colour) for (p, m), colour in KINDS])
    _lags(drawn, found)
    return drawn


def _lags(drawn: NDArray[np.uint8], found: Timing) -> None:
    lags = 1e3 * found.lag_s
    spread = max(float(np.ptp(lags)), 0.5)
    middle = float(lags.mean())
    right = Chart(drawn, (560, 0, 440, 560), (0.0, 1.0), (middle - spread, middle + spread))
    right.frame("Lag of the mask by row", "field, top to bottom", "ms")
    ends = np.array([0.0, 1.0])
    right.line(ends, 1e3 * (found.line_s[0] + found.line_s[1] * ends), GREY)
    right.bars(found.bands, lags, 3e3 * found.lag_sigma_s, BLUE)
    right.points(found.bands, lags, BLUE)


def _pulsing(reading: Readings) -> list[int]:
    return [k for k, p in enumerate(reading.projector) if not p.still]


def _kind(reading: Readings, k: int) -> tuple[int, int]:
    return reading.projector[k].lit, reading.mask[k].opened
