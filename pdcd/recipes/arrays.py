"""Arrays of a request by the name of their field, and the goal that is made of them.

No file is opened here: whoever takes the request reads them first (`pdcd.planning.given`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pdcd.arrays import Floats
from pdcd.errors import RequestError
from pdcd.protocol.fields import ARRAY_FIELDS
from pdcd.protocol.plan_summary import Goal
from pdcd.protocol.request import CaptureRequest, NumberRows, SentArray
from pdcd.recipes.goals import MATRICES, PLANE_FIELDS, Target, check_target

Given = Mapping[str, Floats]
"""Arrays by the request's field, read and finite, float64: (rows, columns), except for codes."""

NO_ARRAYS: Given = MappingProxyType({})

MOST_ELEMENTS = 6144**2
"""Most numbers in an array, 300 MB: all pairs of cells of 64 x 96 cells."""
_MOST_CODE_LEVELS = 2**24
"""Most levels in both arrays of a request's own codes, 128 MiB: 2700 codes of 48 x 64 cells."""
_FEWEST_ELEMENTS = 2**16
"""Numbers that are read of any array, so that one of a wrong shape is refused because of it."""


def count_most_elements(name: str, grid: tuple[int, int]) -> int:
    """The most numbers that an array of this field can mean on a rig of that grid."""
    rows, columns = grid
    if name == "codes_from":
        return _MOST_CODE_LEVELS
    if name in PLANE_FIELDS:
        useful = rows * columns
    elif name == "kernel":
        useful = (2 * rows - 1) * (2 * columns - 1)
    else:
        useful = (rows * columns) ** 2
    return min(max(useful, _FEWEST_ELEMENTS), MOST_ELEMENTS)


def convert_rows(name: str, rows: NumberRows) -> Floats:
    """Rows of numbers as an array. Raises RequestError."""
    if len({len(row) for row in rows}) != 1:
        raise RequestError(f"{name} has rows of unequal length", hint="give a full rectangle")
    return np.array(rows, dtype=np.float64)


def read_target(request: CaptureRequest, given: Given, grid: tuple[int, int]) -> Target:
    """What a request asks for.

    Parameters
    ----------
    given : arrays that came as files; those that came as rows are taken from the request.

    Raises RequestError, also for an array that nobody has read.
    """
    arrays = {name: given[name] for name in ARRAY_FIELDS if name in given}
    for name in ARRAY_FIELDS:
        value = getattr(request, name)
        if name in arrays or value is None:
            continue
        if isinstance(value, str | SentArray):
            raise RequestError(
                f"{name} was named, but not read", hint="hand the array over beside the request"
            )
        arrays[name] = convert_rows(name, value)
    for name in PLANE_FIELDS:
        if name in arrays and arrays[name].shape != grid:
            raise RequestError(
                f"{name} is {' x '.join(map(str, arrays[name].shape))}, the grid is "
                f"{grid[0]} x {grid[1]} cells",
                hint="give one value for each cell",
            )
    goal = Goal(
        name=request.goal,
        p=request.p,
        shift=request.shift,
        radius=request.radius,
        mix=request.mix,
        period=request.period,
        disparity=request.disparity,
        plane=request.plane,
        keep=request.keep,
        rows=request.rows,
        masked=request.masked,
    )
    return check_target(make_target(goal, grid, arrays))


def make_target(goal: Goal, grid: tuple[int, int], arrays: Mapping[str, Floats]) -> Target:
    """A goal over a grid with these arrays by name, planes of any shape; nothing is checked."""
    planes = {name: a.ravel() for name, a in arrays.items() if name in PLANE_FIELDS}
    return Target(goal, grid, planes, {name: a for name, a in arrays.items() if name in MATRICES})
