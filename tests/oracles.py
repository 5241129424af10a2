"""Slow, plain evaluations that the fast code is held against; they share no formula with it.

Panels are cut into square pixels of 1/`fine` cell. Every pair (mask pixel, projector pixel) is
followed through the exposure exactly, by the matrix exponential of the linear system
``(1, m, i, m i, integral of m i)``.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from pdcd.panels.frames import BLACK, WHITE, FrameLog, Frames
from pdcd.probing.panel import PanelOptics

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


GUARDS = {"quarter": 1 / 4, "side-5/8": 3 / 16, "side-3/4": 1 / 8, "side-7/8": 1 / 16}
"""Way from the edge of a cell to that of its window, in cells."""


@dataclass(frozen=True)
class Timeline:
    """Targets of all pixels of one panel: `on[s]` (P,) from `start_s[s]` on."""

    start_s: Floats
    on: Bools


def pixel_targets(
    frames: Frames, row: int, fine: int, primal: bool, offset: tuple[float, float]
) -> Bools:
    """Pixel by pixel, straight from the definition of shifts and windows, (pixels,)."""
    rows, cols = frames.grid
    index = int((frames.primal_index if primal else frames.dual_index)[row]) if row >= 0 else BLACK
    out = np.zeros((rows * fine, cols * fine), dtype=bool)
    for y in range(rows * fine):
        for x in range(cols * fine):
            at = ((y + 0.5) / fine, (x + 0.5) / fine)
            if primal:
                out[y, x] = _primal_pixel(frames, row, index, at)
            else:
                out[y, x] = _dual_pixel(frames, row, index, (at[0] + offset[0], at[1] + offset[1]))
    return out.ravel()


def _code_bit(frames: Frames, bits: NDArray[np.uint8], cy: int, cx: int) -> bool:
    return bool(np.unpackbits(bits)[cy * frames.lattice[1] + cx])


def _primal_pixel(frames: Frames, row: int, index: int, at: tuple[float, float]) -> bool:
    if index in (BLACK, WHITE):
        return index == WHITE
    shift = int(frames.shift[row])
    cy, cx = int(np.floor(at[0] + 0.5 * (shift >> 1))), int(np.floor(at[1] + 0.5 * (shift & 1)))
    return _code_bit(frames, frames.primal_patterns[index], cy, cx)


def _dual_pixel(frames: Frames, row: int, index: int, at: tuple[float, float]) -> bool:
    """A point is open when a window over it is: those of the four sub-shifts cover the mask, once,
    or more often where they are larger than half a cell."""
    guard = GUARDS.get(frames.window, 0.0)
    covered = False
    for shift in range(4 if guard else 1):
        y, x = at[0] + 0.5 * (shift >> 1), at[1] + 0.5 * (shift & 1)
        cy, cx = int(np.floor(y)), int(np.floor(x))
        if not (guard <= y - cy < 1.0 - guard and guard <= x - cx < 1.0 - guard):
            continue
        if not covered and not (0 <= cy < frames.lattice[0] and 0 <= cx < frames.lattice[1]):
            return False  # the mask's cells end here
        covered = True
        if index in (BLACK, WHITE):
            return index == WHITE
        if int(frames.shift[row]) == shift:
            inside = cy < frames.lattice[0] and cx < frames.lattice[1]
            return inside and _code_bit(frames, frames.dual_patterns[index], cy, cx)
    assert covered, "no window covers this point"
    return False


def timeline(
    frames: Frames,
    log: FrameLog,
    panel: PanelOptics,
    open_ns: int,
    primal: bool,
    fine: int,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Timeline:
    shown = log.primal_shown if primal else log.dual_shown
    stamps = log.primal_ns if primal else log.dual_ns
    end = int(log.end_ns[0 if primal else 1])
    start = [0.0]
    on = [pixel_targets(frames, -1, fine, primal, offset)]
    for number, (row, stamp) in enumerate(zip(shown, stamps, strict=True)):
        start.append((int(stamp) + panel.skew_ns - open_ns) * 1e-9)
        on.append(pixel_targets(frames, int(row), fine, primal, offset))
        if log.dark_s is not None and number + 1 < len(stamps):
            dark_ns = round(1e9 * float(log.dark_s[number]))
            start.append((int(stamps[number + 1]) - dark_ns + panel.skew_ns - open_ns) * 1e-9)
            on.append(on[0])
    start.append((end + panel.skew_ns - open_ns) * 1e-9)
    on.append(on[0])
    return Timeline(np.array(start), np.array(on))


def _edges(a: Timeline, b: Timeline, exposure_s: float) -> Floats:
    edges = np.unique(np.concatenate([a.start_s, b.start_s, [0.0, exposure_s]]))
    return edges[(edges >= 0.0) & (edges <= exposure_s)]


def _at(track: Timeline, t: float) -> Bools:
    return np.asarray(track.on[np.flatnonzero(track.start_s <= t)[-1]])


def _generator(panel_m: PanelOptics, panel_i: PanelOptics, m_on: bool, i_on: bool) -> Floats:
    """d/dt of (1, m, i, m i, integral m i) for one pair of targets; instant panels excluded."""
    gm = 1.0 if m_on else panel_m.leak
    gi = 1.0 if i_on else panel_i.leak
    am = 1.0 / (panel_m.rise_s if m_on else panel_m.fall_s)
    ai = 1.0 / (panel_i.rise_s if i_on else panel_i.fall_s)
    a = np.zeros((5, 5))
    a[1, 0], a[1, 1] = am * gm, -am
    a[2, 0], a[2, 2] = ai * gi, -ai
    a[3, 1], a[3, 2], a[3, 3] = ai * gi, am * gm, -(am + ai)
    a[4, 3] = 1.0
    return a


def pair_integrals(
    primal: Timeline, dual: Timeline, panel_i: PanelOptics, panel_m: PanelOptics, exposure_s: float
) -> Floats:
    """(mask pixels, projector pixels) integrals of m i, by matrix exponentials; to rounding."""
    # Pixels that are asked the same at all times are followed once.
    lit, which_lit = np.unique(primal.on, axis=1, return_inverse=True)
    seen, which_seen = np.unique(dual.on, axis=1, return_inverse=True)
    primal, dual = Timeline(primal.start_s, lit), Timeline(dual.start_s, seen)
    pairs = _pairs(primal, dual, panel_i, panel_m, exposure_s)
    return np.asarray(pairs[np.ix_(which_seen.ravel(), which_lit.ravel())])


def _pairs(
    primal: Timeline, dual: Timeline, panel_i: PanelOptics, panel_m: PanelOptics, exposure_s: float
) -> Floats:
    instant = panel_i.rise_s == panel_i.fall_s == panel_m.rise_s == panel_m.fall_s == 0.0
    edges = _edges(primal, dual, exposure_s)
    nm, ni = dual.on.shape[1], primal.on.shape[1]
    if instant:
        total = np.zeros((nm, ni))
        for lo, hi in itertools.pairwise(edges):
            m = np.where(_at(dual, lo), 1.0, panel_m.leak)
            i = np.where(_at(primal, lo), 1.0, panel_i.leak)
            total += (hi - lo) * np.outer(m, i)
        return total
    state = np.zeros((5, nm, ni))
    state[0] = 1.0
    state[1], state[2], state[3] = panel_m.leak, panel_i.leak, panel_m.leak * panel_i.leak
    for lo, hi in itertools.pairwise(edges):
        m_on, i_on = _at(dual, lo), _at(primal, lo)
        new = np.empty_like(state)
        for m_lit, i_lit in itertools.product((False, True), repeat=2):
            where = np.ix_(
                np.arange(5), np.flatnonzero(m_on == m_lit), np.flatnonzero(i_on == i_lit)
            )
            step = expm(_generator(panel_m, panel_i, m_lit, i_lit) * (hi - lo))
            new[where] = np.tensordot(step, state[where], axes=1)
        state = new
    return np.asarray(state[4])


def cell_of(grid: tuple[int, int], fine: int) -> NDArray[np.int64]:
    rows, cols = grid
    y, x = np.divmod(np.arange(rows * cols * fine * fine), cols * fine)
    return np.asarray((y // fine) * cols + x // fine)


def to_cells(pairs: Floats, grid: tuple[int, int], fine: int) -> tuple[Floats, Floats]:
    """Cell means of the pair integrals (N, N), and the mean over each cell of their diagonal."""
    cell = cell_of(grid, fine)
    n = grid[0] * grid[1]
    mean = np.zeros((n, cell.size))
    mean[cell, np.arange(cell.size)] = 1.0 / fine**2
    return mean @ pairs @ mean.T, mean @ np.diag(pairs)
