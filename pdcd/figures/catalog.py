"""All figures by the number they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from pdcd.errors import ConfigError
from pdcd.figures.figure import Figure

FILES: dict[str, str] = {
    "1": "fig01",
    "5": "fig05",
    "7": "fig07",
    "8": "fig08",
    "9": "fig09",
    "10": "fig10",
    "11": "fig11",
    "12": "fig12",
    "table-1": "table1",
    "table-2": "table2",
    "appendix": "appendix",
}
"""Number -> module below `pdcd.figures` that holds its `FIGURE`; the page goes by this order."""


def figures_of(numbers: Sequence[str]) -> list[Figure]:
    """These figures in the order of the page; none named is all. Raises ConfigError."""
    unknown = [number for number in numbers if number not in FILES]
    if unknown:
        raise ConfigError(
            f"there is no figure {', '.join(unknown)}", hint=f"one of {', '.join(FILES)}"
        )
    return [figure_of(number) for number in FILES if number in numbers or not numbers]


def figure_of(number: str) -> Figure:
    """The figure of a number of `FILES`."""
    figure: Figure = import_module(f"pdcd.figures.{FILES[number]}").FIGURE
    return figure
