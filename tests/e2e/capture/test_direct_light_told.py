"""Late panels let direct light into photos that are to have none: what the verdict says of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdcd
from pdcd.protocol.result import quality_of
from pdcd.words import GoalName

pytestmark = pytest.mark.whole

GRID = (12, 16)
CELLS = GRID[0] * GRID[1]
BLOCKING = 1.0 - np.eye(CELLS)
ELSEWHERE = 1.0 - np.roll(np.eye(CELLS), 3, axis=1)


def taken(folder: Path, goal: GoalName, lag_s: float, **options: Any) -> tuple[float, str, str]:
    """Relative RMS error, verdict and its first reason."""
    bench = pdcd.local(
        {
            "scene": {"kind": "open-book", "grid": list(GRID)},
            "mask": {"skew_s": lag_s, "rise_s": 0.003, "fall_s": 0.003},
            "projector": {"rise_s": 0.001, "fall_s": 0.001},
            "server": {"state_dir": str(folder)},
        }
    )
    run = bench.capture(goal, codes=128, **options)
    summary = run.manifest.summary
    quality, error = quality_of(summary), summary["rms_error_quads"]
    assert quality is not None and isinstance(error, float)
    return error, quality.verdict, quality.reasons[0] if quality.reasons else ""


def test_what_is_known_and_taken_out_is_no_reason(tmp_path: Path) -> None:
    error, verdict, reason = taken(tmp_path, "indirect", 0.012)
    assert error < 0.02
    assert verdict == "good", reason


@pytest.mark.parametrize(
    ("lag_s", "least", "verdict"), [(0.012, 0.2, "doubtful"), (0.016, 1.0, "bad")]
)
def test_a_matrix_that_blocks_it_has_no_photo_that_shows_it(
    tmp_path: Path, lag_s: float, least: float, verdict: str
) -> None:
    error, said, reason = taken(tmp_path, "relit", lag_s, matrix=BLOCKING)
    assert error > least
    assert said == verdict and "no photo shows how much" in reason


@pytest.mark.parametrize(("matrix", "lag_s"), [(BLOCKING, 0.0), (ELSEWHERE, 0.016)])
def test_where_none_gets_in_all_is_well(tmp_path: Path, matrix: Any, lag_s: float) -> None:
    """Panels in step; and a matrix that keeps direct light, and blocks what is hardly there."""
    error, said, reason = taken(tmp_path, "relit", lag_s, matrix=matrix)
    assert error < 0.03
    assert said == "good", reason


@pytest.mark.parametrize(
    ("p", "codes", "most", "verdicts"),
    [
        # p^2 K is whole: direct light is counted as often as is wanted.
        (0.25, 160, 0.1, ("good",)),
        (0.1, 300, 0.1, ("good",)),
        # A half: every second cell counts it once, the others never.
        (0.125, 32, 1.5, ("doubtful", "bad")),
    ],
)
def test_direct_light_beside_a_fraction_of_light_matched_elsewhere(
    tmp_path: Path, p: float, codes: int, most: float, verdicts: tuple[str, ...]
) -> None:
    """Fig. 8 with a shift: direct light is kept as all other light, and is the strongest."""
    with pdcd.local(
        {"scene": {"kind": "open-book", "grid": list(GRID)}, "server": {"state_dir": str(tmp_path)}}
    ) as bench:
        run = bench.capture("fraction", p=p, codes=codes, shift=(2, 3))
        quality, error = run.quality, run.rms_error_quads
        assert quality is not None and error is not None
        assert error < most and (error < 0.3) == (quality.verdict == "good")
        assert quality.verdict in verdicts
        if quality.reasons:
            assert "weights that are" in quality.reasons[0]
        assert run.sigma_kind == "sensor", "codes in parts do not keep such light alike"
