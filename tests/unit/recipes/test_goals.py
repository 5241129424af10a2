"""What a goal may be given: each number and array at the edge of what it can mean, and beyond."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.protocol.fields import list_needed_fields, list_optional_fields
from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.goals import KEEPS, Target, check_target
from pdcd.recipes.partners import describe_partners
from pdcd.words import GoalName

ROWS, COLS = GRID = (4, 8)
CELLS = ROWS * COLS


def target(name: str, **given: Any) -> Target:
    """Arrays of (rows, columns) or less are planes, the others matrices."""
    arrays = {key: np.array(value, float) for key, value in given.items() if is_array(value)}
    numbers = {key: value for key, value in given.items() if key not in arrays}
    matrices = {key: arrays.pop(key) for key in ("matrix", "kernel") if key in arrays}
    return Target(Goal(name=name, **numbers), GRID, arrays, matrices)  # type: ignore[arg-type]


def is_array(value: object) -> bool:
    return isinstance(value, np.ndarray | list)


def plane(fill: float = 0.0, **cells: float) -> np.ndarray[Any, Any]:
    """All cells alike but those that are named by ``c`` and their number."""
    found = np.full(CELLS, fill)
    for name, value in cells.items():
        found[int(name[1:])] = value
    return found


NONE: dict[str, Any] = {}
REGIONS = {"region_a": plane(1.0, c3=0.0), "region_b": plane(c5=1.0)}
PAIR = {"warp": plane(3.0), "warp_b": plane(4.0)}

GOOD: list[tuple[str, dict[str, Any]]] = [
    ("indirect", NONE),
    ("indirect", {"shift": (0, 7)}),
    ("indirect", {"warp": plane(-1.0, c0=CELLS - 1)}),
    ("indirect", {"illumination": plane(1e-6)}),
    ("indirect", {"illumination": plane(1.0, c0=0.0)}),
    ("fraction", {"p": 0.25}),
    ("long-range", {"radius": 0}),
    ("long-range", {"radius": 6}),
    ("short-range", {"radius": 6}),
    ("descattered", {"shift": (0, 1)}),
    ("descattered", {"shift": (-1, 0)}),
    ("split", {"period": 4}),
    ("split", {"period": 8}),
    ("two-samples", {**PAIR, "mix": (0.5, -2.0)}),
    ("blocked", REGIONS),
    ("relit", {"matrix": np.eye(CELLS)}),
    ("filtered", {"kernel": np.ones((3, 5))}),
    ("filtered", {"kernel": [[0.0, 0.0, 1.0]]}),
]

BAD: list[tuple[str, dict[str, Any], str]] = [
    ("nothing", NONE, "unknown goal 'nothing'.*known goals: white, indirect"),
    ("fraction", NONE, "goal fraction needs p"),
    ("two-samples", {"warp": plane()}, "needs mix, warp_b"),
    ("white", {"p": 0.5, "radius": 3}, "takes no p, radius .*leave it out"),
    ("indirect", {"shift": (0, 1), "warp": plane()}, "a shift and a warp"),
    ("fraction", {"p": 0.0}, "p = 0"),
    ("fraction", {"p": 1.0}, "p = 1"),
    ("fraction", {"p": -0.5}, "p = -0.5"),
    ("long-range", {"radius": -1}, "radius -1 is negative"),
    ("long-range", {"radius": 7}, "no cell is further than 7 cells"),
    ("short-range", {"radius": 7}, "all indirect light comes from within 7 cells.*goal indirect"),
    ("descattered", {"shift": (0, 0)}, "needs a shift other than 0 0"),
    ("split", {"period": 0}, "period of 0 cells cannot be moved by a quarter"),
    ("split", {"period": 6}, "period of 6 cells cannot be moved by a quarter.*8 columns"),
    ("split", {"period": -4}, "period of -4 cells cannot be moved"),
    ("two-samples", {**PAIR, "mix": (1.0, float("inf"))}, "largest weight of mix is inf"),
    ("two-samples", {**PAIR, "mix": (float("nan"), 1.0)}, "largest weight of mix is nan"),
    ("indirect", {"illumination": np.ones(CELLS - 1)}, "31 values, the grid has 4 x 8 cells"),
    ("indirect", {"illumination": plane(1.0, c1=np.nan)}, "illumination .* not finite"),
    ("indirect", {"illumination": plane(1.0, c1=-0.01)}, "must lie between 0 and 1"),
    ("indirect", {"illumination": plane(0.0, c1=1.01)}, "must lie between 0 and 1"),
    ("indirect", {"illumination": plane(9e-7)}, "black everywhere"),
    ("indirect", {"warp": plane(0.5)}, "warp leaves the grid .*0 to 31; -1 means none"),
    ("indirect", {"warp": plane(c4=-2.0)}, "warp leaves the grid"),
    ("indirect", {"warp": plane(c4=32.0)}, "warp leaves the grid"),
    ("indirect", {"warp": plane(-1.0)}, "warp pairs no cell at all"),
    ("two-samples", {**PAIR, "warp_b": plane(-1.0), "mix": (1.0, 1.0)}, "warp_b pairs no cell"),
    ("blocked", {**REGIONS, "region_a": plane(0.5)}, "region_a must be 0 or 1"),
    ("blocked", {**REGIONS, "region_b": plane(c1=0.5)}, "region_b must be 0 or 1"),
    ("relit", {"matrix": np.eye(CELLS - 1)}, r"matrix is \(31, 31\), not \(32, 32\)"),
    ("relit", {"matrix": np.ones(CELLS)}, "must be a two-dimensional array"),
    ("relit", {"matrix": np.zeros((CELLS, CELLS))}, "matrix is zero everywhere"),
    ("relit", {"matrix": np.full((CELLS, CELLS), np.inf)}, "largest weight of matrix is inf"),
    ("filtered", {"kernel": np.ones((2, 3))}, r"kernel is \(2, 3\).*sides must be odd"),
    ("filtered", {"kernel": np.ones((3, 4))}, r"kernel is \(3, 4\).*sides must be odd"),
]


@pytest.mark.parametrize(("name", "given"), GOOD)
def test_what_a_goal_can_mean_is_taken_as_it_is(name: str, given: dict[str, Any]) -> None:
    asked = target(name, **given)
    assert check_target(asked) is asked and asked.cells == CELLS


@pytest.mark.parametrize(("name", "given", "words"), BAD)
def test_what_it_cannot_mean_is_refused_by_name(
    name: str, given: dict[str, Any], words: str
) -> None:
    with pytest.raises(RequestError, match=words):
        check_target(target(name, **given))


def test_a_goal_may_take_what_it_does_not_need() -> None:
    assert set(KEEPS) == set(get_args(GoalName))
    for name in KEEPS:
        needs, may = list_needed_fields(name), list_optional_fields(name)
        assert not set(needs) & set(may)
        # Every photo may be lit by a pattern; entries of T are those of single cells.
        assert ("illumination" in {*needs, *may}) == (name != "transport")


def test_cells_are_matched_by_a_shift_by_a_warp_or_with_themselves() -> None:
    assert target("indirect").partner is None
    assert target("indirect", shift=(0, 0)).partner is None
    assert target("indirect", shift=(1, -2)).partner == (1, -2)
    warp = np.roll(np.arange(CELLS), 3)
    found = target("indirect", warp=warp).partner
    np.testing.assert_array_equal(found, describe_partners(warp, GRID))
    assert target("indirect").light is None
    light = plane(0.5)
    np.testing.assert_array_equal(target("indirect", illumination=light).light, light)
