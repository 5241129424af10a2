"""Figure 1: all light, indirect light from one photo, and direct light as their difference.

One scene with every effect that the paper names. The star inside its wax disk is covered by the
wax: only light that went deep knows of it, so that it is in the indirect picture alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.figures.figure import Figure, Image, Mode, Number, Photos, Row, Take, take_coded
from pdcd.figures.places import patch

SCENE = "still-life"
BOUNDS = {"ours": (0.10, 0.07), "paper": (0.20, 0.13)}
"""Of the errors by either codes, on the quick and on the full page."""
STAR, WAX = (0.26, 0.59), (0.195, 0.66)
"""(x, y) on the field: inside the star, and on the wax beside it."""
PICTURES = {
    "white": "all light",
    "indirect": "indirect, one photo",
    "direct": "direct = white - indirect",
}


def takes(mode: Mode) -> dict[str, Take]:
    """The indirect photo, with our codes and with the paper's."""
    return {
        by: take_coded(by, SCENE, "indirect", 512, bound=mode.bound(*bounds))
        for by, bounds in BOUNDS.items()
    }


def shown(mode: Mode, photos: Photos) -> Iterator[Row | Number]:
    """Three pictures by either codes, and in truth."""
    ours, papers = photos["ours"], photos["paper"]
    yield Row.of(ours.pictures, PICTURES, "our codes")
    yield Row.of(papers.pictures, PICTURES, "the paper's codes")
    yield Row.of(ours.truths, PICTURES, "the truth")
    # Direct light is made by subtracting, so that the sum is white to the last digit.
    total = ours.pictures["direct"] + ours.pictures["indirect"]
    off = float(np.nanmean(np.abs(ours.pictures["white"] - total)))
    yield Number("direct + indirect - white, mean, scene units", off, most=1e-5)
    for name in ("indirect", "direct"):
        found, true = contrast(ours.pictures[name]), contrast(ours.truths[name])
        what = f"contrast of the star in the wax, {name} picture"
        yield Number(what, found, true - 0.05, true + 0.05, percent=True)
    gain = papers.error / ours.error
    yield Number("error of the paper's codes over that of ours", gain, least=1.0)


def contrast(image: Image) -> float:
    """Share by which the middle of the disk is darker than its rim, green channel."""
    middle, rim = (patch(image, at) for at in (STAR, WAX))
    return 1.0 - middle / rim


FIGURE = Figure(
    "1",
    "Direct and indirect light of one scene",
    see="The star inside the wax disk shows in the indirect picture alone.",
    paper="512 codes in one exposure of 30 s; direct is white less indirect.",
    unlike="our table is drawn: a glass rod, wax with a star, a book, a mirror, sweets, glitter.",
    takes=takes,
    shown=shown,
)
