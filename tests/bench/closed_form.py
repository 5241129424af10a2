"""How long the realised probing matrix and a photo take, and how much memory, over grid and K."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.bench import plots
from tests.bench.cases import COUNTS, GRIDS
from tests.bench.measure import LONG_S, REPEATS, alone
from tests.bench.photo import SCENE
from tests.bench.tables import Aim, Section, Table, grid_name, seconds

Key = tuple[str, str, tuple[int, int], int]
"""Window, panels, grid, number of codes."""
Found = dict[Key, dict[str, Any]]

VARIANTS = (
    ("whole", "ideal"),
    ("whole", "defects"),
    ("quarter", "ideal"),
    ("quarter", "defects"),
)
AIM_GRID, AIM_COUNT, AIM_S, AIM_MIB = (48, 64), 128, 1.0, 1024.0

NOT_RUN = "-"
MAX_KEPT = 3072 * 512 * 12
"""Cells times rank-1 terms of the largest case that this run has time to keep whole."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure all cases, one process each; plots go to `folder`."""
    grids, counts = (GRIDS[1:3], (8, 128)) if quick else (GRIDS, COUNTS)
    found: Found = {}
    for window, panels in VARIANTS:
        for grid in grids:
            for count in counts:
                found[window, panels, grid, count] = alone(
                    "photo:measure_case",
                    grid=grid,
                    count=count,
                    window=window,
                    panels=panels,
                    kept=_work(grid, count, window, panels) <= MAX_KEPT,
                )
    tables = [
        _table(found, "streamed", "Photo of the scene, the matrix streamed through in chunks"),
        _table(found, "kept", "The whole realised probing matrix, and a photo from it"),
    ]
    _plot(found, folder / "closed-form.png")
    peak = max(values["streamed_mib"] for values in found.values())
    base = max(values["base_mib"] for values in found.values())
    aimed = found["quarter", "defects", AIM_GRID, AIM_COUNT]
    name = f"{grid_name(AIM_GRID)} cells, {AIM_COUNT} codes x 4 shifts, every defect"
    return Section(
        title="The realised probing matrix in closed form",
        text=(
            f"Each row is one guarded exposure of the scene `{SCENE}`: three refreshes a code with "
            'whole windows, twelve with quarter windows. "Ideal" panels switch at once and lie '
            'exactly on each other; "defects" have unequal rise and fall, leaking blacks, skew, '
            "jitter and a misregistered mask, all at once. Streaming is what the mock camera does: "
            "its memory holds one chunk, whatever the number of codes. Keeping the whole matrix is "
            "what decoding does for its report; it is reduced to the number of cells when there "
            f'are more codes than that. Cells that read "{NOT_RUN}" would have taken more than '
            f"their share of this run; times above {LONG_S:g} s are of one run, all others the "
            f"median of {REPEATS}. Peaks are of the whole process, of which up to {base:.0f} MiB "
            "were taken before (interpreter, libraries, the scene, the codes). The highest peak of "
            f"all streamed cases of this run was {peak:.0f} MiB."
        ),
        tables=tables,
        plots=[("closed-form.png", "Time and memory over the number of codes, quarter windows.")],
        aims=[
            Aim(f"Π̂ + photo, {name}", "s", aimed["kept_s"], AIM_S),
            Aim(f"peak memory of Π̂ + photo, {name}", "MiB", aimed["kept_mib"], AIM_MIB),
        ],
    )


def _work(grid: tuple[int, int], count: int, window: str, panels: str) -> int:
    """Cells times the rank-1 terms that the exposure's matrix has before it is reduced."""
    shifts = 4 if window == "quarter" else 1
    fields = 3 if panels == "defects" else 1
    return grid[0] * grid[1] * count * shifts * fields


def _table(found: Found, route: str, title: str) -> Table:
    heads = ("cells", "K", *(f"{window}, {panels}" for window, panels in VARIANTS))
    table = Table(f"{title}: time, peak memory", heads)
    for grid, count in sorted({key[2:] for key in found}):
        cells = [_cell(found[window, panels, grid, count], route) for window, panels in VARIANTS]
        if set(cells) != {NOT_RUN}:
            table.add(grid_name(grid), str(count), *cells)
    return table


def _cell(values: dict[str, Any], route: str) -> str:
    if f"{route}_s" not in values:
        return NOT_RUN
    return f"{seconds(values[f'{route}_s'])}, {values[f'{route}_mib']:.0f} MiB"


def _plot(found: Found, path: Path) -> None:
    figure, (left, right) = plots.panels(2)
    for index, grid in enumerate(sorted({key[2] for key in found})):
        for panels, style in (("ideal", "--"), ("defects", "-")):
            counts = [key[3] for key in found if key[:3] == ("quarter", panels, grid)]
            values = [found["quarter", panels, grid, count] for count in counts]
            how = plots.style(index, label=f"{grid_name(grid)} cells, {panels}")
            left.plot(counts, [v["streamed_s"] for v in values], style, **how)
            right.plot(counts, [v["streamed_mib"] for v in values], style, **how)
    plots.limit(left, AIM_S, f"{AIM_S:g} s")
    plots.limit(right, AIM_MIB, f"{AIM_MIB:g} MiB")
    plots.finish(
        left,
        r"Time of $\hat{\Pi}$ and a photo, streamed, quarter windows",
        "number of codes K",
        "wall time in s",
    )
    plots.finish(right, "Peak memory of the process", "number of codes K", "peak memory in MiB")
    plots.legend(right)
    plots.save(figure, path)
