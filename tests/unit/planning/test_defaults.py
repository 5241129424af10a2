"""What a plain request leaves to the program: parts where a RAW file costs little."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import CameraConfig, Config, ScheduleConfig
from pdcd.planning.defaults import (
    Defaults,
    is_camera_needed,
    readout_s,
    resolve_defaults,
)
from pdcd.planning.make import make_plan
from pdcd.protocol.request import CaptureRequest

GRID = (12, 16)
N = GRID[0] * GRID[1]
ITSELF = np.arange(N).reshape(GRID).tolist()
BACKWARDS = np.arange(N)[::-1].reshape(GRID).tolist()


def camera(seconds: float | None = 0.0) -> CameraInfo:
    return CameraInfo("", "", "modern", np.ones(3), (100,), (), readout_s=seconds)


def settled_of(config: Config | None = None, file_s: float | None = 0.0, **fields: Any) -> Defaults:
    request = CaptureRequest(**{"goal": "indirect", **fields})
    return resolve_defaults(request, config or Config(), GRID, camera(file_s))


def parts_of(
    config: Config | None = None, file_s: float | None = 0.0, **fields: Any
) -> tuple[Any, str]:
    """Parts alone, without a pilot."""
    found = settled_of(config, file_s, **{"pilot": 0, **fields})
    return found.request.parts, " ".join(found.reasons)


@pytest.mark.parametrize(
    ("seconds", "parts"), [(0.0, 8), (0.06, 8), (0.1, 4), (0.3, 4), (0.4, 1), (3.0, 1), (None, 1)]
)
def test_parts_are_as_many_as_their_files_are_worth(seconds: float | None, parts: int) -> None:
    """Seven files, or three, may take a quarter of the time of the codes: 1.6 s. Each takes 0.16 s
    beside the file: twice 50 ms on black, and the shutter's lag."""
    found, reason = parts_of(file_s=seconds)
    assert found == parts
    assert ("measures the error bars" in reason) == (parts > 1)
    assert ("not in the error bars" in reason) == (parts == 1)


def test_without_noise_one_exposure_is_best() -> None:
    """Nothing is gained from filling the sensor more often, and the codes err more in parts."""
    found, reason = parts_of(Config(camera=CameraConfig(noise="none")))
    assert found == 1 and "no noise" in reason


@pytest.mark.parametrize(("goal", "left"), [("long-range", 124), ("short-range", 112)])
def test_light_by_range_is_measured_in_four_parts_after_a_look(goal: str, left: int) -> None:
    """Far light needs no Hadamard codes, so that any number can be split; the photo of all indirect
    light that short-range light is taken from does."""
    found = settled_of(goal=goal, radius=2)
    assert (found.request.codes, found.request.parts, found.request.pilot) == (128, 4, 16)
    other = found.otherwise
    assert other is not None
    assert (other.codes, other.parts, other.pilot) == (left + 4, 4, 4)
    assert "4 photos of single codes look for mirrors" in found.reasons[0]
    assert "measures the error bars" in found.reasons[1]
    slow = settled_of(goal=goal, radius=2, file_s=3.0)
    assert (slow.request.parts, slow.request.pilot, slow.otherwise) == (1, 0, None)
    assert settled_of(goal=goal, radius=2, codes=128) == found
    near = settled_of(goal=goal, radius=0).otherwise  # that is all indirect light: Hadamard codes
    assert near is not None and (near.codes, near.parts) == (116, 4)
    make_plan(near, Config(), GRID)


@pytest.mark.parametrize(
    ("goal", "fields"),
    [
        ("fraction", {"p": 0.25}),
        ("fraction", {"p": 0.5}),
        ("split", {"period": 8}),
        ("diagonal", {}),
        ("warped", {"warp": BACKWARDS}),
        ("two-samples", {"warp": ITSELF, "warp_b": BACKWARDS, "mix": (1.0, -1.0)}),
        ("descattered", {"shift": (0, 1)}),
        ("filtered", {"kernel": [[1.0, -2.0, 0.5]]}),
    ],
)
def test_goals_of_coded_photos_are_measured_in_parts(goal: str, fields: dict[str, Any]) -> None:
    """In one exposure their error bars were two to five times the error, or before mirrors half of
    it, and their noise three times that of eight."""
    found = settled_of(goal=goal, **fields)
    assert (found.request.parts, found.request.pilot, found.otherwise) == (8, 0, None)
    assert make_plan(found.request, Config(), GRID).how.parts == 8


@pytest.mark.parametrize(("p", "parts"), [(0.375, 8), (0.125, 8), (1 / 32, 4), (1 / 64, 1)])
def test_parts_have_codes_that_light_cells_in_the_share_asked_for(p: float, parts: int) -> None:
    assert settled_of(goal="fraction", p=p).request.parts == parts


