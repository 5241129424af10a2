"""The list of runs: those on disk, newest first, and how each ended.

The folders are the truth. Nothing else is kept, so nothing can be wrong or out of date after a
restart, a copy or a removal by hand. No more is opened than is asked for: a search by time alone
needs only the folders' names.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path

import msgspec

from pdcd.errors import RequestError
from pdcd.files.text import encode_json
from pdcd.printable import to_one_line
from pdcd.protocol.entry import Page, RunEntry, RunQuery
from pdcd.protocol.result import format_job_time
from pdcd.runs.folder import read_manifest
from pdcd.runs.look import make_bare_entry, make_damaged_entry, read_run_entry
from pdcd.runs.walk import (
    DEPTH,
    RunSpot,
    Walk,
    is_job,
    open_run_folder,
    open_state_folder,
    parse_spot,
    require_spot,
    walk_runs,
)

PAGE_BYTES = 2**26
"""Bytes read for one page; further manifests are left to the next page."""
ANSWER_BYTES = 2**19
"""Length of one page as JSON: it still fits into a line of the socket."""


def search_runs(state: Path, query: RunQuery, walk: Walk | None = None) -> Page:
    """A page of the runs below a state folder.

    It may have fewer than `newest` runs, or none, and yet `more` to follow: the amount that is read
    at a time is bounded. Reads directories and manifests, so it must not be called in an event
    loop. `walk` is the result of an earlier walk through the state folder, if there is one. Raises
    RequestError for an invalid `before`, DiskError when the folder cannot be read.
    """
    walk = walk_runs(state) if walk is None else walk
    wanted = list(_by_name(walk.spots, query))
    found: list[RunEntry] = []
    read, told, more = 0, 0, None
    if wanted:
        with open_state_folder(state) as (top, owners):
            for number, spot in enumerate(wanted):
                entry, size = _looked_at(top, spot, str(state / spot.path), owners)
                read += size
                if entry is not None and is_match(entry, query):
                    found.append(entry)
                    told += len(encode_json(entry))
                full = len(found) == query.newest or read > PAGE_BYTES or told > ANSWER_BYTES
                if full and number + 1 < len(wanted):
                    more = spot.path
                    break
    closed = tuple(to_one_line(path) for path in walk.closed[:10])
    return Page(state_folder=str(state), runs=found, more=more, closed=closed, cut=walk.cut)


def find_runs(state: Path, newest: int) -> list[RunEntry]:
    """The newest runs below a state folder, at most so many. Raises DiskError when the folder
    cannot be read."""
    found: list[RunEntry] = []
    for page in iterate_run_pages(state, RunQuery(newest=newest)):
        found += page.runs
        if len(found) >= newest:
            break
    return found[:newest]


def iterate_run_pages(state: Path, query: RunQuery, depth: int = DEPTH) -> Iterator[Page]:
    """Page after page of the runs below a state folder, down to this depth of folders. Raises what
    `search_runs` raises."""
    walk = walk_runs(state, depth)
    while True:
        page = search_runs(state, query, walk)
        yield page
        if page.more is None:
            return
        query = msgspec.structs.replace(query, before=page.more)


def make_name_query(text: str) -> RunQuery:
    """The query for a text by which a person named a run: its job, or its name. Raises
    RequestError."""
    fields = {"job" if is_job(text) else "name": text, "previews": True}
    try:
        return msgspec.convert(fields, RunQuery)
    except msgspec.ValidationError as err:
        raise RequestError(
            f"{to_one_line(text)[:200]!r} is no folder, no job and no name of a run",
            hint="see pdcd runs",
        ) from err


def pick_run(found: Collection[RunEntry], text: str) -> RunEntry:
    """The run that a text means among these; of one job, the run that got furthest.

    Raises RequestError when there is none, or when several runs have that name.
    """
    jobs = sorted({entry.job for entry in found}, reverse=True)
    if not jobs:
        raise RequestError(f"no run is called {to_one_line(text)!r}", hint="see pdcd runs")
    if len(jobs) > 1:
        raise RequestError(
            f"{len(jobs)} runs are called {to_one_line(text)!r}",
            hint=f"name one by its job: {', '.join(jobs[:3])}{' ...' * (len(jobs) > 3)}",
        )
    order = ("done", "partial")
    return min(found, key=lambda e: order.index(e.state) if e.state in order else len(order))


def is_match(entry: RunEntry, query: RunQuery) -> bool:
    """Whether a run matches the query, apart from its time."""
    return (
        (query.goal is None or entry.goal == query.goal)
        and (query.name is None or entry.name == query.name)
        and set(query.tags) <= set(entry.tags)
        and (not query.failed or entry.failed)
    )


def _by_name(spots: list[RunSpot], query: RunQuery) -> Iterator[RunSpot]:
    """The runs that may match, judged by their names."""
    before = None if query.before is None else require_spot(query.before)
    since = None if query.since is None else format_job_time(query.since)
    for spot in spots:
        if since is not None and spot.job < since:
            return  # they are sorted by time
        if before is not None and spot[:2] >= before[:2]:
            continue
        if query.job in (None, spot.job) and (query.previews or not spot.preview):
            yield spot


def _looked_at(
    top: int, spot: RunSpot, path: str, owners: frozenset[int]
) -> tuple[RunEntry | None, int]:
    """A run, and the bytes that were read for it; None where it has been removed meanwhile."""
    bare = make_bare_entry(spot, path)
    if spot.foreign:
        return bare, 0
    try:
        with open_run_folder(top, spot.path, owners) as folder:
            return read_run_entry(folder, spot, path)
    except FileNotFoundError:
        return None, 0
    except OSError as err:
        return make_damaged_entry(bare, err), 0


def read_run_at(folder: Path) -> RunEntry:
    """A run by its folder, wherever that lies and whatever it is called.

    Raises RequestError when there is no folder, DecodeError when it is no run.
    """
    real = Path(os.path.realpath(folder))
    spot = parse_spot(real.name)
    try:
        if spot is None:  # a copy under another name
            spot = RunSpot(read_manifest(real).job, real.name)
        with open_state_folder(real) as (there, _):
            return read_run_entry(there, spot, str(real))[0]
    except OSError as err:
        raise RequestError(
            f"cannot open {to_one_line(str(folder))}: {err.strerror}", hint="see pdcd runs"
        ) from err
