"""`python -m pdcd.api.worker FD`: a process that takes photos on mock benches for a sweep."""

from __future__ import annotations

import sys
from typing import Any

from pdcd.child import PICKLES, Line, LineClosedError, live_for_parent


def serve(line: Line[Any]) -> None:
    """Take what photos are asked for, until the other end is gone."""
    from pdcd.api.task import taken

    try:
        while True:
            line.send(taken(line.receive()))
    except LineClosedError:
        return


if __name__ == "__main__":
    # Before the imports that follow, which take long.
    live_for_parent()
    with Line.at(int(sys.argv[1]), PICKLES) as ours:
        serve(ours)
