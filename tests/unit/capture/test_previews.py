"""Previews do not pile up, and nothing else is touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.capture.engine import Engine
from pdcd.capture.previews import PREVIEWS_KEPT, remove_old_previews
from pdcd.errors import Cancelled
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import make_job_id
from tests import bench_rig


def test_the_last_few_stay_and_strangers_are_left_alone(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "preview", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious").write_text("a photo")
    own = [f"20260101T12{n:02d}00Z-00ff" for n in range(PREVIEWS_KEPT + 3)]
    for name in ("20260101T115900Z-beef.partial", "notes", *own):
        (folder / name / "raw").mkdir(parents=True)
    (folder / "20250101T000000Z-0001").symlink_to(elsewhere)
    (folder / own[0] / "raw" / "link").symlink_to(elsewhere)
    remove_old_previews(folder)
    left = {path.name for path in folder.iterdir()}
    assert left == {"notes", "20250101T000000Z-0001", *own[-PREVIEWS_KEPT:]}
    assert (elsewhere / "precious").exists()
    remove_old_previews(tmp_path / "nowhere")  # logs, and does not fail


def test_a_preview_ends_by_the_error_that_it_had(engine: Engine) -> None:
    with pytest.raises(Cancelled):
        engine.preview(job=make_job_id(), cancelled=lambda: True)
    assert bench_rig.are_panels_black(bench_rig.bench_of(engine))


def test_a_plan_asks_whether_it_is_still_wanted(tmp_path: Path) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path, camera=CameraConfig(f_number=8.0)))
    asked: list[None] = []

    def cancelled() -> bool:
        asked.append(None)
        return len(asked) > 3

    with pytest.raises(Cancelled):
        engine.plan(CaptureRequest(goal="indirect", seconds=60.0), cancelled=cancelled)
    assert len(asked) == 4
    with pytest.raises(Cancelled):
        engine.plan(CaptureRequest(goal="white"), cancelled=lambda: True)
