"""How a whole capture grows with the cells of the grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.bench import plots
from tests.bench.measure import REPEATS, alone
from tests.bench.tables import Aim, Section, Table, grid_name, seconds

GRIDS = ((48, 64), (96, 128), (192, 256))
LIMITS_S = (0.5, 1.5, 6.0)
LIMIT_MIB = 1024.0
COUNT, WINDOW = 128, "whole"

Found = dict[tuple[int, int], dict[str, float]]
"""time_s and peak_mib of each grid."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure each capture in a process of its own."""
    found: Found = {
        grid: alone("captures:measure_engine", grid=grid, count=COUNT, window=WINDOW)
        for grid in (GRIDS[:2] if quick else GRIDS)
    }
    _plot(found, folder / "growth.png")
    return Section(
        title="Growth with the cells",
        text=(
            f"A default indirect capture of {COUNT} codes through whole windows with its white "
            "companion, in process, as above. The slope is that of time over cells on logarithmic "
            "scales: 1 is linear, 2 is quadratic. Medians "
            f"of {REPEATS}, or one capture where it takes more than 2 s."
        ),
        tables=[_table(found)],
        plots=[("growth.png", "Time of a whole capture over the cells of the grid.")],
        aims=_aims(found),
    )


def _aims(found: Found) -> list[Aim]:
    aims = []
    for grid, limit_s in zip(GRIDS, LIMITS_S, strict=True):
        if grid in found:
            what = f"capture, {grid_name(grid)} cells, {COUNT} codes, {WINDOW} windows"
            aims.append(Aim(what, "s", found[grid]["time_s"], limit_s))
            aims.append(Aim(f"{what}: peak memory", "MiB", found[grid]["peak_mib"], LIMIT_MIB))
    return aims


def _table(found: Found) -> Table:
    table = Table("A capture on finer grids", ("cells", "time", "peak memory"))
    for grid, one in found.items():
        table.add(grid_name(grid), seconds(one["time_s"]), f"{one['peak_mib']:.0f} MiB")
    table.add("slope", _slope(found), "")
    return table


def _points(found: Found) -> tuple[list[float], list[float]]:
    """Cells and seconds of the captures."""
    return [float(rows * cols) for rows, cols in found], [one["time_s"] for one in found.values()]


def _slope(found: Found) -> str:
    cells, times = _points(found)
    return f"{np.polyfit(np.log(cells), np.log(times), 1)[0]:.2f}"


def _plot(found: Found, path: Path) -> None:
    figure, (axes,) = plots.panels(1)
    axes.plot(*_points(found), marker="o", color=plots.colour(0), label=f"slope {_slope(found)}")
    title = f"Whole capture of {COUNT} codes, {WINDOW} windows"
    plots.finish(axes, title, "cells of the grid", "wall time in s")
    plots.legend(axes)
    plots.save(figure, path)
