"""An engine that cannot make its rig dark says so, and is left as it was where a rig is changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.measured import CalibrationChoice
from pdcd.bench.tables import CalibrationConfig, Config, SceneConfig
from pdcd.capture.calibrate import CalibrationRun
from pdcd.capture.engine import Engine
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError, DeviceLost
from pdcd.protocol.events import Event, PicturesArchived
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests import bench_rig


@pytest.mark.parametrize(("device", "method"), [("display", "black"), ("shutter", "close")])
def test_black_that_did_not_come_is_not_told_as_done(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, device: str, method: str
) -> None:
    def fail() -> None:
        raise DeviceLost("gone", device=device)

    engine.show("white")
    assert not bench_rig.are_panels_black(bench_rig.bench_of(engine))
    monkeypatch.setattr(getattr(engine._rig, device), method, fail)
    with pytest.raises(DeviceLost, match=r"panels may still be lit \(see the daemon's log\)"):
        engine.show("black")
    monkeypatch.undo()
    engine.show("black")
    assert bench_rig.are_panels_black(bench_rig.bench_of(engine))


@pytest.mark.parametrize("device", ["display.play", "shutter.open", "readout.fetch"])
def test_a_driver_that_would_end_the_program_ends_its_job(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, device: str
) -> None:
    def leave(*_: object) -> None:
        raise SystemExit(3)

    role, _, method = device.partition(".")
    monkeypatch.setattr(getattr(engine._rig, role), method, leave)
    result = bench_rig.capture(engine, CaptureRequest(goal="white", codes=4))
    assert result.state == "failed" and result.error is not None
    assert result.error["message"] == "SystemExit: 3"
    monkeypatch.undo()
    assert not bench_rig.bench_of(engine).shutter_open
    assert bench_rig.capture(engine, CaptureRequest(goal="white", codes=4), "b").state == "done"


def test_an_interrupt_is_felt_after_the_rig_is_safe(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(engine._rig.display, "play", interrupt)
    with pytest.raises(KeyboardInterrupt):
        bench_rig.capture(engine, CaptureRequest(goal="white", codes=4))
    bench = bench_rig.bench_of(engine)
    assert bench_rig.are_panels_black(bench) and not bench.shutter_open


@pytest.mark.parametrize("wanted", [True, False])
@pytest.mark.parametrize(("device", "method"), [("display", "black"), ("shutter", "close")])
def test_a_job_after_which_the_rig_is_not_safe_says_so(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, device: str, method: str, wanted: bool
) -> None:
    def fail() -> None:
        raise DeviceLost("gone", device=device)

    broken = []

    def hear(event: Event) -> None:
        if isinstance(event, PicturesArchived):  # from here on
            broken.append(event)
            monkeypatch.setattr(getattr(engine._rig, device), method, fail)

    request = CaptureRequest(goal="white", codes=4)
    result = engine.capture(
        request, job="job", emit=hear, cancelled=lambda: bool(broken) and not wanted
    )
    assert result.state == ("done" if wanted else "cancelled")
    assert result.warnings[-1].startswith("the panels may still be lit, or the shutter open")
    monkeypatch.undo()
    again = engine.capture(
        request, job="job-2", emit=lambda event: None, cancelled=lambda: not wanted
    )
    assert not any("shutter open" in text for text in again.warnings)


def test_a_rig_whose_worker_fails_to_stop_is_released_and_one_that_fails_frees_its_worker(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped: list[str] = []

    def fail() -> None:
        raise RuntimeError("a fault of the program")

    monkeypatch.setattr(engine._rig, "disconnect", fail)
    monkeypatch.setattr(engine._worker, "stop", lambda: stopped.append("worker"))
    with pytest.raises(RuntimeError):
        engine.stop()
    assert stopped == ["worker"]
    monkeypatch.undo()


def test_a_calibration_that_cannot_have_its_card_leaves_the_rig_connected(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect = Rig.connect

    def refuse(rig: Rig) -> None:
        if rig is not engine._rig:
            raise DeviceLost("no bench with a card", device="camera")
        connects.append(len(disconnects))
        connect(rig)

    monkeypatch.setattr(Rig, "connect", refuse)
    connects: list[int] = []
    disconnects: list[Any] = []
    monkeypatch.setattr(engine._rig, "disconnect", lambda: disconnects.append(1))
    with pytest.raises(DeviceLost):
        engine._with_card()
    assert disconnects == connects == [1] and engine._rig.camera_info is not None


def test_a_scene_that_is_a_card_already_is_calibrated_as_it_stands(tmp_path: Path) -> None:
    engine = Engine.from_config(
        bench_rig.config(tmp_path, scene=SceneConfig(kind="card", grid=(3, 4)))
    )
    engine.start()
    assert engine._with_card() is engine._rig
    engine.stop()


def test_the_rig_that_goes_on_after_a_calibration_is_opened_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And that which took the photos is left alone by then: both hold the same devices."""
    engine = Engine.from_config(
        bench_rig.config(
            tmp_path,
            scene=SceneConfig(kind="card", grid=(3, 4)),
            calibration=CalibrationConfig(use="latest"),
        )
    )
    engine.start()
    before = engine._rig
    calls: list[tuple[str, bool]] = []

    def noted(name: str, real: Callable[[Rig], Any]) -> Callable[[Rig], Any]:
        def call(rig: Rig) -> Any:
            calls.append((name, rig is before))
            return real(rig)

        return call

    for name in ("connect", "disconnect", "make_safe"):
        monkeypatch.setattr(Rig, name, noted(name, getattr(Rig, name)))
    found = CaptureResult(job="job", state="done", folder=str(tmp_path), passed=True)
    monkeypatch.setattr(CalibrationRun, "execute", lambda run: found)
    result = engine.calibrate(
        CalibrateRequest(), job="job", emit=lambda event: None, cancelled=lambda: False
    )
    assert (result.job, result.passed) == ("job", True) and engine._rig is not before
    made = [name for name, old in calls if not old]
    assert made == ["connect"] and calls[-1] == ("connect", False)
    assert engine._rig.camera_info is not None
    engine.stop()


def test_a_rig_that_cannot_be_as_it_was_measured_goes_on_as_it_was(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(config: Config) -> CalibrationChoice:
        raise ConfigError("mask.rise_s cannot be so long")

    monkeypatch.setattr("pdcd.capture.engine.choose_calibration", refuse)
    before = engine._rig
    monkeypatch.setattr(engine, "_asked", Config(calibration=CalibrationConfig(use="latest")))
    connects: list[Rig] = []
    real = Rig.connect

    def connect(rig: Rig) -> None:
        connects.append(rig)
        real(rig)

    monkeypatch.setattr(Rig, "connect", connect)
    with pytest.raises(ConfigError):
        engine._adopt()
    assert connects == [before] and engine._rig is before
    assert bench_rig.capture(engine, CaptureRequest(goal="white", codes=4)).state == "done"
