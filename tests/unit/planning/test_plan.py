"""Requests -> plans: figures, defaults, refusals."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.bench.tables import Config, LimitsConfig
from pdcd.errors import RequestError
from pdcd.planning.make import make_plan
from pdcd.protocol.request import CaptureRequest

GRID = (48, 64)


def plan_of(config: Config | None = None, **fields: Any) -> Any:
    request = CaptureRequest(**{"goal": "indirect", **fields})
    return make_plan(request, config or Config(), GRID)


def test_a_family_that_is_named_is_not_replaced() -> None:
    with pytest.raises(RequestError, match="hadamard"):
        plan_of(goal="fraction", p=0.2, codes=100, family="hadamard")
    assert plan_of(goal="fraction", p=0.2, codes=21, family="singer").family == "singer"
    with pytest.raises(RequestError, match="goal fraction"):
        plan_of(goal="indirect", codes=21, family="singer")


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"codes": 10}, "10"), ({"codes": 1}, "1"), ({"p": 0.5}, "takes no p"),
        ({"goal": "fraction"}, "needs p"), ({"codes": 65536}, "exposure"),
    ],
)  # fmt: skip
def test_refusals(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(RequestError, match=what):
        plan_of(Config(limits=LimitsConfig(max_exposure_s=60.0)), **fields)


@settings(max_examples=50)
@given(
    goal=st.sampled_from(["white", "indirect", "direct"]),
    codes=st.sampled_from([2, 4, 12, 16]),
    window=st.sampled_from(["whole", "quarter"]),
    guards=st.booleans(),
    black=st.sampled_from(["none", "mask", "ambient", "both"]),
    white=st.booleans(),
)
def test_every_plan_adds_up(
    goal: str, codes: int, window: str, guards: bool, black: str, white: bool
) -> None:
    fields = {
        "goal": goal, "codes": codes, "window": window, "guards": guards,
        "black_level": black, "white": white,
    }  # fmt: skip
    plan = make_plan(msgspec.convert(fields, CaptureRequest), Config(), (3, 4))
    summary = plan.summary()
    assert summary.refreshes == sum(len(plan.frames(s)) for s in plan.recipe.shots)
    assert summary.seconds == pytest.approx(sum(s.exposure_s for s in summary.shots))
    assert 0.0 < summary.light_share <= 1.0
    assert summary.raw_files == len(plan.recipe.shots)
