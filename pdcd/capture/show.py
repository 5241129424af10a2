"""Frames for `display.show`: patterns to hold on both panels without a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import Panels
from pdcd.bench.tables import Config
from pdcd.calibration.pictures import MOVING, STILL
from pdcd.codes.make import make_codes
from pdcd.errors import RequestError
from pdcd.panels.draw import draw
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import Patterns, make_empty_patterns, pack_bits, pack_levels
from pdcd.panels.schedule import build_frames
from pdcd.planning.bench_fit import choose_grid_window

_CELL_PATTERNS = ("white", "checker", "grid", "code")
"""Patterns of code cells: they lie where the panels are placed."""
_ALONE = ("projector", "mask")
"""One panel white, the other black."""
PATTERNS = (*_CELL_PATTERNS, *_ALONE, *STILL)
"""All patterns that can be held; those of `MOVING` can only be played."""
_GRID_CELLS = 8
"""Distance of the lines of the alignment grid."""
_SHEET_ROWS, _SHEET_STEP, _MARGIN_PX, _SHEET_GREY = 6, 4, 8, 96
"""Of a sheet: most refreshes, their scale if there are several, and margin and grey around each
panel."""


def make_pattern_frames(pattern: str, index: int, grid: tuple[int, int], config: Config) -> Frames:
    """Frames of one refresh. For patterns of cells the mask shows the complement of the projector's
    pattern (white, grid: the same one); pictures of pixels are on both panels, each on its own
    pixels.

    Raises RequestError for an unknown pattern or a code that does not exist.
    """
    if pattern in STILL or pattern in _ALONE:
        return make_pixel_frames(pattern, config)
    rows, cols = grid
    primal = np.zeros((rows, cols), dtype=np.bool_)
    if pattern == "checker":
        primal = np.indices(grid).sum(axis=0) % 2 == 0
    elif pattern == "grid":
        r, c = np.indices(grid)
        primal = (r % _GRID_CELLS == 0) | (c % _GRID_CELLS == 0)
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
        primal_patterns=pack_bits(primal.reshape(1, -1)),
        dual_patterns=pack_bits(dual.reshape(1, -1)),
        primal_index=one,
        dual_index=one,
        shift=np.zeros(1, dtype=np.uint8),
        code=np.zeros(1, dtype=np.int32),
        guard=np.zeros(1, dtype=np.bool_),
        grid=grid,
        lattice=grid,
        window="whole",
    )


def make_pixel_frames(pattern: str, config: Config, seconds: float = 0.0) -> Frames:
    """The refreshes of a picture of pixels, one of `STILL`, `_ALONE` or `MOVING`; moving ones are
    repeated for about that time, and shown at least once."""
    sizes = config.projector.size_px, config.mask.size_px
    if pattern in _ALONE:
        patterns: list[Patterns] = [make_empty_patterns(), make_empty_patterns()]
        index = [np.array([WHITE if pattern == role else BLACK], np.int32) for role in _ALONE]
    else:
        pictures = [MOVING[pattern](s) if pattern in MOVING else [STILL[pattern](s)] for s in sizes]
        patterns = [pack_levels(np.stack(own).reshape(len(own), -1)) for own in pictures]
        times = max(1, round(seconds * config.row_hz / len(pictures[0])))
        index = [np.tile(np.arange(len(own), dtype=np.int32), times) for own in pictures]
    count = index[0].size
    return Frames(
        primal_patterns=patterns[0],
        dual_patterns=patterns[1],
        primal_index=index[0],
        dual_index=index[1],
        shift=np.zeros(count, dtype=np.uint8),
        code=np.arange(count, dtype=np.int32),
        guard=np.zeros(count, dtype=np.bool_),
        grid=(1, 1),
        lattice=(1, 1),
        window=PIXEL_WINDOW,
    )


def draw_sheet(frames: Frames, panels: Panels) -> NDArray[np.uint8]:
    """What both panels show, projector left and mask right, (H, W, 3) uint8; of several refreshes,
    the first ones below each other, at a smaller scale."""
    rows = range(min(len(frames), _SHEET_ROWS))
    step = 1 if len(rows) == 1 else _SHEET_STEP
    lines = []
    for row in rows:
        shown = [
            draw(frames, view, row)[::step, ::step] for view in (panels.projector, panels.mask)
        ]
        height = max(part.shape[0] for part in shown) + _MARGIN_PX
        padded = [
            np.pad(p, ((0, height - p.shape[0]), (0, _MARGIN_PX)), constant_values=_SHEET_GREY)
            for p in shown
        ]
        lines.append(np.concatenate(padded, axis=1))
    return np.repeat(np.concatenate(lines)[..., None], 3, axis=2)


def make_loop_frames(grid: tuple[int, int], config: Config, seconds: float) -> Frames:
    """All codes of the schedule, repeated for about that time, as in an indirect photo.

    To be viewed through the mask by eye: direct light is dark, indirect light remains.
    """
    schedule = config.schedule
    window = choose_grid_window(schedule.window, config, grid)
    codes = make_codes(
        schedule.family, Lattice(grid, window).shape, schedule.codes, dual="complement"
    )
    pairs = pack_bits(codes.primal), pack_bits(codes.dual)
    once = build_frames(pairs, grid, window=window, schedule="full", passes=1)
    passes = max(1, round(seconds * config.row_hz / len(once)))
    return build_frames(pairs, grid, window=window, schedule="full", passes=passes)
