"""Many captures, one table: on one bench, in processes of their own, or on a cluster.

A sweep finds finished captures in its folder: each capture has a place there, named by a hash of
everything that determines it, with its run or a link to it.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec

from pdcd.api.arguments import make_request, to_json_types
from pdcd.api.bench import Bench
from pdcd.api.executors import Processes, connect_cluster
from pdcd.api.local import Configured, LocalBench, describe_bench, resolve_config
from pdcd.api.progress import draw_progress
from pdcd.api.table import Table
from pdcd.api.task import (
    Task,
    TaskRecord,
    Value,
    find_kept_row,
    hash_capture,
    hold_place,
    keep_in_place,
    load_arrays,
    make_failed_row,
    make_result_row,
    take_capture,
)
from pdcd.bench.tables import Config
from pdcd.errors import PdcdError, RequestError
from pdcd.files.text import encode_json
from pdcd.protocol.request import CaptureRequest

_Request = Mapping[str, Any] | CaptureRequest | str
"""Keywords of a capture with its "goal", and for a sweep over benches a "config"; a request; or
the name of a goal."""

_Ends = Generator[tuple[Task, TaskRecord], None, None]
"""Tasks and how they ended, in the order in which they end."""


def sweep(
    bench: Bench | Configured,
    requests: Iterable[_Request],
    *,
    workers: int | None = None,
    folder: Path | str | None = None,
    progress: bool | Callable[[TaskRecord], None] = True,
    cluster: Any = None,
) -> Table:
    """Take many photos; one that fails does not end the others.

    Parameters
    ----------
    bench : a bench, which takes one photo after the other; or a configuration as `pdcd.local` takes
        it: then each photo is taken on a bench of its own, as many at a time as there are workers.
        With real devices, photos are taken one after the other, too.
    requests : each a mapping of keywords of `Bench.capture`, with "goal"; where `bench` is a
        configuration it may have "config", tables or TOML text that change some of its keys.
    workers : processes; None: one for each processor; 0: all in this process.
    folder : where the runs go, or links to those of a daemon: the same sweep into the same folder
        takes only photos that are missing or have failed. None: the runs go where those of a single
        capture would, and none is found again.
    progress : whether to show progress; or a function that takes the row of each capture that has
        ended.
    cluster : address of a Dask cluster that takes the photos, or a `distributed.Client` of it;
        needs the extra `cluster`.

    Raises RequestError for a wrong request, before any photo is taken; BusyError where another
    sweep fills the folder.
    """
    place = None if folder is None else Path(folder).absolute()
    shared = bool(workers) or cluster is not None
    if isinstance(bench, Bench):
        if shared:
            raise RequestError(
                "a bench takes one photo at a time", hint="give its configuration instead"
            )
        tasks = _tasks(requests, Config(), bench, place)
        return _collected(tasks, place, progress, partial(_one_by_one, partial(_taken_on, bench)))
    tasks = _tasks(requests, resolve_config(bench), None, place)
    if any(not _mock(task.config) for task in tasks):
        if shared:
            raise RequestError("real devices take one photo at a time", hint="leave out workers")
        workers = 0
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 0:
        raise RequestError(f"{count} workers", hint="take 1 or more, or 0 for this process")
    if cluster is not None:
        with connect_cluster(cluster) as executor:
            return _collected(tasks, place, progress, partial(_all_on, executor))
    run = partial(_all_on, Processes(count)) if count else partial(_one_by_one, take_capture)
    return _collected(tasks, place, progress, run)


def _collected(
    tasks: Sequence[Task],
    folder: Path | None,
    progress: bool | Callable[[TaskRecord], None],
    run: Callable[[Sequence[Task]], _Ends],
) -> Table:
    """Run the tasks that the folder does not have yet, and put all rows into one table."""
    rows: list[TaskRecord] = []
    left: list[Task] = []
    with hold_place(folder):
        for task in tasks:
            row = find_kept_row(task)
            if row is None:
                left.append(task)
            else:
                rows.append(task.told | row)
        with _counting(progress, len(rows), len(tasks)) as tell, closing(run(left)) as ends:
            for task, row in ends:
                keep_in_place(task, row)
                rows.append(task.told | row)
                tell(rows[-1])
    return Table(sorted(rows, key=itemgetter("number")))


@contextmanager
def _counting(
    progress: bool | Callable[[TaskRecord], None], done: int, total: int
) -> Iterator[Callable[[TaskRecord], None]]:
    """Yield the function that is called with each row."""
    if callable(progress) or not progress:
        yield progress or (lambda row: None)
        return
    states: list[bool] = []
    with draw_progress(f"{done} of {total} captures") as show:

        def tell(row: TaskRecord | None) -> None:
            states.extend([] if row is None else [row["state"] == "done"])
            failures = states.count(False)
            words = f"{done + len(states)} of {total} captures"
            share = float(len(states)), float(max(total - done, 1))
            show(words + f", {failures} failed" * bool(failures), share, row is None)

        tell(None)
        yield tell


def _tasks(
    requests: Iterable[_Request], config: Config, bench: Bench | None, folder: Path | None
) -> list[Task]:
    """Every request, checked and made a task; equal requests get different places."""
    seen: Counter[str] = Counter()
    benches: dict[int, tuple[Config, dict[str, Any]]] = {}
    if bench is not None:
        benches[id(config)] = config, bench.described()
    tasks = []
    for number, request in enumerate(requests):
        try:
            task = _task(request, config, bench)
        except PdcdError as err:
            raise RequestError(f"request {number}: {err.message}", hint=err.hint) from err
        # Most tasks share one configuration, whose files need not be read again for each task.
        what = benches.setdefault(id(task.config), (task.config, describe_bench(task.config)))[1]
        first = hash_capture(what, task.request, task.arrays, 0)
        key = hash_capture(what, task.request, task.arrays, seen[first])
        seen[first] += 1
        # One folder a task: runs that begin in the same second could have the same name.
        place = None if folder is None else folder / "runs" / key[:16]
        tasks.append(replace(task, folder=place, told={"number": number, **task.told}))
    return tasks


def _task(request: _Request, config: Config, bench: Bench | None) -> Task:
    """One request as a task. Raises RequestError and ConfigError."""
    if isinstance(request, CaptureRequest):
        return Task(config, request)
    if not isinstance(request, str | Mapping):
        raise RequestError(
            f"{request!r:.80} is no request", hint="give a goal, or keywords with one"
        )
    keywords = {"goal": request} if isinstance(request, str) else dict(request)
    overlay = keywords.pop("config", None)
    if overlay is not None:
        if bench is not None:
            raise RequestError("a bench keeps its configuration", hint="give one instead of it")
        config = resolve_config(overlay, config)
    goal = str(keywords.pop("goal", None))

    def grid() -> tuple[int, int]:
        return LocalBench(config).grid if bench is None else bench.grid

    made, arrays = make_request(goal, keywords, grid)
    # Only now, when all values are checked: others could not be put into a table.
    told = {f"asked.{name}": _said(value) for name, value in keywords.items()}
    told |= {f"asked.config.{name}": _said(v) for name, v in _flat(overlay)}
    return Task(config, made, load_arrays(arrays), told=told)


def _flat(tables: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """The dotted keys of tables with their values; text given instead counts as one key."""
    if not isinstance(tables, Mapping):
        if tables is not None:
            yield path or "text", tables
        return
    for name, value in tables.items():
        yield from _flat(value, f"{path}.{name}" if path else str(name))


def _said(value: Any) -> Value:
    """A requested value as one cell of a table."""
    simple = to_json_types(value)
    if simple is None or isinstance(simple, bool | int | float | str):
        return simple
    text = encode_json(simple).decode()
    return text if len(text) <= 80 else f"{text[:76]} ..."


def _one_by_one(take: Callable[[Task], TaskRecord], tasks: Sequence[Task]) -> _Ends:
    """One after the other, in this process."""
    for task in tasks:
        yield task, take(task)


def _all_on(executor: Executor, tasks: Sequence[Task]) -> _Ends:
    """As many at a time as the executor takes; closing the generator ends those still running."""
    futures = {executor.submit(take_capture, task): task for task in tasks}
    try:
        for future in as_completed(futures):
            task = futures[future]
            try:
                row = future.result()
            except PdcdError as err:
                row = make_failed_row(task.request, err)
            except Exception as err:  # any way in which a cluster loses a call
                row = make_failed_row(task.request, PdcdError(f"the cluster lost it: {err}"))
            yield task, row
    finally:
        for future in futures:
            future.cancel()
        executor.shutdown(wait=False)


def _taken_on(bench: Bench, task: Task) -> TaskRecord:
    """Take the photo on a given bench."""
    request = task.request
    # A daemon keeps runs in places of its own.
    if task.folder is not None and request.out is None and isinstance(bench, LocalBench):
        request = msgspec.structs.replace(request, out=str(task.folder))
    try:
        return make_result_row(request, bench.take(request, task.arrays))
    except PdcdError as err:
        return make_failed_row(request, err)


def _mock(config: Config) -> bool:
    """Whether the bench has no device that another process could hold."""
    return {config.display.driver, config.trigger.driver, config.camera.driver} == {"mock"}
