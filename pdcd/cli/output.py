"""What commands print: JSON objects, small tables, the end of a job, and progress."""

from __future__ import annotations

import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import msgspec

from pdcd.cli.exits import CANCELLED, DONE, FAILED, exit_code
from pdcd.client import OnEvent
from pdcd.errors import PdcdError
from pdcd.printable import one_line
from pdcd.request import CaptureResult, Figure, Quality
from pdcd.runs.events import (
    Armed,
    Attention,
    Converging,
    Decoded,
    Decoding,
    Event,
    Learning,
    Planning,
    Progress,
    StepBegun,
    StepEnded,
    fields,
)
from pdcd.runs.later import REPORT

Value = float | int | str
"""What the summary of a run holds beside the verdict."""

WIDTH = 80
"""Columns of a terminal that sentences are wrapped to."""

LINE_INTERVAL_S = 1.0
"""Least time between two progress lines where no bar can be drawn."""


def percent(share: Value) -> str:
    """Write a share as a percentage of three digits."""
    return f"{100.0 * float(share):.3g} %"


KINDS = {
    "measured": "measured by the spread of parts",
    "modelled": "modelled, not measured",
}
"""How the part of sigma that is not noise was found, for people."""

SUMMARY: tuple[tuple[str, str, Callable[[Value], str]], ...] = (
    ("taken", "taken", str),
    ("decided", "decided", str),
    ("codes", "codes", str),
    ("refreshes", "refreshes", str),
    ("exposure_s", "exposure", lambda s: f"{float(s):.3f} s"),
    ("missed_refreshes", "missed refreshes", str),
    ("rms_sigma", "RMS sigma", lambda e: f"{percent(e)} of the picture"),
    ("sigma_kind", "error bars", lambda kind: KINDS.get(str(kind), str(kind))),
    ("rms_error", "RMS error", lambda e: f"{percent(e)} against the scene's known truth"),
    ("transport_sigma", "sigma of T", lambda e: f"{percent(e)} of its entries' RMS"),
    ("transport_error", "error of T", lambda e: f"{percent(e)} against the scene's known truth"),
    ("predicted_error", "predicted", percent),
    ("wall_s", "wall time", lambda s: f"{float(s):.2f} s"),
)
"""Lines of the table after a capture: key of the summary, label, how to write the value."""


def say(text: str) -> None:
    """Print one result line; what cannot be seen in it is escaped, for others wrote much of it."""
    sys.stdout.write(one_line(text) + "\n")


def tell(text: str) -> None:
    """Print one line for the human who watches; never part of the result. Escaped as by `say`."""
    sys.stderr.write(one_line(text) + "\n")
    sys.stderr.flush()


def say_json(value: object) -> None:
    """Print a wire object on one line and hand it on at once."""
    say(msgspec.json.encode(value).decode())
    sys.stdout.flush()


def say_compared(report: object, items: Iterable[tuple[str, bool]], *, as_json: bool) -> int:
    """Print what was made again, each by its name and whether it is as it was, and return the exit
    code that goes with it."""
    found = list(items)
    if as_json:
        say_json(report)
    else:
        for name, identical in found:
            say(f"{'identical' if identical else 'DIFFERS  '}  {name}")
    return DONE if all(identical for _, identical in found) else FAILED


