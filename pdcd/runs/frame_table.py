"""frames.csv of a run: one row for every refresh of every shot: what was asked for, what was shown,
and when."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import open_file
from pdcd.panels.frames import BLACK, FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import Patterns, has_cell_count
from pdcd.runs.record import ShotRecord

FRAMES_FILE = "frames.csv"
_MAX_LINE = 2**12
"""Characters of a row that are read at a time; the longest has a few hundred."""
_DAMAGE = (OSError, UnsoundFileError, csv.Error)
COLUMNS = (
    "shot", "refresh", "code", "shift", "guard", "primal_index", "dual_index",
    "primal_shown", "dual_shown", "t_primal_ns", "t_dual_ns", "skew_ns", "missed", "dropped",
    "row", "dual_row",
)  # fmt: skip
DARK_COLUMN = "dark_ns"
"""An additional column, where the display shows rows with dark time between them."""


def append_frames(path: Path, shot: str, frames: Frames, log: FrameLog) -> None:
    """Append the refreshes of a shot to the table, which is made if needed.

    For one display either all logs have dark times or none. Raises OSError.
    """
    row, dual_row = log.asked
    columns: tuple[NDArray[np.generic], ...] = (
        np.arange(len(log)),
        np.append(frames.code, -1)[row],
        np.append(frames.shift, 0)[row],
        np.append(frames.guard, True)[row].astype(np.int64),
        np.append(frames.primal_index, BLACK)[row],
        np.append(frames.dual_index, BLACK)[row],
        log.primal_shown,
        log.dual_shown,
        log.primal_ns,
        log.dual_ns,
        log.dual_ns - log.primal_ns,
        log.missed,
        ((log.primal_shown != row) | (log.dual_shown != dual_row)).astype(np.int64),
        row,
        dual_row,
    )
    heads: tuple[str, ...] = COLUMNS
    if log.dark_s is not None:
        heads, columns = (
            (*heads, DARK_COLUMN),
            (*columns, np.rint(1e9 * log.dark_s).astype(np.int64)),
        )
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(heads)
        listed = zip(*(c.tolist() for c in columns), strict=True)
        writer.writerows((shot, *row) for row in listed)


def read_frame_columns(path: Path, wanted: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
    """A whole table by column, an entry for each refresh: "shot" str, all others int64. wanted :
    which columns; None: all. Raises DecodeError for a damaged one."""
    try:
        with _opened(path) as file:
            head, *lines = _read_rows(file)
        entries = zip(*lines, strict=True) if lines else [()] * len(head)
        columns = dict(zip(head, entries, strict=True))
        return {
            name: np.array(columns[name], np.str_) if name == "shot" else _to_numbers(columns[name])
            for name in (_known(head) if wanted is None else wanted)
        }
    except (*_DAMAGE, KeyError, ValueError, OverflowError) as err:
        raise make_table_error(path, err) from err


def _known(heads: Sequence[str]) -> tuple[str, ...]:
    """Columns that a table must have, and the optional one if it is there."""
    return (*COLUMNS, DARK_COLUMN) if DARK_COLUMN in heads else COLUMNS


def _to_numbers(entries: Sequence[str]) -> NDArray[np.int64]:
    """Entries as numbers. Raises ValueError that names the first entry that is none."""
    try:
        return np.array([int(entry) for entry in entries], dtype=np.int64)
    except (ValueError, OverflowError):
        wrong = next(entry for entry in entries if not _is_number(entry))
        raise ValueError(f"{wrong[:24]!r} is no whole number of 64 bits") from None


def _is_number(entry: str) -> bool:
    try:
        return -(2**63) <= int(entry) < 2**63
    except ValueError:  # also of thousands of digits
        return False


def make_table_error(path: Path, err: Exception) -> DecodeError:
    """The error of a damaged table."""
    return DecodeError(f"cannot read {path}: {err}", hint="restore it from a copy")


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    """The table, whatever its contents: read line by line, and through its descriptor."""
    with open_file(path) as descriptor, os.fdopen(os.dup(descriptor), newline="") as file:
        yield file


def _read_rows(file: TextIO) -> Iterator[list[str]]:
    """Rows of a table. Raises csv.Error for one that is too long."""
    return csv.reader(_read_lines(file))


def _read_lines(file: TextIO) -> Iterator[str]:
    while line := file.readline(_MAX_LINE):
        if len(line) == _MAX_LINE and not line.endswith("\n"):
            raise csv.Error(f"a row of more than {_MAX_LINE} letters")
        yield line


class FrameTable:
    """Reads the table of one run folder, each line once, also while it still grows."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FRAMES_FILE
        self._heads: list[str] = []
        self._rows: dict[str, list[list[str]]] = {}
        self._read_bytes = 0

    def of(
        self, shot: ShotRecord, pair: tuple[Patterns, Patterns], *, grid: tuple[int, int]
    ) -> tuple[Frames, FrameLog]:
        """What a shot was asked to show of its patterns, and what it showed.

        Each shot can be asked for only once, because its lines are then dropped. Raises DecodeError
        when the table is damaged or lacks some of them.
        """
        table = self._table(shot.name, shot.refreshes)
        frames = _frames(table, shot, pair, grid)
        for name in ("primal_shown", "dual_shown"):
            wrong = table[name][(table[name] < BLACK) | (table[name] >= len(frames))]
            if wrong.size:
                told = f"{name} of shot {shot.name} has row {wrong[0]}, of {len(frames)} rows"
                raise make_table_error(self._path, ValueError(told))
        return frames, _log(table, shot)

    def log_of(
        self,
        name: str,
        refreshes: int,
        *,
        end_ns: tuple[int, int],
        source: str,
        verified: bool,
        mask_delay: int,
    ) -> FrameLog:
        """When the panels showed what in a photo without codes. Raises DecodeError as `of`."""
        return _log_of(
            self._table(name, refreshes), end_ns, source, verified=verified, mask_delay=mask_delay
        )

    def _table(self, name: str, refreshes: int) -> dict[str, NDArray[np.int64]]:
        """The lines of a shot by column; they are dropped here."""
        try:
            if name not in self._rows:
                self._read_on()
            rows = self._rows.pop(name, [])
            if len(rows) != refreshes:
                raise DecodeError(
                    f"{self._path} has {len(rows)} refreshes of shot {name}, not {refreshes}",
                    hint="restore it from a copy",
                )
            columns = dict(zip(self._heads, zip(*rows, strict=True), strict=True))
            return {column: _to_numbers(columns[column]) for column in _known(self._heads)[1:]}
        except (*_DAMAGE, OverflowError, IndexError, KeyError, ValueError) as err:
            raise make_table_error(self._path, err) from err

    def _read_on(self) -> None:
        """Sort the lines added since the last call by their shots."""
        with _opened(self._path) as file:
            file.seek(self._read_bytes)
            lines = _read_rows(file)
            if not self._heads:
                self._heads = next(lines, [])
            place = self._heads.index("shot")
            for line in lines:
                self._rows.setdefault(line[place], []).append(line)
            self._read_bytes = file.tell()


