"""Tables of frames that are damaged: what cannot be read is a typed error."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.errors import DecodeError
from pdcd.frames.patterns import none
from pdcd.runs.frame_table import COLUMNS, NAME, FrameTable
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