def say_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in aligned columns."""
    shown = [[one_line(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    for row in shown:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        say("  ".join(cells).rstrip())


def say_result(result: CaptureResult, *, as_json: bool) -> int:
    """Print the end of a job and return the exit code that goes with it."""
    if as_json:
        say_json(result)
    else:
        _say_plainly(result)
    if result.error is not None and result.state in ("failed", "cancelled"):
        error = PdcdError(
            result.error.get("message") or result.state,
            device=result.error.get("device"),
            hint=result.error.get("hint"),
        )
        tell(f"pdcd: {error}")
    if result.state == "failed":
        return exit_code((result.error or {}).get("kind"))
    return CANCELLED if result.state == "cancelled" else DONE


def _say_plainly(result: CaptureResult) -> None:
    rows = [["job", result.job], ["state", result.state]]
    quality = result.summary.get("quality")
    if isinstance(quality, Quality):
        rows.append(["verdict", quality.verdict])
    for key, label, write in SUMMARY:
        value = figure(result.summary, key)
        if value is not None:
            rows.append([label, write(value)])
    if result.folder is not None:
        rows.append(["folder", result.folder])
    for label, name in (("to look at", "preview/{}.png"), ("to measure", "linear/{}.tif")):
        file = name.format(result.summary.get("picture"))
        if file in result.files:
            rows.append([label, f"{result.folder}/{file}"])
    for label, file in (("T to look at", "preview/transport.png"), ("T", "transport.npz")):
        if file in result.files:
            rows.append([label, f"{result.folder}/{file}"])
    if REPORT in result.files:
        rows.append(["report", f"{result.folder}/{REPORT}"])
    say_table(rows)
    say_notes(result)


def figure(summary: Mapping[str, Figure], key: str) -> Value | None:
    """A value of the summary that is a number or a word."""
    value = summary.get(key)
    return None if isinstance(value, Quality) else value


def say_notes(result: CaptureResult) -> None:
    """Print why a photo is not good, what else to know of it, and all warnings of the run."""
    quality = result.summary.get("quality")
    notes = [("warning", text) for text in result.warnings]
    if isinstance(quality, Quality):
        reasons = [(quality.verdict, text) for text in quality.reasons]
        notes = [*reasons, *(("remark", text) for text in quality.remarks), *notes]
    for head, text in notes:
        for line in textwrap.wrap(one_line(f"{head}: {text}"), WIDTH, subsequent_indent="  "):
            say(line)


@contextmanager
def progress(first: str = "waiting") -> Iterator[OnEvent]:
    """Show events on stderr: a bar on a terminal, else lines at most one a second.

    `first` is what is done before the first event.
    """
    if not sys.stderr.isatty():
        yield _Lines()
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        task = bars.add_task(first, total=None)
        stages = _Stages()

        def show(event: Event) -> None:
            words = _words(event)
            done, total = _share(event) or (None, None)
            if stages.begins(event):  # so that the time left is that of this stage
                bars.reset(task, total=total or 1.0, description=words)
            bars.update(task, description=words, completed=done, total=total)

        yield show


class _Lines:
    """Progress where no bar can be drawn: in a pipe, a log, a terminal without movement."""

    def __init__(self) -> None:
        self._next_s = 0.0
        self._begun_s = 0.0
        self._stages = _Stages()

    def __call__(self, event: Event) -> None:
        now_s = time.monotonic()
        if self._stages.begins(event):
            self._begun_s = now_s
        share = _share(event)
        if share is None:
            tell(_words(event))
            return
        if now_s < self._next_s:
            return
        self._next_s = now_s + LINE_INTERVAL_S
        done, total = share
        left_s = (now_s - self._begun_s) * (total - done) / done if done else 0.0
        tell(_words(event) + (f", {left_s:.0f} s left" if left_s >= 1.0 else ""))


class _Stages:
    """Of what there is progress: of the plan, of each exposure, of making pictures."""

    def __init__(self) -> None:
        self._stage: str | None = None

    def begins(self, event: Event) -> bool:
        """Whether the event is the first of a stage."""
        if isinstance(event, (Armed, Progress)):
            stage = f"shot {event.shot}"
        elif isinstance(event, Planning):
            stage = "planning"
        elif isinstance(event, (Learning, Decoding, Decoded)):
            stage = "decoding"
        else:
            return False
        new = stage != self._stage or isinstance(event, Armed)
        self._stage = stage
        return new


def _share(event: Event) -> tuple[float, float] | None:
    """Work done, and all of it, where the event tells."""
    if isinstance(event, Progress):
        return event.frame, event.frames
    return (event.done, event.total) if isinstance(event, (Decoded, Planning)) else None


def _words(event: Event) -> str:
    """Say where the job stands: the shot, if the event names one, and the step or the refreshes."""
    return one_line(_plain_words(event))


def _plain_words(event: Event) -> str:
    step = event.type.replace("_", " ")
    if isinstance(event, Decoded):
        return f"decoding: {100.0 * event.done / event.total:.0f} %"
    if isinstance(event, Planning):
        return f"planning {event.stage}: {100.0 * event.done / event.total:.0f} %"
    if isinstance(event, Converging):
        error = "unknown" if event.rms_sigma is None else f"{100.0 * event.rms_sigma:.2g} %"
        return f"part {event.part}: error {error}, wanted {100.0 * event.target:g} %"
    if isinstance(event, StepBegun):
        return f"step {event.number} of {event.steps}: {event.step}"
    if isinstance(event, StepEnded):
        return f"{event.step}: {event.verdict}"
    if isinstance(event, Attention):
        return event.text
    if isinstance(event, Progress):
        step = f"{event.frame}/{event.frames} refreshes"
        if event.missed:
            step += f", {event.missed} missed"
    shot = fields(event).get("shot")
    return f"{shot}: {step}" if shot else step
