"""What to keep of the light transport, as a value: every row of Tables 1 and 2 of the paper.

A `Goal` is a name with its numbers, a `Target` is one over a grid, with its arrays. What it means
as a matrix and how it is photographed is in `pdcd.recipes.make`; this file checks its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pdcd.arrays import Floats
from pdcd.errors import RequestError
from pdcd.protocol.fields import (
    ARRAY_FIELDS,
    list_needed_fields,
    list_optional_fields,
    list_request_fields,
)
from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.bounds import WEIGHTS, check_bounds
from pdcd.recipes.partners import Partner, check_depths, describe_partners
from pdcd.words import GoalName

_Grid = tuple[int, int]

MATRICES = ("kernel", "matrix")
"""Parameters that are arrays of another shape than the grid."""
PLANE_FIELDS = tuple(name for name in ARRAY_FIELDS if name not in MATRICES)
"""Parameters with one value for each cell of the grid."""

KEEPS: dict[GoalName, str] = {
    "white": "all light",
    "indirect": "light that left its cell (Table 2, row 2)",
    "direct": "light that stayed in its cell, as white less indirect (Table 2, row 1)",
    "fraction": "direct light and the share p of the indirect (section 5)",
    "illuminated": "an ordinary photo under a pattern (Table 1, rows 1, 2)",
    "diagonal": "light that stayed in its cell, by signed codes (Table 1, row 3)",
    "off-diagonal": "light from the cell at a shift (Table 1, row 4)",
    "warped": "light from one chosen cell each (Table 1, row 5)",
    "two-samples": "a weighted pair of cells each (Table 1, row 6)",
    "relit": "transport times a matrix of weights (Table 1, row 7)",
    "long-range": "light from further than a radius (Table 2, row 3)",
    "short-range": "indirect light from within a radius (Table 2, row 4)",
    "blocked": "all but light from B to A (Table 2, row 5)",
    "descattered": "direct light less that of a neighbour (Table 2, row 6)",
    "filtered": "a filter over shifts (Table 2, row 7)",
    "split": "indirect light that is sharp, and that is smooth (Fig. 10)",
    "keyed": "all but direct light from a range of depths (Fig. 11)",
    "epipolar": "light that stays in its row of cells, or that does not",
    "stereo": "direct light from a range of depths",
    "transport": "entries of T itself: a slice between two rows of cells, or all (Fig. 5)",
}
"""What each goal keeps. The parameters that it takes are listed with each field of
`CaptureRequest`. All goals but "transport" may also be taken under an illumination (Table 1,
row 7)."""

OFF_AXIS_GOALS = ("keyed", "epipolar", "stereo")
"""Goals of benches whose camera is off the projector's axis."""


@dataclass(frozen=True, eq=False)
class Target:
    """A goal over a grid of cells, with its arrays.

    planes : name -> (N,) float64; matrices : name -> 2-D float64.
    """

    goal: Goal
    grid: _Grid
    planes: Mapping[str, Floats] = field(default_factory=dict)
    matrices: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def cells(self) -> int:
        """N."""
        return self.grid[0] * self.grid[1]

    @property
    def partner(self) -> Partner:
        """The projector cell that each camera cell is matched with, by shift or warp, or itself."""
        if "warp" in self.planes:
            return describe_partners(self.planes["warp"].astype(np.int64), self.grid)
        return None if self.goal.shift in (None, (0, 0)) else self.goal.shift

    @property
    def light(self) -> Floats | None:
        """The illumination, (N,), or None for full light."""
        return self.planes.get("illumination")


