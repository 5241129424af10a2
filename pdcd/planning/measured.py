"""What a plan makes of a bench that was measured: how small cells may be, which schedule is quiet,
and why, in a line each."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.calibration.cell_size import Meeting, largest_window, leak_of, smallest_cell_for
from pdcd.calibration.pulses import Answer, kept_apart
from pdcd.frames.windows import GUARDS, windows
from pdcd.maps.scale import fewest_pixels
from pdcd.planning.guards import (
    WHOLE_CELL_LIMIT,
    choose_schedule,
    choose_window,
    lag_by_rows_s,
    lag_rows,
    shares_of_cell,
)
from pdcd.words import ScheduleName

MOST_LEAK = 0.005
"""Share of the direct light that cells of "auto" let into an indirect photo at most."""
LEAST_CELL_PX, LEAST_MASK_PX = 2.0, 4.0
"""Pixels of projector and mask that a cell has at least."""
MOST_CELLS = 256 * 192
"""Cells of "auto" at most: more take long to plan and decode, and few scenes have such detail."""
QUIET = 0.005
"""Share of a code's light in its neighbours at which a schedule is as good as any."""
BY_COST: tuple[ScheduleName, ...] = ("lag", "lead", "both", "full")
"""Schedules of two and three refreshes."""


def with_grid(config: Config) -> Config:
    """The configuration with "auto" cells worked out: half windows then keep what leaks below
    `MOST_LEAK`. Where nothing was measured, the scene's cells or the usual ones are taken."""
    if config.schedule.grid != "auto":
        return config
    schedule = msgspec.structs.replace(config.schedule, grid=_auto_grid(config))
    return msgspec.structs.replace(config, schedule=schedule)


def meeting_of(config: Config) -> Meeting | None:
    """How light and mask meet; None where nobody measured it."""
    e95_px, blur_px = config.rig.misregistration_px, config.mask.blur_px
    if e95_px == 0.0 and blur_px == 0.0:
        return None
    across = fewest_pixels(panels_of(config).mask.map, config.projector.size_px[::-1])
    return Meeting(e95_px, blur_px, 1.0 / across if across else 0.0)


def window_for(asked: str, config: Config, cell_px: float) -> str:
    """Window of cells of so many projector pixels: as asked for, or the largest that neither
    touches another cell's light nor leaks for blur. Raises ConfigError."""
    meeting, widest = meeting_of(config), 0.0
    if meeting is not None:
        fitting = (
            windows(name).side
            for name in GUARDS
            if windows(name).side <= largest_window(meeting, cell_px)
            and float(leak_of(meeting, cell_px, windows(name).side)) <= WHOLE_CELL_LIMIT
        )
        widest = max(fitting, default=0.0)
    return choose_window(asked, *shares_of_cell(config, cell_px), widest)


def times_measured(config: Config) -> bool:
    """Whether rise and fall of both panels are known."""
    return all(p.rise_s > 0.0 and p.fall_s > 0.0 for p in (config.projector, config.mask))


def quietest(config: Config, mask_lag_s: float | None) -> ScheduleName:
    """The schedule of the fewest refreshes that keeps codes apart; of those that do not, the best.

    Where the lag is not known, as `choose_schedule` has it.
    """
    if mask_lag_s is None:
        return choose_schedule("auto", *lag_rows(config, mask_lag_s))
    leaks = {name: schedule_leak(config, name, mask_lag_s) for name in BY_COST}
    quiet = [name for name in BY_COST if leaks[name] <= QUIET]
    return quiet[0] if quiet else min(BY_COST, key=lambda name: leaks[name])


def schedule_leak(config: Config, schedule: ScheduleName, mask_lag_s: float) -> float:
    """Light of a code in its neighbours under a schedule, over its own, at the worst row."""
    projector, mask = (Answer(p.rise_s, p.fall_s) for p in (config.projector, config.mask))
    worst = 0.0
    for row_s in lag_by_rows_s(config):
        kept = kept_apart(schedule, projector, mask, mask_lag_s + row_s, 1.0 / config.row_hz)
        worst = max(worst, kept.leak)
    return worst


def reasons_for(
    config: Config,
    grid: tuple[int, int],
    window: str,
    schedule: ScheduleName,
    mask_lag_s: float | None,
) -> tuple[str, ...]:
    """Why cells, window and schedule are what they are; nothing on a bench that nobody measured."""
    told = []
    meeting = meeting_of(config)
    if meeting is not None:
        width, height = config.projector.size_px
        cell_px = min(width / grid[1], height / grid[0])
        leak = float(leak_of(meeting, cell_px, windows(window).side))
        told.append(
            f"cells of {cell_px:.3g} projector pixels: the panels meet within "
            f"{meeting.e95_px:.2g} px (95 % of the field), blur is {meeting.blur_px:.2g} px"
        )
        told.append(
            f"window {window}: {100.0 * leak:.2g} % of the direct light leaks into an indirect "
            "photo"
        )
    if times_measured(config) and mask_lag_s is not None and schedule != "none":
        leak = schedule_leak(config, schedule, mask_lag_s)
        low_s, high_s = lag_by_rows_s(config)
        told.append(
            f"schedule {schedule}: the mask follows by {1e3 * (mask_lag_s + low_s):.2g} to "
            f"{1e3 * (mask_lag_s + high_s):.2g} ms; {100.0 * leak:.2g} % of a code's light "
            "gets into its neighbours"
        )
    return tuple(told)


def _auto_grid(config: Config) -> tuple[int, int] | None:
    meeting = meeting_of(config)
    if meeting is None:
        return None
    width, height = config.projector.size_px
    # A cell of the projector's own pixels; the mask may have fewer of them.
    across = fewest_pixels(panels_of(config).mask.map, (height, width)) or 1.0
    least_px = max(
        smallest_cell_for(meeting, MOST_LEAK),
        LEAST_CELL_PX,
        LEAST_MASK_PX / across,
        math.sqrt(width * height / MOST_CELLS),
    )
    if not np.isfinite(least_px):
        return None
    return max(1, int(height / least_px)), max(1, int(width / least_px))
