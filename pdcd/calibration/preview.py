"""Previews of steps for people to look at, drawn where matplotlib is installed (the extra `plots`).

A step hands over a function that draws on an empty figure; without matplotlib nothing calls it.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pdcd.arrays import Floats

Draw = Callable[[Any], None]
"""Draws on a figure of matplotlib."""

_INCHES, _DPI = (10.0, 6.5), 90
_STYLE: Any = {
    "axes.titlesize": 12,
    "axes.labelsize": 11,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "legend.fontsize": 10,
}
"""Font sizes that can be read in a picture of half its width."""
PLOT_BLUE, PLOT_RED, PLOT_GREEN, PLOT_GREY = "#0072b2", "#d55e00", "#009e73", "0.6"
"""Colours that people who do not distinguish red from green can tell apart, too (Okabe and Ito)."""
PLOT_CHANNELS = ((PLOT_RED, "o"), (PLOT_GREEN, "s"), ("#004d38", "D"), (PLOT_BLUE, "^"))
"""Colour and marker of red, both greens, blue."""
_MOST_ARROWS = 900
"""Vectors of a field that are drawn, at most; more would cover each other."""
_LONGEST = 0.06
"""95th percentile of the arrows' lengths, over the width of their box."""
_ROUND = (1.0, 2.0, 5.0, 10.0)
"""First digits of measures and of enlargements."""


def write_step_preview(path: Path, draw: Draw) -> None:
    """Write a step's preview as a PNG file, where matplotlib is installed. Raises OSError."""
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return
    file = io.BytesIO()
    with rc_context(_STYLE):
        figure = Figure(figsize=_INCHES, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        figure.savefig(file, dpi=_DPI, format="png", metadata={"Software": None})
    path.write_bytes(file.getvalue())


def label_plot(axes: Any, title: str, x: str = "", y: str = "") -> None:
    """Title and names of the axes, with their units."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)


class ArrowField(NamedTuple):
    """Vectors at places of a field.

    places : (n, 2), 0..1 right and down. vectors_px : (n, 2), in `unit`.
    """

    places: Floats
    vectors_px: Floats
    title: str
    unit: str = "px"


def draw_arrows(figure: Any, fields: Sequence[ArrowField], *, text_below: bool = False) -> None:
    """Draw fields of vectors side by side, enlarged so that they can be seen, with a scale; where
    there are many, an even selection. All fields share one scale; a field of much smaller vectors
    is enlarged further, which its text says. `text_below` leaves room for lines of words."""
    figure.set_size_inches(_INCHES[0], _INCHES[1] if text_below else 0.75 * _INCHES[1])
    shown = [_take_finite(field) for field in fields]
    usual = [float(np.quantile(np.hypot(*v.T), 0.95)) if len(v) else 0.0 for _, v in shown]
    largest = max(*usual, 1e-6)
    for axes, field, each, (places, vectors) in zip(
        np.atleast_1d(figure.subplots(1, len(fields))), fields, usual, shown, strict=True
    ):
        times = _round_down(largest / each) if each else 1.0
        some = slice(None, None, max(1, len(places) // _MOST_ARROWS))
        (x, y), (right, down) = places[some].T, vectors[some].T
        drawn = axes.quiver(
            x, y, right, -down, color=PLOT_BLUE, width=0.003,
            scale=largest / times / _LONGEST, scale_units="width",
        )  # fmt: skip
        measure = _round_down(largest) / times
        text = f"{measure:.3g} {field.unit}"
        if times > 1.0:
            text += f"; arrows are drawn {times:g} times as long as beside"
        axes.quiverkey(drawn, 0.1, -0.05, measure, text, labelpos="E")
        axes.set(xlim=(0.0, 1.0), ylim=(1.0, 0.0), xticks=[], yticks=[], box_aspect=0.75)
        label_plot(axes, f"{field.title}\n95 % below {each:.2g} {field.unit}")


def _take_finite(field: ArrowField) -> tuple[Floats, Floats]:
    """Places and vectors that are finite."""
    good = np.isfinite(field.places + field.vectors_px).all(axis=-1)
    return field.places[good], field.vectors_px[good]


def _round_down(value: float) -> float:
    """The next number below with one digit, which is 1, 2 or 5."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(first for first in _ROUND if first * power <= value * (1.0 + 1e-9)) * power


def draw_text_lines(figure: Any, lines: Sequence[str]) -> None:
    """Lines of words below all else."""
    figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=9, family="monospace")
