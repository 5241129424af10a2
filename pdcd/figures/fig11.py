"""Figure 11: a red box at six depths, seen by a camera beside the projector; one depth is blocked.

The camera stands off the projector's axis, so that direct light comes back beside the cell it was
sent from, by the disparity of the point. All photos keep the same paths: all light except that
which comes back at disparity 0, the direct light of one plane. Codes and mask do not depend on the
box. The figure checks how much direct light of its front is left, against the value from geometry.
Windows of a quarter of a cell block all of it up to a quarter cell of disparity, and pass all of it
from three quarters on.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import SceneConfig
from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigurePhoto,
    FigurePlot,
    FigureTake,
    GridShape,
    Line,
    PanelRow,
    PaperFigure,
    Photos,
    take_coded,
)
from pdcd.sensor.profile import weigh_colours
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.effects import Array

BOX_SCENE = "off-axis-box"
_DEPTHS = {"b": -2.0, "c": -1.0, "d": -0.5, "e": 0.0, "f": 0.5, "g": 2.0}
"""Disparity of the box's front, in cells, from far to near; that of (e) is blocked."""
_BOUNDS = {"b": 0.07, "c": 0.063, "d": 0.31, "e": 0.105, "f": 0.37, "g": 0.05}
_HALF_BLOCKED = {"d": 0.45, "f": 0.5}
"""Bounds of half-blocked fronts on the full page. They differ by twice the share of a cell by which
panels are misplaced, and that share is larger for the full page's smaller cells. The front that is
blocked, in (e), has the least light that can be wrong."""
_MISPLACED = 0.15
"""Cells by which the bench's panels may lie off their believed places: 2 of 21 projector pixels,
and the error of a map that is linear in each cell."""


def list_fig11_takes(mode: FigureMode) -> dict[str, FigureTake]:
    """The box at six depths, and at the blocked one with the paper's codes as well."""
    bounds = {n: mode.bound(_BOUNDS[n], _HALF_BLOCKED.get(n, _BOUNDS[n])) for n in _DEPTHS}
    found = {n: _take("ours", d, bounds[n], white=n == "e") for n, d in _DEPTHS.items()}
    return {**found, "paper": _take("paper", _DEPTHS["e"], 0.35, white=False)}


def _take(by: str, disparity: float, bound: float, *, white: bool) -> FigureTake:
    options, said = (
        {"disparity": disparity, "painted": True},
        f"front at {disparity:+g} cells, {{}}",
    )
    return take_coded(
        by, BOX_SCENE, "keyed", 512, {"white": white}, options=options, off_axis=True, bound=bound,
        said=said,
    )  # fmt: skip


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
    """Six photos on one scale, their truth, and the light left of the front."""
    blocked, papers = photos["e"], photos["paper"]
    white = float(np.nanpercentile(blocked.pictures["white"], 99.5))
    other = (
        FigurePanel(blocked.pictures["white"], "(e) in white light", white),
        FigurePanel(blocked.image, "(e) our codes", white),
        FigurePanel(papers.image, "(e) the paper's codes", white),
    )
    yield PanelRow(other, "the plane of the box's front blocked")
    taken = [FigurePanel(photos[n].image, f"({n}) {d:+g} cells", white) for n, d in _DEPTHS.items()]
    true = [FigurePanel(photos[n].truth, f"({n}) truth", white) for n in _DEPTHS]
    for panels, title in ((taken, "a box that comes nearer, the same codes"), (true, "the truth")):
        yield PanelRow(tuple(panels[:3]), title)
        yield PanelRow(tuple(panels[3:]))
    found = {
        name: measure_direct_left(photos[name], disparity) for name, disparity in _DEPTHS.items()
    }
    yield _plot(found)
    for name, disparity in _DEPTHS.items():
        what = f"({name}) direct light left of the front at {disparity:+g} cells"
        least, most = (_kept(abs(disparity) + off) for off in (-_MISPLACED, _MISPLACED))
        yield BoundedNumber(what, found[name], least - 0.06, most + 0.06)
    yield BoundedNumber(
        "(e) the same, the paper's codes", measure_direct_left(papers, _DEPTHS["e"])
    )


def _plot(found: dict[str, float]) -> FigurePlot:
    fine = np.linspace(-2.2, 2.2, 400)
    return FigurePlot(
        "left",
        "The box's front",
        "disparity of the box's front, in cells",
        "direct light left of it",
        "Direct light left of the box's front, by how far from the plane it is.",
        (
            Line(fine, [_kept(abs(d)) for d in fine], "by geometry"),
            Line(list(_DEPTHS.values()), list(found.values()), "photos", "o", 1),
        ),
    )


def _kept(disparity: float) -> float:
    """Share of direct light that quarter windows keep at a disparity, in cells, from the blocked
    plane."""
    return float(np.clip((disparity - 0.25) / 0.5, 0.0, 1.0))


def measure_direct_left(photo: FigurePhoto, disparity: float) -> float:
    """Share of the direct light of a box's front that is left in a keyed photo.

    The front's indirect light, which stays, is subtracted using its true values.
    """
    on, direct, white = _front(photo.grid, disparity, photo.image.shape[2])
    height, width = photo.image.shape[:2]
    row = (np.arange(height) * photo.grid[0]) // height
    col = (np.arange(width) * photo.grid[1]) // width
    cell = row[:, None] * photo.grid[1] + col
    there = on[cell] & np.isfinite(photo.image).all(axis=-1)
    seen = float(photo.image[there].sum())
    rest = float((white - direct)[cell[there]].sum())
    return (seen - rest) / float(direct[cell[there]].sum())


@lru_cache(maxsize=8)
def _front(
    grid: GridShape, disparity: float, colours: int = 3
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Cells (N,) that see the lit front and whose neighbours do, too; direct and all light (N,
    C)."""
    options = {"disparity": disparity, "painted": True}
    scene = build_scene(SceneConfig(kind=BOX_SCENE, grid=grid, options=options))
    lit = np.ones((1, scene.cells))
    parts = [e for e in scene.effects if isinstance(e, DisplacedEffect)]
    direct: Array = np.stack([e.apply(lit)[0] for e in parts], axis=-1)
    moved = parts[0].displacement[:, 1].reshape(grid)
    on = np.isclose(moved, disparity, atol=1e-6)
    inside = on.copy()
    for axis in (0, 1):
        inside &= np.roll(on, 1, axis) & np.roll(on, -1, axis)
    return inside.ravel(), weigh_colours(direct, colours), weigh_colours(scene.white(), colours)


FIGURE = PaperFigure(
    "11",
    "Light keyed by depth",
    see="The box is there at all depths but one: at (e), where its front lies in the blocked plane,"
    " only light is left that came by way of wall and floor.",
    paper="The probing matrix of indirect photos (512 codes), one RAW photo a depth.",
    unlike="The front is flat and square to the camera, so that it fades as a whole; the paper's"
    " box is seen aslant. Its edges lie at edges of cells.",
    takes=list_fig11_takes,
    shown=shown,
)
