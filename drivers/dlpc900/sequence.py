"""Turns frames into what two panels are sent: planes, tables of entries, and times of rows.

Times are whole microseconds, as the device counts them. A table holds one entry a row; if that is
too many, consecutive rows that show the same become one entry.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import (
    BLACK,
    ConfigError,
    FrameLog,
    Frames,
    check_binary,
    join_logs,
    streams,
)

from .around import BLACK_PLANE, TableEntry
from .commands import MOST_US

SOURCE = "dlpc900"
"""Name of the time source: the start plus the sums of the table's times."""
_NEAR = 1e-3
"""Largest relative difference of a row's length from whole microseconds."""
_PULSES_HINT = (
    "check the wires from TRIG_OUT_2 of both; where about one pulse comes, or none, set the other "
    "display.options.trigger_bit"
)
_Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class PanelPlanes:
    """What one panel shows: `plane` (R,) is the number in `keys` for each row, -1 for none; `rows`
    are rows of the frames that show each key."""

    plane: NDArray[np.int32]
    keys: tuple[bytes, ...]
    rows: tuple[int, ...]

    def find_rows(self, keys: Sequence[bytes]) -> list[int]:
        """Rows of the frames to draw for these keys."""
        place = dict(zip(self.keys, self.rows, strict=True))
        return [place[key] for key in keys]


@dataclass(frozen=True)
class DmdSequence:
    """R rows for projector and mask, in blocks that each fit one table.

    asked : (2, R) rows of the frames, `BLACK` for none.
    row_us, dark_us, delay_us : length of rows; dark time after each, and delay of the mask (R,).
    blocks : first row of each, and the row after its last. joined : whether an entry may hold
        several equal rows.
    """

    frames: Frames
    asked: NDArray[np.int32]
    planes: tuple[PanelPlanes, PanelPlanes]
    row_us: int
    dark_us: _Numbers
    delay_us: _Numbers
    mask_delay: int
    blocks: tuple[tuple[int, int], ...] = ()
    joined: bool = False

    def begins_us(self, side: int, block: tuple[int, int]) -> _Numbers:
        """When each row of a block begins on a panel, and black after them; the projector's first
        row begins at 0."""
        first, last = block
        begins = np.append(0, np.cumsum(self.row_us + self.dark_us[first:last]))
        begins[-1] -= self.dark_us[last - 1]  # black ends the last row
        if side == 1:
            delay_us = self.delay_us[first:last]
            begins += np.append(delay_us, delay_us[-1])
        return begins

    def lead_us(self, block: tuple[int, int]) -> tuple[int, int]:
        """How much later each panel must be started than the other."""
        delay_us = int(self.delay_us[block[0]])
        return max(0, -delay_us), max(0, delay_us)

    def make_table(self, side: int, block: tuple[int, int], *, joined: bool) -> list[TableEntry]:
        """The entries of a block on one panel, which end on black."""
        keys = self.planes[side].keys
        return [
            TableEntry(keys[n] if n >= 0 else BLACK_PLANE, exposure, dark)
            for n, exposure, dark in zip(
                *(numbers.tolist() for numbers in self._find_entries(side, block, joined)),
                strict=True,
            )
        ]

    def _find_entries(
        self, side: int, block: tuple[int, int], joined: bool
    ) -> tuple[NDArray[np.int32], _Numbers, _Numbers]:
        """For each entry of `make_table`: its plane, numbered as in `PanelPlanes`, its exposure,
        and the dark time after it."""
        first, last = block
        plane = self.planes[side].plane[first:last]
        dark_us = self.dark_us[first:last].copy()
        dark_us[-1] = 0
        exposure_us = np.diff(self.begins_us(side, block)) - dark_us
        return _join_rows(plane, exposure_us, dark_us) if joined else (plane, exposure_us, dark_us)

    def make_log(self, starts_ns: Sequence[tuple[int, int]]) -> FrameLog:
        """The log of blocks. `starts_ns` are the times at which their first rows began on the
        projector, and would have begun on the mask without its delay."""
        logs = []
        for block, start_ns in zip(self.blocks, starts_ns, strict=True):
            part = slice(*block)
            begins = [start_ns[side] + 1000 * self.begins_us(side, block) for side in (0, 1)]
            shown = self.asked[:, part]
            logs.append(
                FrameLog(
                    primal_shown=shown[0],
                    dual_shown=shown[1],
                    primal_ns=begins[0][:-1],
                    dual_ns=begins[1][:-1],
                    end_ns=np.array([begins[0][-1], begins[1][-1]]),
                    missed=np.zeros(shown.shape[1], dtype=np.int32),
                    source=SOURCE,
                    verified=False,
                    primal_asked=shown[0],
                    dual_asked=shown[1],
                    mask_delay=self.mask_delay,
                    dark_s=self.dark_us[part] / 1e6,
                    delay_s=self.delay_us[part] / 1e6 if self.delay_us.any() else None,
                )
            )
        pulses = self._count_lit(0), self._count_lit(1)
        return replace(join_logs(logs), pulses=pulses, pulses_hint=_PULSES_HINT)

    def _count_lit(self, side: int) -> int:
        """Entries of all tables of a panel that are not black: each gives a pulse."""
        planes = (self._find_entries(side, block, self.joined)[0] for block in self.blocks)
        return sum(int(np.count_nonzero(plane >= 0)) for plane in planes)


