"""Whole captures: over the socket against their aims, and in process over grid and K."""

from __future__ import annotations

from pathlib import Path

from pdcd.bench.tables import DEFAULT_GRID
from tests.bench import plots
from tests.bench.captures import measure_help, measure_socket
from tests.bench.cases import GRIDS
from tests.bench.measure import REPEATS, alone
from tests.bench.photo import SCENE
from tests.bench.tables import Aim, Section, Table, grid_name, seconds

COUNTS = (8, 128, 512)
MAX_SIZE = 3072 * 512
"""Cells times codes of the largest case that this run has time for."""
WINDOWS = ("whole", "quarter")
SOCKET_COUNT, SOCKET_WINDOW = 128, "quarter"
CELLS = grid_name(DEFAULT_GRID)
HELP_REPEATS = 10
SOCKET_LIMIT_S, HELP_LIMIT_S, HELLO_LIMIT_S = 3.0, 0.150, 1.0

Found = dict[tuple[str, tuple[int, int], int], dict[str, float]]
"""(window, grid, K) -> time_s, peak_mib."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure the daemon, the command line, and the engine in processes of its own."""
    socket = measure_socket(SOCKET_COUNT, SOCKET_WINDOW)
    help_s = measure_help(HELP_REPEATS)
    grids, counts = (GRIDS[:3:2], COUNTS[:2]) if quick else (GRIDS, COUNTS)
    found: Found = {
        (window, grid, count): alone(
            "captures:measure_engine", grid=grid, count=count, window=window
        )
        for window in WINDOWS
        for grid in grids
        for count in counts
        if grid[0] * grid[1] * count <= MAX_SIZE
    }
    _plot(found, folder / "capture.png")
    ends = Table("From the shell", ("what", "time", "peak memory"))
    name = f"{SOCKET_COUNT} codes, {SOCKET_WINDOW} windows, over the socket"
    ends.add(f"capture, {name}", seconds(socket["time_s"]), f"{socket['peak_mib']:.0f} MiB")
    ends.add("`pdcd serve` to its first words", seconds(socket["hello_s"]), "")
    ends.add("`pdcd --help`", seconds(help_s), "")
    return Section(
        title="Whole captures",
        text=(
            f"An indirect capture of the scene `{SCENE}` on the mock bench, with full sensor noise "
            "and a virtual clock: metering, the indirect shot and its white companion, RAW files "
            "written and decoded, error maps, the report, previews, all files hashed and made "
            "durable. Cells of 128x96 and 256x192 do not end on the pixels of both panels here, so "
            "that three more photos show light along their borders, which the virtual bench "
            "computes pixel by pixel. From the shell: a real `pdcd serve`, timed from a request "
            f"to its answer at {CELLS} cells; the peak memory is the daemon's, and its first "
            "words come when the rig is open. Times are medians of "
            f"{REPEATS}, that of `--help` of {HELP_REPEATS}."
        ),
        tables=[ends, _table(found)],
        plots=[("capture.png", "Time of a whole capture in process.")],
        aims=[
            Aim(f"capture, {CELLS} cells, {name}", "s", socket["time_s"], SOCKET_LIMIT_S),
            Aim("`pdcd --help`", "s", help_s, HELP_LIMIT_S),
            Aim("`pdcd serve` to its first words", "s", socket["hello_s"], HELLO_LIMIT_S),
        ],
    )


def _table(found: Found) -> Table:
    table = Table(
        "A capture in process: time, peak memory",
        ("cells", "K", *(f"{w} windows" for w in WINDOWS)),
    )
    for grid, count in dict.fromkeys(key[1:] for key in found):
        values = [found[window, grid, count] for window in WINDOWS]
        cells = [f"{seconds(v['time_s'])}, {v['peak_mib']:.0f} MiB" for v in values]
        table.add(grid_name(grid), str(count), *cells)
    return table


def _plot(found: Found, path: Path) -> None:
    figure, (axes,) = plots.panels(1)
    for window, style in zip(WINDOWS, ("--", "-"), strict=True):
        for index, grid in enumerate(dict.fromkeys(key[1] for key in found)):
            counts = [key[2] for key in found if key[:2] == (window, grid)]
            times = [found[window, grid, count]["time_s"] for count in counts]
            label = f"{grid_name(grid)} cells, {window}"
            axes.plot(counts, times, style, **plots.style(index, label=label))
    plots.limit(
        axes, SOCKET_LIMIT_S, f"{SOCKET_LIMIT_S:g} s for {CELLS}, {SOCKET_COUNT}, {SOCKET_WINDOW}"
    )
    title = "Whole capture on the mock bench, in process"
    plots.finish(axes, title, "number of codes K", "wall time in s")
    plots.legend(axes)
    plots.save(figure, path)
