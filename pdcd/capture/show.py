"""Frames for `display.show`: patterns to hold on both panels without a camera."""

from __future__ import annotations

import numpy as np

from pdcd.bench.tables import Config
from pdcd.codes.make import make_codes
from pdcd.errors import RequestError
from pdcd.frames.frames import WHITE, Frames
from pdcd.frames.lattice import Lattice
from pdcd.frames.patterns import pack
from pdcd.frames.schedule import build_frames
from pdcd.planning.guards import choose_window

PATTERNS = ("white", "checker", "grid", "code")
GRID_CELLS = 8
"""Distance of the lines of the alignment grid."""


def pattern_frames(pattern: str, index: int, grid: tuple[int, int], config: Config) -> Frames:
    """One refresh: the projector shows the pattern, the mask its complement (white, grid: both).

    Raises RequestError for a pattern that is not known or a code that does not exist.
    """
    rows, cols = grid
    primal = np.zeros((rows, cols), dtype=np.bool_)
    if pattern == "checker":
        primal = np.indices(grid).sum(axis=0) % 2 == 0
    elif pattern == "grid":
        r, c = np.indices(grid)
        primal = (r % GRID_CELLS == 0) | (c % GRID_CELLS == 0)
    elif pattern == "code":
        schedule = config.schedule
        if not 0 <= index < schedule.codes:
            raise RequestError(f"code {index} does not exist", hint=f"0 to {schedule.codes - 1}")
        codes = make_codes(schedule.family, grid, schedule.codes, dual="complement")
        primal = codes.primal[index].reshape(grid)
    elif pattern != "white":
        raise RequestError(
            f"unknown pattern {pattern!r}", hint=f"take black, {', '.join(PATTERNS)}"
        )
    dual = primal if pattern == "grid" else ~primal
    which = WHITE if pattern == "white" else 0
    one = np.array([which], dtype=np.int32)
    return Frames(
        primal_patterns=pack(primal.reshape(1, -1)),
        dual_patterns=pack(dual.reshape(1, -1)),
        primal_index=one,
        dual_index=one,
        shift=np.zeros(1, dtype=np.uint8),
        code=np.zeros(1, dtype=np.int32),
        guard=np.zeros(1, dtype=np.bool_),
        grid=grid,
        lattice=grid,
        window="whole",
    )


def loop_frames(grid: tuple[int, int], config: Config, seconds: float) -> Frames:
    """All codes of the schedule over and over for about that time, as an indirect photo has them.

    Seen through the mask by eye: direct light is dark, indirect light remains.
    """
    schedule, (width, height) = config.schedule, config.projector.size_px
    cell_px = min(width / grid[1], height / grid[0])
    window = choose_window(schedule.window, config.rig.misregistration_px / cell_px)
    codes = make_codes(
        schedule.family, Lattice(grid, window).shape, schedule.codes, dual="complement"
    )
    pairs = pack(codes.primal), pack(codes.dual)
    once = build_frames(pairs, grid, window=window, schedule="full", passes=1)
    passes = max(1, round(seconds * config.row_hz / len(once)))
    return build_frames(pairs, grid, window=window, schedule="full", passes=passes)
