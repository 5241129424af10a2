"""Whole captures: real windows show the codes, their own frame log makes the mock's photo."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.tables import RigConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig, x11_rig
from tests.xserver import XServer

REQUEST = CaptureRequest(goal="indirect", codes=12, window="whole")


def engine_on(folder: Path, server: XServer, **more: Any) -> Engine:
    rig = RigConfig(clock="real", on_miss="flag", settle_s=0.03)
    config = x11_rig.config(folder, server, rig=rig, more={"time_source": "auto"}, **more)
    return Engine.from_config(config)


@pytest.mark.long
def test_a_photo_of_real_windows_is_that_of_their_frame_log(
    tmp_path: Path, x_quarter: XServer
) -> None:
    engine = engine_on(tmp_path, x_quarter)
    engine.start()
    try:
        result = bench_rig.capture(engine, REQUEST)
        assert result.state == "done", result.error
        assert result.folder is not None
        manifest = json.loads((Path(result.folder) / "capture.json").read_text())
        bench = bench_rig.bench_of(engine)
    finally:
        engine.stop()
    assert manifest["drivers"]["drivers"]["display"]["name"] == "x11"
    assert {s["source"] for s in manifest["run"]["shots"]} == {"present-msc"}
    assert not any(s["verified"] for s in manifest["run"]["shots"])
    error = result.summary["rms_error_quads"]
    assert isinstance(error, float) and error < 0.1
    assert bench.frames is None  # the mock display had no part in it
