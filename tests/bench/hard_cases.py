"""What is hard for arithmetic, and for memory: errors against independent references."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pdcd.codes.make import make_codes
from tests import hard_cases
from tests.bench.measure import alone, peak_mib
from tests.bench.tables import Aim, Section, Table, grid_name, seconds
from tests.hard_cases.case import measured

CODE_LIMITS = (((48, 64), 512, 1.0, 2048.0), ((192, 256), 4096, 30.0, 2048.0))
"""Cells, Hadamard codes, and the most time in s and memory in MiB that making them may take."""


def table() -> list[dict[str, Any]]:
    """Run all cases: name, error, measure, reference, bound, naive, naive_error of each."""
    return [asdict(measured(case)) for case in hard_cases.ALL]


def codes(*, grid: tuple[int, int], count: int) -> dict[str, float]:
    """Time in s and peak memory in MiB of making coloured Hadamard codes, in this process."""
    begun_s = time.perf_counter()
    make_codes("hadamard", (grid[0], grid[1]), count, dual="complement", seed=1)
    return {"time_s": time.perf_counter() - begun_s, "peak_mib": peak_mib()}


def run(*, quick: bool, folder: Path) -> Section:
    """Measure everything; there are no plots, so nothing goes to `folder`."""
    heads = ("case", "error", "bound", "measured", "against", "the plain way")
    cases = Table("Hard cases", heads)
    worst = 0.0
    for row in table():
        plain = f"{row['naive']}: {row['naive_error']:.1e}" if row["naive"] else ""
        figures = f"{row['error']:.1e}", f"{row['bound']:.0e}"
        cases.add(row["name"], *figures, row["measure"], row["reference"], plain)
        worst = max(worst, row["error"] / row["bound"] if row["bound"] else float(row["error"] > 0))
    made, aims = _codes(CODE_LIMITS[:1] if quick else CODE_LIMITS)
    return Section(
        title="Hard cases",
        text=(
            "Each case has a reference that shares no formula with the program, and a bound that "
            "the tests assert. The plain way is what the case is hard for; it exceeds the bound."
        ),
        tables=[cases, made],
        aims=[Aim("worst hard case, share of its bound", "", worst, 1.0), *aims],
    )


def _codes(
    limits: tuple[tuple[tuple[int, int], int, float, float], ...],
) -> tuple[Table, list[Aim]]:
    made = Table("Coloured codes, each set in a process of its own", ("cells", "K", "time", "peak"))
    aims = []
    for grid, count, limit_s, limit_mib in limits:
        got = alone("hard_cases:codes", grid=grid, count=count)
        name = f"{count} coloured codes, {grid_name(grid)} cells"
        made.add(grid_name(grid), str(count), seconds(got["time_s"]), f"{got['peak_mib']:.0f} MiB")
        aims += [
            Aim(name, "s", got["time_s"], limit_s),
            Aim(f"{name}: memory", "MiB", got["peak_mib"], limit_mib),
        ]
    return made, aims
