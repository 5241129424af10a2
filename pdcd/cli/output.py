"""What commands print: JSON objects, small tables, and the end of a job."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

from pdcd.api.progress import tell_user
from pdcd.api.rows import summary_rows
from pdcd.cli.exits import CANCELLED, DONE, FAILED, exit_code_of
from pdcd.cli.request import name_options
from pdcd.cli.streams import write_stdout
from pdcd.errors import ConfigError, PdcdError
from pdcd.files.text import encode_json
from pdcd.printable import to_one_line
from pdcd.protocol.result import CaptureResult, Quality, quality_of, read_summary_value
from pdcd.runs.folder import REPORT_FILE

WIDTH = 80
"""Columns of output where there is no terminal with a width."""
_LABEL = 16
"""Columns up to this width are not broken into lines."""
_WHOLE_WORDS: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}


def say(text: str) -> None:
    """Print one result line. Invisible characters are escaped, as much of it comes from others."""
    write_stdout(to_one_line(text) + "\n")


def say_json(value: object) -> None:
    """Print a wire object on one line."""
    say(encode_json(value).decode())


def say_comparison(report: object, items: Iterable[tuple[str, bool]], *, as_json: bool) -> int:
    """Print the name of each item that was made again and whether it is identical, and return the
    matching exit code."""
    found = list(items)
    if as_json:
        say_json(report)
    else:
        for name, identical in found:
            say(f"{'identical' if identical else 'DIFFERS  '}  {name}")
    return DONE if all(identical for _, identical in found) else FAILED


def find_terminal_width() -> int:
    """Columns of the terminal that results go to."""
    if not sys.stdout.isatty():
        return WIDTH
    return max(shutil.get_terminal_size((WIDTH, 24)).columns, WIDTH // 2)


def say_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in aligned columns."""
    for line in draw_table(rows):
        say(line)


def draw_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of rows in aligned columns, no wider than the terminal. Words are never broken, so
    that paths can be copied, even if a line gets wider."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = [[to_one_line(cell) for cell in row] for row in rows]
    table = Table.grid(padding=(0, 2, 0, 0), pad_edge=False)
    least = 2 * (len(shown[0]) - 1)
    for column in zip(*shown, strict=True):
        wide = max(map(len, column))
        longest = max(len(word) for cell in column for word in cell.split(" "))
        whole = wide <= _LABEL or not any(" " in cell.strip() for cell in column)
        table.add_column(no_wrap=whole, overflow="fold")
        least += wide if whole else longest
    for row in shown:
        if (
            least > find_terminal_width()
        ):  # a path in the last column, which may be long; sentences may not
            room = max(find_terminal_width() - (least - longest), _LABEL)
            row[-1] = "\n".join(textwrap.wrap(row[-1], room, **_WHOLE_WORDS))
        table.add_row(*map(Text, row))
    console = Console(
        width=max(find_terminal_width(), least), color_system=None, force_jupyter=False
    )
    with console.capture() as captured:
        console.print(table)
    return [line.rstrip() for line in captured.get().splitlines()]


def say_text(text: str) -> None:
    """Print a sentence in lines no longer than the terminal is wide, indented after the first."""
    for line in textwrap.wrap(
        to_one_line(text), find_terminal_width(), subsequent_indent="  ", **_WHOLE_WORDS
    ):
        say(line)


def say_result(result: CaptureResult, *, as_json: bool) -> int:
    """Print how a job ended and return the matching exit code."""
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
        refused = (result.error or {}).get("kind") == "request"
        tell_user(f"pdcd: {name_options(str(error)) if refused else error}")
    if result.state == "failed":
        return exit_code_of((result.error or {}).get("kind"))
    return CANCELLED if result.state == "cancelled" else DONE


def _say_plainly(result: CaptureResult) -> None:
    rows = [["job", result.job], ["state", result.state]]
    quality = quality_of(result.summary)
    if quality is not None:
        rows.append(["verdict", quality.verdict])
    rows += summary_rows(partial(read_summary_value, result.summary))
    if result.folder is not None:
        rows.append(["folder", result.folder])
    for label, name in (("to look at", "preview/{}.png"), ("to measure", "linear/{}.tif")):
        file = name.format(result.summary.get("picture"))
        if file in result.files:
            rows.append([label, f"{result.folder}/{file}"])
    for label, file in (("T to look at", "preview/transport.png"), ("T", "transport.npz")):
        if file in result.files:
            rows.append([label, f"{result.folder}/{file}"])
    if REPORT_FILE in result.files:
        rows.append(["report", f"{result.folder}/{REPORT_FILE}"])
    say_table(rows)
    say_notes(result)


def ask_consent(question: str, *, silent: bool) -> bool:
    """Whether the user at this terminal agrees. Raises ConfigError if there is no terminal to ask
    at, or the output is for a program (`silent`)."""
    if silent or not sys.stdin.isatty():
        raise ConfigError("there is nobody to ask", hint="give --yes")
    tell_user(f"{question} [y/N]")
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    tell_user("nothing was removed")
    return False


def say_notes(result: CaptureResult) -> None:
    """Print why a photo is not good, other remarks on it, and all warnings of the run."""
    say_verdict(quality_of(result.summary), result.warnings)


def say_verdict(quality: Quality | None, warnings: Iterable[str]) -> None:
    """Print the reasons of a verdict, its remarks, and warnings."""
    notes = [("warning", text) for text in warnings]
    if quality is not None:
        reasons = [(quality.verdict, text) for text in quality.reasons]
        notes = [*reasons, *(("remark", text) for text in quality.remarks), *notes]
    for head, text in notes:
        say_text(f"{head}: {text}")
