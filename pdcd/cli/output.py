"""What commands print: JSON objects, small tables, and the end of a job."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence

import msgspec

from pdcd.api.progress import tell
from pdcd.cli.exits import CANCELLED, DONE, FAILED, exit_code
from pdcd.cli.tables import fitted, width, wrapped
from pdcd.errors import PdcdError
from pdcd.printable import one_line
from pdcd.protocol.result import CaptureResult, Quality, figure_of, quality_of
from pdcd.runs.later import REPORT
from pdcd.words import SIGMA_KINDS

Value = float | int | str
"""What the summary of a run holds beside the verdict."""


def percent(share: Value) -> str:
    """Write a share as a percentage of three digits."""
    return f"{100.0 * float(share):.3g} %"


SUMMARY: tuple[tuple[str, str, Callable[[Value], str]], ...] = (
    ("taken", "taken", str),
    ("decided", "decided", str),
    ("codes", "codes", str),
    ("refreshes", "refreshes", str),
    ("exposure_s", "exposure", lambda s: f"{float(s):.3f} s"),
    ("missed_refreshes", "missed refreshes", str),
    ("rms_sigma", "RMS sigma", lambda e: f"{percent(e)} of the picture"),
    ("sigma_kind", "error bars", lambda kind: SIGMA_KINDS.get(str(kind), str(kind))),
    ("scale", "scale", str),
    ("scale_sigma", "scale, sigma", percent),
    ("rms_error_quads", "RMS error", lambda e: f"{percent(e)} of quads, against the known truth"),
    ("rms_error_cells", "", lambda e: f"{percent(e)} of means over cells"),
    ("transport_sigma", "sigma of T", lambda e: f"{percent(e)} of its entries' RMS"),
    ("transport_error", "error of T", lambda e: f"{percent(e)} against the scene's known truth"),
    ("predicted_error", "predicted", percent),
    ("wall_s", "wall time", lambda s: f"{float(s):.2f} s"),
)
"""Lines of the table after a capture: key of the summary, label, how to write the value."""


def say(text: str) -> None:
    """Print one result line, at once also into a pipe: the command may go on for hours.

    What cannot be seen in it is escaped, for others wrote much of it.
    """
    sys.stdout.write(one_line(text) + "\n")
    sys.stdout.flush()


def say_json(value: object) -> None:
    """Print a wire object on one line."""
    say(msgspec.json.encode(value).decode())


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


def say_table(rows: Sequence[Sequence[str]], *, whole: bool = False) -> None:
    """Print rows in aligned columns, no wider than the terminal; or `whole`, each on one line."""
    for line in fitted(rows, sys.maxsize if whole else width()):
        say(line)


def say_text(text: str) -> None:
    """Print a sentence in lines no longer than the terminal is wide."""
    for line in wrapped(text, width()):
        say(line)


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
    quality = quality_of(result.summary)
    if quality is not None:
        rows.append(["verdict", quality.verdict])
    for key, label, write in SUMMARY:
        value = figure_of(result.summary, key)
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


def say_notes(result: CaptureResult) -> None:
    """Print why a photo is not good, what else to know of it, and all warnings of the run."""
    say_verdict(quality_of(result.summary), result.warnings)


def say_verdict(quality: Quality | None, warnings: Iterable[str]) -> None:
    """Print the reasons of a verdict, its remarks, and warnings."""
    notes = [("warning", text) for text in warnings]
    if quality is not None:
        reasons = [(quality.verdict, text) for text in quality.reasons]
        notes = [*reasons, *(("remark", text) for text in quality.remarks), *notes]
    for head, text in notes:
        say_text(f"{head}: {text}")
