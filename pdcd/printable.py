"""Makes texts and shares fit to show: no forged lines in a log, no commands to a terminal or
browser."""

from __future__ import annotations

import contextlib
import html
import json
import os
import sys
from typing import Any


def to_one_line(text: str) -> str:
    """The text on one line, with invisible characters escaped as in JSON (``\\n``).

    That covers newlines, terminal escapes, marks that change the direction of writing, and
    surrogates. A JSON text stays valid, with the same value.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escaped(c) for c in text)


def to_indented_lines(text: str) -> str:
    """A text of several lines: each as from `to_one_line`, all but the first indented.

    So no later line can be mistaken for a message of its own.
    """
    first, *more = (to_one_line(line) for line in text.split("\n"))
    return "\n".join([first, *("  " + line.removeprefix("  ") for line in more)])


def write_stderr(text: str) -> None:
    """Write a text for the user, if stderr is still there: nothing fails because it is not, least
    of all a photo."""
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(text)
        sys.stderr.flush()


def to_html(words: object) -> str:
    """Any text as HTML that shows the text and does nothing else, also inside a quoted
    attribute."""
    return html.escape(to_one_line(str(words)))


def to_percent(share: Any) -> str:
    """A share as a percentage of three digits or more, for messages and pages; "-" for none."""
    try:
        number = float(share)
    except (TypeError, ValueError):
        return "-"
    return f"{100.0 * number:.0f} %" if abs(number) >= 10.0 else f"{100.0 * number:.3g} %"


def _escaped(character: str) -> str:
    # JSON does not escape DEL.
    return "\\u007f" if character == "\x7f" else json.dumps(character)[1:-1]


def keep_standard_streams() -> None:
    """Put the null device where descriptor 0, 1 or 2 was closed, by our parent or a driver's
    library: otherwise the next opened file would get that number, and printed text with it."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)  # gets the lowest free number: this one
            os.set_inheritable(null, True)  # children need all three as well
