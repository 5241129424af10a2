"""Plots in one plain style; matplotlib is an extra, and is loaded where a plot is drawn."""

from __future__ import annotations

import io
from typing import Any

from pdcd.errors import ConfigError
from pdcd.extras import install_hint
from pdcd.figures.figure import Plot

DPI = 110
WIDTH_IN, HEIGHT_IN = 5.6, 3.8
PALETTE = ("#1b6ca8", "#d1495b", "#2e933c", "#8d5a97", "#e08e0b", "#555555", "#17a2a2")


def check_plots() -> None:
    """Raise ConfigError, with what to install, where no plot can be drawn."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as err:
        raise ConfigError(
            "plots need matplotlib",
            hint=f"{install_hint('matplotlib')}, or leave plots out: --no-plots",
        ) from err


def plotted(plot: Plot) -> bytes:
    """A plot as the bytes of a PNG file. Raises ConfigError without matplotlib."""
    check_plots()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(
        figsize=((1.6 if plot.wide else 1.0) * WIDTH_IN, HEIGHT_IN), layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.grid(alpha=0.3)
    axes.tick_params(labelsize=8)
    plot.draw(axes)
    file = io.BytesIO()
    figure.savefig(file, dpi=DPI, format="png", metadata={"Software": None})
    return file.getvalue()


def colour(index: int) -> str:
    """Colour of the index-th line of a plot."""
    return PALETTE[index % len(PALETTE)]


def finish(axes: Any, title: str, x_label: str, y_label: str) -> None:
    """Title, labels with units, legend."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel(y_label, fontsize=9)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
