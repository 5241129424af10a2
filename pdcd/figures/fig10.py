"""Figure 10: indirect light taken apart into sharp and soft.

A ball of mirrors on a disk of wax in front of an open book. Four photos of indirect light alone,
each under stripes that light half of the cells, moved on by a quarter of their period. Light that
came by one sharp path is there under some stripes and not under others; half of the soft light is
there under all of them. So sharp light is the largest of the four less the smallest, and soft light
is twice the smallest. The figure checks that the wax and the other page are in the soft picture,
and the ball's spots in the sharp one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigureTake,
    Image,
    PanelRow,
    PaperFigure,
    Photos,
    take_coded,
)
from pdcd.figures.places import fit_share
from pdcd.virtual.scene.presets.ball_book import draw_pages, draw_wax
from pdcd.virtual.scene.presets.canvas import FrameRaster

BALL_SCENE = "ball-wax-book"
_PRINTED = 128
PERIOD = 4
"""Cells from one stripe to the next. It is the least possible, so that soft light is even."""
_SPOTS = 97.0
"""Percentage of the pages' pixels that are darker than a spot, in indirect light."""


def takes(mode: FigureMode) -> dict[str, FigureTake]:
    """White and direct light, and the four striped photos by our codes and by the paper's.

    The answer of the striped photos is sharp light. Quarter windows, whose stripes have no sharp
    edges, keep nine tenths of it; and it has the errors of both the largest and the smallest photo.
    """
    striped = {"period": PERIOD}
    return {
        "direct": take_coded("ours", BALL_SCENE, "direct", _PRINTED, bound=0.04),
        "ours": take_coded("ours", BALL_SCENE, "split", _PRINTED, striped, bound=0.35),
        "paper": take_coded("paper", BALL_SCENE, "split", _PRINTED, striped, bound=0.45),
    }


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | BoundedNumber]:
    """All, direct and indirect light; sharp and soft light with either codes and in truth."""
    direct, ours, paper = photos["direct"], photos["ours"], photos["paper"]
    scene = {**direct.pictures, "indirect": ours.pictures["indirect"]}
    captions = {"white": "(a) white", "direct": "(b) direct", "indirect": "(c) indirect"}
    yield PanelRow.of(scene, captions, "one scene")
    for pictures, title in (
        (ours.pictures, "our codes"),
        (paper.pictures, "the paper's codes"),
        (ours.truths, "the truth"),
    ):
        white = 2.0 * float(np.nanpercentile(pictures["low"], 99.0))
        sharp = FigurePanel(pictures["high"], "(d) sharp: largest - smallest", white)
        yield PanelRow(
            (sharp, FigurePanel(pictures["low"], "(e) soft: 2 x smallest", white)), title
        )

    raster = FrameRaster(ours.image.shape[:2])
    spots, pages = find_spots(ours.truths["indirect"]), draw_pages(raster)
    for what, name, where, least in (
        ("soft share of the wax", "low", draw_wax(raster), 0.7),
        ("soft share of the pages", "low", pages & ~spots, 0.6),
        ("sharp share of spots", "high", spots, 0.5),
    ):
        yield BoundedNumber(
            f"{what}, our codes", measure_area_share(ours.pictures, name, where), least=least
        )
    # Four photos under stripes add up to all indirect light.
    brightness = fit_share(ours.pictures["indirect"], ours.truths["indirect"])
    yield BoundedNumber(
        "indirect light of the striped photos over its truth", brightness, 0.93, 1.07
    )
    for name, light in (("high", "sharp"), ("low", "soft")):
        for photo, words in ((ours, "our codes"), (paper, "the paper's")):
            yield BoundedNumber(
                f"RMS error of {light} light, {words}", photo.errors[name], percent=True
            )


def find_spots(indirect: Image) -> NDArray[np.bool_]:
    """Where the ball's spots lie on the pages, found in the true indirect light (H, W, 3)."""
    pages = draw_pages(FrameRaster(indirect.shape[:2]))
    grey = np.where(pages, np.nan_to_num(indirect.mean(axis=-1)), 0.0)
    spots: NDArray[np.bool_] = grey > np.percentile(grey[pages], _SPOTS)
    return spots


def measure_area_share(pictures: Mapping[str, Image], name: str, where: NDArray[np.bool_]) -> float:
    """Share of an area's indirect light that is in one picture."""
    return float(np.nansum(pictures[name][where]) / np.nansum(pictures["indirect"][where]))


FIGURE = PaperFigure(
    "10",
    "Sharp and soft indirect light",
    see="The ball's spots are in (d), the glow of the wax and of the facing page in (e).",
    paper="128 codes for each of four photos under shifted stripes, and as many black ones.",
    unlike="The ball hangs in front of the book rather than on the wax, where one cannot tell.",
    takes=takes,
    shown=shown,
)
