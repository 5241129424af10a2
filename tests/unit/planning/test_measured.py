"""What a plan makes of a bench that was measured."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.special import ndtr

from pdcd.bench.tables import Config
from pdcd.panels.schedule import SLOTS
from pdcd.planning.bench_fit import MOST_LEAK, choose_window, with_grid
from pdcd.planning.make import make_plan
from pdcd.planning.schedule_fit import (
    compute_schedule_leak,
    find_quietest_schedule,
    resolve_slot,
)
from pdcd.protocol.request import CaptureRequest


def config(**tables: dict[str, Any]) -> Config:
    """The mock bench with other values in some tables."""
    whole = Config()
    changed = {
        name: msgspec.structs.replace(getattr(whole, name), **values)
        for name, values in tables.items()
    }
    return msgspec.structs.replace(whole, **changed)


AUTO = {"grid": "auto"}


def leak_by_integration(
    cell_px: float, offset_px: float, spread_px: float, guard: float = 0.25
) -> float:
    """Light of other cells in a half window: the mean over its points of what is not its own."""
    x = np.linspace(guard, 1.0 - guard, 20001) * cell_px
    own = ndtr((x - offset_px) / spread_px) - ndtr((x - cell_px - offset_px) / spread_px)
    return float(1.0 - own.mean() ** 2)


def test_automatic_cells_are_as_small_as_the_leak_allows() -> None:
    rig = {"misregistration_px": 0.06}
    sharp, blurred = (
        with_grid(config(rig=rig, mask={"blur_px": blur_px}, schedule=AUTO))
        for blur_px in (0.3, 0.9)
    )
    for found, blur_px in ((sharp, 0.3), (blurred, 0.9)):
        assert isinstance(found.schedule.grid, tuple)
        rows, cols = found.schedule.grid
        cell_px = min(768 / rows, 1024 / cols)
        # The windows end at whole pixels of the mask, whose edges scatter evenly.
        spread_px = np.hypot(blur_px, 1024 / 1600 / np.sqrt(12.0))
        assert leak_by_integration(cell_px, 0.06 / np.sqrt(2.0), spread_px) <= 1.02 * MOST_LEAK
    assert str(sharp.schedule.grid) != str(blurred.schedule.grid)


def test_where_nothing_was_measured_cells_are_the_usual_ones() -> None:
    assert with_grid(config(schedule=AUTO)).schedule.grid is None
    typed = config(schedule={"grid": (6, 8)}, mask={"blur_px": 0.5})
    assert with_grid(typed) is typed


@pytest.mark.parametrize("limit", [0.97, 1.03])
def test_whole_cells_are_taken_as_long_as_they_let_hardly_any_light_through(limit: float) -> None:
    """By blur alone, by misregistration alone, and by half of each."""
    blur = 0.001 / (leak_by_integration(1.0, 0.0, 0.002, guard=0.0) / 0.002)
    apart = 0.001  # of a cell's width is that share of its light
    wanted = "whole" if limit < 1.0 else "quarter"
    assert choose_window("auto", 0.0, limit * blur) == wanted
    assert choose_window("auto", limit * apart) == wanted
    assert choose_window("auto", apart) == "whole"  # up to it, inclusive
    assert choose_window("auto", 0.5 * limit * apart, 0.5 * limit * blur) == wanted


def test_the_quietest_schedule_goes_by_rise_fall_and_lag() -> None:
    quick = {"rise_s": 2e-4, "fall_s": 2e-4}
    swift = config(projector=quick, mask=quick)
    assert (
        find_quietest_schedule(swift, 0.004) == "lag"
        and find_quietest_schedule(swift, -0.004) == "lead"
    )
    slow = config(projector=quick, mask={"rise_s": 0.004, "fall_s": 0.009})
    leaks = {name: compute_schedule_leak(slow, name, 0.004) for name in SLOTS}
    assert find_quietest_schedule(slow, 0.004) == min(leaks, key=lambda name: leaks[name]) == "wide"


def test_panels_set_from_opposite_ends_take_longer_guards() -> None:
    """The mask's light follows by up to a refresh at one edge of the field, and leads by half a one
    at the other: no schedule of three refreshes keeps codes apart at both."""
    quick = {"rise_s": 1e-3, "fall_s": 1e-3, "scan_s": 0.015}
    against = config(
        projector=quick, mask=quick | {"rise_s": 3e-3, "fall_s": 3e-3, "scan_s": -0.015}
    )
    assert compute_schedule_leak(against, "full", 0.005) > 0.1
    assert find_quietest_schedule(against, 0.005) == "wide"
    assert compute_schedule_leak(against, "wide", 0.005) < 0.005


@pytest.mark.parametrize("scan_s", [0.0, 0.015])
def test_light_of_rows_that_are_set_at_other_times_counts_in_full(scan_s: float) -> None:
    """A black projector between codes would meet a mask that is open for light of other rows, which
    a calibration by the difference of both panels cannot rule out."""
    times = {"rise_s": 1e-3, "fall_s": 3e-3, "scan_s": scan_s}
    found = find_quietest_schedule(config(projector=times, mask=times), 0.0)
    assert all(SLOTS[found][0])


@pytest.mark.parametrize(
    ("fall_s", "indirect", "far"),
    [(0.0008, "lag", "lag"), (0.0032, "lag", "wide"), (0.006, "wide", "wide")],
)
def test_far_light_wants_codes_kept_apart_ten_times_as_well(
    fall_s: float, indirect: str, far: str
) -> None:
    panels = config(
        projector={"rise_s": 2e-4, "fall_s": 2e-4}, mask={"rise_s": 0.001, "fall_s": fall_s}
    )
    for goal, fields, wanted in (
        ("indirect", {}, indirect), ("long-range", {"radius": 1}, far),
        ("short-range", {"radius": 1}, far),
    ):  # fmt: skip
        request = msgspec.convert({"goal": goal, "guards": "auto", **fields}, CaptureRequest)
        assert resolve_slot(request, panels, 0.001).schedule == wanted


def test_a_plan_says_why() -> None:
    found = config(
        rig={"misregistration_px": 0.06},
        mask={"blur_px": 0.4, "rise_s": 0.004, "fall_s": 0.008, "skew_s": 0.003},
        projector={"rise_s": 0.002, "fall_s": 0.002},
    )
    plan = make_plan(CaptureRequest(goal="indirect", codes=16), found, (48, 64), 0.003)
    cells, window, schedule, wandered, black = plan.summary().reasons
    assert black.startswith("black exposures: decided after a look at one dark photo")
    assert "16 projector pixels" in cells and "0.06 px" in cells and "0.4 px" in cells
    assert window.startswith("window quarter: ") and "leaks" in window
    assert schedule.startswith("schedule full: the mask follows by 3 to 3 ms")
    assert wandered.startswith("window quarter: of light that wanders half a cell or more")
    asked = CaptureRequest(goal="white", black_level="none")
    assert make_plan(asked, Config(), (48, 64)).summary().reasons == ()


@pytest.mark.parametrize(
    ("goal", "fields", "told"),
    [
        ("indirect", {"window": "quarter"}, True),
        ("filtered", {"window": "quarter", "kernel": ((0.0, 1.0, 0.0),)}, True),
        ("indirect", {"window": "whole"}, False),
        ("long-range", {"window": "quarter", "radius": 1}, False),
        ("white", {"window": "quarter"}, False),
    ],
)
def test_a_plan_says_where_light_of_a_cell_counts_as_from_elsewhere(
    goal: str, fields: dict[str, Any], told: bool
) -> None:
    request = msgspec.convert({"goal": goal, "black_level": "none", **fields}, CaptureRequest)
    reasons = make_plan(request, Config(), (12, 16)).summary().reasons
    assert any("wanders half a cell" in reason for reason in reasons) == told
