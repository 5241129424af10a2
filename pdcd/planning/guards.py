"""Which schedule and window a rig needs: by its mask's lag, and how its panels register."""

from __future__ import annotations

import math

import numpy as np

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.panels.windows import windows
from pdcd.protocol.request import CaptureRequest
from pdcd.words import GuardsName, ScheduleName

FIELD_POINTS = 9
"""Points a side of the field at which the panels' rows are compared."""
JITTERS = 4.0
"""Standard deviations of jitter that a lag must stay away from the ends of what is tolerated."""


def choose_schedule(
    asked: bool | GuardsName, mask_lag_rows: float | None, jitter_rows: float = 0.0
) -> ScheduleName:
    """The schedule's name; "auto" is the one of two refreshes that the measured lag allows.

    Parameters
    ----------
    asked : True is "full" and False "none", as names of `SLOTS`, or "auto".
    mask_lag_rows : lag of the mask in rows, negative where it leads; None where it is not known,
        and "auto" then trusts in nothing but "full".
    jitter_rows : its standard deviation from refresh to refresh.
    """
    if asked is True:
        return "full"
    if asked is False:
        return "none"
    if asked == "auto":
        found = tolerant(mask_lag_rows, jitter_rows)
        return "lag" if "lag" in found else "lead" if "lead" in found else "full"
    return asked


def tolerant(mask_lag_rows: float | None, jitter_rows: float = 0.0) -> tuple[ScheduleName, ...]:
    """Schedules that keep codes apart at that lag, those of the fewest refreshes first."""
    if mask_lag_rows is None:
        return ("full",)
    margin = JITTERS * jitter_rows
    low, high = mask_lag_rows - margin, mask_lag_rows + margin
    found: list[ScheduleName] = []
    if low == high == 0.0:
        found.append("none")
    if -1.0 < low and high < 1.0:
        found.append("both")
    if 0.0 <= low and high <= 1.0:
        found.append("lag")
    elif -1.0 <= low and high <= 0.0:
        found.append("lead")
    return (*found, "full")


WHOLE_CELL_LIMIT = 0.001
"""Misregistration in cells up to which whole cells are worth more than quarter windows: they let
about that share of the direct light into an indirect photo, whose own light is often ten times
weaker."""


BLUR_LEAK = 1.6
"""Share of the direct light that blur brings into an indirect photo under whole cells, over its
standard deviation in cells (`pdcd.probing.cell_size`)."""


def shares_of_cell(config: Config, cell_px: float) -> tuple[float, float]:
    """Misregistration of the panels, and blur on the mask, in cells."""
    return config.rig.misregistration_px / cell_px, config.mask.blur_px / cell_px


def choose_window(asked: str, misregistration_cells: float, blur_cells: float = 0.0) -> str:
    """What "auto" means on a rig with that misregistration and blur, or what was asked for.

    Raises ConfigError when the window cannot cover the misregistration.
    """
    window = asked
    if asked == "auto":
        leak = misregistration_cells + BLUR_LEAK * blur_cells
        window = "whole" if leak <= WHOLE_CELL_LIMIT else "quarter"
    guard = windows(window).guard
    if guard and misregistration_cells > guard:
        raise ConfigError(
            f"misregistration of {misregistration_cells:.2f} cells is more than {window} windows "
            f"tolerate ({guard:g})",
            hint="use fewer, larger cells or align the panels"
            if window == "quarter"
            else "take a smaller window, or auto",
        )
    return window


def asks_for_lag(request: CaptureRequest, config: Config) -> bool:
    """Whether the plan of a request depends on the lag of the mask."""
    asked = config.schedule.guards if request.guards is None else request.guards
    return asked == "auto"


def lag_rows(config: Config, mask_lag_s: float | None) -> tuple[float | None, float]:
    """Lag of the mask and its jitter in rows of frames, as `tolerant` takes them: that of the
    middle of all rows of pixels; how far the others are from it counts as jitter."""
    jitter_s = math.hypot(config.projector.jitter_s, config.mask.jitter_s)
    first_s, last_s = lag_by_rows_s(config)
    jitter_s += 0.5 * (last_s - first_s) / JITTERS
    if mask_lag_s is None:
        return None, jitter_s * config.row_hz
    return (mask_lag_s + 0.5 * (first_s + last_s)) * config.row_hz, jitter_s * config.row_hz


def lag_by_rows_s(config: Config) -> tuple[float, float]:
    """Least and largest lag of the mask over the field that scan-out adds to `skew_s`, in seconds.

    Rows of a panel are set one after the other; where it lies decides which of them meet.
    """
    if not config.projector.scan_s and not config.mask.scan_s:
        return 0.0, 0.0
    panels = panels_of(config)
    at = (np.arange(FIELD_POINTS) + 0.5) / FIELD_POINTS
    points = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    delays = []
    for view, panel in ((panels.projector, config.projector), (panels.mask, config.mask)):
        down = np.clip(view.map.from_field(points)[:, 1] / panel.size_px[1], 0.0, 1.0)
        share = down if panel.scan_s >= 0.0 else 1.0 - down
        delays.append(share * abs(panel.scan_s))
    lag_s = delays[1] - delays[0]
    return float(np.nanmin(lag_s)), float(np.nanmax(lag_s))
