"""The results of a sweep: rows by column, for plots, for a spreadsheet, for other libraries."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from pdcd.api.html import format_table_html
from pdcd.api.task import ENDING, TaskRecord, Value
from pdcd.errors import RequestError, disk_errors

_MOST_SHOWN = 40
"""Most rows that a notebook shows."""
_SHOWN = (
    "number", "goal", "state", "verdict", "codes", "exposure_s", "rms_sigma", "rms_error_quads",
    "rms_error_cells",
)  # fmt: skip


class Table:
    """Rows in the order of the requests; `list(table)` are dictionaries, all with the same keys.

    Columns are "number" (of the request, from 0), then the requested values as "asked.NAME", then
    how the capture ended: `pdcd.api.task.ENDING`. A value that is not known is None.
    """

    def __init__(self, rows: Iterable[TaskRecord]) -> None:
        self._rows = tuple(rows)
        names = dict.fromkeys(name for row in self._rows for name in row)
        asked = [name for name in names if name != "number" and name not in ENDING]
        self.columns: tuple[str, ...] = ("number", *asked, *ENDING)
        """Names of the columns."""

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[TaskRecord]:
        return (dict(zip(self.columns, self._values(row), strict=True)) for row in self._rows)

    @overload
    def __getitem__(self, what: int) -> TaskRecord: ...
    @overload
    def __getitem__(self, what: str) -> NDArray[Any]: ...
    def __getitem__(self, what: int | str) -> TaskRecord | NDArray[Any]:
        """A row by its number in the table, or a column by its name: float64 with NaN for
        unknown values if it holds numbers, else objects. Raises KeyError and IndexError."""
        if isinstance(what, int):
            return dict(zip(self.columns, self._values(self._rows[what]), strict=True))
        if what not in self.columns:
            raise KeyError(f"{what}; columns are {', '.join(self.columns)}")
        values = [row.get(what) for row in self._rows]
        if all(v is None or isinstance(v, int | float) for v in values):
            return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
        found = np.empty(len(values), dtype=object)
        found[:] = values
        return found

    def where(self, **wanted: Value) -> Table:
        """The rows with these values; "asked.seed" may be named as `where(**{"asked.seed": 1})`.

        Raises RequestError for a column that does not exist.
        """
        for name in wanted:
            if name not in self.columns:
                raise RequestError(
                    f"there is no column {name}", hint=f"columns are {', '.join(self.columns)}"
                )
        same = [r for r in self._rows if all(r.get(n) == v for n, v in wanted.items())]
        return Table(same)

    @property
    def failed(self) -> Table:
        """The rows of captures that are not done."""
        return Table(row for row in self._rows if row["state"] != "done")

    def to_csv(self, path: Path | str) -> None:
        """Write it as CSV with a line of names. Raises NoSpaceError, or DiskError."""
        with (
            disk_errors(str(path)),
            Path(path).open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(self.columns)
            writer.writerows(self._values(row) for row in self._rows)

    def _values(self, row: TaskRecord) -> list[Value]:
        return [row.get(name) for name in self.columns]

    def __repr__(self) -> str:
        return f"<Table of {len(self)} captures, {len(self.failed)} failed>"

    def _repr_html_(self) -> str:
        asked = [name for name in self.columns if name.startswith("asked.")]
        names = list(dict.fromkeys((_SHOWN[0], *asked, *_SHOWN[1:])))
        rows = [[_written(row.get(name)) for name in names] for row in self._rows[:_MOST_SHOWN]]
        more = len(self) - _MOST_SHOWN
        return format_table_html(names, rows, f"and {more} more" if more > 0 else "")


def _written(value: Value) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
