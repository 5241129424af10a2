"""Scenes with depth for an off-axis rig: a box in front of a wall, a V-wedge, boxes at four depths.

All take the option `baseline`, the camera's distance to the right of the projector, in heights of
the field; the box also takes `disparity`, that of its front in cells, and `painted`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdcd.errors import ConfigError
from pdcd.virtual.scene.depth import (
    FIELD_HEIGHT,
    FIELD_WIDTH,
    PLANE,
    OffAxisRig,
    build_off_axis_scene,
)
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.solids import Rectangle, make_box, make_wall

_BASELINE = 0.5
_RED, _GREEN, _BLUE = (0.75, 0.12, 0.08), (0.15, 0.65, 0.20), (0.15, 0.25, 0.75)
_WHITE, _GREY = (0.80, 0.80, 0.78), (0.55, 0.55, 0.58)
_FAR = 3.0
"""Distance of the wall behind everything."""
_DEEP = 0.35
"""How deep boxes are."""
_FLOOR = 0.4
"""How far below the axis the floor lies, on which boxes stand."""
_SHELF = (1.6, 2.0, 2.3, 2.6)
"""Distances of the fronts of the boxes on the shelf, from left to right."""


def box_before_wall(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """A red box in front of a grey wall (`baseline`, `disparity`: of the box's front, in cells;
    `painted`: true for boards and letters on it, and for bricks)."""
    numbers = {name: value for name, value in options.items() if name != "painted"}
    baseline, disparity = _numbers("off-axis-box", numbers, baseline=_BASELINE, disparity=0.0)
    painted = options.get("painted", False)
    if not isinstance(painted, bool):
        raise ConfigError(
            f"[scene] options of 'off-axis-box': painted = {painted!r}", hint="true or false"
        )
    rig = OffAxisRig(grid, baseline, ())
    least, most = rig.disparity_cells(_FAR - _DEEP), rig.disparity_cells(0.5 * PLANE)
    if not least < disparity <= most:
        raise ConfigError(
            f"[scene] options of 'off-axis-box': a disparity of {disparity:g} cells",
            hint=f"above {least:.2f} and at most {most:.2f}: between the wall and half its way",
        )
    front = rig.distance(disparity)
    red = make_box((-0.05, -0.15, front), (0.55, _FLOOR, front + _DEEP), _RED)
    rig = OffAxisRig(grid, baseline, (*red, *_room(baseline)))
    if not painted:
        return build_off_axis_scene("off-axis-box", rig)
    from pdcd.virtual.scene.presets.painted import paint_box

    return build_off_axis_scene("off-axis-box", rig, paint_box(rig))


def wedge(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Two walls that meet at a right angle, open to the rig, lighting each other (`baseline`)."""
    (baseline,) = _numbers("off-axis-wedge", options, baseline=_BASELINE)
    left = Rectangle((-0.75, -0.6, 1.7), (1.0, 0.0, 1.0), (0.0, 1.2, 0.0), _RED)
    right = Rectangle((0.25, -0.6, 2.7), (1.0, 0.0, -1.0), (0.0, 1.2, 0.0), _WHITE)
    surfaces = (left, right, _room(baseline)[0])
    return build_off_axis_scene("off-axis-wedge", OffAxisRig(grid, baseline, surfaces))


def shelf(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Boxes at four depths in front of a wall (`baseline`)."""
    (baseline,) = _numbers("off-axis-shelf", options, baseline=_BASELINE)
    places = ((-0.45, _RED), (-0.05, _WHITE), (0.35, _GREEN), (0.85, _BLUE))
    boxes = [
        face
        for z, (x, colour) in zip(_SHELF, places, strict=True)
        for face in make_box((x - 0.14, -0.3, z), (x + 0.14, _FLOOR, z + 0.2), colour)
    ]
    rig = OffAxisRig(grid, baseline, (*boxes, *_room(baseline)))
    return build_off_axis_scene("off-axis-shelf", rig)


def _room(baseline: float) -> tuple[Rectangle, Rectangle]:
    """A wall that fills the view of both devices, and a floor in front of it."""
    larger = _FAR / PLANE
    width = 0.5 * FIELD_WIDTH * larger + baseline
    back = make_wall(_FAR, (width, 0.5 * FIELD_HEIGHT * larger), _WHITE)
    floor = Rectangle((-width, _FLOOR, 1.0), (2.0 * width, 0.0, 0.0), (0.0, 0.0, _FAR - 1.0), _GREY)
    return back, floor


def _numbers(kind: str, options: Mapping[str, Any], **usual: float) -> list[float]:
    """The values of a preset's options, in the order of `usual`, its own values of them. Raises
    ConfigError for options that the preset does not know, and for values that cannot be."""
    values = {**usual, **options}
    for name, value in values.items():
        if name not in usual or isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(
                f"[scene] options of {kind!r}: {name} = {value!r}",
                hint=f"known: {', '.join(usual)}, a number each",
            )
    if not 0.0 < values["baseline"] <= 1.0:
        raise ConfigError(
            f"[scene] options: baseline is {values['baseline']:g}",
            hint="above 0 and at most 1, in heights of the field",
        )
    return [float(value) for value in values.values()]
