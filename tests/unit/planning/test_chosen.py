"""The planner's choice against all plans that it may choose from, tried one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import CameraConfig, LimitsConfig, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.errors import RequestError
from pdcd.planning.choose import PlanChoice, choose_plan
from pdcd.planning.code_counts import LADDER, MOST_REPEATS
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.guess import ScenePrior, guess_plan
from pdcd.planning.make import make_plan
from pdcd.planning.outlook import ErrorEstimate, PlanForecast, RigSetting
from pdcd.planning.plan import Plan
from pdcd.planning.rehearse import simulate_plan
from pdcd.protocol.request import CaptureRequest
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.scene import Scene
from pdcd.watch import Watch
from pdcd.words import ScheduleName
from tests import bench_rig

GRID = (6, 8)
SCENE = Scene("small", GRID, split_into_effects(bench_rig.transport(GRID)))
MOST_S = 3.0


def setting(folder: Path, **tables: Any) -> RigSetting:
    panels = {name: PanelConfig(size_px=(1600, 1200)) for name in ("projector", "mask")}
    given: dict[str, Any] = {
        "camera": CameraConfig(noise="full"),
        "limits": LimitsConfig(min_free_bytes=0, max_exposure_s=MOST_S),
        **panels,
        **tables,
    }
    config = bench_rig.config(folder, **given)
    engine = Engine.from_config(config)
    rig = engine._rig
    return RigSetting(config, rig.look_at_camera(), engine._profile, 0.0)


def request_of(**fields: Any) -> CaptureRequest:
    return msgspec.convert({"goal": "indirect", "window": "whole", **fields}, CaptureRequest)


@dataclass(frozen=True)
class Tried:
    """One plan with its figures."""

    plan: Plan
    estimate: ErrorEstimate
    iso: int
    seconds: float

    def bound(self, confidence: float) -> float:
        return self.estimate.bound(confidence, self.plan.how.repeat)


def seconds_of(plan: Plan) -> float:
    return sum(plan.exposure_s(shot) for shot in plan.recipe.shots)


def tries(
    request: CaptureRequest,
    rig: RigSetting,
    scene: Scene | None,
    schedules: tuple[ScheduleName, ...],
    counts: tuple[int, ...] = LADDER,
) -> Iterator[Tried]:
    """All plans without a pilot whose exposures are short enough and fill no sample."""
    bare = msgspec.structs.replace(
        request, error=None, seconds=None, confidence=None, black_level="none"
    )
    for count in counts:
        for schedule in schedules:
            asked = msgspec.structs.replace(bare, codes=count, guards=schedule)
            try:
                plan = make_plan(asked, rig.config, GRID)
            except RequestError:
                continue
            outlook: PlanForecast = (
                guess_plan(plan, rig, ScenePrior())
                if scene is None
                else simulate_plan(plan, rig, scene, normalise="auto", seed=request.seed)
            )
            for iso in rig.isos:
                once = outlook.judge(iso, 1)
                for passes in (1, 2, 4, 8, 16):
                    longest = max(plan.exposure_s(shot) for shot in plan.recipe.shots)
                    if passes > max(1.0, once.headroom) or longest * passes > MOST_S:
                        break
                    estimate = outlook.judge(iso, passes)
                    for repeat in range(1, MOST_REPEATS + 1):
                        whole = plan.scaled(passes, repeat)
                        if not estimate.saturates:
                            yield Tried(whole, estimate, iso, seconds_of(whole))
                if once.headroom < 2.0:
                    break


def same(found: PlanChoice, best: Tried) -> None:
    """The same plan in all its parts."""
    plan = found.plan
    assert (plan.how.codes, plan.schedule, plan.passes, plan.how.repeat, found.iso) == (
        best.plan.how.codes,
        best.plan.schedule,
        best.plan.passes,
        best.plan.how.repeat,
        best.iso,
    )
    assert found.seconds == pytest.approx(best.seconds) == pytest.approx(seconds_of(plan))


@pytest.mark.parametrize("error", [0.2, 0.03, 0.012])
def test_a_wanted_error_is_met_in_the_shortest_time(tmp_path: Path, error: float) -> None:
    rig = setting(tmp_path)
    request = request_of(error=error)
    found = choose_plan(request, rig, GRID, None)
    every = list(tries(request, rig, None, ("none",)))
    best = min((t for t in every if t.bound(0.95) <= error), key=lambda t: t.seconds)
    same(found, best)
    told = found.plan.prediction
    assert told is not None and told.bound <= error
    assert told.bound == pytest.approx(best.bound(0.95))
    assert told.error == pytest.approx(best.estimate.error(best.plan.how.repeat))
    assert told.code == best.estimate.code
    assert told.sensor == pytest.approx(best.estimate.sensor / best.plan.how.repeat**0.5)
    assert (told.confidence, told.iso) == (0.95, best.iso)
    assert told.prior == str(ScenePrior()) and found.plan.iso == best.iso
    assert found.plan.look is not None and found.plan.look.limit == error


@pytest.mark.parametrize("seconds", [1.0, 3.0, 20.0])
def test_a_given_time_is_spent_on_the_smallest_error(tmp_path: Path, seconds: float) -> None:
    rig = setting(tmp_path)
    request = request_of(seconds=seconds, confidence=None)
    found = choose_plan(request, rig, GRID, None)
    every = list(tries(request, rig, None, ("none",)))
    best = min((t for t in every if t.seconds <= seconds), key=lambda t: t.bound(0.95))
    assert found.seconds <= seconds
    prediction = found.plan.prediction
    assert prediction is not None and prediction.bound <= 1.01 * best.bound(0.95)
    assert found.plan.look is not None and not found.plan.look.may_add


@pytest.mark.parametrize(
    "camera",
    [
        CameraConfig(noise="full", f_number=8.0),
        CameraConfig(noise="full", f_number=16.0),
        CameraConfig(noise="full"),
    ],
)
def test_passes_and_gain_fill_the_sensor_before_exposures_are_repeated(
    tmp_path: Path, camera: CameraConfig
) -> None:
    """Before a scene that is known, at apertures that leave light to spare."""
    rig = setting(tmp_path, camera=camera)
    counts = LADDER[:4]
    request = request_of(goal="fraction", p=0.5, error=0.02, confidence=0.9, guards="lag")
    found = choose_plan(request, rig, GRID, SCENE)
    every = list(tries(request, rig, SCENE, ("lag",), counts))
    fitting = [t for t in every if t.bound(0.9) <= 0.02]
    assert found.plan.prediction is not None and found.plan.prediction.bound <= 0.02
    assert found.plan.prediction.prior == "scene small"
    assert found.plan.prediction.confidence == 0.9
    if fitting:
        best = min(fitting, key=lambda t: t.seconds)
        assert found.seconds <= best.seconds * (1.0 + 1e-9)
    if found.plan.how.codes in counts:
        same(found, min(fitting, key=lambda t: t.seconds))


def test_every_schedule_that_keeps_codes_apart_is_looked_at(tmp_path: Path) -> None:
    slow = {
        name: PanelConfig(size_px=(1600, 1200), rise_s=0.001, fall_s=0.002)
        for name in ("projector", "mask")
    }
    rig = setting(tmp_path, **slow)
    request = request_of(error=0.1)
    found = choose_plan(request, rig, GRID, None)
    every = list(tries(request, rig, None, ("none", "both", "lag", "full")))
    same(found, min((t for t in every if t.bound(0.95) <= 0.1), key=lambda t: t.seconds))
    asked = choose_plan(request_of(error=0.1, guards="full"), rig, GRID, None)
    assert asked.plan.schedule == "full" and asked.seconds >= found.seconds


def test_the_watch_hears_of_all_that_is_looked_at(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    heard: list[tuple[float, float]] = []
    watch = Watch(step=lambda done, total: heard.append((done, total)))
    choose_plan(request_of(error=0.1), rig, GRID, None, watch=watch)
    assert heard and heard[-1][0] == pytest.approx(heard[-1][1])
    # More often than a ladder of codes ends: it is told of each number of codes.
    assert len({done for done, _ in heard}) > 2 * heard[-1][1]
    assert watch.stage == "codes"
    assert [done for done, _ in heard] == sorted(done for done, _ in heard)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"error": 1e-6}, r"0\.0001 % cannot be had: \d+ codes, 64 times, leave .* within 3 s"),
        ({"seconds": 0.05}, r"no plan fits into 0\.05 s: the shortest plan takes 0\."),
    ],
)
def test_what_cannot_be_had_is_told_with_what_can(
    tmp_path: Path, fields: dict[str, Any], words: str
) -> None:
    rig = setting(tmp_path)
    with pytest.raises(RequestError, match=words) as caught:
        choose_plan(request_of(**fields), rig, GRID, None)
    hint = str(caught.value.hint)
    if "error" in fields:
        reachable = float(hint.split()[2]) / 100.0
        found = choose_plan(request_of(error=reachable), rig, GRID, None)
        assert found.plan.prediction is not None
        assert reachable / 1.2 <= found.plan.prediction.bound <= reachable
    else:
        assert hint == "give more time, or leave the white shot out"


@pytest.mark.parametrize(
    ("fields", "families"),
    [
        ({}, {"hadamard"}),
        ({"family": "bernoulli"}, {"bernoulli"}),
        ({"goal": "fraction", "p": 0.3, "family": None}, {"balanced"}),
        ({"goal": "fraction", "p": 0.5}, {"hadamard"}),
    ],
)
def test_codes_are_of_a_family_that_can_be_lit_so_often(
    tmp_path: Path, fields: dict[str, Any], families: set[str]
) -> None:
    rig = setting(tmp_path)
    found = choose_plan(request_of(error=0.3, **fields), rig, GRID, None)
    assert {found.plan.family} == families
    if found.plan.family == "balanced":
        assert found.plan.how.codes % 10 == 0  # three of ten are lit


def test_shares_of_lines_come_in_whole_planes(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    request = request_of(goal="fraction", p=0.2, family="singer", error=0.5)
    found = choose_plan(request, rig, GRID, None)
    assert found.plan.family == "singer" and found.plan.how.codes % 21 == 0


@pytest.mark.parametrize("goal", ["long-range", "diagonal"])
def test_an_unknown_scene_tells_nothing_of_single_paths(tmp_path: Path, goal: str) -> None:
    rig = setting(tmp_path)
    fields: dict[str, Any] = {"radius": 1} if goal == "long-range" else {}
    with pytest.raises(RequestError, match=f"goal {goal} cannot be foreseen") as caught:
        choose_plan(request_of(goal=goal, error=0.1, **fields), rig, GRID, None)
    assert "transport matrix as prior" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"confidence": 0.9}, "confidence goes with a wanted error only"),
        ({"error": 0.1, "seconds": 3.0}, "an error and a time are both asked for"),
        ({"error": 0.1, "codes": 8, "repeat": 2}, "codes and repeat and error are both"),
        ({"seconds": 3.0, "parts": "auto"}, "parts and seconds are both asked for"),
        ({"error": 0.1, "equal_brightness": True}, "equal_brightness and error"),
        ({"error": 0.1, "pilot": "auto"}, "pilot and error are both"),
        ({"seconds": 3.0, "family": "confocal"}, "seconds is for coded photos"),
        ({"error": 0.1, "method": "multi-image"}, "error is for coded photos"),
    ],
)
def test_what_decides_twice_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(RequestError, match=words) as caught:
        is_search_needed(request_of(**fields))
    assert caught.value.hint


@pytest.mark.parametrize(
    ("fields", "wanted"),
    [
        ({}, False),
        ({"codes": 8}, False),
        ({"error": 0.1}, True),
        ({"seconds": 3.0, "pilot": 0}, True),
        ({"error": 0.1, "confidence": 0.6, "family": "balanced", "seed": 3}, True),
    ],
)
def test_an_error_or_a_time_leaves_the_rest_open(fields: dict[str, Any], wanted: bool) -> None:
    assert is_search_needed(request_of(**fields)) is wanted
