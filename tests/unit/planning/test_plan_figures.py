"""Figures of plans: refreshes, seconds, light and files, counted by hand."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.bench.tables import Config
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan, is_windowed
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.recipe import Shot

GRID = (6, 8)
LIGHT = np.linspace(0.1, 1.0, 48).reshape(GRID).tolist()


def plan_of(rig: Config | None = None, **fields: Any) -> Plan:
    whole = {"goal": "indirect", "codes": 8, "window": "whole", **fields}
    return make_plan(msgspec.convert(whole, CaptureRequest), rig or Config(), GRID)


def shot_of(plan: Plan, name: str) -> Shot:
    return next(shot for shot in plan.recipe.shots if shot.name == name)


@pytest.mark.parametrize(
    ("fields", "name", "rows"),
    [
        ({}, "coded", 24),
        ({"guards": "lag"}, "coded", 16),
        ({"guards": "none"}, "coded", 8),
        ({"window": "quarter"}, "coded", 96),
        ({"exposure_s": 0.8}, "coded", 48),
        ({"codes": 16, "parts": 2}, "coded-2", 24),
        ({"codes": 32, "pilot": 16}, "pilot-0003", 3),
        ({"codes": 32, "pilot": 16}, "coded", 48),
        # A single exact pair is shown as often as codes would be.
        ({"illumination": LIGHT}, "white", 24),
        ({"illumination": LIGHT, "exposure_s": 0.8}, "white", 48),
        ({"goal": "white"}, "white", 24),
    ],
)
def test_refreshes_of_a_shot(fields: dict[str, Any], name: str, rows: int) -> None:
    plan = plan_of(**fields)
    shot = shot_of(plan, name)
    assert plan.refreshes(shot) == rows == len(plan.frames(shot))
    assert plan.exposure_s(shot) == pytest.approx(rows / 60.0 + 2.0 * 0.05)
    assert plan.exposure_s(shot) == pytest.approx(rows / 60.0 + 2.0 * plan.settle_s)


def test_an_exact_sequence_is_shown_at_least_once() -> None:
    plan = plan_of(goal="transport", codes=8)
    shot = plan.recipe.shots[0]
    assert shot.only is not None and len(plan.patterns[shot.program][0]) > 16
    assert plan.passes_of(shot) == 1 and plan.pairs_of(shot) == 1
    lit = plan_of(illumination=LIGHT, codes=12)
    white = shot_of(lit, "white")
    assert (lit.pairs_of(white), lit.passes_of(white)) == (1, 12)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_frames_of_a_test_exposure_are_the_first_pairs_once(window: str) -> None:
    plan = plan_of(window=window, exposure_s=3.2)
    fields = 1 if window == "whole" else 4
    coded = shot_of(plan, "coded")
    test, whole = plan.sequence(coded).frames(3), plan.frames(coded)
    assert len(test) == 3 * 3 * fields and len(whole) == plan.refreshes(coded)
    assert len(test.primal_patterns) == 3
    assert np.array_equal(test.primal_patterns, plan.patterns["coded"][0][:3])
    assert np.array_equal(test.dual_patterns, plan.patterns["coded"][1][:3])
    assert test.window == window


def test_a_single_code_of_a_pilot_is_its_own_pattern() -> None:
    plan = plan_of(codes=32, pilot=16)
    for n in (0, 5, 15):
        frames = plan.frames(shot_of(plan, f"pilot-{n + 1:04d}"))
        assert np.array_equal(frames.primal_patterns, plan.patterns["pilot"][0][n : n + 1])


def test_windows_are_for_codes_on_the_mask_alone() -> None:
    plan = plan_of(codes=32, pilot=16, window="quarter")
    assert plan.window_of(shot_of(plan, "white")) == "whole"
    assert plan.window_of(shot_of(plan, "pilot-0001")) == "whole"
    assert plan.window_of(shot_of(plan, "coded")) == "quarter"
    assert [is_windowed(plan.recipe.programs[name]) for name in ("pilot", "coded")] == [False, True]
    lit = plan_of(illumination=LIGHT)
    assert not is_windowed(lit.recipe.programs["white"])


def test_light_is_what_both_panels_let_through_in_a_third_of_the_refreshes() -> None:
    plan = plan_of(black_level="both")
    assert plan.light_share(shot_of(plan, "white")) == pytest.approx(1 / 3)
    coded = shot_of(plan, "coded")
    lit = np.unpackbits(np.asarray(plan.patterns["coded"][0]).astype(np.uint8), axis=1, count=48)
    share = lit.mean(axis=1)
    kept = float(np.mean(share * (1.0 - share)))
    assert plan.light_share(coded) == pytest.approx(kept / 3)
    for name in ("coded-black-primal", "coded-black-dual", "white-black-dual"):
        assert plan.light_share(shot_of(plan, name)) == 0.0
    quarter = plan_of(window="quarter", guards="none")
    lit = np.unpackbits(np.asarray(quarter.patterns["coded"][0]).astype(np.uint8), axis=1, count=63)
    share = lit.mean(axis=1)
    wanted = float(np.mean(share * (1.0 - share))) / 4
    assert quarter.light_share(shot_of(quarter, "coded")) == pytest.approx(wanted)


def test_a_plan_of_more_exposures_shows_the_same_codes() -> None:
    plan = plan_of()
    found = plan.repeated(4)
    assert found.how.repeat == 4 and found.patterns is plan.patterns
    assert len(found.recipe.shots) == 5  # the white photo is only shown beside the answer
    told = found.summary()
    assert [shot.exposures for shot in told.shots] == [1, 4]
    assert [shot.exposures for shot in plan.summary().shots] == [1, 1]
    assert [shot.codes for shot in told.shots] == [0, 8]
    white, coded = told.shots
    assert told.refreshes == white.refreshes + 4 * coded.refreshes
    assert told.seconds == pytest.approx(white.exposure_s + 4 * coded.exposure_s)
    assert told.raw_files == 5


def test_a_summary_tells_of_a_pilot_once() -> None:
    plan = plan_of(codes=32, pilot=16, black_level="none")
    told = plan.summary()
    assert [(s.name, s.exposures, s.codes, s.refreshes) for s in told.shots] == [
        ("white", 1, 0, plan.refreshes(shot_of(plan, "white"))),
        ("pilot-0001", 16, 1, 3),
        ("coded", 1, 16, 48),
    ]
    assert told.refreshes == told.shots[0].refreshes + 16 * 3 + 48
    assert told.raw_files == 18 and told.pilot == 16 and told.codes == 32
    assert told.light_share == plan.light_share(shot_of(plan, "coded"))
    assert (told.goal, told.family, told.p, told.grid) == ("indirect", "hadamard", 0.5, GRID)
    assert (told.window, told.schedule, told.guards, told.parts) == ("whole", "full", True, 1)
    assert told.black_level == "none"
    assert not plan_of(guards="none").summary().guards


def test_the_light_of_single_codes_speaks_for_photos_that_are_sums_of_them() -> None:
    plan = plan_of(goal="direct", method="multi-image")
    told = plan.summary()
    assert [(s.name, s.exposures) for s in told.shots] == [("photo-0001", 8)]
    assert told.light_share == plan.light_share(shot_of(plan, "photo-0001"))
    whole = plan_of(codes=16, pilot=16).summary()
    assert whole.light_share == whole.shots[-1].light_share


@pytest.mark.parametrize("repeat", [1, 3])
def test_photos_of_a_slice_count_as_often_as_each_is_taken(repeat: int) -> None:
    plan = plan_of(goal="transport", rows=(2, 2), repeat=repeat)
    told = plan.summary()
    (shot,) = told.shots
    assert shot.exposures == told.raw_files == len(plan.recipe.shots) == 15 * repeat
    assert told.seconds == pytest.approx(sum(map(plan.exposure_s, plan.recipe.shots)))
    assert told.refreshes == sum(map(plan.refreshes, plan.recipe.shots))


@settings(max_examples=50)
@given(
    goal=st.sampled_from(["white", "indirect", "direct"]),
    codes=st.sampled_from([2, 4, 12, 16]),
    window=st.sampled_from(["whole", "quarter"]),
    guards=st.booleans(),
    black_level=st.sampled_from(["none", "mask", "ambient", "both"]),
    white=st.booleans(),
)
def test_every_plan_adds_up(**fields: Any) -> None:
    plan = make_plan(msgspec.convert(fields, CaptureRequest), Config(), (3, 4))
    summary = plan.summary()
    assert summary.refreshes == sum(len(plan.frames(s)) for s in plan.recipe.shots)
    assert summary.seconds == pytest.approx(sum(s.exposure_s for s in summary.shots))
    assert 0.0 < summary.light_share <= 1.0
    assert summary.raw_files == len(plan.recipe.shots)
