"""Tables of frames that are damaged: what cannot be read is a typed error."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.panels.frames import BLACK, FrameLog, Frames
from pdcd.panels.patterns import make_empty_patterns, pack_bits
from pdcd.runs.frame_table import (
    COLUMNS,
    FRAMES_FILE,
    FrameTable,
    append_frames,
    read_frame_columns,
)
from pdcd.runs.record import ShotRecord

SHOT = ShotRecord(
    name="coded", window="whole", raw="raw/coded.dng", sha256="0" * 64, size_bytes=1, iso=100,
    f_number=8.0, open_ns=0, close_ns=1, end_ns=(1, 1), refreshes=1, missed=0, source="mock",
    verified=True,
)  # fmt: skip


@pytest.mark.parametrize("number", ["1e3", "", str(2**63), "-" + "9" * 400])
def test_a_number_that_is_none_of_a_refresh(number: str, tmp_path: Path) -> None:
    row = ["coded", *["0"] * (len(COLUMNS) - 2), number]
    (tmp_path / FRAMES_FILE).write_text(f"{','.join(COLUMNS)}\r\n{','.join(row)}\r\n")
    with pytest.raises(DecodeError, match=f"{FRAMES_FILE}: .* is no whole number of 64 bits"):
        FrameTable(tmp_path).of(SHOT, (make_empty_patterns(), make_empty_patterns()), grid=(2, 3))
    with pytest.raises(DecodeError, match=FRAMES_FILE):
        read_frame_columns(tmp_path / FRAMES_FILE)


@pytest.mark.parametrize(("name", "row"), [("primal_shown", 1), ("dual_shown", 99999),
                                           ("dual_shown", BLACK - 1)])  # fmt: skip
def test_a_row_that_no_frame_has(name: str, row: int, tmp_path: Path) -> None:
    """Of a sequence of one row; black is shown for none."""
    patterns = pack_bits(np.eye(6, dtype=np.bool_)[:1])
    for shown in (0, BLACK, row):
        entries = {**dict.fromkeys(COLUMNS, "0"), "shot": "coded", name: str(shown)}
        text = f"{','.join(COLUMNS)}\r\n{','.join(entries.values())}\r\n"
        (tmp_path / FRAMES_FILE).write_text(text)
        table = FrameTable(tmp_path)
        if shown != row:
            assert len(table.of(SHOT, (patterns, patterns), grid=(2, 3))[0]) == 1
            continue
        with pytest.raises(DecodeError, match=f"{name} of shot coded has row {row}, of 1 rows"):
            table.of(SHOT, (patterns, patterns), grid=(2, 3))


def test_a_delayed_mask_does_not_change_what_was_asked_of_the_panels(tmp_path: Path) -> None:
    """The mask's rows begin and end a refresh later; those of the frames are the projector's."""
    patterns = pack_bits(np.eye(6, dtype=np.bool_)[:3])
    asked = np.array([1, 0, 2], np.int32)
    frames = Frames(
        patterns, patterns, asked, asked[::-1].copy(), np.zeros(3, np.uint8),
        np.array([0, 1, 2], np.int32), np.zeros(3, np.bool_), (2, 3), (2, 3), "whole",
    )  # fmt: skip
    rows = np.array([[0, 1, 2, BLACK], [BLACK, 0, 1, 2]], np.int32)
    times = np.arange(4) * 16_000_000
    log = FrameLog(
        rows[0], rows[1], times, times + 5, np.array([64, 80]) * 1_000_000,
        np.zeros(4, np.int32), "test", True, rows[0], rows[1], mask_delay=1,
    )  # fmt: skip
    append_frames(tmp_path / FRAMES_FILE, "coded", frames, log)
    shot = msgspec.structs.replace(SHOT, refreshes=4)
    back, shown = FrameTable(tmp_path).of(shot, (patterns, patterns), grid=(2, 3))
    assert len(back) == 3
    for name in ("primal_index", "dual_index", "shift", "code", "guard"):
        np.testing.assert_array_equal(getattr(back, name), getattr(frames, name))
    for mine, its in zip(rows, shown.asked, strict=True):
        np.testing.assert_array_equal(its, mine)


def test_columns_of_whole_tables(tmp_path: Path) -> None:
    table = tmp_path / FRAMES_FILE
    table.write_text("shot,refresh,code\r\n")  # of a run without a refresh
    found = read_frame_columns(table, ("shot", "code"))
    assert [(name, column.size) for name, column in found.items()] == [("shot", 0), ("code", 0)]
    table.write_text("shot,refresh,code\r\na,0,-3\r\nb,0,4\r\n")
    found = read_frame_columns(table, ("code", "shot"))
    assert {name: column.tolist() for name, column in found.items()} == {
        "code": [-3, 4],
        "shot": ["a", "b"],
    }
    with pytest.raises(DecodeError, match="guard"):
        read_frame_columns(table, ("guard",))
    table.write_text("shot,refresh,code\r\na,0\r\n")
    with pytest.raises(DecodeError):
        read_frame_columns(table, ("shot",))
