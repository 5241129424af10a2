"""Figure 9: a resolution chart on the back of a tank of milky water, seen through the milk.

Two photos. (c) keeps all direct light and a sixteenth of the rest; (d) keeps all light that began
one cell to the side and a sixteenth of the rest (an eighth each in a quick figure, as a sixteenth
needs at least 256 codes). Milk sends as much light back to a cell as to the next one, so their
difference (e) is free of it: it is direct light less that from the next cell. The figure checks the
contrast of the chart's bars, dark against light: for two areas of brightness a and b it is
(b - a) / (b + a), and 1 is black on white.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    CODERS,
    LIKE_THE_PAPER,
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
from pdcd.virtual.scene.presets.chart import BLOCKS, list_chart_bars

CHART_SCENE = "chart-in-milk"
_BESIDE = (0, -1)
"""One cell to the left: Table 2 has n = m + 1."""
_PRINTED = 1024
_CELL = 8.0 / 3.0 / 64.0
"""Width of a cell in the units of `BLOCKS`, 64 to a row."""


def list_fig09_takes(mode: FigureMode) -> dict[str, FigureTake]:
    """A floodlit photo, and (c) and (d) by our codes and by the paper's."""
    found = {
        "white": FigureTake(CHART_SCENE, "white", LIKE_THE_PAPER, bound=0.022, said="floodlit")
    }
    # The error of coins comes from light that the milk sends back, nearly all light in the tank.
    # Little light comes from the next cell, less with the paper's p: there noise dominates.
    bounds = {"ours": (0.042, mode.bound(0.057, 0.11)), "paper": (0.26, 0.48)}
    c, d = {"p": _p(mode)}, {"p": _p(mode), "shift": _BESIDE}
    for by, (of_c, of_d) in bounds.items():
        found[f"{by} c"] = take_coded(
            by, CHART_SCENE, "fraction", _PRINTED, c, bound=of_c, said="(c), {}"
        )
        found[f"{by} d"] = take_coded(
            by, CHART_SCENE, "off-diagonal", _PRINTED, d, bound=of_d, said="(d), {}"
        )
    return found


def _p(mode: FigureMode) -> float:
    """Share of the rest that (c) and (d) keep."""
    return 1.0 / 8.0 if mode.quick else 1.0 / 16.0


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
    """Floodlit, (c), (d) and (e), with either codes and in truth."""
    white, p = photos["white"], _p(mode)
    c, d = photos["ours c"], photos["ours d"]
    known = {
        words: _pictures(white.image, photos[f"{by} c"].image, photos[f"{by} d"].image, p)
        for by, (_, words) in CODERS.items()
    }
    known["the truth"] = _pictures(white.truth, c.truth, d.truth, p)
    for title, pictures in known.items():
        panels = [FigurePanel(image, words, _top(image)) for words, image in pictures.items()]
        yield PanelRow(tuple(panels), title)
    ours, truth = (
        [measure_contrasts(image) for image in known[words].values()]
        for words in ("our codes", "the truth")
    )
    yield _plot(ours, truth)
    # The chart was designed to show less than an eighth of its contrast when floodlit.
    yield BoundedNumber("contrast of the widest bars, floodlit", ours[0][0], 0.02, 0.125)
    yield BoundedNumber("the same in (c)", ours[1][0], 0.25, 0.65)
    # Ink is a seventeenth as bright as paper: without milk the contrast of the bars is 0.89.
    yield BoundedNumber("the same in (e), de-scattered", ours[3][0], 0.75, 1.05)
    yield BoundedNumber("contrast in (e) over floodlit", ours[3][0] / ours[0][0], least=8.0)
    off = abs(ours[3][0] - truth[3][0])
    yield BoundedNumber("error of that contrast against the truth", off, most=0.02)
    clear = known["the truth"]["(e) de-scattered"]
    for words, most in (("our codes", 0.053), ("the paper's codes", None)):
        error = _rms(known[words]["(e) de-scattered"] - clear) / _rms(clear)
        yield BoundedNumber(f"RMS error of (e), {words}", error, most=most, percent=True)


def _plot(ours: list[list[float]], truth: list[list[float]]) -> FigurePlot:
    width = [one[2] / _CELL for one in BLOCKS]
    lines = []
    for index, (number, words) in enumerate({0: "floodlit", 1: "(c)", 3: "(e)"}.items()):
        lines.append(Line(width, ours[number], words, "o-", index))
        lines.append(Line(width, truth[number], style=":", colour=index))
    return FigurePlot(
        "contrast",
        "Bars of the chart",
        "width of a bar, cells of 64 to a row",
        "contrast of the bars",
        "Contrast of each block of bars; dotted: the truth, through the same lens.",
        tuple(lines),
        x_from=0.0,
        y_range=(0.0, 1.1),
    )


def _pictures(white: Image, direct: Image, beside: Image, p: float) -> dict[str, Image]:
    return {
        "floodlit": white,
        f"(c) direct + {p:.4g} of the rest": direct,
        f"(d) from beside + {p:.4g} of the rest": beside,
        "(e) de-scattered": (direct - beside) / (1.0 - p),
    }


def measure_contrasts(image: Image) -> list[float]:
    """Contrast of the bars of each block of the chart in a picture (H, W, 3) of the field; NaN
    where the picture is too coarse to have pixels in them."""
    grey = image.mean(axis=-1)
    found = []
    for ink, gap in list_chart_bars():
        dark, light = (_inside(grey, area) for area in (ink, gap))
        found.append((light - dark) / (light + dark))
    return found


def _inside(grey: NDArray[np.floating], area: NDArray[np.bool_]) -> float:
    """Mean of a picture over an area that is drawn on another raster."""
    rows, cols = (
        ((np.arange(n) + 0.5) * whole / n).astype(np.intp)
        for n, whole in zip(grey.shape, area.shape, strict=True)
    )
    there = area[np.ix_(rows, cols)] & np.isfinite(grey)
    return float(grey[there].mean()) if there.any() else float("nan")


def _top(image: Image) -> float:
    return float(np.nanpercentile(image, 99.0))


def _rms(image: Image) -> float:
    return float(np.sqrt(np.nanmean(np.square(image))))


FIGURE = PaperFigure(
    "9",
    "A resolution chart in milky water",
    see="Floodlit, the milk hides the chart; in (e), the difference of two photos, even the fine"
    " bars are black on white.",
    paper="1024 codes for each of two photos, p = 1/16, a relay lens of 220 mm.",
    unlike="The milk is a veil, a blur and a near glow of fixed shape: no light is traced through"
    " it. The tank stands square to the camera and fills most of the field.",
    takes=list_fig09_takes,
    shown=shown,
)
