"""Figure 9: a resolution chart on the back of a tank of milky water, seen through the milk.

Two photos. (c) keeps all direct light and a sixteenth of the rest; (d) keeps all light that began
one cell beside and a sixteenth of the rest (an eighth each in a quick figure: the codes of a
sixteenth are 256 at least). Milk sends light back as much to a cell as to the next,
so their difference (e) is free of it: what is left are direct light less that of the next
cell. What is checked is the contrast of the chart's bars, dark against light: of two areas
of brightness a and b it is (b - a) / (b + a), and 1 is black on white.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    LIKE_THE_PAPER,
    OUR_CODES,
    PAPERS_CODES,
    Drawn,
    Figure,
    Image,
    Mode,
    Number,
    Panel,
    Photo,
    Plot,
    Row,
    Take,
    codes_printed,
)
from pdcd.figures.plot import finish
from pdcd.virtual.scene.presets.chart import BLOCKS, bars

SCENE = "chart-in-milk"
BESIDE = (0, -1)
"""One cell to the left: Table 2 has n = m + 1."""
CODES = codes_printed(1024)
FROM = {"ours": (OUR_CODES, "our codes"), "paper": (PAPERS_CODES, "the paper's codes")}
CELL = 8.0 / 3.0 / 64.0
"""Width of a cell in the units of `BLOCKS`, 64 to a row."""


def takes(mode: Mode) -> dict[str, Take]:
    """A floodlit photo, and (c) and (d) by our codes and by the paper's."""
    found = {"white": Take(SCENE, "white", LIKE_THE_PAPER, bound=0.022, said="floodlit")}
    for who, (asked, said) in FROM.items():
        given = {**asked, "p": _p(mode), "codes": CODES}
        # Coins err by what the milk sends back, which is all there is in the tank.
        # From beside comes little light, less with the paper's p: there noise is most of the error.
        c, d = (0.042, mode.bound(0.057, 0.11)) if who == "ours" else (0.26, 0.48)
        found[f"{who} c"] = Take(SCENE, "fraction", given, bound=c, said=f"(c), {said}")
        given = {**given, "shift": BESIDE}
        found[f"{who} d"] = Take(SCENE, "off-diagonal", given, bound=d, said=f"(d), {said}")
    return found


def _p(mode: Mode) -> float:
    """Share of the rest that (c) and (d) keep."""
    return 1.0 / 8.0 if mode.quick else 1.0 / 16.0


def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
    """Floodlit, (c), (d) and (e), by either codes and in truth."""
    white, p = photos["white"], _p(mode)
    known = {
        "our codes": _pictures(white.image, photos["ours c"].image, photos["ours d"].image, p),
        "the paper's codes": _pictures(
            white.image, photos["paper c"].image, photos["paper d"].image, p
        ),
        "the truth": _pictures(white.truth, photos["ours c"].truth, photos["ours d"].truth, p),
    }
    rows = tuple(
        Row(tuple(Panel(image, words, white=_top(image)) for words, image in found.items()), title)
        for title, found in known.items()
    )
    found = {
        title: [contrasts(image) for image in images.values()] for title, images in known.items()
    }
    ours, truth = found["our codes"], found["the truth"]
    left = known["the truth"]["(e) de-scattered"]
    numbers = [
        # The chart was made so that floodlit it shows less than an eighth of its contrast.
        Number("contrast of the widest bars, floodlit", ours[0][0], least=0.02, most=0.125),
        Number("the same in (c)", ours[1][0], least=0.25, most=0.65),
        # Ink is a seventeenth of paper: without milk the bars have 0.89.
        Number("the same in (e), de-scattered", ours[3][0], least=0.75, most=1.05),
        Number("contrast in (e) over floodlit", ours[3][0] / ours[0][0], least=8.0),
        Number(
            "error of that contrast against the truth", abs(ours[3][0] - truth[3][0]), most=0.02
        ),
    ]
    for title, most in (("our codes", 0.053), ("the paper's codes", None)):
        error = _rms(known[title]["(e) de-scattered"] - left) / _rms(left)
        numbers.append(Number(f"RMS error of (e), {title}", error, most=most, percent=True))

    def draw(axes: Any) -> None:
        width = [one[2] / CELL for one in BLOCKS]
        for number, words in ((0, "floodlit"), (1, "(c)"), (3, "(e)")):
            line = axes.plot(width, ours[number], "o-", label=words)[0]
            axes.plot(width, truth[number], ":", color=line.get_color())
        axes.set_xlim(left=0.0)
        axes.set_ylim(0.0, 1.1)
        finish(
            axes,
            "Bars of the chart",
            "width of a bar, cells of 64 to a row",
            "contrast of the bars",
        )

    caption = "Contrast of each block of bars; dotted: the truth, through the same lens."
    return Drawn(rows, (Plot("contrast", draw, caption),), tuple(numbers))


def _pictures(white: Image, direct: Image, beside: Image, p: float) -> dict[str, Image]:
    return {
        "floodlit": white,
        f"(c) direct + {p:.4g} of the rest": direct,
        f"(d) from beside + {p:.4g} of the rest": beside,
        "(e) de-scattered": (direct - beside) / (1.0 - p),
    }


def contrasts(image: Image) -> list[float]:
    """Contrast of the bars of each block of the chart in a picture (H, W, 3) of the field; NaN
    where the picture is too coarse to have pixels in them."""
    grey = image.mean(axis=-1)
    found = []
    for ink, gap in bars():
        dark, light = (_inside(grey, area) for area in (ink, gap))
        found.append((light - dark) / (light + dark))
    return found


def _inside(grey: NDArray[np.floating], area: NDArray[np.bool_]) -> float:
    """Mean of a picture over an area that is drawn on a raster of its own."""
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


FIGURE = Figure(
    "9",
    "A resolution chart in milky water",
    see="Floodlit, the milk hides the chart; in (e), the difference of two photos, even the fine"
    " bars are black on white.",
    paper="1024 codes for each of two photos, p = 1/16, a relay lens of 220 mm.",
    unlike="The milk is a veil, a blur and a near glow of fixed shape: no light is traced through"
    " it. The tank stands square to the camera and fills most of the field.",
    takes=takes,
    drawn=drawn,
)
