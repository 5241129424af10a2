"""Whole captures with the PTP drivers on the virtual 450D, beside the same with the mock camera."""

from __future__ import annotations

import itertools
import re
import signal
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.ptp.codes import Operation
from drivers.ptp.eos import EosCamera
from drivers.virtual_camera import CameraBody, FaultScript, ScriptedFault, make_bench_backend
from pdcd.bench import config as settings
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.events import Progress
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.processes import LONG_S
from tests.real_daemon import connect, serving

OPTIONS = {"usb": "virtual"}


def ptp(folder: Path, f_number: Any = 8.0, **tables: Any) -> Config:
    """The small bench with camera and trigger over PTP."""
    camera = CameraConfig(driver="ptp", noise="none", f_number=f_number, options=OPTIONS)
    return bench_rig.config(folder, camera=camera, trigger=TriggerConfig(driver="ptp"), **tables)


def run(
    config: Config, script: FaultScript | None = None, **fields: Any
) -> tuple[CaptureResult, CameraBody | None]:
    engine = Engine.from_config(config)
    context = engine._rig._context
    body = None
    if config.camera.driver == "ptp":
        backend = make_bench_backend(context, script=script)
        EosCamera.of(context).session._backend = backend
        body = backend.body
    engine.start()
    request = msgspec.convert({"goal": "indirect", "codes": 16, **fields}, CaptureRequest)
    result = bench_rig.capture(engine, request)
    engine.stop()
    return result, body


def image_of(result: CaptureResult) -> np.ndarray[Any, np.dtype[np.float64]]:
    assert result.error is None and result.folder is not None, result.error
    with np.load(Path(result.folder) / "probe.npz") as data:
        return np.asarray(data["image"])


@pytest.mark.parametrize("f_number", [8.0, "auto"])
def test_the_answer_is_that_of_the_mock_camera(tmp_path: Path, f_number: Any) -> None:
    """Same bench, same codes; only the lens has the stops of a real one where it is metered."""
    (tmp_path / "mock").mkdir()
    (tmp_path / "ptp").mkdir()
    mock = CameraConfig(noise="none", f_number=f_number)
    expected, _ = run(bench_rig.config(tmp_path / "mock", camera=mock))
    result, body = run(ptp(tmp_path / "ptp", f_number))
    image, wanted = image_of(result), image_of(expected)
    if f_number == 8.0:
        np.testing.assert_array_equal(image, wanted)
    else:  # another aperture rounds otherwise
        np.testing.assert_allclose(image, wanted, atol=2e-3 * float(wanted.max()))
    assert body is not None and body.store.in_ram == 0 and not body.session_open
    assert result.folder is not None
    manifest = read_manifest(Path(result.folder))
    assert manifest.drivers["camera"]["model"] == "Canon EOS 450D"
    names = {shot.raw for shot in manifest.run.shots} | {test.raw for test in manifest.meter}
    assert names <= set(manifest.files) and all(name.endswith(".cr2") for name in names)
    assert body.shutter.opened == len(names)


def test_who_waits_for_a_camera_shows_that_he_lives(tmp_path: Path) -> None:
    """The watchdog of the service allows 20 s without a sign: less than some waits take."""
    engine = Engine.from_config(ptp(tmp_path))
    context = engine._rig._context
    faults = (ScriptedFault("deaf", Operation.EOS_BULB_END, 2),)
    backend = make_bench_backend(context, script=FaultScript(wire=faults, file="late", late_s=25.0))
    EosCamera.of(context).session._backend = backend
    signs_ns = [engine._rig.clock.now_ns()]

    def cancelled() -> bool:
        signs_ns.append(engine._rig.clock.now_ns())
        return False

    engine.start()
    request = CaptureRequest(goal="white", codes=4)
    engine.capture(request, job="job", emit=lambda _: None, cancelled=cancelled)
    signs_ns.append(engine._rig.clock.now_ns())
    engine.stop()
    assert signs_ns[-1] - signs_ns[0] > 20e9
    assert max(b - a for a, b in itertools.pairwise(signs_ns)) < 12e9


@pytest.mark.parametrize(
    ("script", "kind"),
    [
        (FaultScript(wire=(ScriptedFault("unplug", Operation.EOS_BULB_END, 2),)), "device_lost"),
        (FaultScript(wire=(ScriptedFault("mute", Operation.EOS_BULB_START),)), "exposure"),
        (FaultScript(file="none"), "exposure"),
        (FaultScript(file="truncated"), "exposure"),
        (FaultScript(wire=(ScriptedFault("corrupt", Operation.GET_PARTIAL_OBJECT),)), "exposure"),
    ],
)
def test_a_fault_ends_the_job_by_its_kind_and_leaves_no_photo(
    tmp_path: Path, script: FaultScript, kind: str
) -> None:
    result, body = run(ptp(tmp_path), script)
    assert result.state == "failed" and result.error is not None
    assert result.error["kind"] == kind and result.error["hint"]
    assert not [name for name in result.files if name.startswith("raw/")]
    assert body is not None and body.shutter.opened == 1
    assert not list(tmp_path.rglob("capture.json"))


@pytest.mark.long
def test_a_signal_in_mid_exposure_lets_go_of_the_shutter(tmp_path: Path) -> None:
    path, socket, said = tmp_path / "pdcd.toml", tmp_path / "s", tmp_path / "stderr"
    path.write_text(settings.format_config(ptp(tmp_path, rig=RigConfig(clock="real"))))
    words = ("--config", path, "--socket", socket)
    with said.open("wb") as stderr, serving(*words, stderr=stderr) as process:
        with connect(socket) as client:
            client.call("capture.start", {"goal": "indirect", "codes": 512, "white": False})
            client.call("events.subscribe", {"jobs": "all"})
            next(e for e in client.events() if isinstance(e, Progress) and e.frame > 0)
            process.send_signal(signal.SIGTERM)
            assert process.wait(timeout=LONG_S) == 0
    assert re.findall(r"shutter (held open|let go)", said.read_text()) == ["held open", "let go"]
