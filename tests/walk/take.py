"""`python -m tests.walk.take GOAL GRID FOLDER`: one plain capture on the mock bench, in a process
that is traced from its first line. GRID is ROWSxCOLS, or "" for the default."""

from __future__ import annotations

import sys
from typing import Any, cast

import pdcd


def take(goal: Any, grid: str, folder: str) -> None:
    """Take one photo with defaults; the run folder goes into `folder`."""
    config = {"scene": {"grid": [int(side) for side in grid.split("x")]}} if grid else None
    with pdcd.local(cast(Any, config), folder=folder) as bench:
        bench.capture(goal, progress=False)


if __name__ == "__main__":
    take(*sys.argv[1:])
