"""Tables and plots as values: printed as text, written as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Table:
    """A title, column heads, rows of text, and a note on how to read them."""

    title: str
    heads: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    note: str = ""

    def add(self, *cells: str) -> None:
        """Append a row."""
        self.rows.append(cells)

    def text(self) -> str:
        """Columns padded with blanks, for a terminal."""
        lines = [self.heads, *self.rows]
        widths = [max(len(line[c]) for line in lines) for c in range(len(self.heads))]
        padded = [_padded(line, widths) for line in lines]
        rule = "-" * max(len(line) for line in padded)
        return "\n".join(["", self.title, rule, padded[0], rule, *padded[1:], ""])

    def markdown(self) -> str:
        """A Markdown table under its title in bold, the note below."""
        lines = [self.heads, ("---", *["---:"] * (len(self.heads) - 1)), *self.rows]
        body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        note = f"\n\n{self.note}" if self.note else ""
        return f"**{self.title}**\n\n{body}{note}"


@dataclass(frozen=True)
class Aim:
    """One aim, the figure measured for it in this run, and its limit in the same unit."""

    what: str
    unit: str
    measured: float
    limit: float

    @property
    def reached(self) -> bool:
        """Whether the figure is below its limit."""
        return self.measured < self.limit


@dataclass(frozen=True)
class Section:
    """One chapter of the report: what it shows, its tables, and the names of its plots."""

    title: str
    text: str
    tables: Sequence[Table]
    plots: Sequence[tuple[str, str]] = ()
    """File name and caption of each."""
    aims: Sequence[Aim] = ()


def seconds(value_s: float) -> str:
    """A time with three digits and a fitting unit."""
    if value_s < 0.001:
        return f"{value_s * 1e6:.3g} µs"
    return f"{value_s * 1e3:.3g} ms" if value_s < 0.9995 else f"{value_s:.3g} s"


def percent(share: float) -> str:
    """A share in percent with two digits."""
    return f"{100.0 * share:.2g} %"


def grid_name(grid: tuple[int, int]) -> str:
    """Columns by rows, the way panels are named: "64x48"."""
    return f"{grid[1]}x{grid[0]}"


def _padded(line: Sequence[str], widths: Sequence[int]) -> str:
    first, *others = (cell for cell in line)
    cells = [first.ljust(widths[0])]
    cells += [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
    return "  ".join(cells).rstrip()
