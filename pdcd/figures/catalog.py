"""All figures by their numbers."""

from __future__ import annotations

from collections.abc import Sequence

from pdcd.errors import ConfigError
from pdcd.figures import appendix, fig01, fig05, fig07, fig08, fig09, fig10, fig11, fig12, tables
from pdcd.figures.figure import PaperFigure

FIGURES: dict[str, PaperFigure] = {
    one.number: one
    for one in (
        *(module.FIGURE for module in (fig01, fig05, fig07, fig08, fig09, fig10, fig11, fig12)),
        tables.TABLE_1,
        tables.TABLE_2,
        appendix.FIGURE,
    )
}
"""Figures by number, in the order of the page."""


def choose_figures(numbers: Sequence[str]) -> list[PaperFigure]:
    """The named figures in the order of the page; all if none is named. Raises ConfigError."""
    unknown = [number for number in numbers if number not in FIGURES]
    if unknown:
        raise ConfigError(
            f"there is no figure {', '.join(unknown)}", hint=f"one of {', '.join(FIGURES)}"
        )
    return [one for number, one in FIGURES.items() if number in numbers or not numbers]
