"""Tables of frames that are damaged: what cannot be read is a typed error."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.errors import DecodeError
from pdcd.frames.patterns import none
from pdcd.runs.frame_table import COLUMNS, NAME, FrameTable, read_columns
from pdcd.runs.record import ShotRecord

SHOT = ShotRecord(
    name="coded", window="whole", raw="raw/coded.dng", sha256="0" * 64, size_bytes=1, iso=100,
    f_number=8.0, open_ns=0, close_ns=1, end_ns=(1, 1), refreshes=1, missed=0, source="mock",
    verified=True,
)  # fmt: skip


@pytest.mark.parametrize("number", ["1e3", "", str(2**63), "-" + "9" * 400])
def test_a_number_that_is_none_of_a_refresh(number: str, tmp_path: Path) -> None:
    row = ["coded", *["0"] * (len(COLUMNS) - 2), number]
    (tmp_path / NAME).write_text(f"{','.join(COLUMNS)}\r\n{','.join(row)}\r\n")
    with pytest.raises(DecodeError, match=NAME):
        FrameTable(tmp_path).of(SHOT, (none(), none()), grid=(2, 3))
    with pytest.raises(DecodeError, match=NAME):
        read_columns(tmp_path / NAME)


def test_columns_of_whole_tables(tmp_path: Path) -> None:
    table = tmp_path / NAME
    table.write_text("shot,refresh,code\r\n")  # of a run without a refresh
    found = read_columns(table, ("shot", "code"))
    assert [(name, column.size) for name, column in found.items()] == [("shot", 0), ("code", 0)]
    table.write_text("shot,refresh,code\r\na,0,-3\r\nb,0,4\r\n")
    found = read_columns(table, ("code", "shot", "row"))
    assert {name: column.tolist() for name, column in found.items()} == {
        "code": [-3, 4],
        "shot": ["a", "b"],
    }
    with pytest.raises(DecodeError, match="guard"):
        read_columns(table, ("guard",))
    table.write_text("shot,refresh,code\r\na,0\r\n")
    with pytest.raises(DecodeError):
        read_columns(table, ("shot",))
