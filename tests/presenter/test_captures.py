"""Whole captures: real windows show the codes, their own frame log makes the mock's photo."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

from drivers.x11 import X11Display
from pdcd.config import RigConfig
from pdcd.engine import Engine
from pdcd.request import CaptureRequest
from tests import bench_rig, x11_rig
from tests.xserver import QUARTER, XServer, run

REQUEST = CaptureRequest(goal="indirect", codes=12, window="whole")


def engine_on(folder: Path, server: XServer, **more: Any) -> Engine:
    rig = RigConfig(clock="real", on_miss="flag", settle_s=0.03)
    config = x11_rig.config(folder, server, rig=rig, more={"time_source": "auto"}, **more)
    return Engine.from_config(config)


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
    error = result.summary["rms_error"]
    assert isinstance(error, float) and error < 0.1
    assert bench.frames is None  # the mock display had no part in it


def test_a_presenter_killed_in_mid_run_fails_the_job_and_no_other(
    tmp_path: Path, x_quarter: XServer
) -> None:
    engine = engine_on(tmp_path, x_quarter)
    engine.start()
    try:
        display = engine._rig.display
        assert isinstance(display, X11Display)

        def kill(kind: str, fields: dict[str, Any]) -> None:
            if kind == "progress" and fields["frame"] > 0:
                assert display._presenter is not None
                os.kill(display._presenter.pid, signal.SIGKILL)

        result = engine.capture(
            CaptureRequest(goal="indirect", codes=64, window="whole"),
            job="killed",
            owner={},
            emit=kill,
            cancelled=lambda: False,
        )
        assert result.state == "failed"
        assert result.error is not None and result.error["kind"] == "device_lost"
        assert not x11_rig.root_pixels(x_quarter).any()
        assert not bench_rig.bench_of(engine).shutter_open
        assert bench_rig.capture(engine, REQUEST, job="next").state == "done"
    finally:
        engine.stop()


def test_a_server_that_dies_fails_the_job_and_the_next_without_ending_anything(
    tmp_path: Path,
) -> None:
    with run(*QUARTER) as server:
        engine = engine_on(tmp_path, server)
        engine.start()
        try:

            def kill(kind: str, fields: dict[str, Any]) -> None:
                if kind == "progress" and fields["frame"] > 0:
                    os.kill(server.pid, signal.SIGKILL)

            result = engine.capture(
                CaptureRequest(goal="indirect", codes=64, window="whole"),
                job="killed",
                owner={},
                emit=kill,
                cancelled=lambda: False,
            )
            assert result.state == "failed"
            assert result.error is not None and result.error["kind"] == "device_lost"
            assert result.folder is not None
            last = (Path(result.folder) / "log.jsonl").read_text().splitlines()[-1]
            assert json.loads(last)["safe"] is False  # nobody can say what the panels show
            assert not bench_rig.bench_of(engine).shutter_open
            again = bench_rig.capture(engine, REQUEST, job="next")
            assert again.state == "failed"
            assert again.error is not None and again.error["kind"] == "device_lost"
        finally:
            engine.stop()
