"""Frames through the driver's USB reports to the mirrors of two virtual DMDs, and to photos.

Driver, virtual devices and the reader of reports know nothing of each other. What panels are to
show is `draw`'s word.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.virtual_dlpc900 import PLANES_BY_OTHERS, VirtualDmdOptions
from pdcd.bench.placed import panels_of
from pdcd.errors import ConfigError
from pdcd.panels.draw import draw
from pdcd.panels.frames import Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from pdcd.words import ScheduleName
from tests.dlpc900_pair import LEAST_US, DmdPair, Lit
from tests.dlpc900_reports import PLANES_OF_BYTE, Start, read_entry, read_plane, read_runs

pytestmark = pytest.mark.whole

SIZE, GRID = (96, 64), (6, 8)


def make_codes(
    count: int,
    schedule: ScheduleName = "none",
    *,
    passes: int = 1,
    dark_us: int = 0,
    window: str = "whole",
    grid: tuple[int, int] = GRID,
) -> Frames:
    rng = np.random.default_rng(count)
    cells = (grid[0] + 1) * (grid[1] + 1) if window == "quarter" else grid[0] * grid[1]
    sides = [pack_bits(rng.random((count, cells)) < 0.5) for _ in range(2)]
    return build_frames(
        (sides[0], sides[1]), grid, window=window, schedule=schedule, passes=passes,
        dark_s=1e-6 * dark_us,
    )  # fmt: skip


class Wanted:
    """What one panel is to show, row by row."""

    def __init__(self, pair: DmdPair, frames: Frames, side: int) -> None:
        panels = panels_of(pair.config)
        view = (panels.projector, panels.mask)[side]
        index = (frames.primal_index, frames.dual_index)[side]
        drawn: dict[tuple[int, int], NDArray[np.bool_]] = {}
        self.planes = []
        for row in range(len(frames)):
            key = int(index[row]), int(frames.shift[row])
            if key not in drawn:
                drawn[key] = draw(frames, view, row) > 0
            self.planes.append(drawn[key])
        gaps = np.zeros(len(frames)) if frames.dark_s is None else frames.dark_s
        self.dark_us = np.rint(1e6 * gaps).astype(int)
        self.row_us = round(1e6 / pair.config.row_hz)
        self.begins_us = np.append(0, np.cumsum(self.row_us + self.dark_us))[:-1]


def check_reports(starts: list[Start], wanted: Wanted, order: str, lead: int) -> list[int]:
    """Every entry and plane that the reports say; how many rows each table holds."""
    row, counts = 0, []
    for start in starts:
        entries = start.entries
        assert start.shown == len(entries) <= 400
        assert all((e.clears, e.depth, e.led) == (True, 1, 1) for e in entries)
        lit = [int(plane.any()) for plane in wanted.planes[row : row + len(entries) - 1 - lead]]
        assert [e.last_byte for e in entries] == [0] * lead + lit + [0], "black gives no pulse"
        assert not any(e.waits for e in entries[1:])
        assert not read_plane(start, len(entries) - 1, order).any(), "it ends in the dark"
        assert not any(read_plane(start, n, order).any() for n in range(lead))
        for n in range(lead, len(entries) - 1):
            wrong = np.count_nonzero(read_plane(start, n, order) != wanted.planes[row])
            assert wrong == 0, (row, wrong)
            assert entries[n].exposure_us == wanted.row_us
            last = n == len(entries) - 2
            assert entries[n].dark_us == (0 if last else wanted.dark_us[row]), row
            row += 1
        counts.append(len(entries) - 1 - lead)
    assert row == len(wanted.planes)
    return counts


def check_mirrors(lit: list[Lit], counts: list[int], wanted: Wanted) -> list[int]:
    """Every plane that stood, for how long, and that the rest is dark; when each row began."""
    row, begins_ns, at = 0, list[int](), 0
    for count in counts:
        is_lit = [bool(plane.any()) for plane in wanted.planes[row : row + count]]
        while not lit[at + is_lit.index(True)].plane.any():
            at += 1
        rows, at = lit[at : at + count], at + count
        for at_ns, plane in rows:
            assert np.count_nonzero(plane != wanted.planes[row]) == 0, row
            begins_ns.append(at_ns)
            row += 1
        first = row - count
        since_us = (np.array(begins_ns[first:]) - begins_ns[first]) / 1000.0
        planned_us = wanted.begins_us[first:row] - wanted.begins_us[first]
        assert np.abs(since_us - planned_us).max() <= 1.0
        black = lit[at]
        assert not black.plane.any()
        assert black.at_ns - begins_ns[-1] == pytest.approx(1000 * wanted.row_us, abs=1000)
    assert not any(one.plane.any() for one in lit[at:])
    return begins_ns


def check_all(pair: DmdPair, frames: Frames, order: str = "TI") -> list[int]:
    """From frames to mirrors, both panels; rows of each table."""
    log, starts, lit = pair.play(frames)
    chained = pair.config.display.options.get("start") == "chain"
    begins = []
    for side in (0, 1):
        wanted = Wanted(pair, frames, side)
        counts = check_reports(starts[side], wanted, order, int(chained and side == 0))
        begins.append(np.array(check_mirrors(lit[side], counts, wanted)))
    of_rows = log.primal_shown >= 0
    assert np.count_nonzero(of_rows) == len(frames)
    logged = log.primal_ns[of_rows], log.dual_ns[of_rows]
    for first, last in itertools.pairwise([0, *itertools.accumulate(counts)]):
        for told, stood in zip(logged, begins, strict=True):
            apart = (told - told[first]) - (stood - stood[first])
            assert np.abs(apart[first:last]).max() <= 1000
        if pair.config.display.options.get("start") != "software":
            late = (logged[1] - logged[0]) - (begins[1] - begins[0])
            assert np.abs(late[first:last]).max() <= 1000
    assert pair.dark
    return counts


# The reader of reports


def test_the_reader_of_reports_reads_streams_of_other_programs() -> None:
    """Pieces that TI's and other people's encoders send, made by those."""
    entry = read_entry(bytes.fromhex("0700d2000011690000010268"))
    assert (entry.exposure_us, entry.dark_us, entry.waits, entry.clears) == (210, 105, False, True)
    assert (entry.image, entry.bit) == (2, 13)
    entry = read_entry(bytes.fromhex("000069000091000000010000"))
    assert (entry.exposure_us, entry.dark_us, entry.waits, entry.image) == (105, 0, True, 0)
    two = read_runs(bytes.fromhex("96010000009601ffffff0001ac02000100"), 300, 2)
    assert two.tolist() == [[[0, 0, 0]] * 150 + [[255, 255, 255]] * 150] * 2
    cells = bytes.fromhex(
        "05cfbec20515ed1a052defd3053c9f9d000114000114052e6dec05cd205205de860705950892000114000114"
        "000100"
    )
    lines = ("cfbec2", "15ed1a", "2defd3", "3c9f9d"), ("2e6dec", "cd2052", "de8607", "950892")
    found = read_runs(cells, 20, 6)
    for row, line in enumerate(np.repeat([0, 1], 3)):
        assert found[row].tobytes() == b"".join(5 * bytes.fromhex(cell) for cell in lines[line])


# From frames to mirrors


@pytest.mark.parametrize("order", sorted(PLANES_OF_BYTE))
@pytest.mark.parametrize("schedule", ["none", "both"])
@pytest.mark.parametrize(("count", "dark_us"), [(32, 0), (128, 20)])
def test_every_plane_and_time_on_an_edge(
    count: int, dark_us: int, schedule: ScheduleName, order: str
) -> None:
    unit = VirtualDmdOptions() if order == "TI" else VirtualDmdOptions(plane_bytes=PLANES_BY_OTHERS)
    pair = DmdPair(SIZE, GRID, unit=unit, plane_order="GBR" if order == "TI" else "BGR")
    frames = make_codes(count, schedule, dark_us=dark_us)
    assert check_all(pair, frames, order) == [len(frames)]


@pytest.mark.parametrize("copy_above", ["parts", "never"])
def test_windows_that_cut_cells_and_other_ways_to_pack(copy_above: str) -> None:
    pair = DmdPair(SIZE, GRID, copy_above=copy_above, row_us=125)
    frames = make_codes(32, window="quarter", dark_us=10)
    assert check_all(pair, frames) == [128]


def test_as_many_planes_as_there_is_memory_for() -> None:
    """400 of a DLP6500, and those of the picture with black in it are left."""
    pair = DmdPair(SIZE, GRID)
    frames = make_codes(376)
    assert check_all(pair, frames) == [376]
    with pytest.raises(ConfigError, match="376 codes"):
        pair.display.load(make_codes(377))
    assert pair.dark


@pytest.mark.parametrize("keeps", [True, False])
def test_photos_one_after_the_other(keeps: bool) -> None:
    """What is loaded already, what is not, and more or fewer entries than before."""
    pair = DmdPair(SIZE, GRID, unit=VirtualDmdOptions(keeps_images=keeps))
    for frames in (make_codes(40), make_codes(64, "both"), make_codes(40), make_codes(40)):
        assert check_all(pair, frames) == [len(frames)]


@pytest.mark.parametrize("keeps", [True, False])
@pytest.mark.parametrize("start", ["trigger", "chain", "software"])
def test_photos_that_come_around(start: str, keeps: bool) -> None:
    """Black rows between codes among them: with a trigger one black entry takes longer."""
    pair = DmdPair(SIZE, GRID, unit=VirtualDmdOptions(keeps_images=keeps), start=start)
    schedules: tuple[ScheduleName, ...] = ("both", "none", "full")
    parts = [make_codes(20 + n, schedules[n], passes=3 - n) for n in range(3)]
    for frames in 5 * parts:
        assert check_all(pair, frames) == [len(frames)]
    for frames in (*parts, make_codes(30), *parts):
        assert check_all(pair, frames) == [len(frames)]


@pytest.mark.parametrize("start", ["chain", "software"])
@pytest.mark.parametrize(
    ("count", "schedule", "passes", "tables"),
    [(150, "none", 4, [300, 300]), (250, "both", 1, None), (128, "both", 3, [256] * 3)],
)
def test_more_rows_than_a_table_has_entries(
    count: int, schedule: ScheduleName, passes: int, tables: list[int] | None, start: str
) -> None:
    """Whole rounds of what repeats, or other planes in each table."""
    pair = DmdPair(SIZE, GRID, start=start)
    frames = make_codes(count, schedule, passes=passes, dark_us=15)
    counts = check_all(pair, frames)
    assert sum(counts) == len(frames) > 400
    assert counts == tables if tables else len(counts) == 2


@pytest.mark.parametrize("passes", [300, 1000])
def test_white_of_any_length_is_one_table(passes: int) -> None:
    """Rows that are alike share an entry where there is no room for one each."""
    pair = DmdPair(SIZE, GRID)
    white = build_frames(None, GRID, window="whole", schedule="none", passes=passes)
    _, starts, lit = pair.play(white)
    for side in (0, 1):
        (start,) = starts[side]
        *entries, black = start.entries
        assert len(entries) == (passes if passes < 400 else 1)
        assert sum(entry.exposure_us for entry in entries) == passes * LEAST_US
        assert all(read_plane(start, n, "TI").all() for n in range(len(entries)))
        stood = [at_ns for at_ns, plane in lit[side] if plane.all()]
        end_ns = next(at_ns for at_ns, plane in lit[side] if not plane.any())
        assert end_ns - stood[0] == 1000 * passes * LEAST_US and black.exposure_us == LEAST_US


def test_a_mask_that_is_delayed_row_by_row() -> None:
    pair = DmdPair(SIZE, GRID, row_us=150)
    delay_us = np.array([5, 30, 10, 40, 0, 20, 20, 25])
    frames = replace(make_codes(8, dark_us=25), delay_s=1e-6 * delay_us)
    _, _, lit = pair.play(frames)
    begins = [[at_ns for at_ns, plane in side if plane.any()] for side in lit]
    assert (np.diff(begins[0]) == 175_000).all()
    assert (np.array(begins[1]) - begins[0] == 1000 * delay_us).all()


@pytest.mark.whole
def test_devices_of_full_size() -> None:
    pair = DmdPair((1920, 1080), (48, 64))
    frames = make_codes(32, dark_us=20, grid=(48, 64))
    assert check_all(pair, frames) == [32]
