"""Which refreshes keep the codes of a bench apart, given the mask's lag and the panels' times."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.panels.schedule import count_slot_rows
from pdcd.probing.pulses import PanelResponse, compute_code_separation
from pdcd.protocol.request import CaptureRequest
from pdcd.words import GuardsName, ScheduleName

RANGES = ("long-range", "short-range")
"""Goals of light by its range."""
_FIELD_POINTS = 9
"""Points a side of the field at which the panels' rows are compared."""
_JITTERS = 4.0
"""Standard deviations of jitter that a lag must stay within what a schedule tolerates."""
QUIET = 0.005
"""Share of a code's light in its neighbours below which schedules count as equally good."""
_FAR_QUIET = 0.0005
"""The same for far light: each of its paths goes through the mask in so few codes that the rest of
one code in the next counts a hundred times as much."""
BY_COST: tuple[ScheduleName, ...] = ("lag", "lead", "full", "wide")
"""Schedules of two, three and four refreshes under which the projector is always lit. Light from
all rows then counts alike, whenever each row is set; a calibration measures only the difference of
these times between both panels."""


@dataclass(frozen=True)
class CodeSlot:
    """Time of one code: refreshes of a schedule, the dark time after each, and the whole, s."""

    schedule: ScheduleName
    dark_s: float
    slot_s: float


def resolve_slot(request: CaptureRequest, config: Config, mask_lag_s: float | None) -> CodeSlot:
    """Refreshes and dark time of a code, as asked for or as the rig has them; the schedule is
    "none" where a dark time keeps codes apart. Raises RequestError as `resolve_dark_s`."""
    dark_s = resolve_dark_s(request, config, mask_lag_s)
    asked = _asked_guards(request, config)
    if dark_s is not None:
        schedule: ScheduleName = "none"
    elif asked == "auto" and has_measured_times(config):
        quiet = _FAR_QUIET if request.goal in RANGES else QUIET
        schedule = find_quietest_schedule(config, mask_lag_s, quiet)
    else:
        schedule = choose_schedule(asked, *convert_lag_to_rows(config, mask_lag_s))
    slot_s = count_slot_rows(schedule) / config.row_hz + (dark_s or 0.0)
    return CodeSlot(schedule, dark_s or 0.0, slot_s)


def is_lag_needed(request: CaptureRequest, config: Config) -> bool:
    """Whether the plan of a request depends on the lag of the mask."""
    return _asked_guards(request, config) in ("auto", "dark")


def _asked_guards(request: CaptureRequest, config: Config) -> bool | GuardsName:
    return config.schedule.guards if request.guards is None else request.guards


def resolve_dark_s(
    request: CaptureRequest, config: Config, mask_lag_s: float | None
) -> float | None:
    """Time for which both panels are black after each row, if that keeps codes apart, s; None if
    refreshes do. "auto" takes a dark time where the panels can and it is shorter than a row.

    Raises RequestError where it is asked for and the panels cannot.
    """
    asked = _asked_guards(request, config)
    row_s = 1.0 / config.row_hz
    if asked == "dark":
        if not config.display.row_times:
            raise RequestError(
                "schedule: the panels show no dark time between rows",
                hint="take schedule both, or set display.row_times for panels that do",
            )
        return row_s if mask_lag_s is None else choose_dark_s(config, mask_lag_s)
    if asked != "auto" or not config.display.row_times or mask_lag_s is None:
        return None
    dark_s = choose_dark_s(config, mask_lag_s)
    return dark_s if dark_s < row_s else None


def choose_dark_s(config: Config, mask_lag_s: float) -> float:
    """The shortest dark time that keeps the light of a row from the mask of the next, s.

    It is as long as the mask is late or early, at the worst row of pixels, plus four standard
    deviations of jitter, plus the time until what a slow panel still shows is less than `QUIET` of
    a row's light.
    """
    projector, mask = config.projector, config.mask
    jitter_s = _JITTERS * math.hypot(projector.jitter_s, mask.jitter_s)
    late_s = max(abs(mask_lag_s + row_s) for row_s in scan_out_lags_s(config)) + jitter_s
    least_s = QUIET / config.row_hz
    tails_s = (
        p.fall_s * math.log(max(p.fall_s / least_s, 1.0)) for p in (projector, mask) if p.fall_s
    )
    return late_s + sum(tails_s)


