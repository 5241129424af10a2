"""Planned, logged and the camera's own exposure: one table of cases."""

from __future__ import annotations

import math

import pytest

from pdcd.bench.exposure_time import describe_time_conflict

OPEN, TOLD = "the shutter was open for", "the camera reports"


@pytest.mark.parametrize(
    ("planned_s", "logged_s", "told_s", "begins"),
    [
        (2.2, 2.2, 2.2, ""),
        (2.2, 2.2, 2.0, ""),  # bulb times in whole seconds
        (2.2, 3.2, 3.0, ""),
        (2.2, 8.2, 8.2, OPEN),  # a stopped daemon
        (2.2, 8.2, 0.0, OPEN),
        (2.2, 0.2, 2.2, OPEN),
        (2.0, 2.0, 0.005, TOLD),  # not at bulb
        (2.0, 2.0, 30.0, TOLD),
        (0.7, 0.7, 0.005, ""),  # a short one may be told by any figure
        (20.0, 24.9, 24.9, ""),
        (20.0, 25.1, 25.1, OPEN),
        (20.0, 20.0, 14.9, TOLD),
        (20.0, 24.0, 26.0, TOLD),  # within a quarter of what was logged, not of the plan
        (2.2, 2.2, 0.0, ""),  # no tag
        (2.2, 2.2, -1.0, ""),
        (2.2, 2.2, math.inf, ""),
        (2.2, 2.2, math.nan, ""),
        (2.2, 2.2, 4294967295.0, ""),
    ],
)
def test_which_times_disagree(
    planned_s: float, logged_s: float, told_s: float, begins: str
) -> None:
    said = describe_time_conflict(planned_s, logged_s, told_s)
    assert said.startswith(begins) if begins else said == ""
