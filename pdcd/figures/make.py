"""Makes figures: complete ones stay, the others are taken and drawn, and the page is kept up to
date."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path

from pdcd.errors import Cancelled, ConfigError, disk_errors
from pdcd.figures.catalog import FIGURES
from pdcd.figures.draw import check_plots, draw_plot, draw_row
from pdcd.figures.figure import (
    PRINTED,
    BoundedNumber,
    FigureMode,
    FigurePlot,
    FigureTake,
    PanelRow,
    PaperFigure,
)
from pdcd.figures.photo import photograph_takes
from pdcd.figures.record import (
    PaperFigureRecord,
    fingerprint_of,
    read_record,
    record_of,
    write_record,
)
from pdcd.files.images import encode_png
from pdcd.files.put import replace_file
from pdcd.pages.render import render_page

PAGE = "index.html"


@dataclass
class MakeOutcome:
    """made : figures in the order of the page. failed : number -> reason, for those that failed."""

    made: list[PaperFigureRecord] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def held(self) -> bool:
        """Whether all figures are there, with every number within its bounds."""
        return not self.failed and all(made["held"] for made in self.made)


def make_paper_figures(
    figures: Sequence[PaperFigure],
    folder: Path,
    mode: FigureMode,
    pool: Executor,
    *,
    plots: bool = True,
    tell: Callable[[int, int, float | None], None] = lambda taken, of, left_s: None,
) -> MakeOutcome:
    """Make figures and the page of a folder; figures that are complete and unchanged stay.

    pool : the processes that make figures, from `open_processes`. plots : whether to draw plots,
    which needs matplotlib. `tell` hears of the progress: captures taken, captures in all, and the
    estimated seconds left, None while unknown. A figure that fails does not end the others.
    Raises ConfigError without matplotlib, and DiskError.
    """
    if plots:
        check_plots()
    with disk_errors(str(folder)):
        (folder / "data").mkdir(parents=True, exist_ok=True)
    outcome, inputs = MakeOutcome(), fingerprint_of(mode, plots=plots)
    waiting = {
        one.number: one for one in figures if read_record(folder, one.number, inputs) is None
    }
    takes = {number: one.takes(mode) for number, one in waiting.items()}
    of = sum(map(len, takes.values()))
    begun_s, taken = time.monotonic(), 0
    # The most expensive first, so that no process is left alone with one at the end.
    dearest = sorted(waiting.values(), key=lambda one: -sum(map(_cost, takes[one.number].values())))
    jobs = {pool.submit(_make_figure, one, folder, mode, inputs, plots): one for one in dearest}
    if jobs:
        tell(0, of, None)
    _write_page(folder, mode, inputs, outcome, waiting)
    for job in as_completed(jobs):
        number = jobs[job].number
        if (error := job.exception()) is not None:
            outcome.failed[number] = str(error)
        del waiting[number]
        taken += len(takes[number])
        _write_page(folder, mode, inputs, outcome, waiting)
        spent_s = time.monotonic() - begun_s
        tell(taken, of, spent_s * (of - taken) / taken if taken else None)
    found = (read_record(folder, one.number, inputs) for one in figures)
    outcome.made = [made for made in found if made and made["number"] not in outcome.failed]
    return outcome


def _cost(take: FigureTake) -> int:
    """Rough cost of a capture; a slice of T takes one photo a column."""
    return 512 if take.goal == "transport" else 64 + int(take.asked.get("codes", 32))


def _write_page(
    folder: Path,
    mode: FigureMode,
    inputs: str,
    outcome: MakeOutcome,
    waiting: dict[str, PaperFigure],
) -> None:
    """Write the page of all figures that are there, not only those asked for."""
    left = {*waiting, *outcome.failed}
    found = [read_record(folder, number, inputs) for number in FIGURES if number not in left]
    made = [one for one in found if one is not None]
    stated = [c for one in made for c in one["captures"] if c["bound"] is not None]
    for one in made:
        stated += [n for n in one["numbers"] if n["least"] is not None or n["most"] is not None]
    text = render_page(
        "figures.html",
        made=made,
        mode=mode,
        failed=outcome.failed,
        waiting=[*waiting],
        stated=len(stated),
        lost=sum(not one["held"] for one in stated),
        printed=PRINTED,
    )
    replace_file(folder / PAGE, text.encode())


@contextmanager
def open_processes(workers: int | None = None) -> Iterator[Executor]:
    """Processes that make figures; without a number two, or one on a single core.

    When the context ends, they end at the next step of their work. Raises ConfigError.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"--workers {workers} is less than 1")
    # More threads for linear algebra gain nothing on arrays of this size and wait for each other;
    # the processes read this when they start.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Otherwise the C library keeps freed memory for each thread.
    os.environ.setdefault("MALLOC_ARENA_MAX", "1")
    context = multiprocessing.get_context("spawn")
    unwanted = context.Event()
    count = workers or min(os.cpu_count() or 1, 2)
    pool = ProcessPoolExecutor(count, context, initializer=_begin, initargs=(unwanted,))
    try:
        yield pool
    finally:
        unwanted.set()
        pool.shutdown(wait=True, cancel_futures=True)


_unwanted: list[Event] = []
"""In a process of the pool: set when its figures are not wanted any more."""
_making = threading.Lock()
"""Held while a figure is made."""


def _begin(unwanted: Event) -> None:
    """Set up a process of the pool: it ignores interrupts, as its parent handles them and ends
    it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _unwanted.append(unwanted)
    threading.Thread(target=_end_with_parent, args=(unwanted,), daemon=True).start()


def _end_with_parent(unwanted: Event) -> None:
    """End this process if its parent was killed: running work first ends at its next step, and
    cleans up."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        unwanted.set()
        with _making:
            os._exit(1)


def _heard() -> None:
    if any(event.is_set() for event in _unwanted):
        raise Cancelled("nobody wants these figures any more")


def _make_figure(
    figure: PaperFigure, folder: Path, mode: FigureMode, inputs: str, plots: bool
) -> None:
    """Take a figure's captures, draw it, write its pictures, and record it with its `inputs`.

    Raises PdcdError.
    """
    takes = figure.takes(mode)
    with _making:
        photos = dict(photograph_takes(takes, mode, _heard))
    shown = list(figure.shown(mode, photos))
    begin = f"fig-{figure.number}"
    rows = (one for one in shown if isinstance(one, PanelRow))
    drawn = (one for one in shown if isinstance(one, FigurePlot) and plots)
    record = record_of(
        figure,
        takes,
        photos,
        [one for one in shown if isinstance(one, BoundedNumber)],
        mode,
        fingerprint=inputs,
        rows=[_write_row(folder, f"{begin}-{k}", row) for k, row in enumerate(rows, 1)],
        plots=[
            _write(folder, f"{begin}-{plot.name}.png", draw_plot(plot), plot.caption)
            for plot in drawn
        ],
    )
    write_record(folder, record)


def _write_row(folder: Path, begin: str, row: PanelRow) -> dict[str, object]:
    pictures = []
    for letter, panel, pixels in zip("abcdefghijklm", row.panels, draw_row(row), strict=False):
        words = re.sub(r"[^a-z0-9]+", "-", panel.caption.lower()).strip("-")[:40]
        file = f"{begin}{letter}-{words}.png"
        pictures.append(_write(folder, file, encode_png(pixels), panel.caption))
    return {"title": row.title, "small": row.small, "pictures": pictures}


def _write(folder: Path, file: str, data: bytes, caption: str) -> dict[str, str]:
    replace_file(folder / file, data)
    return {"file": file, "caption": caption}
