"""Figure 10: indirect light taken apart into sharp and soft.

A ball of mirrors on a disk of wax before an open book. Four photos of indirect light alone, each
under stripes that light half of the cells, moved on by a quarter of their period. Light that came
by one sharp path is there under some stripes and not under others; soft light is half there under
all of them. So the largest less the smallest of the four is what is sharp, and twice the smallest
is what is soft. What is checked: that the wax and the other page are in the soft picture, and the
ball's spots in the sharp one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    OUR_CODES,
    PAPERS_CODES,
    Drawn,
    Figure,
    Image,
    Mode,
    Number,
    Panel,
    Photo,
    Row,
    Take,
    codes_printed,
)
from pdcd.figures.places import share_in
from pdcd.virtual.scene.presets.ball_book import on_pages, on_wax
from pdcd.virtual.scene.presets.canvas import Raster

SCENE = "ball-wax-book"
CODES = {"codes": codes_printed(128)}
PERIOD = 4
"""Cells from one stripe to the next, the narrowest there is: soft light is even over them."""
SPOTS = 97.0
"""Per cent of the pages' pixels that are darker than a spot, in indirect light."""


def takes(mode: Mode) -> dict[str, Take]:
    """White and direct light, and the four striped photos by our codes and by the paper's.

    The answer of the latter is sharp light, of which quarter windows, whose stripes have no sharp
    edges, leave nine tenths; and it has the errors of largest and smallest photo.
    """
    split = {**CODES, "period": PERIOD}
    return {
        "direct": Take(SCENE, "direct", {**OUR_CODES, **CODES}, bound=0.04, said="our codes"),
        "ours": Take(SCENE, "split", {**OUR_CODES, **split}, bound=0.35, said="our codes"),
        "paper": Take(
            SCENE, "split", {**PAPERS_CODES, **split}, bound=0.45, said="the paper's codes"
        ),
    }


def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
    """All, direct and indirect light; sharp and soft light by either codes and in truth."""
    direct, ours, paper = photos["direct"], photos["ours"], photos["paper"]
    brightness = share_in(ours.pictures["indirect"], ours.truths["indirect"])
    first = tuple(
        Panel(direct.pictures[name], words)
        for name, words in (("white", "(a) white"), ("direct", "(b) direct"))
    )
    rows = [Row((*first, Panel(ours.pictures["indirect"], "(c) indirect")), "one scene")]
    for pictures, title in (
        (ours.pictures, "our codes"),
        (paper.pictures, "the paper's codes"),
        (ours.truths, "the truth"),
    ):
        white = 2.0 * float(np.nanpercentile(pictures["low"], 99.0))
        panels = (
            Panel(pictures["high"], "(d) sharp: largest - smallest", white),
            Panel(pictures["low"], "(e) soft: 2 x smallest", white),
        )
        rows.append(Row(panels, title))
    numbers = [
        *_shares(ours, "our codes"),
        # Four photos under stripes add up to all indirect light.
        Number("indirect light of the striped photos over its truth", brightness, 0.93, 1.07),
        Number("RMS error of sharp light, our codes", ours.errors["high"], percent=True),
        Number("RMS error of sharp light, the paper's", paper.errors["high"], percent=True),
        Number("RMS error of soft light, our codes", ours.errors["low"], percent=True),
        Number("RMS error of soft light, the paper's", paper.errors["low"], percent=True),
    ]
    return Drawn(tuple(rows), numbers=tuple(numbers))


def _shares(photo: Photo, words: str) -> list[Number]:
    """How much of the light of wax, spots and pages is in the picture that it belongs in."""
    pictures = photo.pictures
    raster = Raster(photo.image.shape[:2])
    wax, pages, spots = on_wax(raster), on_pages(raster), spots_of(photo.truths["indirect"])
    return [
        Number(f"soft share of the wax, {words}", share(pictures, "low", wax), least=0.7),
        Number(
            f"soft share of the pages, {words}", share(pictures, "low", pages & ~spots), least=0.6
        ),
        Number(f"sharp share of spots, {words}", share(pictures, "high", spots), least=0.5),
    ]


def spots_of(indirect: Image) -> NDArray[np.bool_]:
    """Where the ball's spots lie on the pages, by the true indirect light (H, W, 3)."""
    pages = on_pages(Raster(indirect.shape[:2]))
    grey = np.where(pages, np.nan_to_num(indirect.mean(axis=-1)), 0.0)
    spots: NDArray[np.bool_] = grey > np.percentile(grey[pages], SPOTS)
    return spots


def share(pictures: Mapping[str, Image], name: str, where: NDArray[np.bool_]) -> float:
    """What of the indirect light of an area is in one picture."""
    return float(np.nansum(pictures[name][where]) / np.nansum(pictures["indirect"][where]))


FIGURE = Figure(
    "10",
    "Sharp and soft indirect light",
    see="The ball's spots are in (d), the glow of the wax and of the facing page in (e).",
    paper="128 codes for each of four photos under shifted stripes, and as many black ones.",
    unlike="The ball hangs before the book rather than on the wax, where one cannot tell.",
    takes=takes,
    drawn=drawn,
)