def count_row_us(row_hz: float) -> int:
    """The length of a row. Raises ConfigError unless it is a whole number of microseconds."""
    row_us = max(1, round(1e6 / row_hz))
    if abs(row_us * row_hz * 1e-6 - 1.0) > _NEAR:
        raise ConfigError(
            f"rows of {1e6 / row_hz:.2f} us are no whole microseconds, which the device counts",
            device="display",
            hint=f"set refresh_hz of both panels to {1e6 / row_us:.2f}",
        )
    return row_us


def make_sequence(frames: Frames, row_us: int, mask_delay: int) -> DmdSequence:
    """All rows of the frames, not yet in blocks. Raises ConfigError for grey levels, and for
    invalid times."""
    check_binary(frames.primal_patterns, frames.dual_patterns)
    asked = np.stack(streams(np.arange(len(frames), dtype=np.int32), mask_delay))
    of_row = np.where(asked[0] == BLACK, asked[1], asked[0])
    times = []
    for name, seconds in (("dark_s", frames.dark_s), ("delay_s", frames.delay_s)):
        given = np.zeros(len(frames)) if seconds is None else seconds
        if not np.isfinite(given).all() or (name == "dark_s" and (given < 0.0).any()):
            raise ConfigError(f"frames with {name} of {given.min()} to {given.max()}")
        times.append(np.rint(1e6 * given).astype(np.int64)[of_row])
    planes = _find_planes(frames, 0, asked[0]), _find_planes(frames, 1, asked[1])
    return DmdSequence(frames, asked, planes, row_us, times[0], times[1], mask_delay)


def find_blocks(sequence: DmdSequence, most: int) -> tuple[tuple[tuple[int, int], ...], bool]:
    """How to cut a sequence for tables of at most `most` entries, and whether equal rows are
    joined: one block if possible, else blocks of whole periods of the sequence."""
    count = sequence.asked.shape[1]
    whole = ((0, count),)
    if count <= most:
        return whole, False
    if all(len(sequence.make_table(side, whole[0], joined=True)) <= most for side in (0, 1)):
        return whole, True
    rows = np.stack(
        [sequence.planes[0].plane, sequence.planes[1].plane, sequence.dark_us, sequence.delay_us]
    )
    rounds = (
        n for n in range(1, most + 1)
        if (rows[:, n] == rows[:, 0]).all() and (rows[:, n:] == rows[:, :-n]).all()
    )  # fmt: skip
    period = next(rounds, most)
    size = period * (most // period)
    return tuple((n, min(n + size, count)) for n in range(0, count, size)), False


def count_fitting_codes(sequence: DmdSequence, most_rows: int, most_planes: int) -> int:
    """How many codes of these frames fit this many rows and planes."""
    frames = sequence.frames
    codes = max(1, len(np.unique(frames.code[frames.code >= 0])))
    fits = [most_rows * codes // sequence.asked.shape[1]]
    fits += [most_planes * codes // len(p.keys) for p in sequence.planes if p.keys]
    return int(min(fits))


def _find_planes(frames: Frames, side: int, asked: NDArray[np.int32]) -> PanelPlanes:
    """The distinct planes of one panel, in the order they are shown."""
    patterns = frames.dual_patterns if side else frames.primal_patterns
    shown = frames.dual_index if side else frames.primal_index
    index = np.where(asked == BLACK, BLACK, shown[asked])
    moved = np.where(index >= 0, frames.shift[asked], 0)
    pairs, first, number = np.unique(
        np.stack([index, moved]), axis=1, return_index=True, return_inverse=True
    )
    where = f"{frames.grid} {frames.lattice} {frames.window}".encode()
    of_pair = np.full(first.size, -1, dtype=np.int32)
    known: dict[bytes, int] = {}
    rows = []
    for pair in np.argsort(first):
        pattern, shift = pairs[:, pair].tolist()
        content = b"white" if pattern < 0 else np.ascontiguousarray(patterns[pattern]).tobytes()
        if pattern == BLACK or not any(content):
            continue
        said = hashlib.blake2b(b"%b %d " % (where, shift), digest_size=16)
        said.update(content)
        key = said.digest()
        if key not in known:
            known[key] = len(known)
            rows.append(int(asked[first[pair]]))
        of_pair[pair] = known[key]
    return PanelPlanes(of_pair[number.ravel()], tuple(known), tuple(rows))


def _join_rows(
    plane: NDArray[np.int32], exposure_us: _Numbers, dark_us: _Numbers
) -> tuple[NDArray[np.int32], _Numbers, _Numbers]:
    """Consecutive rows that show the same, joined into entries of at most the longest exposure."""
    exposure_us = np.where(plane < 0, exposure_us + dark_us, exposure_us)
    dark_us = np.where(plane < 0, 0, dark_us)
    begins = np.append(True, (np.diff(plane) != 0) | (dark_us[:-1] > 0))
    run = np.cumsum(begins) - 1
    together = max(1, int(MOST_US // max(1, exposure_us.max())))
    place = np.arange(plane.size) - np.flatnonzero(begins)[run]
    begins |= place % together == 0
    first = np.flatnonzero(begins)
    last = np.append(first[1:], plane.size) - 1
    return plane[first], np.add.reduceat(exposure_us, first), dark_us[last]
