"""What a plan settles: looks, lags, apertures, families, counts of codes."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import BenchConfig, Config
from pdcd.errors import ConfigError, RequestError
from pdcd.planning.bench_fit import add_bench_plane, choose_window
from pdcd.planning.code_counts import scale_code_count
from pdcd.planning.grey import explain_grey_levels, find_grey_panels, is_mock_as_configured
from pdcd.planning.look import (
    DarkFrames,
    choose_black_level,
    resolve_black_level,
)
from pdcd.planning.make import make_plan
from pdcd.planning.plan import LeakProbe, Plan, average_pair_light
from pdcd.planning.schedule_fit import convert_lag_to_rows, is_lag_needed, list_tolerant_schedules
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import OFF_AXIS_GOALS
from pdcd.recipes.recipe import Shot
from tests.unit.planning.test_measured import config

GRID = (12, 16)


def plan_of(**fields: Any) -> Plan:
    request = CaptureRequest(**{"goal": "indirect", "codes": 8, "window": "whole", **fields})
    return make_plan(request, Config(), GRID)


def shot_of(plan: Plan, name: str) -> Any:
    return next(shot for shot in plan.recipe.shots if shot.name == name)


@pytest.mark.parametrize(
    ("fields", "level", "look"),
    [
        ({"black_level": "mask"}, "mask", None),
        ({"black_level": "none"}, "none", None),
        ({"goal": "transport"}, "none", None),
        ({}, "none", LeakProbe(0.01, may_add=True)),
        ({"error": 0.05}, "none", LeakProbe(0.05, may_add=True)),
        ({"until_error": 0.03}, "none", LeakProbe(0.03, may_add=True)),
        ({"seconds": 9.0}, "none", LeakProbe(0.01, may_add=False)),
    ],
)
def test_black_exposures_are_as_asked_or_wait_for_a_look(
    fields: dict[str, Any], level: str, look: LeakProbe | None
) -> None:
    found = resolve_black_level(CaptureRequest(**{"goal": "indirect", **fields}), Config())
    assert (found.level, found.look) == (level, look)


@pytest.mark.parametrize(
    ("ambient", "mask", "both", "level"),
    [
        (0.0, 0.0, 0.01, "none"), (0.02, 0.0, 0.011, "ambient"), (0.02, 0.01, 0.011, "ambient"),
        (0.01, 0.02, 0.03, "mask"), (0.02, 0.02, 0.03, "both"), (0.005, 0.02, 0.03, "mask"),
        (None, None, 0.03, "ambient"),
    ],
)  # fmt: skip
def test_black_exposures_are_those_that_leaks_call_for(
    ambient: float | None, mask: float | None, both: float, level: str
) -> None:
    leaks = LeakErrors(ambient=ambient, mask=mask, both=both, floor=0.001, limit=0.01, raw=())
    assert choose_black_level(leaks) == level


def test_a_dark_photo_shows_an_open_mask_then_a_lit_projector() -> None:
    plan = plan_of(codes=128)
    dark = DarkFrames.of(plan)
    rows = dark.rows
    assert rows == 15 and dark.phase_s == 0.25
    pause = max(2, int(np.ceil(plan.settle_s * 60.0)))
    for lit in (True, False):
        frames = dark.frames(lit=lit)
        assert len(frames) == 2 * rows + pause
        open_, on = frames.dual_index == -2, frames.primal_index == -2
        assert open_.tolist() == [True] * rows + [False] * (rows + pause)
        assert on.tolist() == [False] * (rows + pause) + [lit] * rows
        assert np.array_equal(frames.guard, ~open_)
    assert dark.seconds == pytest.approx((2 * rows + pause) / 60.0)
    assert dark.shot is plan.last_exposed
    short = plan_of(codes=2, guards="none")
    assert DarkFrames.of(short).rows == short.refreshes(short.recipe.shots[-1]) < 15


def lit_s(plan: Plan, shot: Shot) -> float:
    return plan.sequence(shot).lit_s(plan.row_hz)


@pytest.mark.parametrize(
    ("guards", "lit_rows"), [("none", 1), ("full", 3), ("lag", 2), ("both", 1)]
)
def test_a_cell_is_lit_for_as_long_as_its_codes_say(guards: Any, lit_rows: int) -> None:
    for fields, fields_shown in (({"window": "whole"}, 1), ({"window": "quarter"}, 4)):
        plan = plan_of(guards=guards, black_level="both", **fields)
        primal: Any = plan.patterns["coded"][0]
        cells = GRID[0] * GRID[1] if fields_shown == 1 else (GRID[0] + 1) * (GRID[1] + 1)
        lit = np.unpackbits(primal, axis=1, count=cells).mean(axis=1).sum()
        rows = lit * lit_rows * plan.passes * fields_shown
        assert lit_s(plan, shot_of(plan, "coded")) == pytest.approx(rows / 60.0)
    white = shot_of(plan, "white")
    assert lit_s(plan, white) == pytest.approx(lit_rows * plan.white_slots / 60.0)
    dark = [shot for shot in plan.recipe.shots if shot.primal_black]
    assert dark and all(lit_s(plan, shot) == 0.0 for shot in dark)


def test_a_single_code_of_a_pilot_is_lit_by_itself() -> None:
    plan = plan_of(codes=64, pilot=32)
    singles = [shot for shot in plan.recipe.shots if shot.only is not None]
    primal: Any = plan.patterns[singles[0].program][0]
    cells = GRID[0] * GRID[1]
    shares = np.unpackbits(primal, axis=1, count=cells).mean(axis=1)
    rows = 3 * plan.passes_of(singles[0])
    for shot in (singles[0], singles[5], singles[-1]):
        assert lit_s(plan, shot) == pytest.approx(shares[shot.only] * rows / 60.0)


@pytest.mark.parametrize(
    ("goal", "fields", "plane", "wanted"),
    [
        ("white", {}, (0.5, 0.0, 0.0), None),  # which asks for no depth
        ("epipolar", {}, (0.5, 0.0, 0.0), None),
        ("keyed", {}, (0.5, 0.0, 0.0), (0.5, 0.0, 0.0)),
        ("keyed", {"plane": (1.0, 0.0, 0.0)}, (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ("keyed", {}, None, None),
    ],
)
def test_depths_are_those_of_the_bench_unless_they_are_named(
    goal: Any, fields: dict[str, Any], plane: Any, wanted: Any
) -> None:
    request = CaptureRequest(goal=goal, **fields)
    rig = config(rig={"arrangement": "off-axis", "plane": plane})
    assert add_bench_plane(request, rig).plane == wanted
    assert (request.goal in OFF_AXIS_GOALS) == (goal != "white")
    if request.goal in OFF_AXIS_GOALS:
        with pytest.raises(RequestError, match="off the projector's axis"):
            add_bench_plane(request, Config())
    else:
        assert add_bench_plane(request, Config()) is request


def test_depths_that_are_named_otherwise_leave_the_plane_of_the_bench() -> None:
    rig = config(rig={"arrangement": "off-axis", "plane": (0.5, 0.0, 0.0)})
    named: Any = {"file": "x"}
    for field in ("disparities", "warp"):
        request = msgspec.structs.replace(CaptureRequest(goal="keyed"), **{field: named})
        assert add_bench_plane(request, rig) is request


@pytest.mark.parametrize(
    ("lag", "jitter", "names"),
    [
        (None, 0.0, ("full",)),
        (0.0, 0.0, ("none", "both", "lag", "full")),
        (0.0, 0.01, ("both", "full")),
        (0.04, 0.01, ("both", "lag", "full")),
        (0.039, 0.01, ("both", "full")),
        (1.0, 0.0, ("lag", "full")),
        (0.96, 0.01, ("lag", "full")),
        (0.97, 0.01, ("full",)),
        (-0.96, 0.01, ("lead", "full")),
        (-0.04, 0.01, ("both", "lead", "full")),
        (-1.0, 0.0, ("lead", "full")),
        (1.01, 0.0, ("full",)),
        (-1.01, 0.0, ("full",)),
    ],
)
def test_schedules_bear_a_lag_up_to_their_edges(
    lag: float | None, jitter: float, names: tuple[str, ...]
) -> None:
    assert list_tolerant_schedules(lag, jitter) == names


@pytest.mark.parametrize(
    ("asked", "apart", "blur", "window"),
    [
        ("auto", 0.001, 0.0, "whole"), ("auto", 0.0011, 0.0, "quarter"),
        ("auto", 0.0005, 0.0003, "whole"), ("auto", 0.0005, 0.0004, "quarter"),
        ("whole", 5.0, 5.0, "whole"), ("quarter", 0.25, 0.0, "quarter"),
        ("quarter", 0.26, 0.0, None), ("side-7/8", 0.0625, 0.0, "side-7/8"),
        ("side-7/8", 0.07, 0.0, None),
    ],
)  # fmt: skip
def test_windows_cover_what_the_panels_are_apart(
    asked: str, apart: float, blur: float, window: str | None
) -> None:
    if window is None:
        hint = "fewer, larger cells" if asked == "quarter" else "smaller window"
        with pytest.raises(ConfigError, match="misregistration") as caught:
            choose_window(asked, apart, blur)
        assert hint in str(caught.value.hint)
    else:
        assert choose_window(asked, apart, blur) == window


def test_a_lag_is_in_rows_and_not_always_needed() -> None:
    found = config(mask={"jitter_s": 3e-4}, projector={"jitter_s": 4e-4})
    for given, wanted_rows in ((None, None), (-0.005, pytest.approx(-0.3))):
        lag, jitter = convert_lag_to_rows(found, given)
        assert lag == wanted_rows and jitter == pytest.approx(0.03)
    cases: Any = (
        (None, "auto", True), (None, "full", False), ("auto", "full", True), (True, "auto", False),
    )  # fmt: skip
    for asked, default, wanted in cases:
        request = CaptureRequest(goal="white", guards=asked)
        assert is_lag_needed(request, config(schedule={"guards": default})) is wanted


BITS = (np.zeros((2, 3), np.uint8), np.zeros((2, 3), np.float32))


@pytest.mark.parametrize(
    ("pair", "names"),
    [((0, 0), ()), ((1, 0), ("projector",)), ((0, 1), ("mask",)), ((1, 1), ("projector", "mask"))],
)
def test_grey_levels_are_told_of_the_panels_that_show_them(
    pair: tuple[int, int], names: tuple[str, ...]
) -> None:
    pairs: Any = [(BITS[0], BITS[0]), tuple(BITS[n] for n in pair)]
    assert find_grey_panels(pairs) == names
    assert [*explain_grey_levels(pairs, Config())] == []  # a mock bench is as it is described
    tables = {name: {"gamma": 2.2} for name in ("projector", "mask")}
    told = [*explain_grey_levels(pairs, config(**tables))]
    assert len(told) == len(names) and all("gamma 2.2" in line for line in told)
    hidden = msgspec.structs.replace(Config(), bench=BenchConfig(truth="x.toml"))
    assert not is_mock_as_configured(hidden) and is_mock_as_configured(Config())
    told = [*explain_grey_levels(pairs, hidden)]
    assert len(told) == len(names)
    assert all(
        "not known" in line and f"the {n}" in line for n, line in zip(names, told, strict=True)
    )


@pytest.mark.parametrize(
    ("codes", "p", "wanted"),
    [
        (128, 0.5, 128), (128, 0.25, 256), (64, 0.125, 256), (128, 0.3, 210), (100, 0.07, 700),
        (8, 0.3, 10), (4, 0.9, 2), (1, 0.9, 1),
    ],
)  # fmt: skip
def test_as_many_codes_as_are_equally_bright(codes: int, p: float, wanted: int) -> None:
    """The nearest number to codes / (2 p) of which a share p is a whole number, if one is near."""
    found = scale_code_count(codes, CaptureRequest(goal="fraction", p=p))
    assert found == wanted
    rule = codes / (2.0 * p)
    near = [n for n in range(1, 2000) if abs(p * n - round(p * n)) < 1e-6 and round(p * n) >= 1]
    best = min(near, key=lambda n: abs(n - round(rule)))
    if abs(best - round(rule)) <= int(0.25 * rule):
        assert abs(found - round(rule)) == abs(best - round(rule))


@pytest.mark.parametrize(
    "fields", [{"goal": "fraction"}, {"goal": "indirect", "p": 0.5}, {"goal": "white", "p": 0.5}]
)
def test_equal_brightness_is_for_shares_alone(fields: dict[str, Any]) -> None:
    with pytest.raises(RequestError, match="share p"):
        scale_code_count(64, CaptureRequest(**fields))


def test_light_of_codes_is_the_mean_of_products() -> None:
    primal = np.packbits(np.array([[1, 1, 1, 1], [1, 0, 0, 0]], np.bool_), axis=1)
    dual = np.packbits(np.array([[1, 1, 0, 0], [1, 1, 1, 1]], np.bool_), axis=1)
    assert average_pair_light((primal, dual), 4) == pytest.approx((1.0 * 0.5 + 0.25 * 1.0) / 2)
