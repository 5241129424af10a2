"""How far the planner climbs, and what it tries of each plan, before errors that are made up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config, LimitsConfig
from pdcd.errors import RequestError
from pdcd.planning import choose as module
from pdcd.planning.choose import PlanChoice, choose_plan
from pdcd.planning.code_counts import LADDER
from pdcd.planning.outlook import ErrorEstimate, RigSetting
from pdcd.planning.plan import Plan
from pdcd.protocol.request import CaptureRequest
from tests.unit.planning.test_measured import config

GRID = (3, 4)
Errors = Callable[[Plan, int, int], ErrorEstimate]


def estimate(code: float, sensor: float, headroom: float = 1.0) -> ErrorEstimate:
    return ErrorEstimate(code, sensor, 0.0, 0.0, 0.0, headroom)


class Foreseen:
    """Stands for what is foreseen before unknown scenes, and keeps what it was asked."""

    def __init__(self, patch: pytest.MonkeyPatch, errors: Errors) -> None:
        self.plans: list[Plan] = []
        self.judged: list[tuple[int, int, int]] = []
        self._errors = errors
        patch.setattr(module, "guess_plan", self._guess)

    def _guess(self, plan: Plan, *_: Any) -> Any:
        self.plans.append(plan)

        def judge(_: Any, iso: int, passes: int) -> ErrorEstimate:
            self.judged.append((plan.how.codes, iso, passes))
            return self._errors(plan, iso, passes)

        return type("Made", (), {"judge": judge})()

    @property
    def counts(self) -> list[int]:
        return [plan.how.codes for plan in self.plans]


def rig(most_s: float = 1000.0, isos: tuple[int, ...] = (100,), **limits: Any) -> RigSetting:
    camera: Any = CameraInfo("", "", "modern", None, isos, ())  # type: ignore[arg-type]
    tables = config(camera={"iso": None})
    wide = LimitsConfig(min_free_bytes=0, max_exposure_s=most_s, **limits)
    return RigSetting(msgspec.structs.replace(tables, limits=wide), camera, None, 0.0)  # type: ignore[arg-type]


def chosen(setting: RigSetting, **fields: Any) -> PlanChoice:
    given = {"goal": "indirect", "window": "whole", "guards": "none", "white": False, **fields}
    return choose_plan(msgspec.convert(given, CaptureRequest), setting, GRID, None)


@pytest.mark.parametrize(
    ("codes", "looked_at"),
    [
        ([1.0] * 20, 7),
        # At eight times as many codes the error must be down by a fifth.
        ([1.0] * 6 + [0.79] * 14, 13),
        ([1.0] * 6 + [0.81] * 14, 7),
        ([1.0] * 3 + [0.5] * 17, 10),
        ([1.0, 0.5] + [1.0] * 18, 8),
        ([0.5] + [1.0] * 5 + [0.41] * 14, 7),
        ([1.0, 0.5] + [1.0] * 4 + [0.39] * 14, 13),
    ],
)
def test_more_codes_are_tried_as_long_as_they_help(
    monkeypatch: pytest.MonkeyPatch, codes: list[float], looked_at: int
) -> None:
    foreseen = Foreseen(
        monkeypatch, lambda plan, iso, passes: estimate(codes[LADDER.index(plan.how.codes)], 1e-3)
    )
    with pytest.raises(RequestError, match="cannot be had"):
        chosen(rig(), error=0.01)
    assert foreseen.counts == list(LADDER[:looked_at])


@pytest.mark.parametrize(("code", "looked_at"), [(0.0124, 1), (0.0126, 7)])
def test_codes_that_err_much_less_than_the_sensor_are_enough(
    monkeypatch: pytest.MonkeyPatch, code: float, looked_at: int
) -> None:
    """Less than a tenth of what 64 exposures leave of the sensor's error."""
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(code, 1.0))
    chosen(rig(), error=0.2)
    assert foreseen.counts[:looked_at] == list(LADDER[:looked_at])
    assert (len(foreseen.counts) == 1) == (looked_at == 1)


def test_a_sensor_that_is_too_noisy_for_any_number_of_codes_ends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """64 exposures leave an eighth of its error; codes that err more might still hide it."""
    foreseen = Foreseen(
        monkeypatch, lambda plan, *_: estimate(0.2 if plan.how.codes < 24 else 0.05, 0.8)
    )
    with pytest.raises(RequestError, match="cannot be had"):
        chosen(rig(), error=0.01)
    assert foreseen.counts == [8, 12, 16, 24]


@pytest.mark.parametrize(
    ("headroom", "most_s", "tried"),
    [
        (0.9, 1000.0, [(100, 1)]),
        (1.99, 1000.0, [(100, 1)]),
        (2.0, 1000.0, [(100, 1), (100, 2), (200, 1), (200, 2)]),
        (5.0, 1000.0, [(100, p) for p in (1, 2, 4)] + [(200, p) for p in (1, 2, 4)]),
        # Eight codes take 0.13 s, and 0.1 s on black.
        (5.0, 0.47, [(100, 1), (100, 2), (200, 1), (200, 2)]),
        (5.0, 0.46, [(100, 1), (200, 1)]),
    ],
)
def test_light_to_spare_is_used_by_passes_and_gain(
    monkeypatch: pytest.MonkeyPatch, headroom: float, most_s: float, tried: list[tuple[int, int]]
) -> None:
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(0.001, 1.0, headroom))
    chosen(rig(most_s, isos=(100, 200)), error=0.5)
    assert [(iso, passes) for codes, iso, passes in foreseen.judged if codes == 8] == tried


