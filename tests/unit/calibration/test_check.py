"""The check before a session: what it must find, and that it cries no wolf.

What photos say of a bench is made up here; tests/e2e/calibration/test_check_step.py takes them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pdcd.calibration.check.changes import (
    BenchSnapshot,
    CheckResult,
    compare_snapshots,
    measure_closed_mask,
)
from pdcd.calibration.check.moved import MapDrift
from pdcd.calibration.figures import Verdict
from pdcd.errors import CalibrationError

SIZE_PX = (1024, 768)
T_S = 1.0 / 60.0
GUARD_PX = 4.0
EPS = 1.0 / 500.0
LAG_S = 1e-5
"""Noise of the lag."""


def drift(
    right_px: float = 0.0, down_px: float = 0.0, turn_deg: float = 0.0, bent_px: float = 0.0
) -> MapDrift:
    """Of 700 dots, each known to 0.03 px. bent_px : what no similarity explains, in one part."""
    numbers = np.array([right_px, down_px, 0.0, np.radians(turn_deg)])
    left = np.zeros((3, 4, 2))
    left[1, 2] = bent_px, 0.0
    return MapDrift(SIZE_PX, numbers, np.array([1e-3, 1e-3, 4e-6, 4e-6]), left, 700)


WHITE = 2e4 * np.linspace(1.0, 0.7, 16) * np.linspace(0.8, 1.0, 12)[:, None]
SETTINGS = {"camera": "450D 0123", "iso": "100", "f_number": "4"}
THEN = BenchSnapshot(drift(), drift(), WHITE, (EPS, 0.01 * EPS), (0.0, LAG_S), SETTINGS)


def checked(**changed: Any) -> CheckResult:
    """The bench as it was, but for some of what its photos say."""
    return compare_snapshots(replace(THEN, **changed), THEN, GUARD_PX, T_S)


def verdicts(found: CheckResult) -> dict[str, Verdict]:
    return {f.figure.name: f.figure.verdict for f in found.findings if f.figure.verdict}


def test_noise_raises_no_alarm() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        camera, mask = (drift(*rng.normal(0.0, 3e-3, 2)) for _ in range(2))
        white = WHITE * (1.0 + 4e-3 * rng.normal() + 2e-3 * rng.normal(size=WHITE.shape))
        closed = EPS * (1.0 + 0.01 * rng.normal()), 0.01 * EPS
        lag = LAG_S * rng.normal(), LAG_S
        found = checked(camera=camera, mask=mask, white=white, closed=closed, lag_s=lag)
        assert found.verdict is Verdict.GOOD, verdicts(found)
        assert not any(finding.advice for finding in found.findings)


BAD, REFIT = Verdict.BAD, Verdict.DOUBTFUL


@pytest.mark.parametrize(
    ("changed", "expected", "said"),
    [
        ({"mask": drift(0.64)}, {"mask.place": REFIT}, "the mask moved"),
        ({"mask": drift(1.92)}, {"mask.place": BAD}, "the mask moved"),
        ({"mask": drift(turn_deg=0.1)}, {"mask.place": REFIT}, "the mask moved"),
        ({"mask": drift(bent_px=0.3)}, {"mask.place": BAD}, "or bent"),
        ({"white": 0.9 * WHITE}, {"lamp": REFIT}, "iris"),
        ({"white": 0.7 * WHITE}, {"lamp": BAD}, "iris"),
        ({"closed": (EPS + 0.0076, 0.01 * EPS)}, {"mask.contrast": BAD}, "polarisers"),
        ({"lag_s": (1e-3, LAG_S)}, {"mask.skew_s": BAD}, "calibrate the timing"),
        ({"lag_s": (3e-4, LAG_S)}, {"mask.skew_s": REFIT}, "calibrate the timing"),
        ({"lag_s": (T_S, LAG_S)}, {"mask.skew_s": BAD}, "+1 refresh(es) later"),
        ({"camera": drift(1.1, -0.6, 0.02)}, {"camera.place": REFIT}, "the camera was bumped"),
        ({"camera": drift(3.6, -1.8, 0.02)}, {"camera.place": BAD}, "the camera was bumped"),
        # Its picture moves on the card; mask and camera stay where they were.
        (
            {"camera": drift(0.7), "mask": drift(0.7)},
            {"mask.place": REFIT, "camera.place": REFIT},
            "the projector moved",
        ),
        ({"settings": SETTINGS | {"iso": "200"}}, {"settings": BAD}, "iso is 200 and was 100"),
    ],
)
def test_every_change_is_found_and_no_other(
    changed: dict[str, Any], expected: dict[str, Verdict], said: str
) -> None:
    found = checked(**changed)
    assert verdicts(found) == expected
    assert said in " ".join(finding.advice for finding in found.findings)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"white": 0.01 * WHITE}, "almost no light"),
        ({"saturated": 0.2}, "saturated"),
        ({"mask": replace(drift(), count=40)}, "dots of the mask"),
    ],
)
def test_photos_that_say_nothing_are_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        checked(**changed)


def test_what_could_not_be_measured_is_bad_unless_the_mask_is_out_of_place() -> None:
    unknown = (float("nan"), float("nan"))
    assert verdicts(checked(closed=unknown)) == {"mask.contrast": BAD}
    assert verdicts(checked(lag_s=unknown)) == {"mask.skew_s": BAD}
    found = checked(lag_s=unknown, mask=drift(0.64))
    assert verdicts(found) == {"mask.place": REFIT, "mask.skew_s": REFIT}


def test_another_scene_is_not_taken_for_a_lamp() -> None:
    rng = np.random.default_rng(0)
    found = checked(white=WHITE * rng.uniform(0.4, 1.0, WHITE.shape))
    assert verdicts(found) == {"lamp": REFIT}
    assert "the scene differs" in found.findings[3].advice


def test_light_through_the_closed_mask_is_measured_away_from_dots() -> None:
    rng = np.random.default_rng(0)
    white = np.full((90, 120), 2e4)
    white[:, :10] = 10.0  # beside the card
    dots = 0.002 * white
    places = np.array([[40.3, 30.2], [80.5, 60.9]])
    x, y = np.meshgrid(np.arange(120) + 0.5, np.arange(90) + 0.5)
    for right, down in places:
        dots[np.hypot(x - right, y - down) < 6.0] = 2e4
    variance = 0.5 * (dots + 16.8**2)
    noisy = dots + rng.normal(size=dots.shape) * np.sqrt(variance)
    value, sigma = measure_closed_mask(noisy, variance, white, places, 8.0)
    assert abs(value - 0.002) < 4.0 * sigma
    assert sigma < 1e-5
    with pytest.raises(CalibrationError, match="closed"):
        measure_closed_mask(noisy, variance, white, places, 200.0)


@pytest.mark.parametrize(
    ("then", "now", "verdict"),
    [
        ((0.0, 0.0), (0.0, 0.0), Verdict.GOOD),
        ((7e-6, 3e-6), (-6e-7, 3e-6), Verdict.GOOD),
        ((-7e-6, 3e-6), (6e-6, 3e-6), Verdict.GOOD),
        ((7e-6, 3e-6), (2e-3, 3e-6), Verdict.BAD),
        ((2e-3, 7e-4), (3.5e-3, 7e-4), Verdict.DOUBTFUL),
        ((2e-3, 2e-5), (3.5e-3, 2e-5), Verdict.BAD),
    ],
)
def test_a_black_that_cannot_be_seen_is_not_taken_for_another(
    then: tuple[float, float], now: tuple[float, float], verdict: Verdict
) -> None:
    """Its noise is no change, however large it is over the share that was seen."""
    found = compare_snapshots(replace(THEN, closed=now), replace(THEN, closed=then), GUARD_PX, T_S)
    assert verdicts(found).get("mask.contrast", Verdict.GOOD) == verdict
