"""The list of what a sweep has done, and the table that it ends with."""

from __future__ import annotations

import csv
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.api import ledger as module
from pdcd.api.ledger import NAME, Ledger
from pdcd.api.table import Table
from pdcd.api.task import ENDING, Record
from pdcd.errors import BusyError, DiskError, RequestError


def run_at(folder: Path, text: bytes = b"manifest") -> Record:
    folder.mkdir(parents=True)
    (folder / "capture.json").write_bytes(text)
    digest = hashlib.sha256(text).hexdigest()
    return {"state": "done", "folder": str(folder), "manifest_sha256": digest}


def test_every_line_is_on_the_disk_before_the_next_photo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: list[int] = []
    monkeypatch.setattr(module.os, "fsync", lambda fd: sizes.append(os.fstat(fd).st_size))  # type: ignore[attr-defined]
    ledger = Ledger(tmp_path / "deep" / "s")
    ledger.add("one", {"state": "done"})
    ledger.add("two", {"state": "failed"})
    data = (tmp_path / "deep" / "s" / NAME).read_bytes()
    ledger.close()
    lines = data.split(b"\n")
    assert sizes == [len(lines[0]) + 1, len(data)] and lines[-1] == b""
    assert [json.loads(line) for line in lines[:2]] == [
        {"key": "one", "row": {"state": "done"}}, {"key": "two", "row": {"state": "failed"}},
    ]  # fmt: skip


def test_lines_that_are_none_are_left_out_and_the_last_of_a_key_counts(tmp_path: Path) -> None:
    first, second = run_at(tmp_path / "a"), run_at(tmp_path / "b", b"another")
    ledger = Ledger(tmp_path)
    assert ledger.known == {}
    for row in (first, second):
        ledger.add("k", row)
    ledger.close()
    path = tmp_path / NAME
    path.write_bytes(b'nonsense\n\n{"key": 5}\n' + path.read_bytes() + b"[]\n\xff\n")
    size = path.stat().st_size
    again = Ledger(tmp_path)
    assert again.known == {"k": second}
    again.close()
    assert path.stat().st_size == size  # it ends with a line's end, and needs no other
    Ledger(tmp_path / "new").close()
    assert (tmp_path / "new" / NAME).read_bytes() == b""


def test_half_a_line_gets_an_end(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(b'{"key": "ha')
    ledger = Ledger(tmp_path)
    ledger.add("k", {"state": "done"})
    ledger.close()
    first, second, last = (tmp_path / NAME).read_bytes().split(b"\n")
    assert first == b'{"key": "ha' and json.loads(second)["key"] == "k" and last == b""


@pytest.mark.parametrize("what", ["a file", "a large one", "a FIFO", "none"])
def test_a_run_whose_manifest_cannot_be_read_is_not_there(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = run_at(tmp_path / "run")
    monkeypatch.setattr(module, "MAX_MANIFEST_BYTES", 8)
    manifest = tmp_path / "run" / "capture.json"
    if what != "a file":
        manifest.unlink()
    if what == "a large one":
        manifest.write_bytes(b"manifest ")
    elif what == "a FIFO":
        os.mkfifo(manifest)
    ledger = Ledger(tmp_path)
    ledger.add("k", row)
    ledger.add("nul", row | {"folder": "a\0b"})
    ledger.close()
    again = Ledger(tmp_path)
    assert [*again.known] == (["k"] if what == "a file" else [])
    again.close()


def test_a_folder_that_cannot_be_had_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DiskError, match="file"):
        Ledger(tmp_path / "file")
    ledger = Ledger(tmp_path / "s")
    with pytest.raises(BusyError) as caught:
        Ledger(tmp_path / "s")
    assert caught.value.hint == "wait for it, or take another folder"
    ledger.close()


ROWS: list[Record] = [
    {"number": 0, "asked.tags": "a,b\nc", "goal": "white", "state": "done", "codes": 8},
    {"number": 1, "asked.tags": None, "goal": "wh\xeft", "state": "failed", "codes": 0.5},
    {"number": 2, "asked.tags": "x", "goal": "white", "state": "cancelled", "codes": True},
]


def test_a_table_is_written_as_others_read_it(tmp_path: Path) -> None:
    table = Table(ROWS)
    table.to_csv(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="", encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    assert tuple(head) == table.columns == ("number", "asked.tags", *ENDING)
    assert [line[:4] for line in lines] == [
        ["0", "a,b\nc", "white", "done"], ["1", "", "wh\xeft", "failed"],
        ["2", "x", "white", "cancelled"],
    ]  # fmt: skip
    with pytest.raises(DiskError, match="none"):
        table.to_csv(tmp_path / "none" / "t.csv")


def test_columns_of_numbers_are_numbers_and_rows_are_found_by_all_values() -> None:
    table = Table(ROWS)
    assert table["codes"].tolist() == [8.0, 0.5, 1.0] and table["codes"].dtype == np.float64
    assert table["asked.tags"].dtype == object and table["asked.tags"].shape == (3,)
    assert table["error"].dtype == np.float64 and np.isnan(table["error"]).all()
    assert [row["number"] for row in table.where(goal="white")] == [0, 2]
    assert [row["number"] for row in table.where(goal="white", state="done")] == [0]
    assert [row["number"] for row in table.where(**{"asked.tags": None})] == [1]
    assert len(table.where()) == 3 and [row["number"] for row in table.failed] == [1, 2]
    with pytest.raises(RequestError, match="there is no column speed") as caught:
        table.where(goal="white", speed=1)
    assert str(caught.value.hint).startswith("columns are number, asked.tags, goal")
    assert tuple(table[-1]) == table.columns and table[-1]["number"] == 2


def test_a_cell_of_a_notebook_is_short() -> None:
    told: list[Any] = [None, 1 / 3, 12345.678, 7, True, "<b>", 1e-9]
    rows: list[Record] = [{"number": n, "asked.x": value, "state": "done"} for n, value in
                          enumerate(told)]  # fmt: skip
    shown = Table(rows)._repr_html_()
    cells = ["", "0.3333", "1.235e+04", "7", "True", "&lt;b&gt;", "1e-09"]
    for number, cell in enumerate(cells):
        assert f"<tr><td>{number}</td><td>{cell}</td><td></td><td>done</td>" in shown
    heads = "".join(
        f"<th>{name}</th>"
        for name in ("number", "asked.x", "goal", "state", "verdict", "codes", "exposure_s",
                     "rms_sigma", "rms_error_quads", "rms_error_cells")
    )  # fmt: skip
    assert shown.startswith(f"<div><table><thead><tr>{heads}</tr></thead><tbody><tr>")
    assert shown.endswith("</tr></tbody></table></div>")
