"""Plots in one plain style, small enough to keep in a repository."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from PIL import Image

from pdcd.figures.draw import MARKERS, PALETTE

mpl.use("Agg")

DPI, COLOURS = 110, 64
WIDTH_IN, HEIGHT_IN = 5.0, 3.8
"""Size of one pair of axes."""


def colour(index: int) -> str:
    """Colour of the index-th line of a plot."""
    return PALETTE[index % len(PALETTE)]


def marker(index: int) -> str:
    """Shape of its points."""
    return MARKERS[index % len(MARKERS)]


def style(index: int, **more: Any) -> dict[str, Any]:
    """Both, as keywords of `plot`."""
    return {"marker": marker(index), "color": colour(index), **more}


def panels(
    across: int, down: int = 1, *, scale: float = 1.0, same_y: bool = False
) -> tuple[Figure, list[Any]]:
    """An empty figure and its axes, row by row; with one scale of y for all, if wanted."""
    beside = 1.4 if across * down == 1 else 1.0  # a legend stands beside a single one
    size_in = (scale * WIDTH_IN * across * beside, scale * HEIGHT_IN * down)
    figure = Figure(figsize=size_in, layout="constrained")
    axes = figure.subplots(down, across, squeeze=False, sharey=same_y)
    return figure, list(axes.ravel())


def scene_panels(count: int) -> tuple[Figure, list[Any]]:
    """Small axes for so many scenes, three beside each other, with one scale of y for all."""
    across = min(count, 3)
    figure, axes = panels(across, -(-count // across), scale=0.66, same_y=True)
    for empty in axes[count:]:
        empty.set_axis_off()
    return figure, axes


def finish(axes: Any, title: str, x_label: str, y_label: str, *, base: int = 2) -> None:
    """Logarithmic axes (x to `base`), title and labels with units, a grid."""
    axes.set_xscale("log", base=base)
    axes.set_yscale("log")
    axes.set_title(title, fontsize=11)
    axes.set_xlabel(x_label, fontsize=10)
    axes.set_ylabel(y_label, fontsize=10)
    axes.tick_params(which="both", labelsize=9)
    axes.grid(alpha=0.3)
    if base == 2:
        axes.xaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%d"))
        axes.yaxis.set_major_formatter(mpl.ticker.StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(mpl.ticker.FuncFormatter(_between_decades))


def _between_decades(value: float, _: int | None) -> str:
    """2 and 5 of every decade, in plain digits."""
    first = f"{value:e}"[0]
    return f"{value:g}" if first in "25" else ""


def find_room(axes: list[Any], used: int) -> tuple[Any, Any]:
    """Axes to take a legend of, and empty ones to put it into; None: beside them."""
    return axes[used - 1], axes[used] if used < len(axes) else None


def legend(axes: Any, place: Any = None, title: str | None = None) -> None:
    """A legend beside the axes, or in the place of other ones, with lines long enough to tell
    dashes."""
    (axes if place is None else place).legend(
        *axes.get_legend_handles_labels(),
        fontsize=9,
        title=title,
        title_fontsize=9,
        handlelength=3.0,
        loc="center left",
        bbox_to_anchor=(1.0 if place is None else 0.0, 0.5),
    )


def limit(axes: Any, value: float, label: str) -> None:
    """A grey line at the aim."""
    axes.axhline(value, color="grey", lw=0.8)
    axes.annotate(
        f"aim {label}",
        (0.01, value),
        xycoords=("axes fraction", "data"),
        xytext=(0, -2),  # above the line the frame may cut it
        textcoords="offset points",
        fontsize=9,
        ha="left",
        va="top",
        color="grey",
        zorder=1,  # below the lines: it hides no point
        bbox={"facecolor": "white", "alpha": 0.8, "pad": 0.5, "lw": 0},
    )


def save(figure: Figure, path: Path, colours: int = COLOURS) -> None:
    """Write as PNG with a palette: a third of the size, and plots have few colours anyway."""
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=DPI)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.open(drawn).convert("RGB").quantize(colours).save(path, optimize=True)
