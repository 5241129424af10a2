"""Which numbers of codes the planner tries, and what ends it."""

from __future__ import annotations

import dataclasses

import msgspec
import pytest

from pdcd.codes.pilot.codes import choose_pilot_count
from pdcd.errors import RequestError
from tests.unit.planning.test_climbed import Foreseen, chosen, estimate, rig
from tests.unit.planning.test_measured import config


def test_codes_are_tried_up_to_the_limit_of_an_exposure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Black before and after the codes takes 0.1 s, whatever their number: 24 codes take 0.5 s."""
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(1.0, 0.01))
    with pytest.raises(RequestError, match="cannot be had"):
        chosen(rig(0.51), error=0.01)
    assert foreseen.counts == [8, 12, 16, 24]


def test_a_schedule_that_is_too_long_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight codes take 0.37 s of two refreshes each, and 0.5 s of three."""
    foreseen = Foreseen(monkeypatch, lambda *_: estimate(0.0, 0.1))
    tables = config(mask={"rise_s": 0.001, "fall_s": 0.001})
    tables = msgspec.structs.replace(tables, limits=rig(0.4).config.limits)
    setting = dataclasses.replace(rig(), config=tables)
    assert chosen(setting, seconds=0.9, guards=None).plan.how.codes == 8
    assert {plan.schedule for plan in foreseen.plans} == {"none", "both", "lag"}


@pytest.mark.parametrize("asked", [{"seconds": 9.0}, {"error": 0.1}])
def test_a_limit_that_leaves_no_plan_is_named(
    monkeypatch: pytest.MonkeyPatch, asked: dict[str, float]
) -> None:
    Foreseen(monkeypatch, lambda *_: estimate(0.0, 0.1))
    with pytest.raises(RequestError, match=r"(fits into|cannot be had).*the limit is 0\.2 s") as e:
        chosen(rig(0.2), **asked)
    assert "limits.max_exposure_s" in str(e.value.hint)


def test_a_family_that_suits_no_number_of_codes_is_said() -> None:
    with pytest.raises(RequestError, match="no number of codes suits them") as caught:
        chosen(rig(), goal="fraction", p=0.3, family="hadamard", seconds=9.0)
    assert "family" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("p", "family", "counts"),
    [
        (0.01, "balanced", [100, 200, 300, 400, 600, 800]),
        (1 / 9, "singer", [73, 146, 219, 292, 438, 584, 803]),
    ],
)
def test_numbers_of_codes_are_tried_once_each(
    monkeypatch: pytest.MonkeyPatch, p: float, family: str, counts: list[int]
) -> None:
    """A number that stands for several of the ladder is no sign that more codes do not help."""
    foreseen = Foreseen(monkeypatch, lambda plan, *_: estimate(1.0 / plan.how.codes, 1e-9))
    with pytest.raises(RequestError, match="cannot be had"):
        chosen(rig(14.0), goal="fraction", p=p, family=family, error=1e-6)
    assert foreseen.counts == counts


@pytest.mark.parametrize(
    ("parts", "family", "counts"),
    [(3, "hadamard", [24, 36, 48, 72]), (4, "hadamard", [32, 48, 64, 96]), (4, "singer", [52])],
)
def test_parts_that_a_request_names_are_kept(
    monkeypatch: pytest.MonkeyPatch, parts: int, family: str, counts: list[int]
) -> None:
    """Each of them has a number of codes of the ladder, and none is taken again."""
    foreseen = Foreseen(monkeypatch, lambda plan, *_: estimate(1.0 / plan.how.codes, 1e-3))
    goal = {"goal": "fraction", "p": 0.25, "seconds": 1.6} if family == "singer" else {}
    found = chosen(rig(), **{"seconds": 1.0 + parts / 6.0, **goal}, parts=parts, family=family)
    assert foreseen.counts == counts[: len(foreseen.counts)] and len(foreseen.counts) > 0
    how = found.plan.how
    assert (how.parts, how.repeat, how.codes) == (parts, 1, foreseen.counts[-1])
    assert found.seconds == pytest.approx(how.codes / 60.0 + 0.1 * parts)


def test_parts_of_a_pilot_each_have_codes_that_there_are() -> None:
    shares = [choose_pilot_count(count, by_map=True, parts=3) for count in (24, 36, 48, 72)]
    assert shares == [12, 12, 12, 12]
    assert choose_pilot_count(24, by_map=True) == 16


def test_an_error_that_parts_cannot_reach_is_refused_without_repetitions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Foreseen(monkeypatch, lambda *_: estimate(0.0, 0.1))
    assert chosen(rig(), error=0.05).plan.how.repeat == 4
    with pytest.raises(RequestError, match="32 codes, once, leave 10 %"):
        chosen(rig(), error=0.05, parts=4)
