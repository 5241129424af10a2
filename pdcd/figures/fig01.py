"""Figure 1: all light, indirect light from one photo, and direct light as their difference.

One scene with every effect that the paper names. The star inside its wax disk is covered by wax:
only light that went deep reaches it, so only the indirect picture shows it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigureTake,
    Image,
    PanelRow,
    PaperFigure,
    Photos,
    take_coded,
)
from pdcd.figures.places import average_patch

_SCENE = "still-life"
_BOUNDS = {"ours": (0.10, 0.07), "paper": (0.20, 0.13)}
"""Bounds of the errors with either codes, on the quick and on the full page."""
_STAR, _WAX = (0.26, 0.59), (0.195, 0.66)
"""(x, y) on the field: inside the star, and on the wax beside it."""
_PICTURES = {
    "white": "all light",
    "indirect": "indirect, one photo",
    "direct": "direct = white - indirect",
}


def takes(mode: FigureMode) -> dict[str, FigureTake]:
    """The indirect photo, with our codes and with the paper's."""
    return {
        by: take_coded(by, _SCENE, "indirect", 512, bound=mode.bound(*bounds))
        for by, bounds in _BOUNDS.items()
    }


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | BoundedNumber]:
    """Three pictures by either codes, and in truth."""
    ours, papers = photos["ours"], photos["paper"]
    yield PanelRow.of(ours.pictures, _PICTURES, "our codes")
    yield PanelRow.of(papers.pictures, _PICTURES, "the paper's codes")
    yield PanelRow.of(ours.truths, _PICTURES, "the truth")
    # Direct light is computed by subtraction, so that the sum is white to the last digit.
    total = ours.pictures["direct"] + ours.pictures["indirect"]
    off = float(np.nanmean(np.abs(ours.pictures["white"] - total)))
    yield BoundedNumber("direct + indirect - white, mean, scene units", off, most=1e-5)
    for name in ("indirect", "direct"):
        found, true = (
            measure_disk_contrast(ours.pictures[name]),
            measure_disk_contrast(ours.truths[name]),
        )
        what = f"contrast of the star in the wax, {name} picture"
        yield BoundedNumber(what, found, true - 0.05, true + 0.05, percent=True)
    gain = papers.error / ours.error
    yield BoundedNumber("error of the paper's codes over that of ours", gain, least=1.0)


def measure_disk_contrast(image: Image) -> float:
    """Share by which the middle of the disk is darker than its rim, in green or in grey."""
    middle, rim = (average_patch(image, at) for at in (_STAR, _WAX))
    return 1.0 - middle / rim


FIGURE = PaperFigure(
    "1",
    "Direct and indirect light of one scene",
    see="The star inside the wax disk shows in the indirect picture alone.",
    paper="512 codes in one exposure of 30 s; direct is white less indirect.",
    unlike="our table is drawn: a glass rod, wax with a star, a book, a mirror, sweets, glitter.",
    takes=takes,
    shown=shown,
)
