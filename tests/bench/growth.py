"""How a whole capture grows with the cells of the grid, beside the version before it was linear."""

from __future__ import annotations

import io
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tests.bench import plots
from tests.bench.measure import REPEATS, alone_in
from tests.bench.tables import Aim, Section, Table, grid_name, seconds
from tests.places import ROOT
from tests.tools import find

BEFORE = "47b8d4c79855988312ae644ff6de8e55a17d6bbe"
"""Last commit at which a capture looked at every pair of cells."""
GRIDS = ((48, 64), (96, 128), (192, 256))
LIMITS_S = (0.5, 1.5, 6.0)
LIMIT_MIB = 1024.0
COUNT, WINDOW = 128, "whole"
TIMEOUT_S = 300.0
"""What takes longer is given up."""

Grid = tuple[int, int]
Found = dict[Grid, dict[str, float] | None]
"""time_s and peak_mib of each grid; None where it was given up."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure both versions, each capture in a process of its own."""
    grids = GRIDS[:2] if quick else GRIDS
    now = {grid: _measure(ROOT, grid) for grid in grids}
    before: Found = {}
    absent = "The version before was left out of this quick run."
    if not quick:
        with _checkout(BEFORE) as root:
            before = {} if root is None else {grid: _measure(root, grid) for grid in grids}
        absent = f"Commit {BEFORE[:7]} is not in this clone, so that it could not be measured."
    _plot(now, before, folder / "growth.png")
    note = "" if before else absent
    return Section(
        title="Growth with the cells",
        text=(
            f"A default indirect capture of {COUNT} codes through whole windows with its white "
            "companion, in process, as above. *Before* is commit "
            f"{BEFORE[:7]}, unpacked and measured in this same run: its report and its modelled "
            "sigma looked at every pair of cells, and so did each cell for its code. The slope is "
            "that of time over cells on logarithmic scales: 1 is linear, 2 is quadratic. Medians "
            f"of {REPEATS}, or one capture where it takes more than 2 s."
        ),
        tables=[_table(now, before, note)],
        plots=[("growth.png", "Time of a whole capture over the cells of the grid.")],
        aims=_aims(now),
    )


def _measure(root: Path, grid: Grid) -> dict[str, float] | None:
    try:
        found: dict[str, float] = alone_in(
            root, "captures:measure_engine", TIMEOUT_S, grid=grid, count=COUNT, window=WINDOW
        )
    except subprocess.TimeoutExpired:
        return None
    return found


@contextmanager
def _checkout(commit: str) -> Iterator[Path | None]:
    """A folder with the project as it was at a commit; None where git does not have it."""
    git = find("git").path
    command = [git or "git", "archive", "--format=tar", commit]
    archive = subprocess.run(command, cwd=ROOT, capture_output=True, check=False) if git else None
    if archive is None or archive.returncode != 0:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
            files.extractall(folder, filter="data")
        yield Path(folder)


def _aims(now: Found) -> list[Aim]:
    aims = []
    for grid, limit_s in zip(GRIDS, LIMITS_S, strict=True):
        if grid not in now:
            continue
        found = now[grid] or {"time_s": np.inf, "peak_mib": np.inf}
        what = f"capture, {grid_name(grid)} cells, {COUNT} codes, {WINDOW} windows"
        aims.append(Aim(what, "s", found["time_s"], limit_s))
        aims.append(Aim(f"{what}: peak memory", "MiB", found["peak_mib"], LIMIT_MIB))
    return aims


def _table(now: Found, before: Found, note: str) -> Table:
    heads = ("cells", "time", "peak memory", "before", "its peak memory")
    table = Table("A capture on finer grids", heads, note=note)
    for grid, found in now.items():
        old = before.get(grid)
        gone = (f"over {TIMEOUT_S:.0f} s", "") if grid in before else ("", "")
        table.add(grid_name(grid), *_cells(found), *(gone if old is None else _cells(old)))
    table.add("slope", _slope(now), "", _slope(before), "")
    return table


def _cells(found: dict[str, float] | None) -> tuple[str, str]:
    if found is None:
        return f"over {TIMEOUT_S:.0f} s", ""
    return seconds(found["time_s"]), f"{found['peak_mib']:.0f} MiB"


def _points(found: Found) -> tuple[list[float], list[float]]:
    """Cells and seconds of the captures that ended."""
    ended = [(grid[0] * grid[1], value["time_s"]) for grid, value in found.items() if value]
    return [float(cells) for cells, _ in ended], [time_s for _, time_s in ended]


def _slope(found: Found) -> str:
    cells, times = _points(found)
    if len(cells) < 2:
        return ""
    return f"{np.polyfit(np.log(cells), np.log(times), 1)[0]:.2f}"


def _plot(now: Found, before: Found, path: Path) -> None:
    figure, (axes,) = plots.panels(1)
    for index, (name, found) in enumerate((("now", now), (f"before ({BEFORE[:7]})", before))):
        if found:
            label = f"{name}, slope {_slope(found)}"
            axes.plot(*_points(found), marker="o", color=plots.colour(index), label=label)
    title = f"Whole capture of {COUNT} codes, {WINDOW} windows"
    plots.finish(axes, title, "cells of the grid", "wall time in s")
    plots.legend(axes)
    plots.save(figure, path)
