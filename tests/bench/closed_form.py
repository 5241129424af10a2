"""How long the realised probing matrix and a photo take, and how much memory, over grid and K."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.bench import plots
from tests.bench.cases import COUNTS, GRIDS
from tests.bench.measure import alone
from tests.bench.photo import SCENE
from tests.bench.tables import Aim, Section, Table, grid_name, seconds

VARIANTS = (
    ("whole", "ideal"),
    ("whole", "defects"),
    ("quarter", "ideal"),
    ("quarter", "defects"),
)
AIM_GRID, AIM_COUNT, AIM_S, AIM_MIB = (48, 64), 128, 1.0, 1024.0

NOT_RUN = "-"
MAX_STREAMED = 12288 * 512
MAX_KEPT = 3072 * 512
"""Largest cells times codes that this run has time for, streamed and kept."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure all cases, one process each; plots go to `folder`."""
    grids, counts = (GRIDS[:3], (8, 128)) if quick else (GRIDS, COUNTS)
    found: dict[tuple[str, str, tuple[int, int], int], dict[str, Any]] = {}
    for window, panels in VARIANTS:
        for grid in grids:
            for count in counts:
                size = grid[0] * grid[1] * count
                if size > MAX_STREAMED:
                    continue
                found[window, panels, grid, count] = alone(
                    "photo:measure_case",
                    grid=grid,
                    count=count,
                    window=window,
                    panels=panels,
                    kept=size <= MAX_KEPT,
                )
    tables = [
        _table(found, "streamed", "Photo of the scene, the matrix streamed through in chunks"),
        _table(found, "kept", "The whole realised probing matrix, and a photo from it"),
    ]
    _plot(found, folder / "closed-form.png")
    base = max(values["base_mib"] for values in found.values())
    aimed = found["quarter", "defects", AIM_GRID, AIM_COUNT]
    name = f"{grid_name(AIM_GRID)} cells, {AIM_COUNT} codes x 4 shifts, every defect"
    return Section(
        title="The realised probing matrix in closed form",
        text=(
            f"Each row is one guarded exposure of the scene `{SCENE}`: three refreshes a code with "
            'whole windows, twelve with quarter windows. "Ideal" panels switch at once and lie '
            'exactly on each other; "defects" have unequal rise and fall, leaking blacks, skew, '
            "jitter and a misregistered mask, all at once. Streaming is what the mock camera does "
            "and needs memory for one chunk only; keeping the whole matrix is what decoding does "
            'for its report. Cells that read "-" would have taken more than their '
            f"share of this run. Peaks are of the whole process, of which up to {base:.0f} MiB were taken before "
            "(interpreter, libraries, the scene, the codes)."
        ),
        tables=tables,
        plots=[("closed-form.png", "Time and memory over the number of codes, quarter windows.")],
        aims=[
            Aim(f"Π̂ + photo, {name}", "s", aimed["kept_s"], AIM_S),
            Aim(f"peak memory of Π̂ + photo, {name}", "MiB", aimed["kept_mib"], AIM_MIB),
        ],
    )


def _table(
    found: dict[tuple[str, str, tuple[int, int], int], dict[str, Any]], route: str, title: str
) -> Table:
    heads = ["cells", "K", *(f"{window}, {panels}" for window, panels in VARIANTS)]
    table = Table(f"{title}: median time of 3, peak memory", tuple(heads))
    for grid, count in sorted({key[2:] for key in found}):
        cells = [
            _cell(found.get((window, panels, grid, count), {}), route)
            for window, panels in VARIANTS
        ]
        if any(cell != NOT_RUN for cell in cells):
            table.add(grid_name(grid), str(count), *cells)
    return table


def _cell(values: dict[str, Any], route: str) -> str:
    if f"{route}_s" not in values:
        return NOT_RUN
    return f"{seconds(values[f'{route}_s'])}, {values[f'{route}_mib']:.0f} MiB"


def _plot(found: dict[tuple[str, str, tuple[int, int], int], dict[str, Any]], path: Path) -> None:
    figure, (left, right) = plots.panels(2)
    for grid in sorted({key[2] for key in found}):
        colour = plots.colour(grid[0])
        for panels, style in (("ideal", "--"), ("defects", "-")):
            counts = [k[3] for k in found if k[:3] == ("quarter", panels, grid)]
            values = [found["quarter", panels, grid, count] for count in counts]
            label = f"{grid_name(grid)} cells, {panels}"
            times = [v["streamed_s"] for v in values]
            peaks = [v["streamed_mib"] for v in values]
            left.plot(counts, times, style, marker="o", color=colour, label=label)
            right.plot(counts, peaks, style, marker="o", color=colour, label=label)
    left.axhline(AIM_S, color="grey", lw=0.8)
    right.axhline(AIM_MIB, color="grey", lw=0.8)
    plots.finish(left, "Time of Π̂ and a photo, streamed", "number of codes K", "wall time in s")
    plots.finish(right, "Peak memory of the process", "number of codes K", "peak memory in MiB")
    left.legend(fontsize=7)
    plots.save(figure, path)
