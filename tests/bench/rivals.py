"""Error and time of three ways to one matrix, as they are measured in a process of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.probing.realised import collect_factors
from tests import oracles
from tests.bench.cases import Case, make_case
from tests.bench.measure import peak_mib, timed
from tests.bench.photo import exposure
from tests.bench.slow_ways import dense, intervals, stepped

Floats = NDArray[np.float64]
Realised = tuple[Floats, Floats]
"""The matrix between cells (N, N), and the direct light's own diagonal (N,), in seconds."""

PICKED = 12
"""Cells whose pixels the exact reference follows; all pairs of them are compared."""
REFRESHES_PER_S = 60.0
FIRST_STEPS = 16


def measure_way(
    way: str, grid: tuple[int, int], count: int, window: str, limit_s: float
) -> list[dict[str, Any]]:
    """Time, peak and error of one way; time steps are halved until a run takes `limit_s`.

    What the pixels are asked to show is laid out before the clock starts for the two slow ways,
    and within the measured time for the closed form.
    """
    case = make_case((grid[0], grid[1]), count, window, "defects")
    # Pixels of a quarter of a cell resolve the windows, but not an offset of the mask.
    case = replace(case, bench=replace(case.bench, offset_cells=(0.0, 0.0)))
    fine = 4 if window == "quarter" else 1
    primal, dual = _timelines(case, fine)
    exposure_s = case.close_ns * 1e-9
    wanted = _reference(case, primal, dual, fine)
    optics = (case.bench.primal, case.bench.dual)
    cuts = intervals(primal, dual, exposure_s)
    if way == "closed form":
        return [_measured(lambda: _closed_form(case), wanted, case)]
    if way == "dense":
        return [_measured(lambda: _cells(dense(cuts, *optics), case, fine), wanted, case)]

    def step(steps: int) -> Realised:
        return _cells(stepped(cuts, *optics, steps * REFRESHES_PER_S), case, fine)

    found: list[dict[str, Any]] = []
    steps = FIRST_STEPS
    while not found or found[-1]["time_s"] < limit_s:
        found.append({**_measured(partial(step, steps), wanted, case), "steps": steps})
        steps *= 2
    return found


def _measured(run: Callable[[], Realised], wanted: Realised, case: Case) -> dict[str, Any]:
    """Time, peak memory, and the largest error relative to the largest entry."""
    time_s, (matrix, direct) = timed(run)
    picked = _picked(case)
    wrong = max(
        float(np.abs(matrix[np.ix_(picked, picked)] - wanted[0]).max()),
        float(np.abs(direct[picked] - wanted[1]).max()),
    )
    return {"time_s": time_s, "peak_mib": peak_mib(), "error": wrong / float(wanted[0].max())}


def _closed_form(case: Case) -> Realised:
    whole = collect_factors(exposure(case))
    return whole.dense(), whole.coaxial


def _timelines(case: Case, fine: int) -> tuple[oracles.Timeline, oracles.Timeline]:
    bench = case.bench
    return (
        oracles.timeline(case.frames, case.log, bench.primal, 0, True, fine),
        oracles.timeline(case.frames, case.log, bench.dual, 0, False, fine),
    )


def _picked(case: Case) -> NDArray[np.int64]:
    cells = case.frames.grid[0] * case.frames.grid[1]
    return np.linspace(0, cells - 1, PICKED).astype(np.int64)


def _reference(case: Case, primal: oracles.Timeline, dual: oracles.Timeline, fine: int) -> Realised:
    """Matrix exponentials for all pairs of pixels of the picked cells."""
    cell = oracles.cell_of(case.frames.grid, fine)
    pixels = np.concatenate([np.flatnonzero(cell == c) for c in _picked(case)])
    pairs = oracles.pair_integrals(
        oracles.Timeline(primal.start_s, primal.on[:, pixels]),
        oracles.Timeline(dual.start_s, dual.on[:, pixels]),
        case.bench.primal,
        case.bench.dual,
        case.close_ns * 1e-9,
    )
    blocks = pairs.reshape(PICKED, fine**2, PICKED, fine**2).mean(axis=(1, 3))
    return blocks, np.diag(pairs).reshape(PICKED, fine**2).mean(axis=1)


def _cells(pairs: Floats, case: Case, fine: int) -> Realised:
    """Means over cells of a matrix between pixels (row-major over the whole panel)."""
    if fine == 1:
        return pairs, np.diag(pairs).copy()
    rows, cols = case.frames.grid
    split = (rows, fine, cols, fine)
    half = pairs.reshape(*split, -1).mean(axis=(1, 3)).reshape(rows * cols, *split)
    direct = np.diag(pairs).reshape(split).mean(axis=(1, 3)).ravel()
    return half.mean(axis=(2, 4)).reshape(rows * cols, rows * cols), direct