def check_target(target: Target) -> Target:
    """The target itself, or RequestError that says what to change."""
    goal = target.goal
    if goal.name not in KEEPS:
        raise RequestError(f"unknown goal {goal.name!r}", hint=f"known goals: {', '.join(KEEPS)}")
    needs = list_needed_fields(goal.name)
    numbers = {name for name in goal.__struct_fields__ if name != "name"}
    given = {name for name in numbers if getattr(goal, name) is not None}
    given |= {*target.planes, *target.matrices}
    takes = (*needs, *list_optional_fields(goal.name))
    missing, spare = sorted({*needs} - given), sorted(given - {*takes})
    if missing:
        wanted = list_request_fields()[missing[0]].takes
        raise RequestError(
            f"goal {goal.name} needs {', '.join(missing)}",
            hint=f"give {missing[0]}, which takes {wanted}",
        )
    if spare:
        raise RequestError(
            f"goal {goal.name} takes no {', '.join(spare)}",
            hint=f"leave it out; it takes {', '.join(takes)}",
        )
    if {"shift", "warp"} <= given:
        raise RequestError(
            f"goal {goal.name} was given a shift and a warp",
            hint="give one: both say which cell each camera cell is matched with",
        )
    check_bounds(target.goal, target.grid, target.matrices)
    _check_numbers(target)
    if goal.name in OFF_AXIS_GOALS:
        check_depths(goal, target.grid, target.planes)
    for name, plane in target.planes.items():
        _check_plane(target, name, plane)
    for name, matrix in target.matrices.items():
        _check_matrix(target, name, matrix)
    return target


def _check_numbers(target: Target) -> None:
    """Refuse what `check_bounds` lets pass; it has checked that all weights are finite."""
    goal, grid = target.goal, target.grid
    if goal.radius is not None and goal.radius < 0:
        raise RequestError(f"radius {goal.radius} is negative", hint="count cells from 0")
    if goal.name == "long-range" and goal.radius is not None and goal.radius >= max(grid) - 1:
        raise RequestError(
            f"no cell is further than {goal.radius} cells from another",
            hint="take a smaller radius",
        )
    if goal.name == "short-range" and goal.radius is not None and goal.radius >= max(grid) - 1:
        raise RequestError(
            f"all indirect light comes from within {goal.radius} cells",
            hint="take the goal indirect, or a smaller radius",
        )
    if goal.name == "descattered" and goal.shift == (0, 0):
        raise RequestError("descattered needs a shift other than 0 0", hint="such as 0 -1")
    if goal.period is not None and (goal.period % 4 or goal.period < 4):
        raise RequestError(
            f"stripes with a period of {goal.period} cells cannot be moved by a quarter of it "
            f"across {grid[1]} columns",
            hint="take 4, or another multiple of 4 that fits the grid",
        )


def _check_plane(target: Target, name: str, plane: Floats) -> None:
    cells, (rows, cols) = target.cells, target.grid
    if plane.size != cells:
        raise RequestError(
            f"{name} has {plane.size} values, the grid has {rows} x {cols} cells",
            hint="give one value for each cell",
        )
    if not np.isfinite(plane).all():
        raise RequestError(f"{name} has values that are not finite")
    if name.startswith("warp"):
        if np.any(plane != np.rint(plane)) or plane.min() < -1 or plane.max() >= cells:
            raise RequestError(
                f"{name} leaves the grid",
                hint=f"cells are numbered 0 to {cells - 1}; -1 means none",
            )
        if plane.max() < 0:
            raise RequestError(f"{name} pairs no cell at all")
    elif name != "disparities" and (plane.min() < 0.0 or plane.max() > 1.0):
        raise RequestError(f"{name} must lie between 0 and 1", hint="light cannot be negative")
    if name.startswith("region") and np.any((plane != 0.0) & (plane != 1.0)):
        raise RequestError(f"{name} must be 0 or 1 in every cell")
    if name == "illumination" and plane.max() < WEIGHTS[0]:
        raise RequestError("the illumination is black everywhere")


def _check_matrix(target: Target, name: str, matrix: Floats) -> None:
    cells = target.cells
    if matrix.ndim != 2:
        raise RequestError(f"{name} must be a two-dimensional array")
    if not matrix.any():
        raise RequestError(f"{name} is zero everywhere")
    if name == "matrix" and matrix.shape != (cells, cells):
        raise RequestError(f"matrix is {matrix.shape}, not {(cells, cells)}")
    if name == "kernel":
        if matrix.shape[0] % 2 == 0 or matrix.shape[1] % 2 == 0:
            raise RequestError(f"kernel is {matrix.shape}", hint="its sides must be odd")
