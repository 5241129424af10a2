"""Figure 12: four scenes, each in white, indirect and direct light.

A ball of mirrors, balls of styrofoam in a glass, a bottle of milky water, and a mirror beside a
vase. Indirect light is one photo; direct light is the white photo less that. The figure checks that
spots, caustics, milk and mirror images are gone from the direct photo, and that the one kind of
indirect light that cannot be removed is still there: light that a mirror throws onto the wall and
that comes back the same way ends in the very cell it began in, as direct light does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigurePhoto,
    FigurePlot,
    FigureTake,
    Image,
    Line,
    PanelRow,
    PaperFigure,
    Photos,
    take_coded,
)
from pdcd.figures.places import fit_share
from pdcd.virtual.scene.presets.canvas import FRAME_WIDTH, FrameRaster
from pdcd.virtual.scene.presets.vase import draw_mirror

_SCENES = {
    "disco-ball": ("Ball of mirrors", 512),
    "glass-and-balls": ("Styrofoam in a glass", 512),
    "milky-bottle": ("Milky water", 512),
    "mirror-and-vase": ("Mirror and vase", 1024),
}
"""Kind of scene: its title, and the codes that the paper prints for it."""
FIRST, MIRROR_SCENE = "disco-ball", "mirror-and-vase"
_ROW_Y = -0.05
"""Height in the drawing's frame of the line through the mirror's middle."""
_PICTURES = {"white": "white light", "indirect": "indirect, one photo", "direct": "direct"}


def list_fig12_takes(mode: FigureMode) -> dict[str, FigureTake]:
    """Each scene with our codes and with as many of the paper's; in quick mode, the latter only for
    the first scene."""
    found = {}
    for kind, (_, printed) in _SCENES.items():
        # White light less indirect light has the noise of both, and a mirror's few paths.
        found[f"{kind}, ours"] = take_coded("ours", kind, "direct", printed, bound=0.034)
        if not mode.quick or kind == FIRST:
            found[f"{kind}, paper's"] = take_coded("paper", kind, "direct", printed, bound=0.053)
    return found


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
    """Three photos of each scene, and the mirror's brightness along a line."""
    for kind, (title, _) in _SCENES.items():
        ours, theirs = photos[f"{kind}, ours"], photos.get(f"{kind}, paper's")
        # Errors of codes spread to both sides; light that codes let through would be all there.
        what = f"{kind}: indirect light left in the direct picture"
        yield BoundedNumber(what, measure_indirect_left(ours), -0.03, 0.03, percent=True)
        for photo, words in ((ours, "our codes"), (theirs, "the paper's codes")):
            if photo is not None:
                yield _row(photo.pictures, f"{title}: {words}")
                what = f"{kind}: RMS error of indirect light, {words}"
                yield BoundedNumber(what, photo.errors["indirect"], percent=True)
    glass = photos[f"{MIRROR_SCENE}, ours"]
    share, true = measure_mirror_share(glass.pictures), measure_mirror_share(glass.truths)
    # Wall and table seen in the glass are a fifth of white and more: not black.
    yield BoundedNumber("direct share of the light of the mirror", share, 0.15, 0.6)
    yield BoundedNumber("its error against the truth", abs(share - true), most=0.01)
    yield _plot(glass)


def _row(pictures: Mapping[str, Image], title: str) -> PanelRow:
    white, indirect, direct = PanelRow.of(pictures, _PICTURES, title).panels
    top = float(np.nanpercentile(indirect.image, 99.5))
    return PanelRow(
        (white, FigurePanel(indirect.image, f"{indirect.caption}, brighter", top), direct), title
    )


def measure_indirect_left(photo: FigurePhoto) -> float:
    """Share of indirect light that is left in the direct picture: the least-squares share of the
    true indirect picture in the direct picture's error."""
    return fit_share(photo.pictures["direct"] - photo.truths["direct"], photo.truths["indirect"])


def measure_mirror_share(pictures: Mapping[str, Image]) -> float:
    """Share of the light of the mirror that is in the direct picture."""
    glass = find_glass(pictures["white"])
    return float(np.nansum(pictures["direct"][glass]) / np.nansum(pictures["white"][glass]))


def find_glass(image: Image) -> NDArray[np.bool_]:
    """Where the mirror is in a picture (H, W, 3) of the field, without its rim."""
    return draw_mirror(FrameRaster(image.shape[:2]), -0.06)


def _plot(photo: FigurePhoto) -> FigurePlot:
    """The brightness of the three pictures along a line through the mirror."""
    height, width = photo.image.shape[:2]
    middle = round((_ROW_Y / 2.0 + 0.5) * height)
    x = ((np.arange(width) + 0.5) / width - 0.5) * FRAME_WIDTH
    part, lines = x < 0.0, []
    for index, (name, words) in enumerate(_PICTURES.items()):
        light = photo.pictures[name][middle - 2 : middle + 3].mean(axis=(0, 2))
        lines.append(Line(x[part], light[part], words, colour=index))
    glass = np.flatnonzero(find_glass(photo.image)[middle])
    return FigurePlot(
        "mirror",
        "A line through the mirror",
        "place in the picture; grey: the glass of the mirror",
        "brightness, 1 is white paper",
        "The mirror is not black in direct light: what it throws onto the wall at a point comes"
        " back by the same way, and ends in the cell it began in. No code can tell it from light"
        " that the glass itself sends back.",
        tuple(lines),
        band=(float(x[glass[0]]), float(x[glass[-1]])),
        y_range=(0.0, None),
    )


FIGURE = PaperFigure(
    "12",
    "Four scenes in white, indirect and direct light",
    see="Spots, caustics, milk and mirror images are in the indirect photos and not in the direct"
    " ones; only the mirror keeps some light there, which it sent out and took back itself.",
    paper="512 codes (mirror and vase: 1024) in one exposure of 30 s.",
    unlike="The glass throws a caustic but bends no sight; the bottle's milk is a veil and a blur;"
    " the vase has a dark rim a cell wide, where cells take a step for a steep slope.",
    takes=list_fig12_takes,
    shown=shown,
)
