"""Runs on disk, for the page: read only, by name, and nothing but pictures and reports.

Names from a browser are only compared with existing ones (`pdcd.runs.index`); no path is made from
them. Files are opened through the state folder's descriptor, without following links, with limits.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import msgspec

from pdcd.api.rows import describe_error
from pdcd.bench.choosing import CALIBRATIONS_FOLDER as CALIBRATIONS
from pdcd.errors import DecodeError, RequestError
from pdcd.files.inside import read_inner_file
from pdcd.protocol.entry import RunEntry
from pdcd.runs.folder import REPORT_FILE
from pdcd.runs.index import find_runs, make_name_query, pick_run, search_runs
from pdcd.runs.place import UNFINISHED
from pdcd.runs.walk import is_job, open_run_folder, open_state_folder

_LISTED = 100
"""Number of the newest runs in the list."""
_PICTURES = "preview"
"""Folder of the pictures of a run."""
MOST_REPORT_BYTES = 2**26
MOST_PICTURE_BYTES = 2**25
_MOST_NAMED = 200
"""Most pictures of one run that are listed."""
_RUNNING = "running"
"""Name of the picture of a run that is still going on."""

_PICTURE = re.compile(r"[A-Za-z0-9_-]{1,64}")
_PICTURE_FILE = re.compile(rf"({_PICTURE.pattern})\.png")


class ShelfRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run as the page shows it; `entry` is null for a calibration. `error` is in words."""

    job: str
    entry: RunEntry | None
    report: bool
    error: str = ""
    pictures: tuple[str, ...] = ()
    """Names of its pictures, the one of its goal first."""


class RunShelf:
    """The runs below a state folder. All methods read the disk: do not call them in an event
    loop."""

    def __init__(self, state: Path) -> None:
        self._state = state

    def runs(self) -> list[ShelfRun]:
        """The newest runs, the newest first. Raises DiskError where the folder cannot be read."""
        found = find_runs(self._state, _LISTED)
        return [
            ShelfRun(
                job=entry.job,
                entry=entry,
                report=self._has_report(self._place(entry)),
                error=describe_error(entry),
            )
            for entry in found
        ]

    def run(self, job: str) -> ShelfRun:
        """One run, quick look or calibration, with its pictures.

        Raises RequestError when there is none of that name, DiskError as `find_runs`.
        """
        entry, place = self._found(job)
        pictures = self._pictures(place, None if entry is None else entry.goal)
        return ShelfRun(job=job, entry=entry, report=self._has_report(place), pictures=pictures)

    def picture(self, job: str, name: str) -> bytes:
        """A picture of a run, PNG. Raises what `run` raises, or RequestError if it has none."""
        if not _PICTURE.fullmatch(name):
            raise RequestError("no picture is called that")
        return self._file(job, f"{_PICTURES}/{name}.png", MOST_PICTURE_BYTES)

    def report(self, job: str) -> bytes:
        """The report of a run, HTML. Raises what `run` raises, or RequestError if it has none."""
        return self._file(job, REPORT_FILE, MOST_REPORT_BYTES)

    def _file(self, job: str, name: str, most_bytes: int) -> bytes:
        _, place = self._found(job)
        try:
            with self._opened(place) as folder:
                return read_inner_file(folder, name, most_bytes)
        except (OSError, ValueError, DecodeError) as err:
            why = (err.strerror if isinstance(err, OSError) else None) or str(err)
            raise RequestError(f"{name} of {job} cannot be read: {why}") from err

    def _found(self, job: str) -> tuple[RunEntry | None, str]:
        """The run of that name, and its path below the state folder. Raises RequestError."""
        if not is_job(job):
            raise RequestError("no run is called that")
        for place in (f"{CALIBRATIONS}/{job}", f"{CALIBRATIONS}/{job}{UNFINISHED}"):
            try:
                with self._opened(place):
                    return None, place
            except OSError:
                continue
        entry = pick_run(search_runs(self._state, make_name_query(job)).runs, job)
        return entry, self._place(entry)

    def _place(self, entry: RunEntry) -> str:
        return str(Path(entry.folder).relative_to(self._state))

    @contextmanager
    def _opened(self, place: str) -> Iterator[int]:
        """Descriptor of one of our folders below the state folder. Raises OSError."""
        with (
            open_state_folder(self._state) as (top, owners),
            open_run_folder(top, place, owners) as folder,
        ):
            yield folder

    def _has_report(self, place: str) -> bool:
        try:
            with self._opened(place) as folder:
                return stat.S_ISREG(
                    os.stat(REPORT_FILE, dir_fd=folder, follow_symlinks=False).st_mode
                )
        except (OSError, ValueError):
            return False

    def _pictures(self, place: str, goal: str | None) -> tuple[str, ...]:
        """Names of pictures, the one of the goal first; none if they cannot be read."""
        names = []
        try:
            with self._opened(f"{place}/{_PICTURES}") as folder, os.scandir(folder) as entries:
                for entry in islice(entries, _MOST_NAMED):
                    found = _PICTURE_FILE.fullmatch(entry.name)
                    if found and entry.is_file(follow_symlinks=False):
                        names.append(found[1])
        except (OSError, ValueError):
            return ()
        return tuple(sorted(names, key=lambda name: (name != goal, name == _RUNNING, name)))
