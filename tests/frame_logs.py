"""Logs of displays that miss nothing."""

from __future__ import annotations

import numpy as np

from pdcd.panels.frames import FrameLog

REFRESH_NS = 16_666_667


def make_log(
    count: int,
    *,
    start_ns: int = 50_000_000,
    refresh_ns: int = REFRESH_NS,
    late_ns: int = 0,
    jitter_ns: int = 0,
) -> FrameLog:
    """Every row is shown in its turn, by the mask `late_ns` after the projector."""
    rng = np.random.default_rng(7)
    at = start_ns + np.arange(count + 1, dtype=np.int64) * refresh_ns
    wobble = rng.integers(-jitter_ns, jitter_ns + 1, size=(2, count + 1))
    primal, dual = at + wobble[0], at + wobble[1] + late_ns
    rows = np.arange(count, dtype=np.int32)
    return FrameLog(
        rows, rows, primal[:-1], dual[:-1], np.array([primal[-1], dual[-1]]),
        np.zeros(count, np.int32), "test", True,
    )  # fmt: skip
