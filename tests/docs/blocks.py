"""The blocks of a Markdown page, and what a reader of it is to do with each.

A block is what is indented by four spaces or stands in a fence. The comment before it, which no
page shows, says what is out of the ordinary: ``<!-- test: WORDS -->``.

=====================================  ============================================================
nothing                                type its lines (a shell's, or Python's in a fence of that
                                       name): each ends with 0
``not run: WHY``                       leave it
``printed by COMMAND``                 compare it with what that command said
``ends with 5``                        its last line ends so
``until interrupted: WORDS, WORDS``    each line goes on until Ctrl-C, once it has said its words,
                                       or an address that answers a browser (``http``)
``Enter answers``                      it asks at a terminal
``as LINE: WHY``                       type that line instead
``comments are RMS errors``            of the captures that they stand behind
``beside captures``                    a daemon takes photos meanwhile
``paths``                              a drawing of folders: all that it names is there
=====================================  ============================================================

A comment with no block behind it is of the block before: ``0.77 % is RMS error`` holds a figure of
the prose against what was said last; ``so LINE`` is one more line to type.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_MARK = re.compile(r"<!-- test: (.*) -->")
_LOOSE = re.compile(r"so |\S+ % is ")
"""Marks that need no block."""


@dataclass(frozen=True)
class Block:
    """One block of a page: `text` without its indent, the number of its first `line`, its `mark`,
    and `prose`, the paragraph before it."""

    page: str
    line: int
    text: str
    language: str
    mark: str
    prose: str

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return f"{self.page}:{self.line}"


def read_blocks(page: str, markdown: str) -> list[Block]:
    """All blocks and loose marks of a page, in order. Raises ValueError for a mark without a
    block, and for a fence without an end."""
    lines = markdown.splitlines()
    found: list[Block] = []
    mark, prose, at = "", "", 0
    while at < len(lines):
        line, began = lines[at], at
        if marked := _MARK.fullmatch(line):
            if mark:
                raise ValueError(f"{page}:{at + 1}: a second mark, and no block for the first")
            mark = marked[1]
            if _LOOSE.match(mark):
                found.append(Block(page, at + 1, "", "", mark, prose))
                mark = ""
        elif line.startswith("```"):
            at = lines.index("```", at + 1)
            text = "\n".join(lines[began + 1 : at])
            found.append(Block(page, began + 1, text, line[3:], mark, prose))
            mark = ""
        elif line.startswith("    ") and (not at or not lines[at - 1].strip()):
            while at + 1 < len(lines) and (lines[at + 1].startswith("    ") or _goes_on(lines, at)):
                at += 1
            text = "\n".join(each[4:] for each in lines[began : at + 1])
            found.append(Block(page, began + 1, text, "", mark, prose))
            mark = ""
        elif line.strip():
            if mark:
                raise ValueError(f"{page}:{at + 1}: no block for {mark!r}")
            prose = line if not at or not lines[at - 1].strip() else f"{prose}\n{line}"
        at += 1
    return found


def _goes_on(lines: list[str], at: int) -> bool:
    """An empty line within a block."""
    return not lines[at + 1].strip() and at + 2 < len(lines) and lines[at + 2].startswith("    ")
