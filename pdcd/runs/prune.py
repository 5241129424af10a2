"""Removal of runs that are no longer wanted: only from the state folder, and never of a run in
progress.

A run is locked, and renamed to say that it is being removed, before any of its files is removed: so
an interrupted removal leaves nothing that looks like a run.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import msgspec

from pdcd.errors import BusyError, DecodeError, DiskError, PdcdError, RequestError, disk_errors
from pdcd.files.inside import remove_folder, walk_folder
from pdcd.protocol.entry import RunEntry, RunQuery
from pdcd.protocol.result import format_job_time
from pdcd.runs.index import iterate_run_pages
from pdcd.runs.place import UNFINISHED
from pdcd.runs.walk import REMOVED, open_run_folder, open_state_folder

_LEFTOVERS = ("failed", "cancelled", "unfinished")
"""Runs without a manifest. Damaged and partial ones are not among them: they may hold all that
there is."""
_KEPT = ("running", "foreign")
"""Never removed."""
MOST_FILES = 1_000_000


class UnwantedRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run that is to be removed, and the result."""

    run: RunEntry
    size_bytes: int
    removed: bool = False
    why: str | None = None
    """Why it could not be removed."""


def find_unwanted_runs(
    state: Path,
    query: RunQuery,
    *,
    older_than: datetime | None = None,
    leftovers: bool = False,
    keep: int = 0,
) -> Iterator[UnwantedRun]:
    """The captures below a state folder that would be removed, newest first.

    They are chosen from those that `query` finds. With `leftovers`, only runs that failed, were
    cancelled or were left unfinished. Of these the newest `keep` are spared; of the rest, those
    started before `older_than` are listed. Raises DiskError when the folder cannot be read.
    """
    limit = None if older_than is None else format_job_time(older_than)
    kept = 0
    for page in iterate_run_pages(state, msgspec.structs.replace(query, previews=False)):
        for run in page.runs:
            if run.state in _KEPT or (leftovers and run.state not in _LEFTOVERS):
                continue
            kept += 1
            if kept > keep and (limit is None or run.job < limit):
                yield UnwantedRun(run=run, size_bytes=_size(state, run))


def remove_run(state: Path, one: UnwantedRun) -> UnwantedRun:
    """Remove a run for good; returns the result. An error is in the result, not raised."""
    path = os.path.relpath(one.run.folder, state)
    try:
        with disk_errors(one.run.folder), _held(state, path) as (parent, name):
            gone = name if name.endswith(REMOVED) else name + REMOVED
            if gone != name:
                os.rename(name, gone, src_dir_fd=parent, dst_dir_fd=parent)
                os.fsync(parent)
            remove_folder(parent, gone)
            os.fsync(parent)
    except PdcdError as err:
        return msgspec.structs.replace(one, why=str(err))
    return msgspec.structs.replace(one, removed=True)


@contextmanager
def _held(state: Path, path: str) -> Iterator[tuple[int, str]]:
    """Descriptor of the folder that holds a run, and the run's name there, while nobody fills the
    run.

    Raises BusyError, RequestError, DiskError, OSError.
    """
    above, _, name = path.rpartition("/")
    if ".." in path.split("/") or not name:
        raise RequestError("it does not lie in the folder of runs")
    with open_state_folder(state) as (top, owners), open_run_folder(top, path, owners) as folder:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BusyError("it is still being filled", hint="see pdcd status") from None
        except OSError as err:
            if name.endswith(UNFINISHED):
                raise DiskError(
                    "its disk has no file locks, so it is not known whether it is being filled",
                    hint="remove it by hand",
                ) from err
        with open_run_folder(top, above, owners) as parent:
            there = os.stat(name, dir_fd=parent, follow_symlinks=False)
            if not os.path.samestat(there, os.fstat(folder)):
                raise BusyError("another folder has taken its name", hint="look again")
            _measured(folder, os.fstat(parent).st_dev)
            yield parent, name


def _size(state: Path, run: RunEntry) -> int:
    """Bytes of all files of a run; 0 where they cannot be read."""
    try:
        with open_state_folder(state) as (top, owners):
            with open_run_folder(top, os.path.relpath(run.folder, state), owners) as folder:
                return _measured(folder, None)
    except (OSError, DiskError, DecodeError):
        return 0


def _measured(folder: int, disk: int | None) -> int:
    """Bytes of all files below an open folder. Raises DiskError where another disk than `disk` is
    mounted in it, or where it holds too many files."""
    size = files = 0
    for _, below, entries in walk_folder(folder):
        if disk is not None and os.fstat(below).st_dev != disk:
            raise DiskError("another disk is mounted in it", hint="unmount it first")
        sizes = [entry.status.st_size for entry in entries if entry.kind != "folder"]
        files += len(sizes)
        size += sum(sizes)
        if files > MOST_FILES:
            raise DiskError(f"it holds more than {MOST_FILES} files", hint="remove it by hand")
    return size
