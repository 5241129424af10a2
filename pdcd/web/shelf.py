"""Runs on disk, for the page: read only, by name, and nothing but pictures and reports.

What a browser names is only compared with what is there (`pdcd.runs.stored`); no path is made of
it. Files are opened through the folder's descriptor, without following links, with limits.
"""

from __future__ import annotations

import os
import re
import stat
from itertools import islice
from pathlib import Path

import msgspec

from pdcd.errors import DecodeError, RequestError
from pdcd.runs.entry import StoredRun
from pdcd.runs.inside import opened, read_file
from pdcd.runs.stored import stored_runs

LISTED = 100
"""Runs in the list, the newest."""
KNOWN = 1000
"""Runs that can be named, the newest."""
REPORT = "report.html"
PICTURES = "preview"
MOST_REPORT_BYTES = 2**26
MOST_PICTURE_BYTES = 2**25
MOST_NAMED = 200
"""Pictures of one run that are looked at."""
RUNNING = "running"
"""The picture of a run that still goes on."""
ASIDE = ("preview", "calibrations")
"""Below the state folder: quick photos, and what is no run."""

_PICTURE = re.compile(r"[A-Za-z0-9_-]{1,64}")
_PICTURE_FILE = re.compile(rf"({_PICTURE.pattern})\.png")


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """A run as the page shows it."""

    job: str
    state: str
    goal: str | None
    user: str | None
    started_utc: str | None
    report: bool
    pictures: tuple[str, ...]
    """Names of its pictures, the one of its goal first."""


class Shelf:
    """The runs below a state folder. All methods read the disk, so they are not for an event
    loop."""

    def __init__(self, state: Path) -> None:
        self._state = state

    def runs(self) -> list[Run]:
        """The newest runs, the newest first."""
        found = stored_runs(self._state, LISTED)
        return [_shown(stored) for stored in found if not self._aside(stored)]

    def run(self, job: str) -> Run:
        """One run. Raises RequestError where there is none of that name."""
        stored = self._stored(job)
        return _shown(stored, _pictures(stored))

    def picture(self, job: str, name: str) -> bytes:
        """A picture of a run, PNG. Raises RequestError where it cannot be had."""
        if not _PICTURE.fullmatch(name):
            raise RequestError("no picture is called that")
        return self._file(job, f"{PICTURES}/{name}.png", MOST_PICTURE_BYTES)

    def report(self, job: str) -> bytes:
        """The report of a run, HTML. Raises RequestError where it cannot be had."""
        return self._file(job, REPORT, MOST_REPORT_BYTES)

    def _file(self, job: str, name: str, most_bytes: int) -> bytes:
        try:
            with opened(Path(self._stored(job).folder)) as folder:
                return read_file(folder, name, most_bytes)
        except (OSError, ValueError, DecodeError) as err:
            why = (err.strerror if isinstance(err, OSError) else None) or str(err)
            raise RequestError(f"{name} of {job} cannot be read: {why}") from err

    def _aside(self, stored: StoredRun) -> bool:
        """Whether it is no photo that somebody asked to keep."""
        return Path(stored.folder).relative_to(self._state).parts[0] in ASIDE

    def _stored(self, job: str) -> StoredRun:
        for stored in stored_runs(self._state, KNOWN):
            if stored.job == job:
                return stored
        raise RequestError("no run is called that")


def _shown(stored: StoredRun, pictures: tuple[str, ...] = ()) -> Run:
    return Run(
        job=stored.job,
        state=stored.state,
        goal=stored.goal,
        user=stored.user,
        started_utc=stored.started_utc,
        report=_has_report(Path(stored.folder)),
        pictures=pictures,
    )


def _has_report(place: Path) -> bool:
    try:
        with opened(place) as folder:
            return stat.S_ISREG(os.stat(REPORT, dir_fd=folder, follow_symlinks=False).st_mode)
    except (OSError, ValueError):
        return False


def _pictures(stored: StoredRun) -> tuple[str, ...]:
    """Names of pictures, the one of the goal first; none where they cannot be looked at."""
    names = []
    try:
        with opened(Path(stored.folder)) as folder:
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
            below = os.open(PICTURES, flags, dir_fd=folder)
            try:
                with os.scandir(below) as entries:
                    for entry in islice(entries, MOST_NAMED):
                        found = _PICTURE_FILE.fullmatch(entry.name)
                        if found and entry.is_file(follow_symlinks=False):
                            names.append(found[1])
            finally:
                os.close(below)
    except (OSError, ValueError):
        return ()
    return tuple(sorted(names, key=lambda name: (name != stored.goal, name == RUNNING, name)))
