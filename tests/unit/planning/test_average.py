"""How often everything is shown because of the noise of ambient light, and by what plan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import CameraInfo
from pdcd.bench.placed import compute_mock_frame
from pdcd.bench.tables import Config
from pdcd.planning.average import (
    MOST_EXPOSURES,
    MOST_S,
    NOISE,
    extend_for_noise,
    predict_plan_noise,
)
from pdcd.planning.look import with_black_exposures
from pdcd.planning.make import make_plan, plan_request
from pdcd.planning.plan import Plan
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.parts import derive_part_seed
from pdcd.watch import Watch
from tests.unit.planning.test_measured import config

GRID = (6, 8)
LEAKS = LeakErrors(ambient=5.0, mask=0.0, both=5.0, floor=1e-4, limit=0.01, raw=())


def camera(file_s: float = 0.0) -> CameraInfo:
    return CameraInfo("", "", "modern", np.ones(3), (100,), (), readout_s=file_s)


def asked(**fields: Any) -> CaptureRequest:
    return CaptureRequest(**{"goal": "indirect", "window": "whole", "white": False, **fields})


def plan_of(**fields: Any) -> Plan:
    return with_black_exposures(make_plan(asked(**fields), Config(), GRID), LEAKS, Config(), ())


def shown(plan: Plan, noise: float, file_s: float = 0.0, rig: Config | None = None) -> Any:
    rig = rig or Config()
    return extend_for_noise(plan, noise, asked(), rig, camera(file_s), Watch())


def test_a_picture_that_is_quiet_enough_stays_as_planned() -> None:
    plan = plan_of(codes=64, parts=4)
    after, text, enough = shown(plan, NOISE)
    assert (after.recipe, after.how, text, enough) == (plan.recipe, plan.how, "", True)
    assert after.patterns is plan.patterns and after.reasons == plan.reasons
    assert after.leaks is not None and (after.leaks.noise, after.leaks.times) == (NOISE, 1)


@pytest.mark.parametrize(("noise", "times"), [(1.01, 2), (1.41, 2), (2.0, 4), (2.01, 5)])
def test_parts_become_more_parts_with_codes_of_their_own(noise: float, times: int) -> None:
    plan = plan_of(codes=64, parts=4)
    after, text, enough = shown(plan, noise * NOISE)
    assert enough and (after.how.parts, after.how.codes) == (4 * times, 64 * times)
    assert len(after.recipe.shots) == times * len(plan.recipe.shots)
    assert after.leaks is not None and after.leaks.times == times
    assert after.leaks.noise == pytest.approx(noise * NOISE / math.sqrt(times))
    assert after.leaks.noise <= NOISE and after.reasons[-1] == text
    assert f"{times} times as many exposures, which are {4 * times} of codes" in text
    # Those that may have been shown stay; no others are the same.
    coded = {name: pair[0].tobytes() for name, pair in after.patterns.items()}
    for name, pair in plan.patterns.items():
        assert after.patterns[name] is pair
    assert len(coded) == 4 * times == len(set(coded.values()))
    assert after.summary().raw_files == 2 * 4 * times


@pytest.mark.parametrize("seed", [0, 1, 7])
@pytest.mark.parametrize(("parts", "times"), [(4, 2), (6, 10), (7, 16)])
def test_no_part_has_the_seed_of_another(seed: int, parts: int, times: int) -> None:
    first = [derive_part_seed(seed, parts, part) for part in range(1, parts + 1)]
    more = [derive_part_seed(seed, parts * times, p) for p in range(parts + 1, parts * times + 1)]
    assert len({*first, *more}) == parts * times


@pytest.mark.parametrize(("times", "parts", "repeat"), [(2, 1, 2), (3, 1, 3), (4, 4, 1), (9, 9, 1)])
def test_one_exposure_is_repeated_or_taken_in_parts_as_long(
    times: int, parts: int, repeat: int
) -> None:
    plan = plan_of(codes=64)
    after, text, _ = shown(plan, math.sqrt(times - 0.5) * NOISE)
    assert (after.how.parts, after.how.repeat) == (parts, repeat)
    assert after.how.coded == 64 * parts and f"are {times} of codes" in text
    lit = [shot for shot in after.recipe.shots if not shot.primal_black]
    assert len(lit) == times
    assert all(after.refreshes(shot) == plan.refreshes(plan.recipe.shots[0]) for shot in lit)


def test_all_photos_of_an_answer_are_repeated() -> None:
    plan = plan_of(goal="direct", codes=64, parts=4, white=True)
    after, _, _ = shown(plan, 1.7 * NOISE)
    assert (after.how.parts, after.how.repeat) == (4, 3)
    for photo in plan.recipe.photos:
        more = next(p for p in after.recipe.photos if p.name == photo.name)
        assert len(more.shots) == 3 * len(photo.shots)
    assert after.patterns is plan.patterns


def test_exposures_seconds_and_memory_are_bounded() -> None:
    plan = plan_of(codes=64, parts=4)
    after, text, enough = shown(plan, 1.0)
    assert after.how.parts == MOST_EXPOSURES and not enough
    assert "darken the room" in text and after.leaks is not None
    assert after.leaks.noise == pytest.approx(1.0 / math.sqrt(MOST_EXPOSURES / 4))
    once = plan.summary().seconds
    slow, _, enough = shown(plan, 1.0, file_s=20.0)
    times = slow.how.parts // 4
    lag_s = Config().trigger.lag_s
    assert 1 < times < MOST_EXPOSURES // 4 and not enough
    assert (times - 1) * (once + 8 * (20.0 + lag_s)) <= MOST_S
    assert times * (once + 8 * (20.0 + lag_s)) > MOST_S
    never, text, enough = shown(plan, 1.0, file_s=1000.0)
    assert never.how == plan.how and not enough and "darken the room" in text
    # Half of the limit holds samples and 16 codes of 48 cells of 12 parts and their black ones.
    rows, cols = compute_mock_frame(Config(), GRID)
    kept = 24 * (16 * 16 * 48 + 9 * rows * cols)
    found, _, enough = shown(plan, 1.0, rig=config(limits={"work_bytes": 2 * kept}))
    assert found.how.parts == 12 and not enough
    found, _, _ = shown(plan, 1.0, rig=config(limits={"work_bytes": 2 * kept - 1}))
    assert found.how.parts == 8


@pytest.mark.parametrize("parts", [1, 4])
def test_noise_falls_with_the_light_that_is_still_to_come(parts: int) -> None:
    plan = plan_of(codes=64, parts=parts)
    first = plan.recipe.shots[0].name
    assert predict_plan_noise(plan, {"coded": 0.04}, plan, [first]) == pytest.approx(
        0.2 / math.sqrt(parts)
    )
    # What was taken by another plan, of half as many codes in all.
    other = plan_of(codes=32)
    got = predict_plan_noise(plan, {"coded": 0.04}, other, ["coded"])
    assert got == pytest.approx(0.2 / math.sqrt(2.0))
    assert predict_plan_noise(plan, {}, plan, [first]) == 0.0


@pytest.mark.parametrize(
    ("fields", "noise", "averages"),
    [
        ({}, "full", True), ({"goal": "direct"}, "full", True), ({}, "none", False),
        ({"codes": 64}, "full", False), ({"parts": 4}, "full", False),
        ({"repeat": 2}, "full", False), ({"black_level": "ambient"}, "full", False),
        ({"goal": "long-range", "radius": 2}, "full", False),
    ],
)  # fmt: skip
def test_plain_requests_alone_are_shown_more_often(
    fields: dict[str, Any], noise: str, averages: bool
) -> None:
    rig = config(camera={"noise": noise})
    request = CaptureRequest(**{"goal": "indirect", "window": "whole", **fields})
    plan = plan_request(request, rig, GRID, camera(), 0.0)
    plans = [plan] if plan.otherwise is None else [plan, plan.otherwise]
    assert [p.look is not None and p.look.average for p in plans] == [averages] * len(plans)
    said = [any("more light" in reason for reason in p.reasons) for p in plans]
    assert said == [averages] * len(plans)
