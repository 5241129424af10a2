"""Which runs lie below a folder, newest first: by their names, and the heads of their manifests.

No more than is asked for is opened, no link is followed, and nothing is waited for. Whether a run
is undamaged is not looked at: that takes reading all of it.
"""

from __future__ import annotations

import heapq
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from pdcd.errors import DecodeError
from pdcd.runs.inside import opened, read_file
from pdcd.runs.manifest import MANIFEST

StoredState = Literal["done", "failed", "cancelled", "unfinished", "damaged"]

DEPTH = 3
"""Folders below the one given in which runs are looked for: `captures`, and what `out` named."""
MOST_ENTRIES = 20_000
"""Names looked at before the search ends."""
MOST_BYTES = 16 * 2**20
"""Longest manifest that is read."""

_RUN = re.compile(r"(\d{8}T\d{6}Z-[0-9a-f]{4})(\.partial)?")


class StoredRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run on disk. `state` "unfinished": it has no manifest, and what it has is kept;
    "damaged": its manifest cannot be read. Goal and user are null where nobody can tell."""

    job: str
    state: StoredState
    folder: str
    goal: str | None = None
    user: str | None = None
    started_utc: str | None = None


class _Named(msgspec.Struct):
    goal: str


class _User(msgspec.Struct):
    user: str | None = None


class _Head(msgspec.Struct):
    """What is read of a manifest, of any schema."""

    job: str
    state: Literal["done", "failed", "cancelled"]
    request: _Named
    owner: _User
    started_utc: str


def stored_runs(folder: Path, newest: int) -> list[StoredRun]:
    """The `newest` runs below `folder` by their names, the newest first; none where it is missing.

    Reads directories and up to `newest` manifests, so it is not for an event loop.
    """
    found = heapq.nlargest(newest, _names(folder))
    return [_looked_at(job, Path(place)) for job, place in found]


def _names(folder: Path) -> Iterator[tuple[str, str]]:
    """Job and path of every run folder; what may not be read is passed over."""
    left, waiting = MOST_ENTRIES, [(str(folder), 0)]
    while waiting:
        place, depth = waiting.pop()
        try:
            with os.scandir(place) as entries:
                for entry in entries:
                    left -= 1
                    if left < 0:
                        return
                    if not entry.is_dir(follow_symlinks=False) or not _is_text(entry.path):
                        continue
                    run = _RUN.fullmatch(entry.name)
                    if run is not None:
                        yield run[1], entry.path
                    elif depth + 1 < DEPTH:
                        waiting.append((entry.path, depth + 1))
        except OSError:
            continue


def _is_text(path: str) -> bool:
    """Whether a path can be told in a message: names of any bytes are allowed on a disk."""
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def _looked_at(job: str, place: Path) -> StoredRun:
    unfinished = StoredRun(job=job, state="unfinished", folder=str(place))
    if place.name != job:
        return unfinished
    try:
        with opened(place) as folder:
            head = msgspec.json.decode(read_file(folder, MANIFEST, MOST_BYTES), type=_Head)
    except FileNotFoundError:
        return unfinished
    # ValueError: no JSON, or another manifest than ours; a name of unlucky bytes included.
    except (OSError, ValueError, RecursionError, DecodeError):
        return msgspec.structs.replace(unfinished, state="damaged")
    if head.job != job:
        return msgspec.structs.replace(unfinished, state="damaged")
    return StoredRun(
        job=job,
        state=head.state,
        folder=str(place),
        goal=head.request.goal,
        user=head.owner.user,
        started_utc=head.started_utc,
    )
