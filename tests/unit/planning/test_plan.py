"""Requests -> plans: figures, defaults, refusals."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.bench.tables import Config, LimitsConfig, RigConfig
from pdcd.errors import ConfigError, RequestError
from pdcd.planning.make import make_plan
from pdcd.protocol.request import CaptureRequest

GRID = (48, 64)


def plan_of(config: Config | None = None, **fields: Any) -> Any:
    request = CaptureRequest(**{"goal": "indirect", **fields})
    return make_plan(request, config or Config(), GRID)


def test_the_papers_capture() -> None:
    """128 pairs under 4 shifts with guards: 1536 refreshes, light share 1/12 * 1/4 (R5)."""
    summary = plan_of(codes=128, window="quarter", white=False).summary()
    assert summary.refreshes == 1536
    assert summary.shots[0].exposure_s == pytest.approx(25.7)
    assert summary.light_share == pytest.approx(1 / 48, rel=1e-3)


def test_the_white_shot_gathers_as_much_light_as_the_indirect_one() -> None:
    shots = {s.name: s for s in plan_of(codes=128).summary().shots}
    coded = shots["coded"].refreshes * shots["coded"].light_share
    assert shots["white"].refreshes * shots["white"].light_share == pytest.approx(coded, rel=1e-2)


def test_plan_counts_the_frames_it_will_build() -> None:
    for fields in ({"window": "quarter"}, {"guards": False}, {"goal": "direct"}, {"goal": "white"}):
        plan = plan_of(codes=8, **fields)
        for shot in plan.recipe.shots:
            assert plan.refreshes(shot) == len(plan.frames(shot))


def test_exposure_becomes_whole_passes() -> None:
    assert plan_of(codes=128, exposure_s=30.0).passes == 4  # 6.4 s a pass
    assert plan_of(codes=128, exposure_s=6.4).passes == 1
    with pytest.raises(RequestError, match="shorter than one pass"):
        plan_of(codes=128, exposure_s=6.0)


@pytest.mark.parametrize(
    ("p", "codes", "parts", "family"),
    [
        (0.5, 128, 1, "hadamard"),
        (0.25, 128, 1, "hadamard"),
        (0.25, 96, 1, "balanced"),
        (0.2, 100, 1, "balanced"),
        (0.0625, 128, 1, "balanced"),
        (0.25, 128, 4, "balanced"),
    ],
)
def test_a_fraction_takes_hadamard_codes_where_they_are_defined(
    p: float, codes: int, parts: int, family: str
) -> None:
    assert plan_of(goal="fraction", p=p, codes=codes, parts=parts).family == family


def test_a_family_that_is_named_is_not_replaced() -> None:
    with pytest.raises(RequestError, match="hadamard"):
        plan_of(goal="fraction", p=0.2, codes=100, family="hadamard")
    assert plan_of(goal="fraction", p=0.2, codes=21, family="singer").family == "singer"
    with pytest.raises(RequestError, match="goal fraction"):
        plan_of(goal="indirect", codes=21, family="singer")


@pytest.mark.parametrize(
    ("fields", "smooth"),
    [
        ({}, True),
        ({"goal": "direct"}, True),
        ({"family": "balanced"}, False),
        ({"family": "balanced", "smooth": True}, True),
        ({"smooth": False}, False),
        ({"goal": "fraction", "p": 0.5}, False),
        ({"goal": "white"}, False),
    ],
)
def test_smooth_light_is_corrected_with_hadamard_codes_unless_told(
    fields: dict[str, Any], smooth: bool
) -> None:
    assert plan_of(**fields).smooth is smooth


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"codes": 10}, "10"),
        ({"codes": 1}, "1"),
        ({"p": 0.5}, "takes no p"),
        ({"goal": "fraction"}, "needs p"),
        ({"codes": 65536}, "exposure"),
    ],
)
def test_refusals(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(RequestError, match=what):
        plan_of(Config(limits=LimitsConfig(max_exposure_s=60.0)), **fields)


def test_grid_finer_than_the_projector_is_refused() -> None:
    with pytest.raises(ConfigError, match="finer"):
        make_plan(CaptureRequest(goal="white"), Config(), (800, 64))


def test_misregistration_chooses_quarter_windows() -> None:
    config = Config(rig=RigConfig(misregistration_px=2.0))
    assert plan_of(config).window == "quarter"
    assert plan_of(config, window="whole").window == "whole"
    with pytest.raises(ConfigError, match="misregistration"):
        plan_of(Config(rig=RigConfig(misregistration_px=5.0)))


@pytest.mark.parametrize(
    "bad",
    [
        {"goal": "sideways"}, {"goal": "indirect", "codes": 0}, {"goal": "indirect", "codes": "8"},
        {"goal": "indirect", "family": "fourier"}, {"goal": "indirect", "colour": "blue"},
        {"goal": "fraction", "p": 1.5}, {"goal": "indirect", "seed": -1}, {},
        {"goal": "indirect", "exposure_s": 0}, {"goal": "indirect", "codes": 2.5},
    ],
)  # fmt: skip
def test_malformed_requests_do_not_decode(bad: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(bad, CaptureRequest)


@settings(deadline=None, derandomize=True, max_examples=50)
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
