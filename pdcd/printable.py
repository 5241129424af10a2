"""Texts of others made fit to print: no forged lines in a log, no orders to a terminal."""

from __future__ import annotations

import json


def one_line(text: str) -> str:
    """The text on one line, with what cannot be seen in it as JSON escapes it (``\\n``).

    That covers newlines, terminal escapes, marks that turn the direction of writing, and halves of
    characters. A JSON text stays one, with the same value.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escaped(c) for c in text)


def lines(text: str) -> str:
    """A text of several lines: each as `one_line` has it, all but the first indented.

    So no further line can be taken for a message of its own.
    """
    first, *more = (one_line(line) for line in text.split("\n"))
    return "\n".join([first, *("  " + line.removeprefix("  ") for line in more)])


def _escaped(character: str) -> str:
    # JSON leaves DEL as it is.
    return "\\u007f" if character == "\x7f" else json.dumps(character)[1:-1]
