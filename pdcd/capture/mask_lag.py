"""How much later the mask is than the projector, as far as the display can measure it."""

from __future__ import annotations

import logging

import numpy as np

from pdcd.bench.devices import Display, DisplayInfo
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, SyncError
from pdcd.panels.schedule import build_frames

logger = logging.getLogger(__name__)

_BLACK_REFRESHES = 30
"""Black refreshes that are logged where the display does not report the mask's lag: half a
second."""
_STEADY = 0.02
"""Largest change of the lag meanwhile, in refreshes: panels on clocks of their own drift."""


def tell_mask_lag_s(
    display: Display, info: DisplayInfo, config: Config, grid: tuple[int, int], *, look: bool
) -> float | None:
    """Lag of the mask as its open display reports it. Where the display does not report one, and
    the mask was measured to be late, the lag is taken from the log of some black refreshes, if
    `look`. The rig needs it for its plans.

    None where it is unknown, or drifts. Raises DeviceLost for a display that is gone.
    """
    skew_s = config.mask.skew_s - config.projector.skew_s
    if info.mask_lag_s is not None or not (look and skew_s):
        return info.mask_lag_s
    black = build_frames(
        None,
        grid,
        window="whole",
        schedule="none",
        passes=_BLACK_REFRESHES * config.display.planes_per_refresh,
        primal_black=True,
        dual_black=True,
    )
    try:
        display.load(black)
        log = display.play(lambda *_: None, lambda: False)
    except (SyncError, ConfigError) as err:
        logger.warning("the lag of the mask is not known error=%s", err)
        return None
    apart_s = 1e-9 * (log.dual_ns - log.primal_ns)[log.missed == 0]
    if not apart_s.size or np.ptp(apart_s) > _STEADY / config.row_hz:
        return None
    return float(np.median(apart_s)) + log.mask_delay / config.row_hz + skew_s