def choose_schedule(
    asked: bool | GuardsName, mask_lag_rows: float | None, jitter_rows: float = 0.0
) -> ScheduleName:
    """The schedule's name; "auto" is the one of two refreshes that the measured lag allows.

    Parameters
    ----------
    asked : True is "full" and False "none", as names of `SLOTS`, or "auto"; "dark" is settled
        before (`resolve_dark_s`).
    mask_lag_rows : lag of the mask in rows, negative where it leads; None where it is not known,
        so that "auto" is "full".
    jitter_rows : its standard deviation from refresh to refresh.
    """
    if asked is True:
        return "full"
    if asked is False:
        return "none"
    if asked == "auto":
        found = list_tolerant_schedules(mask_lag_rows, jitter_rows)
        return "lag" if "lag" in found else "lead" if "lead" in found else "full"
    return "none" if asked == "dark" else asked


def list_tolerant_schedules(
    mask_lag_rows: float | None, jitter_rows: float = 0.0
) -> tuple[ScheduleName, ...]:
    """Schedules that keep codes apart at that lag, those of the fewest refreshes first."""
    if mask_lag_rows is None:
        return ("full",)
    margin = _JITTERS * jitter_rows
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


def convert_lag_to_rows(config: Config, mask_lag_s: float | None) -> tuple[float | None, float]:
    """Lag of the mask and its jitter in rows of frames, for `list_tolerant_schedules`: the lag of
    the middle of all rows of pixels; the deviation of the others from it counts as jitter."""
    jitter_s = math.hypot(config.projector.jitter_s, config.mask.jitter_s)
    first_s, last_s = scan_out_lags_s(config)
    jitter_s += 0.5 * (last_s - first_s) / _JITTERS
    if mask_lag_s is None:
        return None, jitter_s * config.row_hz
    return (mask_lag_s + 0.5 * (first_s + last_s)) * config.row_hz, jitter_s * config.row_hz


def scan_out_lags_s(config: Config) -> tuple[float, float]:
    """Least and largest lag of the mask over the field that scan-out adds to `skew_s`, in seconds.

    Rows of a panel are set one after the other; the panel's place decides which of them meet.
    """
    if not config.projector.scan_s and not config.mask.scan_s:
        return 0.0, 0.0
    panels = panels_of(config)
    at = (np.arange(_FIELD_POINTS) + 0.5) / _FIELD_POINTS
    points = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    delays = []
    for view, panel in ((panels.projector, config.projector), (panels.mask, config.mask)):
        down = np.clip(view.map.from_field(points)[:, 1] / panel.size_px[1], 0.0, 1.0)
        share = down if panel.scan_s >= 0.0 else 1.0 - down
        delays.append(share * abs(panel.scan_s))
    lag_s = delays[1] - delays[0]
    return float(np.nanmin(lag_s)), float(np.nanmax(lag_s))


def has_measured_times(config: Config) -> bool:
    """Whether rise and fall of both panels are known."""
    return all(p.rise_s > 0.0 and p.fall_s > 0.0 for p in (config.projector, config.mask))


def find_quietest_schedule(
    config: Config, mask_lag_s: float | None, quiet: float = QUIET
) -> ScheduleName:
    """The schedule of the fewest refreshes that lets no more than `quiet` of a code's light into
    its neighbours; if none does, the best one.

    Where the lag is not known, the one of `choose_schedule`.
    """
    if mask_lag_s is None:
        return choose_schedule("auto", *convert_lag_to_rows(config, mask_lag_s))
    leaks = {name: compute_schedule_leak(config, name, mask_lag_s) for name in BY_COST}
    fitting = [name for name in BY_COST if leaks[name] <= quiet]
    return fitting[0] if fitting else min(BY_COST, key=lambda name: leaks[name])


def compute_schedule_leak(config: Config, schedule: ScheduleName, mask_lag_s: float) -> float:
    """Light of a code in its neighbours under a schedule, over its own, at the worst row."""
    projector, mask = (PanelResponse(p.rise_s, p.fall_s) for p in (config.projector, config.mask))
    worst = 0.0
    for row_s in scan_out_lags_s(config):
        kept = compute_code_separation(
            schedule, projector, mask, mask_lag_s + row_s, 1.0 / config.row_hz
        )
        worst = max(worst, kept.leak)
    return worst
