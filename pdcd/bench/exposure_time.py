"""How long an exposure is planned to be, and may be at most: what devices are told beforehand.

The rig tells the camera with its settings, and a shutter that wants to know it (`TimedShutter`).
Whoever guards a shutter, or waits for a photo, goes by it: a guardian that waited for
`limits.max_exposure_s` would leave a shutter open for ten minutes after an exposure of two seconds.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pdcd.bench.devices import CameraSettings, Shutter, TimedShutter
from pdcd.bench.tables import Config
from pdcd.panels.frames import Frames

MARGIN_S = 30.0
"""What an exposure may take beyond the time that panels need for their frames: for devices that
answer late, and panels that stall."""
STRETCH = 2.0
"""How much longer than planned the panels may take for their frames, refreshes being late."""


def with_times(
    settings: CameraSettings, config: Config, frames: Frames, refresh_hz: float | None
) -> CameraSettings:
    """Settings of an exposure of all these frames, with how long that is planned to be, and may be.

    refresh_hz : of the panels as found; None where they were not asked, no positive number where a
    driver does not know it. The slower of that and what is configured counts.
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
    return _timed(settings, config, shown_s + settles_s, STRETCH * passes * shown_s + settles_s)


def with_open_time(settings: CameraSettings, config: Config, open_s: float) -> CameraSettings:
    """The same of an exposure that a clock ends, so long after the shutter is surely open."""
    return _timed(settings, config, open_s, open_s)


def tell(shutter: Shutter, settings: CameraSettings) -> None:
    """Let a shutter that wants to know it know how long the next exposure will be."""
    if isinstance(shutter, TimedShutter) and settings.exposure_s is not None:
        longest_s = settings.longest_s
        shutter.expect_exposure(
            settings.exposure_s, settings.exposure_s if longest_s is None else longest_s
        )


def _timed(
    settings: CameraSettings, config: Config, exposure_s: float, longest_s: float
) -> CameraSettings:
    # What was planned within the limit may go beyond it: a guardian is there for what hangs.
    longest_s = min(longest_s, max(config.limits.max_exposure_s, exposure_s)) + MARGIN_S
    return replace(settings, exposure_s=exposure_s, longest_s=longest_s)
