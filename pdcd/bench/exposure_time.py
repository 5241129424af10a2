"""How long an exposure is planned to be, and may be at most; and whether it was that long.

The rig passes both times to the camera with its settings, and to a shutter that wants to know them
(`TimedShutter`). Code that guards a shutter, or waits for a photo, uses them: a guard that waited
for `limits.max_exposure_s` would leave a shutter open for ten minutes after an exposure of two
seconds.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pdcd.bench.devices import CameraSettings, Shutter, TimedShutter
from pdcd.bench.tables import Config
from pdcd.panels.frames import FrameLog, Frames

_MARGIN_S = 30.0
"""Seconds that an exposure may take beyond the time that panels need for their frames: for devices
that answer late, and panels that stall."""
_STRETCH = 2.0
"""Factor by which the panels may exceed the planned time of their frames when refreshes are
late."""

OFF_S, OFF_SHARE = 1.1, 0.25
"""Two times of one exposure conflict where they differ by more than the larger of that many seconds
and that share. Cameras record the time of a bulb exposure in whole seconds, or in thirds of a
stop."""
_MOST_TOLD_S = 86400.0
"""A longer exposure time is taken for none: some cameras write such a number where they keep no
time."""


def with_exposure_times(
    settings: CameraSettings, config: Config, frames: Frames, refresh_hz: float | None
) -> CameraSettings:
    """Settings of an exposure of all these frames, with its planned and its longest duration.

    refresh_hz : rate of the panels as found; None where it was not asked for, not positive where a
        driver does not know it. The slower of this rate and the configured one is used.
    """
    row_hz = config.row_hz
    if refresh_hz is not None and math.isfinite(refresh_hz) and refresh_hz > 0.0:
        row_hz = min(row_hz, refresh_hz * config.display.planes_per_refresh)
    rows = len(frames) + abs(config.mask_delay_rows)
    shown_s = rows / row_hz
    if frames.dark_s is not None:
        shown_s += float(np.sum(frames.dark_s))
    rig = config.rig
    # Codes that were missed are shown again in the same exposure.
    passes = 1 + rig.retries if rig.on_miss == "balance" else 1
    settles_s = 2.0 * rig.settle_s
    return _timed(settings, config, shown_s + settles_s, _STRETCH * passes * shown_s + settles_s)


def with_open_time(settings: CameraSettings, config: Config, open_s: float) -> CameraSettings:
    """The same for an exposure that a clock ends, `open_s` after the shutter is surely open."""
    return _timed(settings, config, open_s, open_s)


def tell_exposure_time(shutter: Shutter, settings: CameraSettings) -> None:
    """Tell the duration of the next exposure to a shutter that wants to know it."""
    if isinstance(shutter, TimedShutter) and settings.exposure_s is not None:
        longest_s = settings.longest_s
        shutter.expect_exposure(
            settings.exposure_s, settings.exposure_s if longest_s is None else longest_s
        )


def planned_open_s(
    settings: CameraSettings, config: Config, frames: Frames, log: FrameLog
) -> float:
    """Planned duration in seconds of an exposure that `with_exposure_times` or `with_open_time`
    announced, with late refreshes and the passes that were shown to make up for them."""
    more = max(0, len(log) - len(frames) - abs(log.mask_delay)) + int(log.missed.sum())
    return (settings.exposure_s or 0.0) + more / config.row_hz


def describe_time_conflict(planned_s: float, logged_s: float, told_s: float) -> str:
    """Which of three times of one exposure conflict, in words with their figures; "" if none do.

    Called by code that takes a photo and can take it again, and by code that judges it.

    planned_s : the planned time (`planned_open_s`).
    logged_s : from the shutter being open to its being closed, by the rig's clock.
    told_s : exposure time in the camera's file; a missing tag, 0 or an impossible time is no fault.
    """
    told = math.isfinite(told_s) and 0.0 < told_s <= _MOST_TOLD_S
    if _disagree(planned_s, logged_s):
        return f"the shutter was open for {logged_s:.3g} s instead of {planned_s:.3g} s"
    if told and (_disagree(logged_s, told_s) or _disagree(planned_s, told_s)):
        return f"the camera reports {told_s:.3g} s for an exposure of {logged_s:.3g} s"
    return ""


def _disagree(expected_s: float, found_s: float) -> bool:
    return abs(found_s - expected_s) > max(OFF_S, OFF_SHARE * expected_s)


def _timed(
    settings: CameraSettings, config: Config, exposure_s: float, longest_s: float
) -> CameraSettings:
    # A plan within the limit may be longer than the limit: a guard is only there for what hangs.
    longest_s = min(longest_s, max(config.limits.max_exposure_s, exposure_s)) + _MARGIN_S
    return replace(settings, exposure_s=exposure_s, longest_s=longest_s)
