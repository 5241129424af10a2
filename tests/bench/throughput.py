"""How fast codes are made, and RAW files written and read."""

from __future__ import annotations

import tempfile
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from drivers.mock.dng import write_dng
from pdcd.codes import FAMILIES, make_codes
from pdcd.lattice import Lattice
from pdcd.raw import read_raw
from tests.bench import plots
from tests.bench.measure import REPEATS, timed
from tests.bench.tables import Section, Table, grid_name, seconds

GRIDS = ((48, 64), (96, 128))
COUNTS = (8, 128, 1024)
SIZES_PX = ((1280, 960), (4272, 2848))
"""Width and height of the RAW files: a small sensor, and the camera of the paper."""
BLACK_DN, WHITE_DN = 512, 16383
MIB = 2**20

CodeTimes = dict[tuple[str, tuple[int, int], int], float]


def run(*, quick: bool, folder: Path) -> Section:
    """Measure in this process; plots go to `folder`."""
    code_s: CodeTimes = {}
    for grid in GRIDS[:1] if quick else GRIDS:
        lattice = Lattice(grid, "quarter").shape
        for family in FAMILIES:
            for count in COUNTS:
                make = partial(make_codes, family, lattice, count, dual="complement", seed=1)
                code_s[family, grid, count] = timed(make)[0]
    _plot(code_s, folder / "codes.png")
    return Section(
        title="Codes and RAW files",
        text=(
            "Codes for quarter windows, primal and dual, packed. `hadamard` spends its time on "
            "giving equal columns to cells far apart; that is done for the lattice as a whole and "
            "grows with the cells, not with K. RAW files are uncompressed 14-bit mosaics in DNG, "
            "written to the temporary folder and read back through LibRaw, with their SHA-256 left "
            f"out. Medians of {REPEATS}."
        ),
        tables=[_code_table(code_s), _raw_table()],
        plots=[("codes.png", "Time to make a set of codes.")],
    )


def _code_table(code_s: CodeTimes) -> Table:
    table = Table("Time to make all codes, and codes a second", ("cells", "K", *FAMILIES))
    for grid, count in dict.fromkeys(key[1:] for key in code_s):
        times = [code_s[family, grid, count] for family in FAMILIES]
        cells = [f"{seconds(t)}, {count / t:.3g}/s" for t in times]
        table.add(grid_name(grid), str(count), *cells)
    return table


def _raw_table() -> Table:
    table = Table("RAW files", ("pixels", "size", "write", "read and decode"))
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photo.dng"
        for width, height in SIZES_PX:
            mosaic = rng.integers(BLACK_DN, WHITE_DN, size=(height, width), dtype=np.uint16)
            write = partial(
                write_dng,
                path,
                mosaic,
                black=BLACK_DN,
                white=WHITE_DN,
                iso=100,
                exposure_s=1.0,
                f_number=8.0,
                model="bench",
                date=datetime(2012, 8, 5, tzinfo=UTC),
            )
            write_s, size = timed(write)
            read_s, _ = timed(partial(read_raw, path))
            table.add(
                f"{width}x{height}",
                f"{size / MIB:.1f} MiB",
                f"{seconds(write_s)}, {size / MIB / write_s:.0f} MiB/s",
                f"{seconds(read_s)}, {size / MIB / read_s:.0f} MiB/s",
            )
    return table


def _plot(code_s: CodeTimes, path: Path) -> None:
    figure, (axes,) = plots.panels(1)
    for grid, style in zip(dict.fromkeys(key[1] for key in code_s), ("-", "--"), strict=False):
        for index, family in enumerate(FAMILIES):
            times = [code_s[family, grid, count] for count in COUNTS]
            label = f"{family}, {grid_name(grid)} cells"
            axes.plot(COUNTS, times, style, marker="o", color=plots.colour(index), label=label)
    plots.finish(axes, "Time to make a set of codes", "number of codes K", "wall time in s")
    plots.legend(axes)
    plots.save(figure, path)
