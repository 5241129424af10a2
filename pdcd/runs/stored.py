"""Which runs lie below a folder, in the words of version 1.2 of the socket protocol.

`pdcd list` and `capture.list` with `runs` answer so, and scripts rely on it. What is known of runs
besides is in `pdcd.runs.index`.
"""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path

from pdcd.errors import DiskError
from pdcd.protocol.entry import RunEntry, RunQuery, StoredRun, StoredState
from pdcd.runs.index import find
from pdcd.runs.place import UNFINISHED


def stored_runs(folder: Path, newest: int) -> list[StoredRun]:
    """The `newest` runs below `folder` by their names, the newest first; none where it cannot be
    read.

    Reads directories and manifests of that many runs, so it is not for an event loop.
    """
    query = RunQuery(newest=max(newest, 1), previews=True)
    found = chain.from_iterable(page.runs for page in find(folder, query))
    told = (run for entry in found if (run := _stored(entry)) is not None)
    try:
        return list(islice(told, newest))
    except DiskError:
        return []


def _stored(entry: RunEntry) -> StoredRun | None:
    """The run in those words; None for what they have none for: a run decoded in part."""
    ending = Path(entry.folder).name.removeprefix(entry.job)
    if ending not in ("", UNFINISHED):
        return None
    state: StoredState
    if ending:
        state = "unfinished"
    elif entry.state in ("done", "failed", "cancelled", "unfinished"):
        state = entry.state
    else:
        state = "damaged"
    return StoredRun(
        job=entry.job,
        state=state,
        folder=entry.folder,
        goal=entry.goal,
        user=entry.user,
        started_utc=entry.started_utc,
    )
