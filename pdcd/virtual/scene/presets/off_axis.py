"""Scenes with depth before an off-axis rig: a box before a wall, a V-wedge, boxes at four depths.

Options of all: `baseline`, the camera's distance to the right of the projector, in heights of the
field; of the box also `disparity`, that of its front in cells, and `painted`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdcd.errors import ConfigError
from pdcd.virtual.scene.depth import HEIGHT, PLANE, WIDTH, OffAxis, off_axis_scene
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.solids import Rectangle, box, wall

BASELINE = 0.5
RED, GREEN, BLUE = (0.75, 0.12, 0.08), (0.15, 0.65, 0.20), (0.15, 0.25, 0.75)
WHITE, GREY = (0.80, 0.80, 0.78), (0.55, 0.55, 0.58)
FAR = 3.0
"""Distance of the wall behind everything."""
DEEP = 0.35
"""How deep boxes are."""
FLOOR = 0.4
"""How far below the axis the floor lies, on which boxes stand."""
SHELF = (1.6, 2.0, 2.3, 2.6)
"""Distances of the fronts of the boxes on the shelf, from left to right."""


def box_before_wall(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """A red box before a grey wall (`baseline`, `disparity`: of the box's front, in cells;
    `painted`: true for boards and letters on it, and for bricks)."""
    numbers = {name: value for name, value in options.items() if name != "painted"}
    baseline = _number("off-axis-box", numbers, ("baseline", "disparity"), "baseline", BASELINE)
    disparity = _number("off-axis-box", numbers, ("baseline", "disparity"), "disparity", 0.0)
    painted = options.get("painted", False)
    if not isinstance(painted, bool):
        raise ConfigError(
            f"[scene] options of 'off-axis-box': painted = {painted!r}", hint="true or false"
        )
    _check_baseline(baseline)
    rig = OffAxis(grid, baseline, ())
    least, most = rig.disparity_cells(FAR - DEEP), rig.disparity_cells(0.5 * PLANE)
    if not least < disparity <= most:
        raise ConfigError(
            f"[scene] options of 'off-axis-box': a disparity of {disparity:g} cells",
            hint=f"above {least:.2f} and at most {most:.2f}: between the wall and half its way",
        )
    front = rig.distance(disparity)
    red = box((-0.05, -0.15, front), (0.55, FLOOR, front + DEEP), RED)
    rig = OffAxis(grid, baseline, (*red, *_room(baseline)))
    if not painted:
        return off_axis_scene("off-axis-box", rig)
    from pdcd.virtual.scene.presets.painted import painted_box

    return off_axis_scene("off-axis-box", rig, painted_box(rig))


def wedge(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Two walls that meet at a right angle, open to the rig, lighting each other (`baseline`)."""
    baseline = _baseline("off-axis-wedge", options)
    left = Rectangle((-0.75, -0.6, 1.7), (1.0, 0.0, 1.0), (0.0, 1.2, 0.0), RED)
    right = Rectangle((0.25, -0.6, 2.7), (1.0, 0.0, -1.0), (0.0, 1.2, 0.0), WHITE)
    surfaces = (left, right, _room(baseline)[0])
    return off_axis_scene("off-axis-wedge", OffAxis(grid, baseline, surfaces))


def shelf(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Boxes at four depths before a wall (`baseline`)."""
    baseline = _baseline("off-axis-shelf", options)
    places = ((-0.45, RED), (-0.05, WHITE), (0.35, GREEN), (0.85, BLUE))
    boxes = [
        face
        for z, (x, colour) in zip(SHELF, places, strict=True)
        for face in box((x - 0.14, -0.3, z), (x + 0.14, FLOOR, z + 0.2), colour)
    ]
    rig = OffAxis(grid, baseline, (*boxes, *_room(baseline)))
    return off_axis_scene("off-axis-shelf", rig)


def _room(baseline: float) -> tuple[Rectangle, Rectangle]:
    """A wall that fills the sight of both devices, and a floor before it."""
    larger = FAR / PLANE
    width = 0.5 * WIDTH * larger + baseline
    back = wall(FAR, (width, 0.5 * HEIGHT * larger), WHITE)
    floor = Rectangle((-width, FLOOR, 1.0), (2.0 * width, 0.0, 0.0), (0.0, 0.0, FAR - 1.0), GREY)
    return back, floor


def _baseline(kind: str, options: Mapping[str, Any]) -> float:
    baseline = _number(kind, options, ("baseline",), "baseline", BASELINE)
    _check_baseline(baseline)
    return baseline


def _check_baseline(baseline: float) -> None:
    if not 0.0 < baseline <= 1.0:
        raise ConfigError(
            f"[scene] options: baseline is {baseline:g}",
            hint="above 0 and at most 1, in heights of the field",
        )


def _number(
    kind: str, options: Mapping[str, Any], known: tuple[str, ...], name: str, usual: float
) -> float:
    """One option. Raises ConfigError for one that the preset does not know, or that is none."""
    unknown = sorted(set(options) - set(known))
    value = options.get(name, usual)
    if unknown or isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(
            f"[scene] options of {kind!r}: {', '.join(unknown) or f'{name} = {value!r}'}",
            hint=f"known: {', '.join(known)}, a number each",
        )
    return float(value)