def test_passes_that_saturate_are_no_choice_and_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    Foreseen(
        monkeypatch,
        lambda plan, iso, passes: estimate(0.001, 0.4 / passes, 4.0 if passes < 2 else 0.5),
    )
    found = chosen(rig(), error=0.21)
    assert (found.plan.passes, found.plan.how.repeat) == (1, 4)


def test_light_that_saturates_at_once_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(0.001, 0.1, 0.5))
    with pytest.raises(RequestError, match=r"cannot be had: at f/.* the light saturates") as caught:
        chosen(rig(), error=0.2)
    assert foreseen.counts == [8] and "less light" in str(caught.value.hint)


@pytest.mark.parametrize(("error", "repeat"), [(0.8, 1), (0.4, 4), (0.11, 53), (0.1, 64)])
def test_as_few_exposures_as_the_error_allows_up_to_64(
    monkeypatch: pytest.MonkeyPatch, error: float, repeat: int
) -> None:
    Foreseen(monkeypatch, lambda *_: estimate(0.0, 0.8))
    found = chosen(rig(), error=error * (1.0 + 1e-9))
    assert found.plan.how.repeat == repeat and found.plan.how.codes == 8
    one_s = found.plan.exposure_s(found.plan.recipe.shots[0])
    assert found.seconds == pytest.approx(repeat * one_s)
    told = found.plan.prediction
    assert told is not None and told.sensor == pytest.approx(0.8 / repeat**0.5)
    assert (told.code, told.iso, found.plan.iso) == (0.0, 100, 100)


def test_what_64_exposures_leave_is_told_where_that_is_too_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Foreseen(monkeypatch, lambda *_: estimate(0.03, 0.32))
    words = (
        r"an RMS error of 4 % cannot be had: 8 codes, 64 times, leave 5 % \(3 % by the codes, 4 %"
    )
    with pytest.raises(RequestError, match=words) as caught:
        chosen(rig(), error=0.04)
    assert "within 1000 s an exposure" in str(caught.value)
    assert caught.value.hint == "ask for 5.2 % or more, or raise limits.max_exposure_s"


@pytest.mark.parametrize(("seconds", "repeat"), [(0.24, 1), (0.46, 1), (0.47, 2), (2.4, 10)])
def test_a_time_is_filled_with_exposures(
    monkeypatch: pytest.MonkeyPatch, seconds: float, repeat: int
) -> None:
    """Each of 8 codes takes 0.233 s."""
    Foreseen(monkeypatch, lambda plan, *_: estimate(0.0 if plan.how.codes == 8 else 9.0, 0.8))
    found = chosen(rig(), seconds=seconds)
    assert (found.plan.how.codes, found.plan.how.repeat) == (8, repeat)
    assert found.seconds == pytest.approx(repeat * (8 / 60.0 + 0.1)) and found.seconds <= seconds


def test_no_more_than_64_exposures_fill_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    Foreseen(monkeypatch, lambda plan, *_: estimate(0.0 if plan.how.codes == 8 else 9.0, 0.8))
    assert chosen(rig(), seconds=100.0).plan.how.repeat == 64


def test_plans_longer_than_the_best_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(0.1, 0.01))
    found = chosen(rig(), error=0.2)
    assert found.plan.how.codes == 8 and foreseen.counts == [8]
    late = Foreseen(monkeypatch, lambda *_: estimate(0.1, 0.01))
    chosen(rig(), seconds=0.35)  # 8 codes take 0.23 s, 12 take 0.3 s and 16 take 0.37 s
    assert late.counts == [8, 12]


def test_exposures_that_the_rig_does_not_allow_are_not_planned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(1.0, 0.01))
    with pytest.raises(RequestError, match="cannot be had"):
        chosen(rig(0.45), error=0.01)
    assert foreseen.counts == [8, 12, 16]


def test_codes_that_take_too_much_memory_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(1.0, 0.01))
    with pytest.raises(RequestError, match=r"cannot be had: this takes .* of memory"):
        chosen(rig(memory_bytes=1000), error=0.01)
    assert foreseen.counts == []


def test_plans_are_asked_for_as_the_request_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(0.001, 0.1))
    found = chosen(
        rig(), error=0.2, confidence=0.9, black_level="both", seed=7, family="balanced",
        guards="lag",
    )  # fmt: skip
    (plan, *_) = foreseen.plans
    assert (plan.schedule, plan.how.black_level, plan.family) == ("lag", "both", "balanced")
    assert plan.look is None and plan.how.repeat == 1 and plan.passes == 1
    told = found.plan.prediction
    assert told is not None and told.confidence == 0.9
    assert found.plan.look is None


def test_panels_that_switch_at_once_in_step_need_no_guards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tables: dict[str, tuple[dict[str, Any], set[str]]] = {
        "at once": ({"rise_s": 0.0, "fall_s": 0.0}, {"none"}),
        "rising": ({"rise_s": 0.001, "fall_s": 0.0}, {"none", "both", "lag", "full"}),
        "falling": ({"rise_s": 0.0, "fall_s": 0.001}, {"none", "both", "lag", "full"}),
    }
    for panel in ("projector", "mask"):
        for times, schedules in tables.values():
            foreseen = Foreseen(monkeypatch, lambda *_: estimate(0.0, 0.8))
            still = {"projector": tables["at once"][0], "mask": tables["at once"][0]}
            rigged = config(**{**still, panel: times})
            limits = LimitsConfig(min_free_bytes=0, max_exposure_s=2.0)
            whole: Config = msgspec.structs.replace(rigged, limits=limits)
            setting = RigSetting(whole, rig().camera, None, 0.0)  # type: ignore[arg-type]
            with pytest.raises(RequestError):
                chosen(setting, error=0.01, guards=None)
            assert {plan.schedule for plan in foreseen.plans} == schedules
