"""The planner by wanted error or time: what it refuses, and what it settles on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import CameraConfig, LimitsConfig, PanelConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.cli.main import main
from pdcd.errors import RequestError
from pdcd.planning.choose import choose_plan
from pdcd.planning.code_counts import LADDER, MOST_REPEATS, list_code_counts
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.given import read_request_arrays
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan
from pdcd.planning.predict import (
    PhotoCodes,
    PredictedError,
    RigSetting,
    guess_scene_light,
    predict_error,
)
from pdcd.protocol.plan_summary import PlanSummary, Prediction
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig
from tests.bench_rig import from_path
from tests.places import DATA

NOISY = CameraConfig(noise="full", readout_s=0.5)
MIRROR = str(DATA / "mirror_32x24.npz")
GRID = (6, 8)
MOST_S = 3.0


def setting(folder: Path, **tables: Any) -> RigSetting:
    panels = {name: PanelConfig(size_px=(1600, 1200)) for name in ("projector", "mask")}
    limits = LimitsConfig(min_free_bytes=0, max_exposure_s=MOST_S)
    given: dict[str, Any] = {"camera": NOISY, "limits": limits, **panels, **tables}
    config = bench_rig.config(folder, **given)
    engine = Engine.from_config(config)
    return RigSetting(config, engine._rig.look_at_camera(), engine._profile, 0.0)


def request_of(**fields: Any) -> CaptureRequest:
    return msgspec.convert({"goal": "indirect", "window": "whole", **fields}, CaptureRequest)


def seconds_of(plan: Plan) -> float:
    return sum(plan.exposure_s(shot) for shot in plan.recipe.shots)


def told_of(plan: Plan) -> Prediction:
    assert plan.prediction is not None
    return plan.prediction


def every_plan(rig: RigSetting, goal: str) -> list[tuple[int, int, float, int, PredictedError]]:
    """Codes, exposures, seconds, files and error of all plans the limits allow, one by one, of
    exposures with the same codes or, of 16 and more, with their own."""
    found: list[tuple[int, int, float, int, PredictedError]] = []
    for count in LADDER:
        try:
            once = make_plan(
                request_of(goal=goal, codes=count, pilot=0, parts=1), rig.config, GRID, 0.0
            )
        except RequestError:
            return found
        longest_s = max(once.exposure_s(shot) for shot in once.recipe.shots)
        for exposures in range(1, MOST_REPEATS + 1):
            split = goal == "indirect" and count >= 16 and exposures >= 4
            plan = once.repeated(exposures)
            codes = PhotoCodes(goal, "hadamard", 0.5, GRID, count, longest_s, 1.0, split=split)
            error = predict_error(codes, guess_scene_light(), rig, 100).repeated(exposures)
            shown = count * exposures if split else count
            found.append((shown, exposures, seconds_of(plan), len(plan.recipe.shots), error))
    return found


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"confidence": 0.9}, "confidence goes with a wanted error only"),
        ({"error": 0.1, "seconds": 9.0}, "an error and a time are both asked for"),
        ({"error": 0.1, "codes": 8, "repeat": 2}, "codes and repeat and error are both"),
        ({"error": 0.1, "pilot": 32}, "pilot and error are both"),
        ({"error": 0.1, "pilot": "auto"}, "pilot and error are both"),
        ({"seconds": 3.0, "parts": "auto"}, "parts and seconds are both asked for"),
        ({"seconds": 9.0, "exposure_s": 2.0}, "exposure_s"),
        ({"error": 0.1, "equal_brightness": True}, "equal_brightness and error"),
        ({"seconds": 9.0, "method": "nayar"}, "seconds is for coded photos"),
        ({"error": 0.1, "family": "isolation"}, "error is for coded photos"),
        ({"goal": "transport", "error": 0.1}, "its entries"),
        ({"goal": "transport", "seconds": 9.0}, "its entries"),
    ],
)
def test_what_decides_twice_is_refused(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(RequestError, match=what) as caught:
        is_search_needed(request_of(**fields))
    assert caught.value.hint


@pytest.mark.parametrize(
    ("error", "goal"), [(0.2, "indirect"), (0.006, "indirect"), (0.03, "direct")]
)
def test_a_wanted_error_is_met_in_the_shortest_time_with_files(
    tmp_path: Path, error: float, goal: str
) -> None:
    rig = setting(tmp_path)
    found = choose_plan(request_of(goal=goal, error=error), rig, GRID, None)
    fitting = [one for one in every_plan(rig, goal) if one[-1].bound(0.95) <= error]
    # A half second a file, and what its trigger takes.
    file_s = 0.5 + rig.config.trigger.lag_s
    codes, exposures, seconds, files, best = min(fitting, key=lambda one: one[2] + one[3] * file_s)
    how = found.how
    assert (how.codes, how.parts * how.repeat) == (codes, exposures)
    assert (how.parts > 1) == (goal == "indirect" and exposures >= 4 and codes >= 16 * exposures)
    # A white photo is shown once beside parts, and with every repetition of what it is part of.
    assert seconds_of(found) <= seconds + 1e-9 and len(found.recipe.shots) <= files
    told = told_of(found)
    assert told.bound == pytest.approx(best.bound(0.95)) and told.bound <= error
    assert (told.code, told.sensor) == pytest.approx((best.code, best.sensor))
    assert (told.confidence, told.iso, found.iso) == (0.95, 100, 100)
    assert told.prior == "guess: 50 paths, 30 % indirect, contrast 3"
    assert found.look is not None and found.look.limit == error and found.look.may_add


@pytest.mark.parametrize("seconds", [1.0, 20.0])
def test_a_given_time_is_spent_on_the_smallest_error(tmp_path: Path, seconds: float) -> None:
    rig = setting(tmp_path)
    found = choose_plan(request_of(seconds=seconds), rig, GRID, None)
    assert seconds_of(found) <= seconds
    fitting = [one[-1] for one in every_plan(rig, "indirect") if one[2] <= seconds]
    assert told_of(found).error == pytest.approx(min(error.error for error in fitting))
    assert found.look is not None and not found.look.may_add


def test_confidence_costs_light(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    low, high = (
        told_of(choose_plan(request_of(error=0.04, confidence=c), rig, GRID, None))
        for c in (0.5, 0.999)
    )
    assert low.bound == pytest.approx(low.error) and high.bound > high.error
    assert high.error < low.error


def test_parts_that_are_named_stay_and_may_end_early(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    named = choose_plan(request_of(error=0.05, parts=5), rig, GRID, None)
    assert named.how.parts == 5 and named.how.codes % 5 == 0 and named.how.repeat == 1
    early = choose_plan(request_of(error=0.2, until_error=0.1), rig, GRID, None)
    assert early.how.parts >= 4  # as nothing else tells when it is enough


def test_the_rest_is_as_the_request_has_it(tmp_path: Path) -> None:
    found = choose_plan(
        request_of(error=0.2, black_level="both", family="balanced", guards="lag"),
        setting(tmp_path), GRID, None,
    )  # fmt: skip
    assert (found.schedule, found.how.black_level, found.family) == ("lag", "both", "balanced")
    assert found.look is None and found.passes == 1 and found.how.pilot == 0


@pytest.mark.parametrize(
    ("fields", "family", "multiple"),
    [
        ({}, "hadamard", 4),
        ({"family": "bernoulli"}, "bernoulli", 1),
        ({"goal": "fraction", "p": 0.3}, "balanced", 10),
        ({"goal": "fraction", "p": 0.5}, "hadamard", 4),
        ({"goal": "fraction", "p": 0.2, "family": "singer"}, "singer", 21),
    ],
)
def test_codes_are_of_a_family_that_can_be_lit_so_often(
    tmp_path: Path, fields: dict[str, Any], family: str, multiple: int
) -> None:
    found = choose_plan(request_of(error=0.3, **fields), setting(tmp_path), GRID, None)
    assert found.family == family and found.how.codes % multiple == 0


@pytest.mark.parametrize(
    ("p", "family", "counts"),
    [
        (None, None, [8, 12, 16, 24, 32, 48]),
        (0.01, "balanced", [100, 200, 300, 400, 600, 800]),
        (1 / 9, "singer", [73, 146, 219, 292, 438, 584]),
    ],
)
def test_numbers_of_codes_are_tried_once_each(
    p: float | None, family: str | None, counts: list[int]
) -> None:
    found = list(list_code_counts(request_of(goal="fraction", p=p or 0.5, family=family)))
    assert found[:6] == counts and len(set(found)) == len(found)


def test_a_family_that_suits_no_number_of_codes_is_said(tmp_path: Path) -> None:
    asked = request_of(goal="fraction", p=0.3, family="hadamard", seconds=9.0)
    with pytest.raises(RequestError, match=r"no hadamard codes .* p = 0\.3") as caught:
        choose_plan(asked, setting(tmp_path), GRID, None)
    assert "family" in str(caught.value.hint)


def test_an_error_out_of_reach_is_refused_with_what_is_in_reach(tmp_path: Path) -> None:
    rig = setting(tmp_path)
    with pytest.raises(RequestError, match=r"0\.0001 % cannot be had: .*codes.*sensor") as caught:
        choose_plan(request_of(error=1e-6), rig, GRID, None)
    reachable = float(str(caught.value.hint).split()[2]) / 100.0
    assert told_of(choose_plan(request_of(error=reachable), rig, GRID, None)).bound <= reachable
    with pytest.raises(RequestError, match="cannot be had"):
        choose_plan(request_of(error=reachable / 1.2), rig, GRID, None)


def test_a_time_too_short_for_any_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"no plan fits into 0\.05 s: the shortest plan takes 0"):
        choose_plan(request_of(seconds=0.05), setting(tmp_path), GRID, None)


def test_limits_of_the_rig_are_kept(tmp_path: Path) -> None:
    brief = LimitsConfig(min_free_bytes=0, max_exposure_s=0.55)
    found = choose_plan(request_of(seconds=9.0), setting(tmp_path, limits=brief), GRID, None)
    assert max(found.exposure_s(shot) for shot in found.recipe.shots) <= 0.55
    none = LimitsConfig(min_free_bytes=0, max_exposure_s=0.15)
    with pytest.raises(RequestError, match=r"limit is 0\.15 s"):
        choose_plan(request_of(seconds=9.0), setting(tmp_path, limits=none), GRID, None)


@pytest.mark.parametrize(
    "fields", [{"goal": "long-range", "radius": 1}, {"goal": "diagonal"}, {"shift": (0, 1)}]
)
def test_no_formula_tells_the_error_of_other_goals(tmp_path: Path, fields: dict[str, Any]) -> None:
    with pytest.raises(RequestError, match="cannot be foreseen") as caught:
        choose_plan(request_of(error=0.1, **fields), setting(tmp_path), GRID, None)
    assert "number of codes" in str(caught.value.hint)


def test_a_prior_file_stands_for_the_scene(tmp_path: Path) -> None:
    rig, grid = setting(tmp_path, limits=LimitsConfig(min_free_bytes=0)), (24, 32)
    files = {"prior": from_path(Path(MIRROR))}
    asked, given = read_request_arrays(request_of(error=0.02), files, grid)
    known = choose_plan(asked, rig, grid, None, given=given)
    assert known.prior == told_of(known).prior == "file mirror_32x24.npz"
    scene = SceneConfig(kind="matrix", path=MIRROR)
    same = Engine.from_config(bench_rig.config(tmp_path, camera=NOISY, scene=scene)).plan(
        request_of(error=0.02)
    )
    assert known.how.coded < same.codes  # the codes avoid the paths of the prior
    with pytest.raises(RequestError, match="24 x 32 cells, the rig of 3 x 4"):
        choose_plan(asked, rig, (3, 4), None, given=given)


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["plan", "indirect", "--local", "--error", "0.03", "--confidence", "0.9"]
    file = tmp_path / "rig.toml"
    file.write_text('[scene]\nkind = "wax-disk"\ngrid = [12, 16]\n')
    assert main([*options, "--config", str(file)]) == 0
    table = capsys.readouterr().out
    assert "RMS error" in table and "scene wax-disk" in table and "with 90 %" in table
    assert main([*options, "--config", str(file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    summary = msgspec.convert(answer, PlanSummary)
    assert summary.prediction is not None and summary.prediction.bound <= 0.03
    assert main([*options, "--config", str(file), "--seconds", "3"]) == 2
    assert "both" in capsys.readouterr().err