@pytest.mark.parametrize(
    ("goal", "fields"),
    [("indirect", {}), ("direct", {}), ("fraction", {"p": 0.25}), ("split", {"period": 8})],
)
def test_cells_matched_with_others_are_photographed_at_once(
    goal: str, fields: dict[str, Any]
) -> None:
    """Their own direct light is kept, and must be so by every code alike: few codes a part do that
    badly. A pilot looks for paths beside it."""
    found = settled_of(goal=goal, shift=(0, 1), **fields)
    assert (found.request.parts, found.request.pilot, found.otherwise) == (1, 0, None)
    assert "pilot: none" in found.reasons[0] and "parts: one exposure" in found.reasons[1]
    assert make_plan(found.request, Config(), GRID).how.parts == 1


def test_an_illumination_leaves_the_rest_open() -> None:
    light = tuple(tuple(0.5 for _ in range(GRID[1])) for _ in range(GRID[0]))
    found = settled_of(illumination=light)
    assert (found.request.parts, found.request.pilot) == (7, 16)


@pytest.mark.parametrize(
    ("codes", "radius", "parts"),
    [(128, 3, 4), (128, 4, 1), (256, 4, 4), (112, 3, 1)],
)
def test_light_from_far_off_is_not_parted_into_codes_too_dense_for_it(
    codes: int, radius: int, parts: int
) -> None:
    """32 codes light a cell in 1/32 of them at the least; beyond 8 cells the best share is 1/290,
    and 250 times less light would be left."""
    for goal in ("long-range", "short-range"):
        rig = Config(schedule=ScheduleConfig(codes=codes))
        found = settled_of(rig, goal=goal, radius=radius)
        assert found.request.parts == parts
        assert (f"from beyond {radius} cells" in found.reasons[1]) == (parts == 1)


@pytest.mark.parametrize(
    "named",
    [
        {"pilot": 0, "parts": 1},
        {"codes": 128, "pilot": 16, "parts": 1},
        {"repeat": 2},
        {"exposure_s": 10.0},
        {"method": "multi-image"},
        {"prior": "decay:3"},
        {"error": 0.01},
        {"seconds": 10.0},
        {"goal": "fraction", "p": 0.25, "equal_brightness": True},
        {"goal": "off-diagonal", "p": 0.25, "shift": (0, 1)},
        {"goal": "white"},
    ],
)
def test_who_says_how_codes_are_spent_gets_one_exposure(named: dict[str, Any]) -> None:
    request = CaptureRequest(**{"goal": "indirect", **named})
    assert not is_camera_needed(request)
    found = settled_of(**named)
    assert (found.request.parts, found.reasons, found.otherwise) == (1, (), None)
    assert found.request.pilot == named.get("pilot", 0)


@pytest.mark.parametrize(
    "named",
    [
        {"seed": 3}, {"window": "whole"}, {"white": False}, {"note": "x"}, {"smooth": True},
        {"codes": 128}, {"family": "hadamard"}, {"codes": 128, "family": "hadamard"},
    ],
)  # fmt: skip
def test_a_number_of_codes_leaves_pilot_and_parts_open(named: dict[str, Any]) -> None:
    assert is_camera_needed(CaptureRequest(**{"goal": "direct", **named}))
    found = settled_of(**named)
    assert (found.request.pilot, found.request.parts) == (16, 7)
    assert found.otherwise is not None
    assert (found.otherwise.pilot, found.otherwise.parts) == (4, 6)


def test_the_cost_of_a_file_is_typed_or_seen_or_assumed() -> None:
    assert readout_s(Config(), camera(0.7)) == 0.7
    assert readout_s(Config(), camera(None)) == readout_s(Config(), None) == 3.0
    typed = msgspec.structs.replace(Config().camera, readout_s=0.2)
    assert readout_s(Config(camera=typed), camera(0.7)) == 0.2


@pytest.mark.parametrize(
    ("codes", "parts", "pilot", "left"), [(128, 4, 16, 112), (128, 3, 8, 120), (64, 8, 0, 0)]
)
def test_parts_that_are_named_stay_beside_a_pilot_that_is_left_open(
    codes: int, parts: int, pilot: int, left: int
) -> None:
    """Each of them keeps a number of Hadamard codes, or there is no pilot."""
    found = settled_of(pilot="auto", codes=codes, parts=parts)
    assert (found.request.codes, found.request.pilot, found.request.parts) == (codes, pilot, parts)
    assert (found.otherwise is None) == (pilot == 0)
    if found.otherwise is not None:
        other = found.otherwise
        assert (other.codes, other.pilot, other.parts) == (left + 4, 4, parts)
        assert f"parts: {parts} exposures, as asked for" in found.reasons[1]
