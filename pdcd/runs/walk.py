"""The run folders below a state folder, found by their names alone.

No link is followed, only folders are opened, and the search is bounded. A folder that somebody else
put there is noted as such, and never read.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from pdcd.bench.choosing import CALIBRATIONS_FOLDER as CALIBRATIONS
from pdcd.errors import DiskError, RequestError
from pdcd.files.inside import WAY
from pdcd.files.system import system

DEPTH = 3
"""Depth of folders below the given one that is searched for runs: `captures`, and what `out`
named."""
MOST_ENTRIES = 200_000
"""Most names that are read in a search."""
_PREVIEWS = "preview"
"""Folder of the previews, of which the daemon itself keeps the last few."""
REMOVED = ".removed"
"""Suffix of the name of a run while it is being removed."""

_RUN = re.compile(
    r"(\d{8}T\d{6}Z-[0-9a-f]{4})"
    r"((?:-partial)?(?:(?:-decoded-\d{1,4})?\.partial)?(?:\.removed)?)"
)
_FOLDER = system.O_RDONLY | system.O_DIRECTORY | system.O_NOFOLLOW | system.O_CLOEXEC


class RunSpot(NamedTuple):
    """Where a run lies. Sorts by time."""

    job: str
    path: str
    """Relative to the state folder, with / between its parts."""
    ending: str = ""
    """The part of its name after the job: "" for a finished run, ".partial" while it is being
    filled ..."""
    foreign: bool = False
    """Whether it belongs to a user who may not have runs here."""

    @property
    def preview(self) -> bool:
        """Whether it is a preview."""
        return self.path.startswith(f"{_PREVIEWS}/")


class Walk(NamedTuple):
    """What was found: the runs, newest first, and the folders that could not be read."""

    spots: list[RunSpot]
    closed: tuple[str, ...]
    cut: bool
    """Whether there are more names than were read."""


def parse_spot(path: str) -> RunSpot | None:
    """The place of a run by its path relative to the state folder; None where that is not a run's
    name."""
    found = _RUN.fullmatch(path.rpartition("/")[2])
    return None if found is None else RunSpot(found[1], path, found[2])


def require_spot(path: str) -> RunSpot:
    """The same for a place in a list of runs. Raises RequestError where it is none."""
    spot = parse_spot(path)
    if spot is None:
        raise RequestError(
            f"{path[:200]!r} is no place in a list of runs", hint="give `more` of the page before"
        )
    return spot


def is_job(text: str) -> bool:
    """Whether a text is the name of a job."""
    spot = parse_spot(text)
    return spot is not None and spot.path == spot.job


def walk_runs(state: Path, depth: int = DEPTH) -> Walk:
    """All run folders below a state folder, down to this depth; none where the folder is missing.

    Raises DiskError when the folder itself cannot be read.
    """
    try:
        with open_state_folder(state) as (top, owners):
            return _walked(top, owners, depth)
    except FileNotFoundError:
        return Walk([], (), False)
    except OSError as err:
        raise DiskError(
            f"cannot read the folder of runs: {err.strerror}",
            device=str(state),
            hint="the mode of that folder says who may read runs",
        ) from err


def _walked(top: int, owners: frozenset[int], depth: int) -> Walk:
    """The same below an open folder. Raises OSError when that cannot be listed."""
    spots: list[RunSpot] = []
    closed: list[str] = []
    left, waiting = MOST_ENTRIES, [""]
    while waiting and left >= 0:
        place = waiting.pop()
        try:
            with _opened(top, place) as folder, system.scandir(folder) as entries:
                for entry in entries:
                    left -= 1
                    if left < 0:
                        break
                    path = f"{place}/{entry.name}" if place else entry.name
                    if not _is_folder(entry) or not _is_text(path) or path == CALIBRATIONS:
                        continue
                    run = _RUN.fullmatch(entry.name)
                    try:
                        foreign = entry.stat(follow_symlinks=False).st_uid not in owners
                    except FileNotFoundError:  # it was renamed or removed just now
                        continue
                    if run is not None:
                        spots.append(RunSpot(run[1], path, run[2], foreign))
                    elif foreign:
                        closed.append(path)
                    elif path.count("/") + 1 < depth:
                        waiting.append(path)
        except OSError:
            if not place:
                raise
            closed.append(place)
    return Walk(sorted(spots, reverse=True), tuple(closed), left < 0)


@contextmanager
def open_state_folder(state: Path) -> Iterator[tuple[int, frozenset[int]]]:
    """Descriptor of a state folder, and the users who may have runs in it. Raises OSError."""
    top = system.open(state, system.O_RDONLY | system.O_DIRECTORY | system.O_CLOEXEC)
    try:
        # The owner of the folder makes the runs; root may have restored them from a copy.
        yield top, frozenset({0, system.geteuid(), system.fstat(top).st_uid})
    finally:
        system.close(top)


@contextmanager
def open_run_folder(top: int, path: str, owners: frozenset[int]) -> Iterator[int]:
    """Descriptor of a run folder by its path below the state folder. Raises OSError.

    Its owner is checked again: the name may have come to mean something else.
    """
    with _opened(top, path) as folder:
        if system.fstat(folder).st_uid not in owners:
            raise PermissionError(0, "it belongs to somebody else")
        yield folder


@contextmanager
def _opened(top: int, path: str) -> Iterator[int]:
    """Descriptor of a folder below another, without following links."""
    with ExitStack() as held:
        at, parts = top, path.split("/") if path else []
        for number, part in enumerate(parts):
            last = number + 1 == len(parts)
            at = system.open(part, _FOLDER if last else WAY, dir_fd=at)
            held.callback(system.close, at)
        yield at


def _is_folder(entry: os.DirEntry[str]) -> bool:
    return entry.is_dir(follow_symlinks=False)


def _is_text(path: str) -> bool:
    """Whether a path can be sent in a message: names on a disk may have any bytes."""
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True
