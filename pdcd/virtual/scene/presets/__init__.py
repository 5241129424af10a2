"""Scenes that need no file: name -> builder of (grid, options)."""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from pdcd.virtual.scene.scene import Scene

__all__ = ["OFF_AXIS_PRESETS", "PRESETS", "STAGED", "find_builder", "list_presets"]

Builder = Callable[[tuple[int, int], Mapping[str, Any]], Scene]


_KEPT: OrderedDict[str, Scene] = OrderedDict()
_MOST_KEPT = 4
"""Scenes that are kept, as sweeps and calibrations reopen their bench and mostly use one scene. A
scene of 48 x 64 cells takes tens of megabytes."""


def _later(module: str, function: str) -> Builder:
    """A builder that imports its module only when called: a rig needs one scene, and starts sooner.
    The last few scenes, which are frozen, are kept and returned again."""

    def build(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
        key = repr((function, tuple(grid), sorted(options.items())))
        scene = _KEPT.pop(key, None)
        if scene is None:
            builder: Builder = getattr(
                import_module(f"pdcd.virtual.scene.presets.{module}"), function
            )
            scene = builder(grid, options)
        _KEPT[key] = scene
        while len(_KEPT) > _MOST_KEPT:
            _KEPT.popitem(last=False)
        return scene

    return build


PRESETS: dict[str, Builder] = {
    "open-book": _later("book", "open_book"),
    "wax-disk": _later("wax", "wax_disk"),
    "disco-ball": _later("disco", "disco_ball"),
    "milky-bottle": _later("bottle", "milky_bottle"),
    "mirror-and-vase": _later("vase", "mirror_and_vase"),
}
"""Each builder takes a grid (rows, cols), both at least 1, and the options of the [scene] table;
it raises ConfigError for options it does not know."""

OFF_AXIS_PRESETS: dict[str, Builder] = {
    "off-axis-box": _later("off_axis", "box_before_wall"),
    "off-axis-wedge": _later("off_axis", "wedge"),
    "off-axis-shelf": _later("off_axis", "shelf"),
}
"""The same for scenes with depth, in front of a camera that is off the projector's axis: their
direct light does not come back where it fell."""


STAGED: dict[str, Builder] = {
    "still-life": _later("still_life", "still_life"),
    "ball-wax-book": _later("ball_book", "ball_wax_book"),
    "chart-in-milk": _later("chart", "chart_in_milk"),
    "glass-and-balls": _later("styrofoam", "styrofoam"),
}
"""The same for scenes made to be looked at, after the figures of the paper. What is measured on all
`PRESETS` is not measured on these."""


def find_builder(kind: str) -> Builder | None:
    """Return the builder of a preset by its name, of any kind; None where there is none."""
    return PRESETS.get(kind) or STAGED.get(kind) or OFF_AXIS_PRESETS.get(kind)


def list_presets() -> list[str]:
    """Return the names of all presets, in their order."""
    return sorted([*PRESETS, *STAGED, *OFF_AXIS_PRESETS])
