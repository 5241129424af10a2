"""Guesses before unknown scenes against the formulas of their documentation, by hand."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.planning.guess import PlanGuess, ScenePrior, guess_plan
from pdcd.planning.make import make_plan
from pdcd.planning.outlook import RigSetting
from pdcd.protocol.request import CaptureRequest
from tests.unit.planning.test_measured import config

GRID = (3, 4)
N = 12
PRIOR = ScenePrior(paths=5.0, indirect=0.4, contrast=2.0)
D, S = 0.6, 0.4
Q = S**2 / 5.0
LEAK = 0.05
RESPONSIVITY = np.array([10.0, 40.0, 20.0])
SATURATION_DN = 1000.0


class Quiet(RigSetting):
    """A rig whose samples have a variance of 9 DN squared, and that remembers for how long."""

    exposures: list[float] = []  # noqa: RUF012

    def variance_dn2(
        self, signal_dn: NDArray[np.float64], iso: int, exposure_s: float
    ) -> NDArray[np.float64]:
        self.exposures.append(exposure_s)
        return np.full(signal_dn.shape, 9.0)


def rig(tables: Config | None = None) -> Quiet:
    profile: Any = type("P", (), {"saturation_dn": lambda _, iso: SATURATION_DN * iso / 100})()
    camera = CameraInfo("", "", "modern", RESPONSIVITY, (100,), ())
    return Quiet(tables or Config(), camera, profile)


def guessed(prior: ScenePrior = PRIOR, leak: float = LEAK, **fields: Any) -> PlanGuess:
    whole = {"codes": 8, "window": "whole", **fields}
    plan = make_plan(msgspec.convert(whole, CaptureRequest), Config(), GRID)
    return PlanGuess(plan, rig(), prior, leak)


SIGNAL = 0.6 * SATURATION_DN / 2.0 * RESPONSIVITY / 40.0
NOISE = float(np.sqrt(np.mean(9.0 / np.array([1.0, 2.0, 1.0]) / SIGNAL**2)))
"""Of one photo over its own signal, green with two samples a quad."""
SHARED = (N / 7.0 - 1.0) / (N - 1.0)
"""Variance of 8 Hadamard codes by cells that share one of 7 columns, over Q."""


@pytest.mark.parametrize(
    ("fields", "signal", "code", "sensor"),
    [
        ({"goal": "white"}, 1.0, 0.0, NOISE),
        ({"goal": "indirect"}, S, np.hypot(np.sqrt(Q * SHARED), LEAK * D), NOISE * S),
        (
            {"goal": "direct"},
            D,
            np.hypot(np.sqrt(Q * SHARED), LEAK * D),
            NOISE * np.hypot(1.0, S),
        ),
        (
            {"goal": "indirect", "family": "bernoulli"},
            S,
            np.hypot(np.sqrt((S**2 + 2.0 * Q) / 8.0), LEAK * D),
            NOISE * S,
        ),
        (
            {"goal": "indirect", "family": "balanced"},
            S,
            np.hypot(np.sqrt(Q / 7.0), LEAK * D),
            NOISE * S,
        ),
        (
            {"goal": "fraction", "p": 0.25, "family": "balanced"},
            D + 0.25 * S,
            0.75 * np.sqrt(Q / 7.0),
            NOISE * (D + 0.25 * S),
        ),
        (
            {"goal": "fraction", "p": 0.25, "family": "bernoulli"},
            D + 0.25 * S,
            np.sqrt(0.75 * (Q + (D + 0.25 * S) ** 2 / 0.25) / 8.0),
            NOISE * (D + 0.25 * S),
        ),
        (
            {"goal": "fraction", "p": 0.5, "family": "rademacher"},
            D + 0.5 * S,
            np.sqrt(0.5 * (Q + (D + 0.5 * S) ** 2 / 0.5) / 8.0),
            NOISE * (D + 0.5 * S),
        ),
        # As many columns as there are cells are never shared.
        ({"goal": "indirect", "codes": 16}, S, LEAK * D, NOISE * S),
    ],
)
def test_errors_are_those_of_the_formulas(
    fields: dict[str, Any], signal: float, code: float, sensor: float
) -> None:
    found = guessed(**fields).judge(100, 1)
    assert found.code == pytest.approx(code / signal)
    assert found.sensor == pytest.approx(sensor / signal)
    assert found.headroom == 1.0
    c, s = code / signal, sensor / signal
    assert found.code_var == pytest.approx(2.0 * c**4 / N)
    assert found.cross_var == pytest.approx(4.0 * c**2 * s**2 / (3 * N))
    assert found.sensor_var == pytest.approx(2.0 * s**4 / (3 * N))


def test_noise_goes_by_iso_contrast_and_the_longest_exposure() -> None:
    view = guessed(goal="indirect")
    once = view.judge(100, 1).sensor
    assert view.judge(200, 1).sensor == pytest.approx(once / 2.0)  # twice the DN, the same noise
    assert guessed(ScenePrior(5.0, 0.4, 4.0), goal="indirect").judge(
        100, 1
    ).sensor == pytest.approx(2.0 * once)
    plan = view.plan
    longest = max(plan.exposure_s(shot) for shot in plan.recipe.shots)
    assert longest > min(plan.exposure_s(shot) for shot in plan.recipe.shots)
    Quiet.exposures.clear()
    view.judge(100, 1)
    view.judge(100, 3)
    assert Quiet.exposures == pytest.approx([longest, 3.0 * longest])


def test_a_guess_says_what_it_assumes() -> None:
    assert str(PRIOR) == "guess: 5 paths, 40 % indirect, contrast 2"
    assert str(ScenePrior()) == "guess: 50 paths, 30 % indirect, contrast 3"


def test_direct_light_leaks_where_the_mask_has_no_time_to_close() -> None:
    """At once and in step there is none; a mask that lags by a refresh shows the next code."""
    sharp = {"projector": {"rise_s": 0.0, "fall_s": 0.0}, "mask": {"rise_s": 0.0, "fall_s": 0.0}}
    for goal in ("indirect", "direct"):
        request = CaptureRequest(goal=goal, codes=8, window="whole", guards=False)
        plan = make_plan(request, config(**sharp), GRID)
        assert guess_plan(plan, rig(config(**sharp)), PRIOR).leak == pytest.approx(0.0, abs=1e-12)
        slow = config(mask={"rise_s": 0.002, "fall_s": 0.006})
        assert guess_plan(plan, rig(slow), PRIOR).leak > 0.01
    white = make_plan(CaptureRequest(goal="white"), Config(), GRID)
    assert guess_plan(white, rig(), PRIOR).leak == 0.0
