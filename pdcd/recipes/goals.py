"""What to keep of the light transport, as a value: every row of Tables 1 and 2 of the paper.

A `Goal` is a name with its parameters. What it means as a matrix and how it is photographed is in
`pdcd.recipes.recipe`; this file knows which parameters each goal takes, and checks them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError

Floats = NDArray[np.float64]
Grid = tuple[int, int]

PLANES: dict[str, str] = {
    "illumination": "light of the projector, 0..1 for each cell",
    "warp": "projector cell of each camera cell, as row * columns + column, or -1",
    "warp_b": "a second warp",
    "region_a": "camera cells, 0 or 1",
    "region_b": "projector cells, 0 or 1",
}
"""Parameters with one value for each cell of the grid."""

MATRICES: dict[str, str] = {
    "kernel": "weights of shifts, an array with odd sides whose centre is the shift (0, 0)",
    "matrix": "weight of every pair of cells, N x N",
}

# name -> (parameters it needs, what it keeps). All goals but "illuminated" and "relit" may also be
# taken under an illumination (Table 1, row 7).
GOALS: dict[str, tuple[tuple[str, ...], str]] = {
    "white": ((), "all light"),
    "indirect": ((), "light that left its cell (Table 2, row 2)"),
    "direct": ((), "light that stayed in its cell, as white less indirect (Table 2, row 1)"),
    "fraction": (("p",), "direct light and the share p of the indirect (section 5)"),
    "illuminated": (("illumination",), "an ordinary photo under a pattern (Table 1, rows 1, 2)"),
    "diagonal": ((), "light that stayed in its cell, by signed codes (Table 1, row 3)"),
    "off-diagonal": (("shift",), "light from the cell at a shift (Table 1, row 4)"),
    "warped": (("warp",), "light from one chosen cell each (Table 1, row 5)"),
    "two-samples": (("warp", "warp_b", "mix"), "a weighted pair of cells each (Table 1, row 6)"),
    "relit": (("matrix",), "transport times a matrix of weights (Table 1, row 7)"),
    "long-range": (("radius",), "light from further than a radius (Table 2, row 3)"),
    "short-range": (("radius",), "indirect light from within a radius (Table 2, row 4)"),
    "blocked": (("region_a", "region_b"), "all but light from B to A (Table 2, row 5)"),
    "descattered": (("shift",), "direct light less that of a neighbour (Table 2, row 6)"),
    "filtered": (("kernel",), "a filter over shifts (Table 2, row 7)"),
    "split": (("period",), "indirect light that is sharp, and that is smooth (Fig. 10)"),
}


@dataclass(frozen=True, eq=False)
class Goal:
    """A goal and its parameters.

    shift : (down, right) cells; radius, period : cells; mix : weights of the two warps;
    p : 0..1.
    planes : name -> (N,) float64; matrices : name -> 2-D float64.
    """

    name: str
    grid: Grid
    p: float | None = None
    shift: tuple[int, int] | None = None
    radius: int | None = None
    mix: tuple[float, float] | None = None
    period: int | None = None
    planes: Mapping[str, Floats] = field(default_factory=dict)
    matrices: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def light(self) -> Floats | None:
        """The illumination, (N,), or None for full light."""
        return self.planes.get("illumination")


def check_goal(goal: Goal) -> Goal:
    """The goal itself, or ConfigError that says what to change."""
    if goal.name not in GOALS:
        raise ConfigError(f"unknown goal {goal.name!r}", hint=f"known goals: {', '.join(GOALS)}")
    needs, _ = GOALS[goal.name]
    names = ("p", "shift", "radius", "mix", "period")
    single = {name: getattr(goal, name) for name in names}
    given = {name for name, value in single.items() if value is not None}
    given |= set(goal.planes) | set(goal.matrices)
    allowed = set(needs) if goal.name == "relit" else {*needs, "illumination"}
    if goal.name == "relit":
        allowed.add("illumination")
    missing, spare = sorted(set(needs) - given), sorted(given - allowed)
    if missing:
        raise ConfigError(f"goal {goal.name} needs {', '.join(missing)}")
    if spare:
        raise ConfigError(f"goal {goal.name} takes no {', '.join(spare)}", hint="leave it out")
    _check_numbers(goal)
    for name, plane in goal.planes.items():
        _check_plane(goal, name, plane)
    for name, matrix in goal.matrices.items():
        _check_matrix(goal, name, matrix)
    return goal


def _check_numbers(goal: Goal) -> None:
    if goal.p is not None and not 0.0 < goal.p < 1.0:
        raise ConfigError(
            f"p = {goal.p} is not between 0 and 1",
            hint="p is the share of indirect light to keep beside the direct, such as 0.25",
        )
    if goal.radius is not None and goal.radius < 0:
        raise ConfigError(f"radius {goal.radius} is negative", hint="count cells from 0")
    if goal.name == "long-range" and goal.radius is not None and goal.radius >= max(goal.grid) - 1:
        raise ConfigError(
            f"no cell is further than {goal.radius} cells from another",
            hint="take a smaller radius",
        )
    if goal.shift is not None:
        down, right = goal.shift
        if abs(down) >= goal.grid[0] or abs(right) >= goal.grid[1]:
            raise ConfigError(
                f"a shift of {goal.shift} leaves the grid of {goal.grid[0]} x {goal.grid[1]} cells",
                hint="take a shift smaller than the grid",
            )
        if goal.name == "descattered" and goal.shift == (0, 0):
            raise ConfigError("descattered needs a shift other than 0 0", hint="such as 0 -1")
    if goal.period is not None and (goal.period % 4 or not 4 <= goal.period <= goal.grid[1]):
        raise ConfigError(
            f"stripes with a period of {goal.period} cells cannot be moved by a quarter of it "
            f"across {goal.grid[1]} columns",
            hint="take 4, or another multiple of 4 that fits the grid",
        )
    if goal.mix is not None and not np.isfinite(goal.mix).all():
        raise ConfigError("the two weights must be finite numbers")


def _check_plane(goal: Goal, name: str, plane: Floats) -> None:
    cells = goal.grid[0] * goal.grid[1]
    if plane.size != cells:
        raise ConfigError(
            f"{name} has {plane.size} values, the grid has {goal.grid[0]} x {goal.grid[1]} cells",
            hint="give one value for each cell",
        )
    if not np.isfinite(plane).all():
        raise ConfigError(f"{name} has values that are not finite")
    if name.startswith("warp"):
        if np.any(plane != np.rint(plane)) or plane.min() < -1 or plane.max() >= cells:
            raise ConfigError(
                f"{name} leaves the grid",
                hint=f"cells are numbered 0 to {cells - 1}; -1 is none",
            )
        if plane.max() < 0:
            raise ConfigError(f"{name} pairs no cell at all")
    elif plane.min() < 0.0 or plane.max() > 1.0:
        raise ConfigError(f"{name} must lie between 0 and 1", hint="light cannot be negative")
    if name.startswith("region") and np.any((plane != 0.0) & (plane != 1.0)):
        raise ConfigError(f"{name} must be 0 or 1 in every cell")
    if name == "illumination" and plane.max() == 0.0:
        raise ConfigError("the illumination is black everywhere")


def _check_matrix(goal: Goal, name: str, matrix: Floats) -> None:
    cells = goal.grid[0] * goal.grid[1]
    if matrix.ndim != 2 or not np.isfinite(matrix).all():
        raise ConfigError(f"{name} must be a two-dimensional array of finite numbers")
    if not matrix.any():
        raise ConfigError(f"{name} is zero everywhere")
    if name == "matrix" and matrix.shape != (cells, cells):
        raise ConfigError(f"matrix is {matrix.shape}, not {(cells, cells)}")
    if name == "kernel":
        if matrix.shape[0] % 2 == 0 or matrix.shape[1] % 2 == 0:
            raise ConfigError(f"kernel is {matrix.shape}", hint="its sides must be odd")
        if matrix.shape[0] // 2 >= goal.grid[0] or matrix.shape[1] // 2 >= goal.grid[1]:
            raise ConfigError(f"kernel is {matrix.shape}, wider than the grid reaches")