def restore_frames(frames: Frames, log: FrameLog) -> tuple[Frames, FrameLog]:
    """What `FrameTable.of` would return for them, for decoding a shot without a table: times of
    rows are those of the log, in whole nanoseconds."""
    dark_s = None if log.dark_s is None else np.rint(1e9 * log.dark_s) / 1e9
    return replace(frames, dark_s=None, delay_s=None), replace(
        log, dark_s=dark_s, delay_s=None, mask_delay=0
    )


def _frames(
    table: dict[str, NDArray[np.int64]],
    shot: ShotRecord,
    pair: tuple[Patterns, Patterns],
    grid: tuple[int, int],
) -> Frames:
    # Every row of the frames was asked for at least once; further passes repeat some of them.
    numbers, first = np.unique(_asked(table)[0], return_index=True)
    first = first[numbers >= 0]
    lattice = Lattice(grid, shot.window).shape
    if not all(has_cell_count(patterns, lattice[0] * lattice[1]) for patterns in pair):
        raise DecodeError(
            f"the codes of shot {shot.name} are not over {lattice[0]} x {lattice[1]} cells",
            hint="restore codes.npz and the manifest from a copy",
        )
    return Frames(
        primal_patterns=pair[0],
        dual_patterns=pair[1],
        primal_index=table["primal_index"][first].astype(np.int32),
        dual_index=table["dual_index"][first].astype(np.int32),
        shift=table["shift"][first].astype(np.uint8),
        code=table["code"][first].astype(np.int32),
        guard=table["guard"][first].astype(np.bool_),
        grid=grid,
        lattice=lattice,
        window=shot.window,
    )


def _log(table: dict[str, NDArray[np.int64]], shot: ShotRecord) -> FrameLog:
    return _log_of(table, shot.end_ns, shot.source, verified=shot.verified, mask_delay=0)


def _log_of(
    table: dict[str, NDArray[np.int64]],
    end_ns: tuple[int, int],
    source: str,
    *,
    verified: bool,
    mask_delay: int,
) -> FrameLog:
    primal, dual = _asked(table)
    return FrameLog(
        primal_shown=table["primal_shown"].astype(np.int32),
        dual_shown=table["dual_shown"].astype(np.int32),
        primal_ns=table["t_primal_ns"],
        dual_ns=table["t_dual_ns"],
        end_ns=np.array(end_ns, dtype=np.int64),
        missed=table["missed"].astype(np.int32),
        source=source,
        verified=verified,
        primal_asked=primal,
        dual_asked=dual,
        mask_delay=mask_delay,
        dark_s=table[DARK_COLUMN] / 1e9 if DARK_COLUMN in table else None,
    )


def _asked(table: dict[str, NDArray[np.int64]]) -> list[NDArray[np.int32]]:
    """Rows of the frames that projector and mask were meant to show."""
    return [table[name].astype(np.int32) for name in ("row", "dual_row")]
