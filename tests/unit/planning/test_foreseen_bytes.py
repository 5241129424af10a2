"""Bytes that plans are foreseen to take, counted by hand for each kind of program."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, PanelConfig, RigConfig
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.pictures.exposed import LARGE_QUADS
from pdcd.planning.make import make_plan
from pdcd.planning.memory import (
    BASE,
    MemoryLimitError,
    check_memory,
    decoding_bytes,
    frame_quads,
    memory_bytes,
    memory_limit_bytes,
    picture_bytes,
    planning_bytes,
)
from pdcd.planning.plan import Plan
from pdcd.protocol.request import CaptureRequest

GRID = (3, 4)
RNG = np.random.default_rng(0)
LIGHT = RNG.random(GRID).tolist()
KERNEL = RNG.standard_normal((3, 3)).tolist()
MATRIX = RNG.standard_normal((12, 12)).tolist()
OFF_AXIS = Config(rig=RigConfig(arrangement="off-axis"))
C = 64 * 12
"""Codes times cells of most cases here."""
SQUARE = 64 * 64


def planned(
    config: Config | None = None, grid: tuple[int, int] = GRID, **fields: Any
) -> tuple[Plan, Lattice]:
    whole = {"goal": "indirect", "codes": 64, "window": "whole", **fields}
    found = make_plan(msgspec.convert(whole, CaptureRequest), config or Config(), grid)
    return found, Lattice(grid, found.window)


@pytest.mark.parametrize(
    ("fields", "most", "kept"),
    [
        # Hadamard codes take a square of their number beside them while they are made.
        ({}, 4 * C + SQUARE, C),
        ({"codes": 8}, 8 * 96, 96),
        ({"window": "quarter"}, 8 * 64 * 20, 64 * 20),
        ({"family": "bernoulli"}, 10 * C, C),
        ({"family": "balanced"}, 8 * C, C),
        ({"family": "balanced", "illumination": LIGHT}, 16 * 12 + 38 * C, 16 * 12 + 5 * C),
        # Of parts the second is made beside the first.
        ({"codes": 16, "parts": 2}, 96 + 8 * 96, 2 * 96),
        ({"goal": "long-range", "radius": 0}, 4 * C + SQUARE, C),
        # Beside the codes what counts far light alike, all 12 camera cells at once.
        (
            {"goal": "long-range", "radius": 1, "grey_masks": False},
            (62 + 104 + 8) * C + 48 * SQUARE + 9 * 12 * 24, C,
        ),
        # Grey masks are kept as numbers.
        (
            {"goal": "long-range", "radius": 1},
            (48 + 80 + 40) * C + 40 * SQUARE + 9 * 12 * 24, 5 * C,
        ),
        # Codes that are chosen together with them, too.
        (
            {"goal": "long-range", "radius": 1, "codes": 8},
            4 * (14 * 144 + 80 * 96), 9 * 96,
        ),
        ({"goal": "diagonal"}, 9 * C + 56 * C, 18 * C),
        ({"goal": "filtered", "kernel": KERNEL}, 9 * C + 56 * C, 18 * C),
        ({"goal": "relit", "matrix": MATRIX, "codes": 8}, 65 * 96 + 24 * 144, 18 * 96),
        # With as many codes as it has rows it is shown as it is: 2 x 12 pairs of either sign.
        ({"goal": "relit", "matrix": MATRIX}, 24 * 96 * 12, 2 * 24 * 16 * 12),
        # A pilot of 16 codes, then 32 of the photo beside it.
        ({"codes": 48, "pilot": 16}, 192 + 8 * 32 * 12, 192 + 32 * 12),
        ({"goal": "white"}, 0, 0),
        ({"goal": "transport"}, 19 * 80 * 12, 19 * 16 * 12),
        ({"goal": "direct", "method": "multi-image", "codes": 8}, 4 * 96 + 64, 96),
    ],
)  # fmt: skip
def test_bytes_of_codes_and_patterns(fields: dict[str, Any], most: int, kept: int) -> None:
    plan, lattice = planned(**fields)
    family = plan.how.family or "hadamard"
    found = planning_bytes(plan.recipe, plan.how, family, lattice, 1)
    assert (found[1], found[0]) == (kept, most)


@pytest.mark.parametrize(
    ("fields", "most", "kept"),
    [
        ({"goal": "keyed", "codes": 8}, 8 * 96, 96),
        ({"goal": "epipolar", "codes": 8}, 2 * 96 + 8 * 96, 4 * 96),
        ({"goal": "keyed", "codes": 16, "disparity": [0, 1]}, 2 * 192 + 8 * 192, 3 * 192),
        (
            {"goal": "epipolar", "codes": 8, "illumination": LIGHT},
            10 * 96 + 68 * 96,
            20 * 96 + 16 * 12,
        ),
    ],
)
def test_bytes_of_codes_of_depths(fields: dict[str, Any], most: int, kept: int) -> None:
    plan, lattice = planned(OFF_AXIS, **fields)
    planning, left = planning_bytes(plan.recipe, plan.how, "hadamard", lattice, 1)
    assert left == kept
    # The white photo under a goal's own light is one pair.
    assert planning in (most, most + 16 * 12)


@pytest.mark.parametrize(("family", "pairs"), [("isolation", 144), ("confocal", 132)])
def test_bytes_of_single_paths(family: str, pairs: int) -> None:
    plan, lattice = planned(family=family)
    coded = plan.recipe.programs["coded"]
    assert len(plan.patterns["coded"][0]) == pairs and not coded.coded
    found = planning_bytes(plan.recipe, plan.how, plan.how.family or "hadamard", lattice, 1)
    assert found == (pairs * (16 * 12 + 32), pairs * 5 * 12)


def test_exact_pairs_are_counted_in_all_their_copies() -> None:
    plan, lattice = planned(goal="transport")
    one = planning_bytes(plan.recipe, plan.how, "hadamard", lattice, 1)
    assert planning_bytes(plan.recipe, plan.how, "hadamard", lattice, 16) == (
        16 * one[0],
        16 * one[1],
    )


LARGE_GRID = (48, 64)
CELLS = 48 * 64


def decoded(plan: Plan, lattice: Lattice, config: Config | None = None, passes: int = 1) -> int:
    return decoding_bytes(plan.recipe, plan.how, lattice, passes, config or Config())


@pytest.mark.parametrize(
    ("fields", "passes", "shots", "photos", "pictures"),
    [
        # Five rows for four that are shown, and two of what is there before and after.
        ({"codes": 8}, 1, {"white": 4, "coded": 12}, [4, 12], 3),
        ({"codes": 8}, 3, {"white": 6, "coded": 32}, [6, 32], 3),
        ({"codes": 12}, 1, {"white": 4, "coded": 17}, [4, 17], 3),
        ({"codes": 16, "parts": 2}, 1, {"w": 4, "1": 12, "2": 12}, [4, -24], 3),
        ({"codes": 8, "window": "quarter"}, 1, {"white": 4, "coded": 42}, [4, 42], 3),
        ({"goal": "diagonal", "codes": 8}, 1, {"plus": 22, "minus": 22}, [-44], 1),
        ({"goal": "white"}, 1, {"white": 4}, [4], 1),
        # A single pair is shown as often as codes would be.
        (
            {"codes": 8, "illumination": RNG.random((48, 64)).tolist(), "window": "whole"},
            1,
            {"white": 12, "coded": 12},
            [12, 12],
            3,
        ),
        # Single codes of a pilot are one pair each.
        (
            {"codes": 48, "pilot": 32},
            1,
            {"white": 4, **{str(k): 4 for k in range(32)}, "coded": 22},
            [4, 22],
            3,
        ),
    ],
)
def test_bytes_of_pictures_beside_the_rows_of_all_shots(
    fields: dict[str, Any], passes: int, shots: dict[str, int], photos: list[int], pictures: int
) -> None:
    """Photos of several shots, negative here, hold these side by side as well."""
    plan, lattice = planned(grid=LARGE_GRID, **fields)
    kept = 16 * CELLS * sum(shots.values())
    shown = CELLS * (9 * len(shots) + 104 * len(photos) + 59 * pictures + 150)
    assert picture_bytes(plan.recipe, CELLS) == shown
    judged = [
        32 * abs(rank) * 2048 + 24 * rank**2 + (16 * -rank * CELLS if rank < 0 else 0)
        for rank in photos
    ]
    reading = 16 * max(shots.values()) * CELLS
    most = max(reading, shown, int(0.75 * shown) + max(judged))
    assert decoded(plan, lattice, passes=passes) == kept + most


@pytest.mark.parametrize(("grid", "exact"), [((32, 32), True), ((25, 41), False)])
def test_matrices_of_few_cells_are_compared_as_a_whole(grid: tuple[int, int], exact: bool) -> None:
    plan, lattice = planned(grid=grid, codes=8)
    cells = grid[0] * grid[1]
    shown = cells * (9 * 2 + 104 * 2 + 59 * 3 + 150)
    judged = 24 * cells**2 if exact else 32 * 12 * cells + 24 * 12**2
    assert decoded(plan, lattice) == 16 * 16 * cells + int(0.75 * shown) + judged


def test_more_rows_than_cells_are_folded_into_a_square() -> None:
    """Of 12 cells: 8 codes are 10 rows with those shown again, and 9 codes of a longer one more."""
    shown = 12 * (9 * 2 + 104 * 2 + 59 * 3 + 150)
    folded = 48 * 12**2
    judged = 32 * 12 * 12 + 24 * 12**2
    for codes in (8, 12):
        plan, lattice = planned(codes=codes)
        most = max(16 * 12 * 12, shown, int(0.75 * shown) + judged)
        assert decoded(plan, lattice) == 16 * 12 * (4 + 12) + most
        assert folded > 16 * 12 * 12
    many = 640
    plan, lattice = planned(grid=(16, 16), codes=many)
    few, _ = planned(grid=(16, 16), codes=many)
    small = replace(few.recipe, photos=(), pictures={})
    found = decoding_bytes(small, plan.how, lattice, 1, Config())
    assert found == 16 * 256 * (256 + 4) + 48 * 256**2


def test_panels_that_take_their_time_have_more_rows_a_code() -> None:
    slow = Config(projector=PanelConfig(size_px=(1024, 768), rise_s=0.001, fall_s=0.003))
    plan, lattice = planned(slow, grid=LARGE_GRID, codes=8)
    bare = replace(plan.recipe, photos=(), pictures={})
    once = decoding_bytes(bare, plan.how, lattice, 1, Config())
    assert once == 16 * CELLS * (4 + 12) + max(16 * 12 * CELLS, CELLS * (9 * 2 + 150))
    fields = 3  # what stays, what rises and what falls
    ranks = int(np.ceil(1.25 * fields)) + 2 * fields, int(1.25 * 8 * fields) + 2 * fields
    found = decoding_bytes(bare, plan.how, lattice, 1, slow)
    assert found == 16 * CELLS * sum(ranks) + 16 * ranks[1] * CELLS


def test_quads_are_those_of_the_camera_as_far_as_it_is_known() -> None:
    typed = Config(camera=CameraConfig(frame_quads=(100, 50)))
    assert frame_quads(typed, GRID) == 5000
    per_cell = Config(camera=CameraConfig(quads_per_cell=3))
    assert frame_quads(per_cell, GRID) == 9 * 12
    mapped = CameraConfig(driver="gphoto2", place=Placing(map=Map.filling((70, 30))))
    assert frame_quads(Config(camera=mapped), GRID) == 2100
    assert frame_quads(Config(camera=CameraConfig(driver="gphoto2")), GRID) == 3_100_000


def test_a_quad_of_a_large_frame_takes_less() -> None:
    plan, _ = planned(codes=8)
    small = 9 * 2 + 104 * 2 + 59 * 3 + 150
    large = 9 * 2 + 80 * 2 + 35 * 3 + 94
    assert picture_bytes(plan.recipe, 2_000_000) == 2_000_000 * large
    assert picture_bytes(plan.recipe, LARGE_QUADS) == LARGE_QUADS * large
    assert picture_bytes(plan.recipe, LARGE_QUADS - 1) == (LARGE_QUADS - 1) * small
    sums, _ = planned(goal="direct", method="multi-image", codes=8)
    recipe = sums.recipe
    counts = (len(recipe.shots), len(recipe.sums), len(recipe.photos), len(recipe.pictures))
    assert counts == (8, 4, 4, 4)
    assert picture_bytes(recipe, 10) == 10 * (9 * 8 + 49 * 4 + 104 * 4 + 59 * 4 + 150)


def test_the_peak_is_that_of_planning_or_of_decoding_beside_what_was_given() -> None:
    plan, lattice = planned(codes=8)
    decoding = decoded(plan, lattice)
    found = memory_bytes(plan.recipe, plan.how, "hadamard", lattice, 1, Config())
    assert found == plan.memory_bytes == BASE + 96 + decoding
    # A plane of 12 numbers is held three times over.
    lit, lattice = planned(codes=8, illumination=LIGHT)
    kept = 16 * 12 + 5 * 96
    assert lit.memory_bytes == BASE + 3 * 96 + kept + decoded(lit, lattice)
    many, lattice = planned(codes=512)
    planning = 4 * 512 * 12 + 512**2
    assert planning > 512 * 12 + decoded(many, lattice)
    assert many.memory_bytes == BASE + planning
    # Grey levels of panels whose curve is known may need 16 copies of exact pairs.
    curved = Config(mask=PanelConfig(size_px=(1600, 1200), gamma=2.2))
    exact, lattice = planned(curved, goal="transport")
    assert exact.memory_bytes == BASE + max(
        16 * 19 * 80 * 12, 16 * 19 * 16 * 12 + decoded(exact, lattice, curved)
    )


def test_a_job_may_take_what_the_limit_is_and_no_more() -> None:
    config = Config(limits=LimitsConfig(memory_bytes=2**28))
    assert memory_limit_bytes(config) == 2**28
    check_memory(2**28, config, (6, 8))
    with pytest.raises(MemoryLimitError, match=r"takes 256 MiB .* 6 x 8 cells.* 256 MiB") as found:
        check_memory(2**28 + 1, config, (6, 8))
    assert isinstance(found.value, RequestError) and "memory_bytes" in str(found.value.hint)
    assert memory_limit_bytes(Config()) > 2**28
