"""A mask that is many refreshes late, which the display takes out from its next start on."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.e2e.calibration.steps_rig import SmallBench
from tests.taken import calibrate, started

TRUTH = """
[projector]
rise_s = 0.001
fall_s = 0.0015
[mask]
rise_s = 0.003
fall_s = 0.006
skew_s = 0.19
[mask.place]
scale = 1.06
[camera]
blur_quads = 0.5
[camera.place]
scale = 1.1
"""


@pytest.mark.long
def test_the_first_check_after_the_start_finds_nothing_changed(tmp_path: Path) -> None:
    with started(SmallBench(tmp_path / "bench", TRUTH, quads=(360, 270)).config) as engine:
        first = calibrate(engine, "geometry", "timing", "check")
        delay = first.record.measured["display.mask_delay_refreshes"].value
        assert abs(delay) == 11
        again = calibrate(engine, "check")
        assert again.record.verdict == "good", again.step("check").figures
