"""Figure 11: a red box at six depths, before a camera beside the projector, with one depth blocked.

The camera stands off the projector's axis, so that direct light comes back beside the cell it was
sent from, by the disparity of the point. All photos keep the same: all light but that which comes
back at disparity 0, the path of direct light of one plane. Codes and mask know nothing of the box.
What is checked: how much direct light of its front is left, against what geometry demands. Windows
of a quarter of a cell block all of it up to a quarter cell of disparity, and let it through from
three quarters on.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import SceneConfig
from pdcd.figures.figure import (
    OUR_CODES,
    PAPERS_CODES,
    Drawn,
    Figure,
    Grid,
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
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.displaced import Displaced
from pdcd.virtual.scene.effects import Array

SCENE = "off-axis-box"
DEPTHS = {"b": -2.0, "c": -1.0, "d": -0.5, "e": 0.0, "f": 0.5, "g": 2.0}
"""Disparity of the box's front, in cells, from far to near; that of (e) is blocked."""
BOUNDS = {"b": 0.07, "c": 0.063, "d": 0.31, "e": 0.105, "f": 0.37, "g": 0.05}
HALF_BLOCKED = {"d": 0.45, "f": 0.5}
"""Half-blocked fronts differ by twice the share of a cell that panels are misplaced by, which is
larger of the full page's smaller cells; where (e) is blocked there is least light to be wrong
about."""
MISPLACED = 0.15
"""Cells by which the bench's panels may lie off where it believes them: 2 of 21 projector pixels,
and what a map that is linear in each cell leaves."""
CODES = {"codes": codes_printed(512)}


def takes(mode: Mode) -> dict[str, Take]:
    """The box at six depths, and at the blocked one by the paper's codes as well."""
    found = {}
    for name, disparity in DEPTHS.items():
        asked = {**OUR_CODES, "white": name == "e"}
        bound = mode.bound(BOUNDS[name], HALF_BLOCKED.get(name, BOUNDS[name]))
        found[name] = _take(disparity, asked, bound, "our codes")
    found["paper"] = _take(DEPTHS["e"], {**PAPERS_CODES, "white": False}, 0.35, "the paper's codes")
    return found


def _take(disparity: float, asked: Mapping[str, Any], bound: float, said: str) -> Take:
    options = {"disparity": disparity, "painted": True}
    words = f"front at {disparity:+g} cells, {said}"
    return Take(SCENE, "keyed", {**asked, **CODES}, options, off_axis=True, bound=bound, said=words)


def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
    """Six photos in one scale, their truth, and what is left of the front."""
    blocked = photos["e"]
    white = float(np.nanpercentile(blocked.pictures["white"], 99.5))
    taken = [Panel(photos[n].image, f"({n}) {d:+g} cells", white) for n, d in DEPTHS.items()]
    true = [Panel(photos[n].truth, f"({n}) truth", white) for n in DEPTHS]
    other = (
        Panel(blocked.pictures["white"], "(e) in white light", white),
        Panel(blocked.image, "(e) our codes", white),
        Panel(photos["paper"].image, "(e) the paper's codes", white),
    )
    rows = (
        Row(other, "the plane of the box's front blocked"),
        Row(tuple(taken[:3]), "a box that comes nearer, the same codes"),
        Row(tuple(taken[3:])),
        Row(tuple(true[:3]), "the truth"),
        Row(tuple(true[3:])),
    )
    found = {name: left(photos[name], disparity) for name, disparity in DEPTHS.items()}
    numbers = [
        Number(
            f"({name}) direct light left of the front at {disparity:+g} cells",
            found[name],
            least=_kept(abs(disparity) - MISPLACED) - 0.06,
            most=_kept(abs(disparity) + MISPLACED) + 0.06,
        )
        for name, disparity in DEPTHS.items()
    ]
    numbers.append(Number("(e) the same, the paper's codes", left(photos["paper"], DEPTHS["e"])))

    def draw(axes: Any) -> None:
        fine = np.linspace(-2.2, 2.2, 400)
        axes.plot(fine, [_kept(abs(d)) for d in fine], lw=1.0, label="by geometry")
        axes.plot(list(DEPTHS.values()), list(found.values()), "o", label="photos")
        finish(
            axes,
            "The box's front",
            "disparity of the box's front, in cells",
            "direct light left of it",
        )

    plot = Plot(
        "left", draw, "Direct light left of the box's front, by how far from the plane it is."
    )
    return Drawn(rows, (plot,), tuple(numbers))


def _kept(disparity: float) -> float:
    """Direct light that quarter windows keep at a disparity, in cells, from the blocked plane."""
    return float(np.clip((disparity - 0.25) / 0.5, 0.0, 1.0))


def left(photo: Photo, disparity: float) -> float:
    """Direct light left of the front of a box in a keyed photo, over what there is of it.

    Indirect light of the front, which stays, is taken off as the scene has it.
    """
    on, direct, white = _front(photo.grid, disparity)
    height, width = photo.image.shape[:2]
    row = (np.arange(height) * photo.grid[0]) // height
    col = (np.arange(width) * photo.grid[1]) // width
    cell = row[:, None] * photo.grid[1] + col
    there = on[cell] & np.isfinite(photo.image).all(axis=-1)
    seen = float(photo.image[there].sum())
    rest = float((white - direct)[cell[there]].sum())
    return (seen - rest) / float(direct[cell[there]].sum())


@lru_cache(maxsize=8)
def _front(grid: Grid, disparity: float) -> tuple[NDArray[np.bool_], Array, Array]:
    """Cells (N,) that see the lit front, as those around them do; direct and all light (N, 3)."""
    options = {"disparity": disparity, "painted": True}
    scene = build_scene(SceneConfig(kind=SCENE, grid=grid, options=options))
    lit = np.ones((1, scene.cells))
    parts = [e for e in scene.effects if isinstance(e, Displaced)]
    direct: Array = np.stack([e.apply(lit)[0] for e in parts], axis=-1)
    moved = parts[0].displacement[:, 1].reshape(grid)
    on = np.isclose(moved, disparity, atol=1e-6)
    inside = on.copy()
    for axis in (0, 1):
        inside &= np.roll(on, 1, axis) & np.roll(on, -1, axis)
    return inside.ravel(), direct, scene.white()


FIGURE = Figure(
    "11",
    "Light keyed by depth",
    see="The box is there at all depths but one: at (e), where its front lies in the blocked plane,"
    " only light is left that came by way of wall and floor.",
    paper="The probing matrix of indirect photos (512 codes), one RAW photo a depth.",
    unlike="The front is flat and square to the camera, so that it fades as a whole; the paper's"
    " box is seen aslant. Its edges lie at edges of cells.",
    takes=takes,
    drawn=drawn,
)
