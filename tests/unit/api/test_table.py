"""The table that a sweep ends with."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from pdcd.api.table import Table
from pdcd.api.task import ENDING, TaskRecord
from pdcd.errors import DiskError, RequestError

ROWS: list[TaskRecord] = [
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


def test_a_notebook_shows_so_many_rows() -> None:
    for count in (40, 45):
        shown = Table({"number": n, "state": "done"} for n in range(count))._repr_html_()
        assert shown.count("<tr>") == 41 and ("and 5 more" in shown) == (count == 45)
    assert Table([]).columns == ("number", *ENDING) and len(Table([])) == 0
