"""Make figures: take what is missing, in several processes, draw, and keep the page up to date."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path

from pdcd.errors import Cancelled, ConfigError, PdcdError
from pdcd.figures.catalog import FILES, figure_of
from pdcd.figures.figure import Figure, Mode, Take
from pdcd.figures.page import page
from pdcd.figures.photo import packed, photographs
from pdcd.figures.plot import check_plots
from pdcd.figures.store import PAGE, Made, Store
from pdcd.figures.write import write_figure
from pdcd.files.put import put_file

TOGETHER = 8
"""Captures before one bench that one process takes in one go, at most."""
LOOK_S = 0.5
"""How often is looked at how far all are."""


@dataclass(frozen=True)
class Ahead:
    """How far the work is. left_s : estimate; None before anything is known."""

    taken: int
    of: int
    figures: tuple[str, ...]
    left_s: float | None


@dataclass
class Outcome:
    """made : figures in the order of the page. failed : number -> why, of those without a page."""

    made: list[Made] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def held(self) -> bool:
        """Whether all are there with every number within its bounds."""
        return not self.failed and all(made.held for made in self.made)


def make(
    figures: Sequence[Figure],
    folder: Path,
    mode: Mode,
    *,
    workers: int | None = None,
    plots: bool = True,
    tell: Callable[[Ahead], None] = lambda ahead: None,
) -> Outcome:
    """Make figures and the page of a folder; what is there and unchanged stays.

    workers : processes; None: two, or one where there is one core. plots : whether to draw plots,
    which needs matplotlib. `tell` hears how far the work is. A figure that fails does not end the
    others. Raises ConfigError without matplotlib, and DiskError.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"--workers {workers} is less than 1")
    if plots:
        check_plots()
    store, outcome = Store(folder, mode, plots=plots), Outcome()
    stale = [figure for figure in figures if store.made(figure) is None]
    if stale:
        _page(store, mode, outcome, waiting=stale)
        _Work(store, mode, stale, outcome, plots).run(workers or min(os.cpu_count() or 1, 2), tell)
    outcome.made = [made for figure in figures if (made := store.made(figure)) is not None]
    _page(store, mode, outcome, waiting=())
    return outcome


def _page(store: Store, mode: Mode, outcome: Outcome, waiting: Sequence[Figure]) -> None:
    """Write the page of all figures that are there, whoever asked for them."""
    left = {figure.number for figure in waiting} | set(outcome.failed)
    found = [store.made(figure_of(number)) for number in FILES if number not in left]
    made = [one for one in found if one is not None]
    store.write(PAGE, page(made, mode, outcome.failed, [f.number for f in waiting]).encode())


