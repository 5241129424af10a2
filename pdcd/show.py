"""Frames for `display.show`: patterns to hold on both panels without a camera."""

from __future__ import annotations

import numpy as np

from pdcd.codes import make_codes
from pdcd.config import Config
from pdcd.errors import ConfigError
from pdcd.interfaces import WHITE, Frames

PATTERNS = ("white", "checker", "code")


def pattern_frames(pattern: str, index: int, grid: tuple[int, int], config: Config) -> Frames:
    """One refresh: the projector shows the pattern, the mask its complement (white: both).

    Raises ConfigError for a pattern that is not known or a code that does not exist.
    """
    rows, cols = grid
    primal = np.zeros((rows, cols), dtype=np.bool_)
    if pattern == "checker":
        primal = np.indices(grid).sum(axis=0) % 2 == 0
    elif pattern == "code":
        schedule = config.schedule
        if not 0 <= index < schedule.codes:
            raise ConfigError(f"code {index} does not exist", hint=f"0 to {schedule.codes - 1}")
        codes = make_codes(schedule.family, grid, schedule.codes, dual="complement")
        primal = codes.primal()[index].reshape(grid)
    elif pattern != "white":
        raise ConfigError(f"unknown pattern {pattern!r}", hint=f"take black, {', '.join(PATTERNS)}")
    which = WHITE if pattern == "white" else 0
    one = np.array([which], dtype=np.int32)
    return Frames(
        primal_patterns=np.packbits(primal.reshape(1, -1), axis=1),
        dual_patterns=np.packbits(~primal.reshape(1, -1), axis=1),
        primal_index=one,
        dual_index=one,
        shift=np.zeros(1, dtype=np.uint8),
        code=np.zeros(1, dtype=np.int32),
        guard=np.zeros(1, dtype=np.bool_),
        grid=grid,
        lattice=grid,
        window="whole",
    )
