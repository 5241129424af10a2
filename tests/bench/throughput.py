"""How fast codes are made, and RAW files written and read."""

from __future__ import annotations

import tempfile
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import rawpy

from pdcd.codes.make import CODE_FAMILIES, make_codes
from pdcd.panels.lattice import Lattice
from pdcd.sensor.raw import read_raw
from tests.bench import plots
from tests.bench.measure import REPEATS, timed
from tests.bench.tables import Aim, Section, Table, grid_name, seconds
from tests.cr2 import SIZE_450D, write_cr2
from tests.dng_file import write_dng

GRIDS = ((48, 64), (96, 128))
COUNTS = (8, 128, 1024)
SIZES_PX = ((1280, 960), (4272, 2848))
"""Width and height of the RAW files: a small sensor, and the camera of the paper."""
BLACK_DN, WHITE_DN = 512, 16383
MIB = 2**20

TIMED = tuple(family for family in CODE_FAMILIES if family != "singer")
"""Singer sets are of other numbers of codes, and of lines that are only looked up."""

CodeTimes = dict[tuple[str, tuple[int, int], int], float]


def run(*, quick: bool, folder: Path) -> Section:
    """Measure in this process; plots go to `folder`."""
    code_s: CodeTimes = {}
    for grid in GRIDS[:1] if quick else GRIDS:
        lattice = Lattice(grid, "quarter").shape
        for family in TIMED:
            for count in COUNTS:
                make = partial(make_codes, family, lattice, count, dual="complement", seed=1)
                code_s[family, grid, count] = timed(make)[0]
    _plot(code_s, folder / "codes.png")
    raw_table, raw_aims = _raw()
    return Section(
        title="Codes and RAW files",
        text=(
            "Codes for quarter windows, primal and dual, packed. `hadamard` spends its time on "
            "giving equal columns to cells far apart; that is done for the lattice as a whole and "
            "grows with the cells, not with K. RAW files are uncompressed 14-bit mosaics in DNG, "
            "written to the temporary folder and read back through LibRaw, with their SHA-256 left "
            "out; the CR2 is compressed, as Canon's are, and holds a grey surface with noise of 20 "
            "DN. AHD is the whole way that LibRaw goes to a picture of the same file, linear, "
            f"demosaiced. Medians of {REPEATS}."
        ),
        tables=[_code_table(code_s), raw_table],
        aims=raw_aims,
        plots=[("codes.png", "Time to make a set of codes.")],
    )


def _code_table(code_s: CodeTimes) -> Table:
    table = Table("Time to make all codes, and codes a second", ("cells", "K", *TIMED))
    for grid, count in dict.fromkeys(key[1:] for key in code_s):
        times = [code_s[family, grid, count] for family in TIMED]
        cells = [f"{seconds(t)}, {count / t:.3g}/s" for t in times]
        table.add(grid_name(grid), str(count), *cells)
    return table


def _raw() -> tuple[Table, list[Aim]]:
    heads = ("file", "size", "write", "read and decode", "LibRaw to AHD")
    table = Table("RAW files", heads)
    rng = np.random.default_rng(1)
    aims: list[Aim] = []
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
            write_s, _ = timed(write)
            read_s, ahd_s = _read_row(table, f"DNG {width}x{height}", path, write_s)
        aims.append(Aim(f"DNG {width}x{height} to linear planes", "s", read_s, 0.15))
        aims.append(Aim("the same as a share of LibRaw's way by AHD", "", read_s / ahd_s, 0.25))
        path = Path(folder) / "photo.cr2"
        grey = rng.normal(4000.0, 20.0, SIZE_450D).astype(np.uint16)
        write_s, _ = timed(partial(write_cr2, path, grey))
        name = f"CR2 {SIZE_450D[1]}x{SIZE_450D[0]}"
        read_s, _ = _read_row(table, name, path, write_s)
        aims.append(Aim(f"{name}, compressed as Canon does, to linear planes", "s", read_s, 0.15))
    return table, aims


def _read_row(table: Table, name: str, path: Path, write_s: float) -> tuple[float, float]:
    """Times of both ways to read a file, also put into the table."""
    size = path.stat().st_size
    read_s, _ = timed(partial(read_raw, path))
    ahd_s, _ = timed(partial(_ahd, path))
    table.add(
        name,
        f"{size / MIB:.1f} MiB",
        f"{seconds(write_s)}, {size / MIB / write_s:.0f} MiB/s",
        f"{seconds(read_s)}, {size / MIB / read_s:.0f} MiB/s",
        f"{seconds(ahd_s)}, {ahd_s / read_s:.1f} times as long",
    )
    return read_s, ahd_s


def _ahd(path: Path) -> None:
    with rawpy.imread(str(path)) as raw:
        raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
            gamma=(1, 1),
            no_auto_bright=True,
            output_bps=16,
            user_wb=[1.0, 1.0, 1.0, 1.0],
            adjust_maximum_thr=0.0,
        )


def _plot(code_s: CodeTimes, path: Path) -> None:
    figure, (axes,) = plots.panels(1)
    for grid, style in zip(dict.fromkeys(key[1] for key in code_s), ("-", "--"), strict=False):
        for index, family in enumerate(TIMED):
            times = [code_s[family, grid, count] for count in COUNTS]
            label = f"{family}, {grid_name(grid)} cells"
            axes.plot(COUNTS, times, style, **plots.style(index, label=label))
    plots.finish(axes, "Time to make a set of codes", "number of codes K", "wall time in s")
    plots.legend(axes)
    plots.save(figure, path)
