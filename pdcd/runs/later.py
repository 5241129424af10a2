"""Files that are made beside a manifest after the run has ended: to look at, and nothing rests on
them. No other file may come to lie in a run's folder later."""

from __future__ import annotations

import re

REPORT = "report.html"
"""Everything of the run on one page."""

_LATER = re.compile(r"report\.html|row-[A-Za-z0-9._-]{1,64}-\d{1,6}-\d{1,6}\.png", re.ASCII)


def row_name(photo: str, cell: tuple[int, int]) -> str:
    """File of the row of a probing matrix that belongs to a cell."""
    return f"row-{photo}-{cell[0]}-{cell[1]}.png"


def made_later(name: str) -> bool:
    """Whether a file of that name, relative to the run's folder, may have been made later."""
    return _LATER.fullmatch(name) is not None
