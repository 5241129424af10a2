"""Figure 8: direct light with less and less indirect light, p = 1/2 to 1/16, equally bright.

Codes that light both panels alike, in a share p of the time, keep direct light and p of the
indirect: a photo is D + p S. Direct light is also lit only a share p of the time, so the number of
codes grows as 1/p.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pdcd.figures.draw import white_of
from pdcd.figures.figure import (
    CODERS,
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigurePlot,
    FigureTake,
    Image,
    Line,
    PanelRow,
    PaperFigure,
    Photos,
    take_coded,
)
from pdcd.figures.places import average_patch

_SCENE = "milky-bottle"
_PRINTED = {2: 64, 4: 128, 8: 256, 16: 512}
"""1/p -> codes as printed."""
_BOUNDS = {2: 0.026, 4: 0.03, 8: 0.037, 16: 0.046}
"""Bounds of the error of our photos: it grows as fewer paths share the light."""
POINTS = {"milk": (0.50, 0.42), "wall": (0.16, 0.34)}
"""(x, y) on the field: in the milk above the label, and on a tile of the wall."""


def list_fig08_takes(mode: FigureMode) -> dict[str, FigureTake]:
    """All light, and four shares of indirect light with either codes."""
    found = {"white": FigureTake(_SCENE, "white", said="all light")}
    # Each cell is lit in exactly a share p of our codes; the paper's coins are less even.
    for below, printed in _PRINTED.items():
        found[f"1/{below}, ours"] = take_coded(
            "ours",
            _SCENE,
            "fraction",
            printed,
            {"p": 1.0 / below, "family": "balanced"},
            all_codes=True,
            bound=_BOUNDS[below],
            said="every cell lit equally often",
        )
        found[f"1/{below}, paper"] = take_coded(
            "paper", _SCENE, "fraction", printed, {"p": 1.0 / below}, all_codes=True
        )
    return found


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
    """Photos from all light to the least indirect light, and two of their points against p."""
    white = photos["white"].image
    level = white_of(white)
    for by, (_, words) in CODERS.items():
        coded = [
            FigurePanel(photos[f"1/{below}, {by}"].image, f"direct + 1/{below} indirect", level)
            for below in _PRINTED
        ]
        yield PanelRow((FigurePanel(white, "direct + indirect", level), *coded), words)
    shares = np.array([1.0, *(1.0 / below for below in _PRINTED)])
    taken = {by: [photos[f"1/{below}, {by}"] for below in _PRINTED] for by in CODERS}
    ours, papers = (read_points([white, *(one.image for one in taken[by])]) for by in CODERS)
    truth = read_points([photos["white"].truth, *(one.truth for one in taken["ours"])])
    yield _plot(shares, ours, papers, truth, "" if white.shape[2] == 1 else " (green)")
    for name, values in ours.items():
        slope, start = _line(shares, values)
        true_slope, true_start = _line(shares, truth[name])
        share, true = slope / (slope + start), true_slope / (true_slope + true_start)
        # Without indirect light the line would be flat; in the milk it falls to less than half.
        what = f"{name}: indirect share of all light, from the line"
        yield BoundedNumber(what, share, true - 0.02, true + 0.02, percent=True)
        what = f"{name}: direct light at p = 0, over the true one"
        yield BoundedNumber(what, start / true_start, 0.95, 1.05)
    lit = [
        float(one.summary["codes"]) * p for one, p in zip(taken["ours"], shares[1:], strict=True)
    ]
    what = "codes in which a cell is lit, largest over smallest"
    yield BoundedNumber(what, max(lit) / min(lit), 1.0, 1.0)
    bright = [float(np.nanmean(one.image)) for one in taken["ours"]]
    yield BoundedNumber(
        "mean brightness at p = 1/16 over that at 1/2", bright[-1] / bright[0], 0.3, 1.0
    )


def read_points(images: Sequence[Image]) -> dict[str, Any]:
    """Brightness of both points in the pictures, one array a point, in green or in grey."""
    return {
        name: np.array([average_patch(image, at) for image in images])
        for name, at in POINTS.items()
    }


def _line(shares: Any, values: Any) -> tuple[float, float]:
    """Slope and value at p = 0 of a straight line through the coded photos."""
    slope, start = np.polyfit(shares[1:], values[1:], 1)
    return float(slope), float(start)


def _plot(
    shares: Any, ours: dict[str, Any], papers: dict[str, Any], truth: dict[str, Any], of: str
) -> FigurePlot:
    lines = []
    for index, name in enumerate(POINTS):
        slope, start = _line(shares, ours[name])
        lines += [
            Line([0.0, 1.0], [start, start + slope], colour=index),
            Line(shares, ours[name], f"{name}, our codes", "o", index),
            Line(shares, papers[name], f"{name}, the paper's", "x", index),
            Line(shares, truth[name], style="_", colour="black"),
            Line([0.0], [start], style="s", colour=index),
        ]
    return FigurePlot(
        "points",
        "Two points of the scene (black dashes: the truth)",
        "share p of indirect light",
        f"brightness{of}, scene units",
        "Lines go through the four coded photos; the square is the direct light that they foretell "
        "for p = 0. The wall hardly changes, the milk loses most of its light.",
        tuple(lines),
        y_range=(0.0, None),
    )


FIGURE = PaperFigure(
    "8",
    "Direct light enhanced: less and less of the indirect",
    see="The veil of milk fades from left to right, and the label comes out; the wall stays.",
    paper="64, 128, 256 and 512 codes, as many more as p is smaller.",
    unlike="a drawn bottle stands for the cola bottle.",
    takes=list_fig08_takes,
    shown=shown,
)
