"""The picture of the timing step: measured light of strips and that by the fitted times; lag by
row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pdcd.calibration.preview import PLOT_BLUE, PLOT_GREY, label_plot
from pdcd.calibration.timing.lag import MeasuredTiming
from pdcd.calibration.timing.strips import StripReadings

_LEAST_SPAN_MS = 1.0
"""Least range of lags on the axis: smaller differences do not matter to a refresh, and should not
look large."""


def draw_timing(figure: Any, found: MeasuredTiming, readings: Sequence[StripReadings]) -> None:
    """Light of the strips in the middle of the field, in all photos, and that by the fitted times;
    the lag of each band, with three sigmas, and the line through them."""
    axes = figure.subplot_mosaic("SS;LL")
    middle = found.bands.size // 2
    light = np.concatenate([reading.value[middle] for reading in readings])
    fitted = found.light[:, middle].ravel()
    names = [f"{one.lit}|{one.opened}" for reading in readings for one in reading.programmes]
    kinds = sorted(set(names))
    at = [kinds.index(name) for name in names]
    axes["S"].plot(at, fitted, "_", color=PLOT_GREY, markersize=12)
    axes["S"].plot(at, light, "o", color=PLOT_BLUE, markersize=3)
    axes["S"].set_xticks(range(len(kinds)), kinds, fontsize=8, rotation=90)
    label_plot(
        axes["S"], f"Strips in the middle of the field, reduced chi^2 of all {found.chi2:.2f}",
        "refreshes for which projector|mask are white; a grey line is what the times make of it",
        "light over white",
    )  # fmt: skip
    ends = np.array([0.0, 1.0])
    axes["L"].plot(ends, 1e3 * (found.line_s[0] + found.line_s[1] * ends), color=PLOT_GREY)
    sigma = 3e3 * found.lag_sigma_s
    axes["L"].errorbar(found.bands, 1e3 * found.lag_s, sigma, fmt="o", color=PLOT_BLUE)
    low, high = axes["L"].get_ylim()
    more = max(0.5 * (_LEAST_SPAN_MS - (high - low)), 0.0)
    axes["L"].set_ylim(low - more, high + more)
    label_plot(axes["L"], "Lag of the mask by row", "field, top (0) to bottom (1)", "lag in ms")
