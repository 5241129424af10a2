"""Figure 8: direct light beside less and less of the indirect, p = 1/2 to 1/16, equally bright.

Codes that light both panels alike, in a share p of the time, keep direct light and p of the
indirect: a photo is D + p S. As direct light counts p as well, smaller p get as many more codes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.figures.figure import (
    OUR_CODES,
    PAPERS_CODES,
    Drawn,
    Figure,
    Mode,
    Number,
    Panel,
    Photo,
    Plot,
    Row,
    Take,
    codes_printed,
)
from pdcd.figures.picture import white_of
from pdcd.figures.places import patch
from pdcd.figures.plot import colour, finish

SCENE = "milky-bottle"
PRINTED = {2: 64, 4: 128, 8: 256, 16: 512}
"""1/p -> codes as printed."""
BOUNDS = {2: 0.026, 4: 0.03, 8: 0.037, 16: 0.046}
"""Of the error of our photos: it grows as fewer paths share the light."""
POINTS = {"milk": (0.50, 0.42), "wall": (0.16, 0.34)}
"""(x, y) on the field: in the milk above the label, and on a tile of the wall."""


def takes(mode: Mode) -> dict[str, Take]:
    """All light, and four shares of the indirect with either codes."""
    found = {"white": Take(SCENE, "white", said="all light")}
    for below, printed in PRINTED.items():
        asked = {"codes": codes_printed(printed), "p": 1.0 / below}
        # Each cell is lit in exactly p of the codes; the coins of the paper are not so even.
        found[f"1/{below}, ours"] = Take(
            SCENE,
            "fraction",
            {**OUR_CODES, **asked, "family": "balanced"},
            all_codes=True,
            bound=BOUNDS[below],
            said="every cell lit equally often",
        )
        found[f"1/{below}, paper"] = Take(
            SCENE,
            "fraction",
            {**PAPERS_CODES, **asked},
            all_codes=True,
            said="the paper's codes",
        )
    return found


def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
    """Photos from all light to the least indirect, and two points of them over p."""
    white = photos["white"].image
    level = white_of(white)
    rows = []
    for who, words in (("ours", "our codes"), ("paper", "the paper's codes")):
        panels = [Panel(white, "direct + indirect", level)]
        panels += [
            Panel(photos[f"1/{below}, {who}"].image, f"direct + 1/{below} indirect", level)
            for below in PRINTED
        ]
        rows.append(Row(tuple(panels), words))
    shares = np.array([1.0, *(1.0 / below for below in PRINTED)])
    seen = {who: points(photos, who) for who in ("ours", "paper")}
    truth = points(photos, "ours", true=True)
    return Drawn(
        tuple(rows), (_plot(shares, seen, truth),), tuple(_numbers(shares, seen["ours"], photos))
    )


def points(photos: Mapping[str, Photo], who: str, *, true: bool = False) -> dict[str, Any]:
    """Brightness of both points over p, from p = 1 on, (5,) each, green channel."""
    taken = [photos["white"], *(photos[f"1/{below}, {who}"] for below in PRINTED)]
    images = [photo.truth if true else photo.image for photo in taken]
    return {name: np.array([patch(image, at) for image in images]) for name, at in POINTS.items()}


def _line(shares: Any, values: Any) -> tuple[float, float]:
    """Slope and value at p = 0 of a straight line through the photos that are coded."""
    slope, start = np.polyfit(shares[1:], values[1:], 1)
    return float(slope), float(start)


def _numbers(shares: Any, seen: Mapping[str, Any], photos: Mapping[str, Photo]) -> list[Number]:
    numbers = []
    truth = points(photos, "ours", true=True)
    for name, values in seen.items():
        slope, start = _line(shares, values)
        true_slope, true_start = _line(shares, truth[name])
        numbers += [
            # Without indirect light the line would be flat; the milk's falls to less than half.
            Number(
                f"{name}: indirect share of all light, from the line",
                slope / (slope + start),
                least=true_slope / (true_slope + true_start) - 0.02,
                most=true_slope / (true_slope + true_start) + 0.02,
                percent=True,
            ),
            Number(
                f"{name}: direct light at p = 0, over the true one",
                start / true_start,
                least=0.95,
                most=1.05,
            ),
        ]
    bright = [float(np.nanmean(photos[f"1/{below}, ours"].image)) for below in PRINTED]
    level = [float(photos[f"1/{below}, ours"].summary["codes"]) / below for below in PRINTED]
    numbers.append(
        Number(
            "codes in which a cell is lit, largest over smallest", max(level) / min(level), 1.0, 1.0
        )
    )
    numbers.append(
        Number("mean brightness at p = 1/16 over that at 1/2", bright[-1] / bright[0], 0.3, 1.0)
    )
    return numbers


def _plot(shares: Any, seen: Mapping[str, Mapping[str, Any]], truth: Mapping[str, Any]) -> Plot:
    def draw(axes: Any) -> None:
        fine = np.array([0.0, 1.0])
        for index, name in enumerate(POINTS):
            shade = colour(index)
            slope, start = _line(shares, seen["ours"][name])
            axes.plot(fine, start + slope * fine, "-", color=shade, lw=1.0)
            axes.plot(
                shares, seen["ours"][name], "o", color=shade, ms=5, label=f"{name}, our codes"
            )
            axes.plot(
                shares, seen["paper"][name], "x", color=shade, ms=6, label=f"{name}, the paper's"
            )
            axes.plot(shares, truth[name], "_", color="black", ms=12)
            axes.plot([0.0], [start], "s", color=shade, ms=5, mfc="none")
        axes.set_ylim(bottom=0.0)
        finish(
            axes,
            "Two points of the scene (black dashes: the truth)",
            "share p of indirect light",
            "brightness (green), scene units",
        )

    return Plot(
        "points",
        draw,
        "Lines go through the four coded photos; the square is the direct light that they foretell "
        "for p = 0. The wall hardly changes, the milk loses most of its light.",
    )


FIGURE = Figure(
    "8",
    "Direct light enhanced: less and less of the indirect",
    see="The veil of milk fades from left to right, and the label comes out; the wall stays.",
    paper="64, 128, 256 and 512 codes, as many more as p is smaller.",
    unlike="a drawn bottle stands for the cola bottle.",
    takes=takes,
    drawn=drawn,
)
