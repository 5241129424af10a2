"""Texts and shares made fit to show: no forged lines in a log, no orders to terminal or browser."""

from __future__ import annotations

import contextlib
import html
import json
import os
import sys
from typing import Any


def to_one_line(text: str) -> str:
    """The text on one line, with what cannot be seen in it as JSON escapes it (``\\n``).

    That covers newlines, terminal escapes, marks that turn the direction of writing, and halves of
    characters. A JSON text stays one, with the same value.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escaped(c) for c in text)


def to_indented_lines(text: str) -> str:
    """A text of several lines: each as `to_one_line` has it, all but the first indented.

    So no further line can be taken for a message of its own.
    """
    first, *more = (to_one_line(line) for line in text.split("\n"))
    return "\n".join([first, *("  " + line.removeprefix("  ") for line in more)])


def write_stderr(text: str) -> None:
    """Write a text for people, if there still is somebody: nothing fails because they do not hear,
    a photo least of all."""
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(text)
        sys.stderr.flush()


def to_html(words: object) -> str:
    """Any text as HTML, also of a quoted attribute, that shows it and does nothing else."""
    return html.escape(to_one_line(str(words)))


def to_percent(share: Any) -> str:
    """A share as a percentage of three digits or more, for messages and pages; "-" for none."""
    try:
        number = float(share)
    except (TypeError, ValueError):
        return "-"
    return f"{100.0 * number:.0f} %" if abs(number) >= 10.0 else f"{100.0 * number:.3g} %"


def _escaped(character: str) -> str:
    # JSON leaves DEL as it is.
    return "\\u007f" if character == "\x7f" else json.dumps(character)[1:-1]


def keep_standard_streams() -> None:
    """Put the null device where descriptor 0, 1 or 2 is closed, by whoever started us or a driver's
    library: the next file that is opened would get its number, and what is printed."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
            os.set_inheritable(null, True)  # children have three as well
