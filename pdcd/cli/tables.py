"""Tables that fit a terminal: columns give way where they are widest, and cells go on below."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from itertools import zip_longest

from pdcd.printable import one_line

WIDTH = 80
"""Columns that are written to where no terminal says how many it has."""
GAP = "  "
UNBROKEN = 24
"""Words longer than this, which are paths mostly, do not hold a column wide. They are never broken,
so that they can be copied."""
TEXT = 28
"""How narrow the last column may get while others are as wide as they are."""
INDENT = "    "
BOUND = re.compile(r"(?<=\d) (?=(?:%|[a-zA-Z]{1,3})(?:[^a-zA-Z]|$))")
"""The space between a number and its unit, where no line ends."""
HELD = "\x00"
"""Stands for such a space while lines are made; texts have none, for it cannot be seen."""


def width() -> int:
    """Columns of the terminal that results go to."""
    if not sys.stdout.isatty():
        return WIDTH
    return max(shutil.get_terminal_size((WIDTH, 24)).columns, WIDTH // 2)


def fitted(rows: Sequence[Sequence[str]], columns: int) -> Iterator[str]:
    """The lines of a table, aligned, and no longer than that but for words that cannot be broken.

    `rows` have equally many cells. What cannot be seen in them is escaped.
    """
    shown = [[one_line(cell) for cell in row] for row in rows]
    widths = _widths(list(zip(*shown, strict=True)), columns - len(GAP) * (len(shown[0]) - 1))
    for row in shown:
        cells = [_wrapped(cell, room) for cell, room in zip(row, widths, strict=True)]
        # What does not fit beside the rest of its row comes below it.
        below = [line for line in cells[-1] if len(line) > widths[-1]]
        cells[-1] = [line for line in cells[-1] if len(line) <= widths[-1]]
        for parts in zip_longest(*cells, fillvalue=""):
            padded = (part.ljust(room) for part, room in zip(parts, widths, strict=True))
            yield GAP.join(padded).rstrip()
        yield from (INDENT + line for line in below)


def wrapped(text: str, columns: int) -> Iterator[str]:
    """A sentence in lines no longer than that, all but the first a little further in."""
    held = BOUND.sub(HELD, one_line(text))
    for line in textwrap.wrap(
        held, columns, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    ):
        yield line.replace(HELD, " ")


def _widths(columns: list[tuple[str, ...]], room: int) -> list[int]:
    """How wide each column is to be, so that all together have room.

    The last column gives way first, which says in words what the others figure; then heads; then
    whatever is widest.
    """
    widths = [max(map(len, column)) for column in columns]
    words = [max(max(map(_longest_word, column)), 1) for column in columns]
    below = [max(map(len, column[1:]), default=0) for column in columns]
    text = [*words[:-1], max(words[-1], min(widths[-1], TEXT))]
    last = len(widths) - 1
    heads = [max(pair) for pair in zip(words, below, strict=True)]
    for least, first in ((text, last), (heads, None), (words, None)):
        while sum(widths) > room:
            spare = [n for n, width in enumerate(widths) if width > least[n]]
            if first is not None:
                spare = [n for n in spare if n == first]
            if not spare:
                break
            widths[max(spare, key=lambda n: widths[n])] -= 1
    return widths


def _longest_word(cell: str) -> int:
    words = BOUND.sub(HELD, cell).split()
    return max((len(word) for word in words if len(word) <= UNBROKEN), default=0)


def _wrapped(cell: str, room: int) -> list[str]:
    if len(cell) <= room:
        return [cell]
    held = BOUND.sub(HELD, cell)
    lines = textwrap.wrap(held, max(room, 1), break_long_words=False, break_on_hyphens=False)
    return [line.replace(HELD, " ") for line in lines] or [""]
