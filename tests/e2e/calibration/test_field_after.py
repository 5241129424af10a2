"""Benches whose panels were placed roughly: after a calibration plain captures run, and are as good
as with the truth typed in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from pdcd.bench.tables import (
    CalibrationConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ScheduleConfig,
)
from pdcd.bench.truth import load_bench_truth
from pdcd.panels.placing import Placing
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.e2e.calibration.steps_rig import MASK_PX, SmallBench
from tests.taken import request_of, started

pytestmark = pytest.mark.whole

GRID = (12, 16)
TIMES = """
[projector]
rise_s = 0.001
fall_s = 0.0015
[mask]
skew_s = 0.002
rise_s = 0.002
fall_s = 0.003
"""
PLACES = "[mask.place]\n{mask}\n[camera.place]\n{camera}\n"


def rough(folder: Path, truth: str, quads: tuple[int, int], flip: str = "none") -> SmallBench:
    """A bench before the open book, in coarse cells. flip : of the mask, as it is typed."""
    tables = {
        "mask": PanelConfig(size_px=MASK_PX, place=Placing(flip=flip)),  # type: ignore[arg-type]
        "scene": SceneConfig(kind="open-book", grid=GRID),
        "schedule": ScheduleConfig(grid=GRID),
    }
    return SmallBench(folder, truth, quads=quads, tables=tables)


def capture(config: Config, goal: str, codes: int) -> CaptureResult:
    with started(config) as engine:
        asked = request_of(goal=goal, codes=codes, parts=1)
        return bench_rig.capture(engine, asked, make_job_id())


def typed(config: Config, field_px: tuple[int, int, int, int]) -> Config:
    """The same bench with the truth typed in, and the same field."""
    true = load_bench_truth(config).of(config)
    projector = structs.replace(true.projector, field_px=field_px)
    schedule = structs.replace(config.schedule, guards="auto")
    return structs.replace(
        true, projector=projector, schedule=schedule, calibration=CalibrationConfig(use="none")
    )


def compare(
    made: SmallBench, goal: str, field_px: tuple[int, int, int, int], codes: int = 64
) -> None:
    found, known = (
        capture(config, goal, codes) for config in (made.config, typed(made.config, field_px))
    )
    assert found.state == known.state == "done", (found.error, known.error)
    errors = [float(one.summary["rms_error_quads"]) for one in (found, known)]  # type: ignore[arg-type]
    assert errors[0] <= max(1.3 * errors[1], errors[1] + 0.003), errors
    # A card has no light but direct: what is left of it is all error, which is doubtful.
    verdict = found.summary["quality"].verdict  # type: ignore[union-attr]
    assert verdict == "good" if goal == "direct" else verdict != "bad"
    assert "blind_share" not in found.summary
    manifest = read_manifest(Path(str(found.folder)))
    assert manifest.run.projector.field_px == field_px
    assert manifest.config["projector"]["field_px"] == list(field_px)
    reasons = manifest.plan["reasons"]
    assert any(f"field of {field_px[2]} x {field_px[3]}" in reason for reason in reasons)


@pytest.mark.timeout(300)
def test_a_mask_that_was_put_up_roughly(tmp_path: Path) -> None:
    """Panels that switch at once: where they lie is all there is to find."""
    text = PLACES.format(mask="offset_px = [10.0, -6.25]", camera="scale = 1.1")
    made = rough(tmp_path, text, (256, 192))
    before = capture(made.config, "white", codes=4)
    assert before.state == "done" and "field_px" not in before.summary
    found = made.calibrate("geometry")
    field = tuple(found.record.measured["projector.field_px"].value)
    assert np.abs(np.array(field) - (10, 0, 246, 186)).max() <= 1
    assert found.figures("geometry")["geometry.field"].verdict == "good"
    compare(made, "indirect", field, codes=32)


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("mask", "camera"),
    [
        ("offset_px = [2.5, 2.5]", "scale = 1.1"),
        ("turn_deg = 3.0", "scale = 1.15"),
        ("scale = 0.7", "scale = 1.1"),
        ("scale = 0.85\noffset_px = [-10.0, 5.0]", "scale = 1.1\nturn_deg = 2.0"),
        ("scale = 1.1\nflip = 'horizontal'\noffset_px = [8.0, 3.0]", "scale = 1.1"),
        ("scale = 1.05\noffset_px = [4.0, 6.0]", "scale = 0.8"),
    ],
)
def test_rough_places_with_slow_panels(tmp_path: Path, mask: str, camera: str) -> None:
    text = TIMES + PLACES.format(mask=mask, camera=camera)
    # Which way a panel is mounted is typed.
    made = rough(tmp_path, text, (320, 240), "horizontal" if "flip" in mask else "none")
    found = made.calibrate("geometry", "timing", "registration")
    assert found.record.verdict != "bad"
    field = tuple(found.record.measured["projector.field_px"].value)
    for goal in ("indirect", "direct"):
        compare(made, goal, field)
