"""Plots in one plain style, small enough to keep in a repository."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

mpl.use("Agg")

WIDTH_IN, HEIGHT_IN, DPI = 5.0, 3.8, 90
"""Size of one pair of axes."""

_COLOURS: dict[object, str] = {}
_PALETTE = ("#1b6ca8", "#d1495b", "#2e933c", "#8d5a97", "#e08e0b", "#555555", "#17a2a2")


def colour(key: object) -> str:
    """A colour for anything; the same thing has the same colour in all plots of a run."""
    return _COLOURS.setdefault(key, _PALETTE[len(_COLOURS) % len(_PALETTE)])


def panels(across: int, down: int = 1, *, scale: float = 1.0) -> tuple[Figure, list[Any]]:
    """An empty figure and its axes, row by row."""
    size_in = (scale * WIDTH_IN * across, scale * HEIGHT_IN * down)
    figure = Figure(figsize=size_in, layout="constrained")
    axes = figure.subplots(down, across, squeeze=False)
    return figure, list(axes.ravel())


def finish(axes: Any, title: str, x_label: str, y_label: str, *, base: int = 2) -> None:
    """Logarithmic axes (x to `base`), title and labels with units, a grid."""
    axes.set_xscale("log", base=base)
    axes.set_yscale("log")
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel(y_label, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    if base == 2:
        axes.xaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%d"))


def limit(axes: Any, value: float, label: str) -> None:
    """A grey line at the aim."""
    axes.axhline(value, color="grey", lw=0.8)
    axes.annotate(f"aim {label}", (0.99, value), xycoords=("axes fraction", "data"), fontsize=7,
                  ha="right", va="bottom", color="grey")  # fmt: skip


def save(figure: Figure, path: Path) -> None:
    """Write as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