class _Work:
    """The captures of figures that are to be made."""

    def __init__(
        self, store: Store, mode: Mode, figures: Sequence[Figure], outcome: Outcome, plots: bool
    ) -> None:
        self._store, self._mode, self._outcome, self._plots = store, mode, outcome, plots
        self._left = {figure.number: figure for figure in figures}
        self._takes = {figure.number: dict(figure.takes(mode)) for figure in figures}
        self._names = {
            number: {name: store.photo_name(take) for name, take in takes.items()}
            for number, takes in self._takes.items()
        }
        """Of each figure: its captures' names, and those of their photos."""
        self._all = {
            self._names[number][name]: take
            for number, takes in self._takes.items()
            for name, take in takes.items()
        }
        self._begun_s = time.monotonic()
        self._at_first = self._weight(self._taken())

    def run(self, workers: int, tell: Callable[[Ahead], None]) -> None:
        """Take and draw all of them."""
        # More threads of the linear algebra gain nothing on arrays of this size and wait for each
        # other; processes get this when they start.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        # The C library keeps freed memory of each thread to itself otherwise.
        os.environ.setdefault("MALLOC_ARENA_MAX", "1")
        context = multiprocessing.get_context("spawn")
        unwanted = context.Event()
        pool = ProcessPoolExecutor(
            workers, mp_context=context, initializer=_begin, initargs=(unwanted,)
        )
        try:
            jobs: dict[Future[None], dict[str, Take]] = {}
            for group in self._groups():
                job = pool.submit(_take, str(self._store.folder), group, self._mode)
                jobs[job] = group
            self._draw_ready()
            while jobs:
                tell(self._ahead())
                done, _ = wait(jobs, timeout=LOOK_S, return_when=FIRST_COMPLETED)
                for job in done:
                    self._ended(job, jobs.pop(job))
                self._draw_ready()
            tell(self._ahead())
        finally:
            unwanted.set()  # a capture that still runs ends at its next step
            pool.shutdown(wait=True, cancel_futures=True)

    def _groups(self) -> list[dict[str, Take]]:
        """Captures that are not there yet, those before one bench together; by file name. The
        dearest come first, so that no process is left alone with them at the end."""
        benches: dict[str, list[tuple[str, Take]]] = {}
        for name, take in self._all.items():
            if not self._store.has(name):
                benches.setdefault(take.stands, []).append((name, take))
        groups = []
        for some in benches.values():
            count = -(-len(some) // TOGETHER)
            groups += [dict(some[part::count]) for part in range(count)]
        return sorted(groups, key=lambda group: -sum(map(_cost, group.values())))

    def _ended(self, job: Future[None], group: Mapping[str, Take]) -> None:
        """Note what failed, for every figure that needs it."""
        error = job.exception()
        if error is None:
            return
        lost = {name for name in group if not self._store.has(name)}
        for number, names in self._names.items():
            if number in self._left and not lost.isdisjoint(names.values()):
                self._outcome.failed[number] = str(error)
                del self._left[number]

    def _draw_ready(self) -> None:
        """Draw every figure whose photos are all there."""
        for number, figure in list(self._left.items()):
            names = self._names[number]
            if not all(map(self._store.has, names.values())):
                continue
            del self._left[number]
            photos = {name: self._store.photo(file) for name, file in names.items()}
            whole = {name: photo for name, photo in photos.items() if photo is not None}
            if len(whole) < len(names):
                self._store.forget(names.values())
                self._outcome.failed[number] = "a photo of it was damaged; make it again"
                continue
            takes = self._takes[number]
            try:
                write_figure(self._store, figure, self._mode, takes, whole, plots=self._plots)
            except PdcdError as err:
                self._outcome.failed[number] = str(err)
                continue
            wanted = {file for other in self._left for file in self._names[other].values()}
            self._store.forget(set(names.values()) - wanted)
            _page(self._store, self._mode, self._outcome, list(self._left.values()))

    def _taken(self) -> set[str]:
        """Photos that are there, or were: those of figures that are done with are gone."""
        done = {
            f for n, names in self._names.items() if n not in self._left for f in names.values()
        }
        return done | set(filter(self._store.has, self._all))

    def _weight(self, taken: set[str]) -> float:
        """Roughly what they have cost, in units of a cheap one."""
        return sum(_cost(self._all[name]) for name in taken)

    def _ahead(self) -> Ahead:
        taken = self._taken()
        weight, whole = self._weight(taken), self._weight(set(self._all))
        gained = weight - self._at_first
        spent_s = time.monotonic() - self._begun_s
        left_s = spent_s * (whole - weight) / gained if gained > 0.0 else None
        return Ahead(len(taken), len(self._all), tuple(self._left), left_s)


def _cost(take: Take) -> float:
    """Roughly what a capture costs, in units of a cheap one."""
    if take.goal == "transport":  # a photo for every column of the slice
        return 8.0
    return 1.0 + int(take.asked.get("codes", 32)) / 64.0


_unwanted: list[Event] = []
"""In a process of the pool: set when nobody wants its captures any more."""


def _begin(unwanted: Event) -> None:
    """A process of the pool: an interrupt is for the one that started it, who ends this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _unwanted.append(unwanted)


def _take(folder: str, takes: Mapping[str, Take], mode: Mode) -> None:
    """Take captures before one bench, and write their photos below `folder` by their names."""
    parent = os.getppid()

    def heard() -> None:
        if os.getppid() != parent or any(event.is_set() for event in _unwanted):
            raise Cancelled("whoever wanted these figures is gone")

    for name, photo in photographs(takes, mode, heard):
        put_file(Path(folder) / name, packed(photo))
