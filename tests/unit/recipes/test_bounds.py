"""Numbers beyond what the grid can mean are refused by name and limit, before any work."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config, SceneConfig
from pdcd.errors import RequestError
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.make import make_plan
from pdcd.protocol.request import CaptureRequest

GRID = (48, 64)
CONFIG = Config(scene=SceneConfig(grid=GRID))


@pytest.mark.parametrize(
    ("fields", "limit"),
    [
        ({"goal": "short-range", "radius": 65}, "at most 64"),
        ({"goal": "short-range", "radius": 30000}, "at most 64"),
        ({"goal": "long-range", "radius": 30000}, "at most 64"),
        ({"goal": "off-diagonal", "shift": [48, 0]}, "at most 47 cells down and 63"),
        ({"goal": "descattered", "shift": [0, -64]}, "at most 47 cells down and 63"),
        ({"goal": "split", "period": 68}, "up to 64"),
        ({"goal": "split", "period": 60000}, "up to 64"),
        ({"goal": "fraction", "p": 1e-300}, "take p from 1.5e-05"),
        ({"goal": "fraction", "p": 1.0 - 1e-9}, "take p from 1.5e-05"),
        ({"goal": "filtered", "kernel": np.ones((97, 1)).tolist()}, "at most 95 x 127"),
        ({"goal": "filtered", "kernel": np.ones((1, 129)).tolist()}, "at most 95 x 127"),
        ({"goal": "filtered", "kernel": [[1e300]]}, "between 1e-06 and 1e+06"),
        ({"goal": "filtered", "kernel": [[1e-300]]}, "between 1e-06 and 1e+06"),
    ],
)
def test_what_the_grid_cannot_mean_is_refused_at_once(fields: dict[str, Any], limit: str) -> None:
    request = msgspec.convert(fields, CaptureRequest)
    with pytest.raises(RequestError) as caught:
        make_plan(request, CONFIG, GRID)
    assert limit in str(caught.value)


@pytest.mark.timeout(60)  # a kernel over the whole grid took minutes
@pytest.mark.parametrize(
    "fields",
    [
        {"goal": "short-range", "radius": 62},
        {"goal": "long-range", "radius": 62},
        {"goal": "off-diagonal", "shift": [47, -63]},
        {"goal": "split", "period": 64},
        {"goal": "filtered", "kernel": np.ones((95, 127)).tolist()},
        {"goal": "filtered", "kernel": [[1e6, -1e-300, 1.0]]},
    ],
)
def test_the_largest_that_a_grid_can_mean_is_planned(fields: dict[str, Any]) -> None:
    request = msgspec.convert({**fields, "codes": 8, "family": "bernoulli"}, CaptureRequest)
    assert make_plan(request, CONFIG, GRID).patterns


@pytest.mark.parametrize(
    "fields",
    [
        {"seconds": 1e300}, {"seconds": 86401.0}, {"radius": 10**30}, {"shift": [10**30, 0]},
        {"shift": [0, -65537]}, {"period": 4 * 10**20}, {"mix": [1e300, 0.0]},
        {"mix": [0.0, float("nan")]}, {"exposure_s": 1e300}, {"codes": 10**9}, {"pilot": 10**9},
        {"parts": 65}, {"repeat": 1025}, {"error": float("inf")}, {"until_error": 1.0},
        {"confidence": 0.4}, {"p": 0.0}, {"seed": -1},
    ],
)  # fmt: skip
def test_what_no_rig_can_mean_is_refused_by_the_type(fields: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError, match=r"Expected `(int|float)`"):
        msgspec.convert({"goal": "white", **fields}, CaptureRequest)


def test_a_day_may_be_asked_for() -> None:
    assert is_search_needed(CaptureRequest(goal="indirect", seconds=86400.0))
