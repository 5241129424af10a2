"""Which schedule and window a rig needs: by its mask's lag, and how its panels register."""

from __future__ import annotations

import math

from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.request import CaptureRequest
from pdcd.words import GuardsName, ScheduleName

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


QUARTER_LIMIT = 0.25
"""Misregistration in cells that quarter windows tolerate without any leak."""


def choose_window(asked: str, misregistration_cells: float) -> str:
    """ "whole" or "quarter": what "auto" means on a rig with that misregistration.

    Raises ConfigError when quarter windows cannot cover the misregistration.
    """
    window = asked
    if asked == "auto":
        window = "whole" if misregistration_cells <= WHOLE_CELL_LIMIT else "quarter"
    if window == "quarter" and misregistration_cells > QUARTER_LIMIT:
        raise ConfigError(
            f"misregistration of {misregistration_cells:.2f} cells is more than quarter windows "
            f"tolerate ({QUARTER_LIMIT})",
            hint="use fewer, larger cells or align the panels",
        )
    return window


def asks_for_lag(request: CaptureRequest, config: Config) -> bool:
    """Whether the plan of a request depends on the lag of the mask."""
    asked = config.schedule.guards if request.guards is None else request.guards
    return asked == "auto"


def lag_rows(config: Config, mask_lag_s: float | None) -> tuple[float | None, float]:
    """Lag of the mask and its jitter in rows of frames, as `pdcd.frames.schedule` takes them."""
    jitter_s = math.hypot(config.projector.jitter_s, config.mask.jitter_s)
    lag = None if mask_lag_s is None else mask_lag_s * config.row_hz
    return lag, jitter_s * config.row_hz
