"""Previews of steps for people to look at, drawn where matplotlib is installed (the extra `plots`).

A step hands over a function that draws on an empty figure; without matplotlib nothing calls it.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdcd.arrays import Floats

Draw = Callable[[Any], None]
"""Draws on a figure of matplotlib."""

_INCHES, _DPI = (10.0, 6.5), 90
PLOT_BLUE, PLOT_RED, PLOT_GREEN, PLOT_GREY = "#2a5ac8", "#c83c28", "#1e8c46", "0.6"
PLOT_CHANNELS = (PLOT_RED, PLOT_GREEN, "#145a1e", PLOT_BLUE)
"""Red, both greens, blue."""
_MOST_ARROWS = 900
"""Vectors that are drawn of a field; more would cover each other."""
_LONGEST = 0.06
"""Length of an arrow that only 5 % exceed, over the width of its box."""


def write_step_preview(path: Path, draw: Draw) -> None:
    """Write a step's preview as a PNG file, where matplotlib is installed. Raises OSError."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return
    figure = Figure(figsize=_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure)
    file = io.BytesIO()
    figure.savefig(file, dpi=_DPI, format="png", metadata={"Software": None})
    path.write_bytes(file.getvalue())


def label_plot(axes: Any, title: str, x: str = "", y: str = "") -> None:
    """Title and names of the axes, with their units."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.grid(alpha=0.3)


def draw_arrows(
    axes: Any, places: Floats, vectors_px: Floats, title: str, unit: str = "px"
) -> None:
    """Vectors at places of a field, so much enlarged that they can be seen, with a measure; of many
    vectors some, evenly.

    places : (n, 2), 0..1 right and down. vectors_px : (n, 2), in `unit`.
    """
    good = np.isfinite(places + vectors_px).all(axis=-1)
    places, vectors_px = places[good], vectors_px[good]
    usual = float(np.quantile(np.hypot(*vectors_px.T), 0.95)) if len(places) else 0.0
    some = slice(None, None, max(1, len(places) // _MOST_ARROWS))
    (x, y), (right, down) = places[some].T, vectors_px[some].T
    drawn = axes.quiver(
        x, y, right, -down, color=PLOT_BLUE, width=0.003,
        scale=max(usual, 1e-6) / _LONGEST, scale_units="width",
    )  # fmt: skip
    measure = f"{usual:.3f} {unit}"
    axes.quiverkey(drawn, 0.1, -0.04, usual, measure, labelpos="E", fontproperties={"size": 9})
    axes.set(xlim=(0.0, 1.0), ylim=(1.0, 0.0), xticks=[], yticks=[], box_aspect=0.75)
    label_plot(axes, f"{title}\n95 % below {measure}")


def draw_text_lines(figure: Any, lines: Sequence[str]) -> None:
    """Lines of words below all else."""
    figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=8, family="monospace")
