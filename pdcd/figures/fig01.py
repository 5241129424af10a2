"""Figure 1: all light, indirect light from one photo, and direct light as their difference.

One scene with every effect that the paper names. The star inside its wax disk is covered by the
wax: only light that went deep knows of it, so that it is in the indirect picture alone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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
from pdcd.figures.places import patch

SCENE = "still-life"
CODES = {"codes": codes_printed(512)}
STAR, WAX = (0.26, 0.59), (0.195, 0.66)
"""(x, y) on the field: inside the star, and on the wax beside it."""
PICTURES = {
    "white": "all light",
    "indirect": "indirect, one photo",
    "direct": "direct = white - indirect",
}


def takes(mode: Mode) -> dict[str, Take]:
    """The indirect photo, with our codes and with the paper's."""
    ours, papers = (0.10, 0.20) if mode.quick else (0.07, 0.13)
    return {
        "ours": Take(SCENE, "indirect", {**OUR_CODES, **CODES}, bound=ours, said="our codes"),
        "paper": Take(
            SCENE, "indirect", {**PAPERS_CODES, **CODES}, bound=papers, said="the paper's codes"
        ),
    }


def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
    """Three pictures by either codes, and in truth."""
    ours, papers = photos["ours"], photos["paper"]
    rows = (
        Row(tuple(Panel(ours.pictures[n], words) for n, words in PICTURES.items()), "our codes"),
        Row(tuple(Panel(papers.pictures[n], w) for n, w in PICTURES.items()), "the paper's codes"),
        Row(tuple(Panel(ours.truths[n], words) for n, words in PICTURES.items()), "the truth"),
    )
    gain = papers.error / ours.error
    total = float(np.nanmean(np.abs(ours.pictures["white"] - sum_of(ours))))
    return Drawn(
        rows,
        numbers=(
            # Direct light is made by subtracting, so that the sum is white to the last digit.
            Number("direct + indirect - white, mean, scene units", total, most=1e-5),
            *stars(ours),
            Number("error of the paper's codes over that of ours", gain, least=1.0),
        ),
    )


def stars(photo: Photo) -> list[Number]:
    """How much darker the star in the wax is than the wax beside it, in two pictures."""
    found = {name: contrast(photo.pictures[name]) for name in ("indirect", "direct")}
    true = {name: contrast(photo.truths[name]) for name in found}
    return [
        Number(
            f"contrast of the star in the wax, {name} picture",
            found[name],
            least=true[name] - 0.05,
            most=true[name] + 0.05,
            percent=True,
        )
        for name in found
    ]


def contrast(image: Image) -> float:
    """Share by which the middle of the disk is darker than its rim, green channel."""
    middle, rim = (patch(image, at) for at in (STAR, WAX))
    return 1.0 - middle / rim


def sum_of(photo: Photo) -> Image:
    """Direct plus indirect light."""
    return np.asarray(photo.pictures["direct"] + photo.pictures["indirect"])


FIGURE = Figure(
    "1",
    "Direct and indirect light of one scene",
    see="The star inside the wax disk shows in the indirect picture alone.",
    paper="512 codes in one exposure of 30 s; direct is white less indirect.",
    unlike="our table is drawn: a glass rod, wax with a star, a book, a mirror, sweets, glitter.",
    takes=takes,
    drawn=drawn,
)
