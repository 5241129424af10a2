"""Exposures and photos of the virtual 450D through the real client: what works, what is refused.

The virtual camera checks what it is sent against its own state machine, and photos are compared
with what it exposed.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from drivers.ptp.codes import ExposureMode, FocusMode
from drivers.ptp.eos import EosCamera
from drivers.ptp.keepalive import KeepAlive
from drivers.virtual_camera import BULB_BODY, CABLE_BODY, RELEASE_BODY, FaultScript, PlainFilm
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import CameraSettings
from pdcd.bench.patience import Patience
from pdcd.errors import ConfigError, DeviceLost, ExposureError
from tests.places import ROOT
from tests.ptp_rig import SETTINGS, PtpRig


def test_the_camera_says_what_it_is_and_what_it_offers(rig: PtpRig) -> None:
    info = rig.readout.connect()
    assert info.model == "Canon EOS 450D" and info.isos == (100, 200, 400, 800, 1600)
    assert 8.0 in info.f_numbers and tuple(info.responsivity_e) == (4.8e6, 8.6e6, 5.6e6)
    assert rig.shutter.connect()["release"] == "bulb"


@pytest.mark.parametrize("seconds", [0.5, 30.0, 300.0])
def test_bulb_lasts_as_long_as_it_is_held(rig: PtpRig, tmp_path: Path, seconds: float) -> None:
    raw = rig.photo(tmp_path, "photo", seconds)
    (exposure,) = rig.body.shutter.exposures
    assert rig.is_photo_of(raw, exposure) and raw.path.name == "photo.cr2"
    lag_s = 0.06 + 4 * 0.01
    assert (exposure.close_ns - exposure.open_ns) * 1e-9 == pytest.approx(seconds + lag_s, abs=1e-6)
    assert exposure.iso == 100 and exposure.f_number == 8.0
    assert rig.body.store.in_ram == 0


def test_settings_are_those_of_the_body_or_refused_with_its_list(rig: PtpRig) -> None:
    with pytest.raises(ConfigError, match="100, 200, 400, 800, 1600"):
        rig.readout.arm(CameraSettings(iso=50, f_number=8.0))
    with pytest.raises(ConfigError, match=r"5\.6, .*, 32"):
        rig.readout.arm(CameraSettings(iso=100, f_number=1.4))
    rig.readout.arm(CameraSettings(iso=1600, f_number=11.0))
    assert rig.body.settings.iso == 1600 and rig.body.settings.f_number == 11.0
    assert rig.body.settings.bulb


def test_a_manual_lens_is_left_alone(tmp_path: Path) -> None:
    rig = PtpRig(model=replace(BULB_BODY, apertures=()))
    rig.connect()
    assert rig.readout.connect().f_numbers == ()
    with pytest.raises(ConfigError, match="leave it out"):
        rig.readout.arm(SETTINGS)
    rig.readout.arm(CameraSettings(100, None))
    rig.disconnect()


@pytest.mark.parametrize(
    ("script", "hint"),
    [
        (FaultScript(dial=ExposureMode.APERTURE_PRIORITY), "dial is not on M"),
        (FaultScript(focus=FocusMode.ONE_SHOT), "set the lens to MF"),
        (FaultScript(battery=0), "charge it"),
        (FaultScript(long_exposure_nr=True), "noise reduction is on"),
        (FaultScript(buffer_full=True), "no room in the camera"),
    ],
)
def test_a_camera_that_is_not_ready_is_not_released(script: FaultScript, hint: str) -> None:
    rig = PtpRig(script)
    rig.connect()
    with pytest.raises(ExposureError, match=hint):
        rig.readout.arm(SETTINGS)
    with pytest.raises(ExposureError):
        rig.shutter.open()
    assert rig.body.shutter.opened == 0
    rig.disconnect()


def test_newer_bodies_are_released_by_their_own_operations(tmp_path: Path) -> None:
    rig = PtpRig(model=RELEASE_BODY)
    assert rig.shutter.connect()["release"] == "remote"
    rig.readout.connect()
    raw = rig.photo(tmp_path, "photo", 3.0)
    assert rig.is_photo_of(raw, rig.body.shutter.exposures[0])
    rig.disconnect()


def test_a_body_without_release_needs_a_cable_and_goes_with_one(tmp_path: Path) -> None:
    rig = PtpRig(model=CABLE_BODY)
    with pytest.raises(ConfigError, match="external trigger"):
        rig.shutter.connect()
    rig.shutter.disconnect()
    cable = PtpRig(model=CABLE_BODY, trigger_driver="mock")
    cable.readout.connect()
    for name in ("one", "two"):
        cable.readout.arm(SETTINGS)
        cable.body.press()
        cable.wait(40.0)
        cable.camera.tick()
        cable.body.release()
        raw = cable.readout.fetch(tmp_path, name, 600.0)
        assert cable.is_photo_of(raw, list(cable.body.shutter.exposures)[-1])
    cable.readout.disconnect()


def test_a_photo_of_a_cable_release_that_nobody_fetched_is_not_taken_for_the_next(
    tmp_path: Path,
) -> None:
    rig = PtpRig(trigger_driver="mock")
    rig.readout.connect()
    rig.readout.arm(SETTINGS)
    rig.body.press()
    rig.wait(1.0)
    rig.body.release()  # and the capture is cancelled
    rig.readout.arm(SETTINGS)
    rig.body.press()
    rig.wait(2.0)
    rig.body.release()
    raw = rig.readout.fetch(tmp_path, "photo", 600.0)
    assert rig.is_photo_of(raw, list(rig.body.shutter.exposures)[-1])
    rig.readout.disconnect()


def test_a_cable_that_is_not_plugged_in_can_be_plugged_in(tmp_path: Path) -> None:
    rig = PtpRig(trigger_driver="mock")
    rig.readout.connect()
    rig.readout.arm(SETTINGS)
    with pytest.raises(ExposureError, match="no photo came"):
        rig.readout.fetch(tmp_path, "one", 600.0)
    rig.readout.arm(SETTINGS)  # cancelled
    rig.readout.arm(SETTINGS)
    rig.body.press()
    rig.wait(1.0)
    rig.body.release()
    raw = rig.readout.fetch(tmp_path, "two", 600.0)
    assert rig.is_photo_of(raw, rig.body.shutter.exposures[0])
    rig.readout.disconnect()


def test_photos_on_the_card_are_fetched_and_stay_there(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="twice"), camera={"destination": "card"})
    rig.connect()
    for name in ("one", "two", "three"):
        raw = rig.photo(tmp_path, name)
        assert rig.is_photo_of(raw, list(rig.body.shutter.exposures)[-1])
    assert len(rig.body.store.files) == 3 and rig.body.store.in_ram == 0
    rig.disconnect()


def test_with_another_readout_the_photos_go_to_the_card() -> None:
    rig = PtpRig(camera_driver="mock")
    rig.shutter.connect()
    rig.shutter.open()
    rig.wait(1.0)
    rig.shutter.close()
    rig.wait(1.0)
    (stored,) = rig.body.store.files.values()
    assert stored.on_card
    rig.shutter.open()
    rig.shutter.close()
    rig.shutter.disconnect()


def test_one_device_serves_both_roles_until_the_last_lets_go(rig: PtpRig) -> None:
    rig.shutter.open()
    rig.shutter.disconnect()
    assert rig.body.session_open and not rig.body.shutter.is_open
    rig.shutter.connect()
    rig.readout.disconnect()
    assert rig.body.session_open
    rig.shutter.open()
    rig.shutter.disconnect()
    assert not rig.body.session_open and not rig.body.shutter.is_open


def test_a_file_that_is_no_raw_file_is_refused(tmp_path: Path) -> None:
    rig = PtpRig(film=PlainFilm(lambda _: b"\xff\xd8\xff\xe1" + bytes(5000)))
    rig.connect()
    with pytest.raises(ExposureError, match="does not begin as a RAW file"):
        rig.photo(tmp_path, "photo")
    assert list(tmp_path.iterdir()) == [] and rig.body.store.in_ram == 0
    rig.disconnect()


def test_a_disk_that_refuses_leaves_nothing_and_frees_the_camera(
    rig: PtpRig, tmp_path: Path
) -> None:
    rig.expose()
    with pytest.raises(OSError, match="No such file"):
        rig.readout.fetch(tmp_path / "missing", "photo", 60.0)
    assert rig.body.store.in_ram == 0
    assert rig.is_photo_of(rig.photo(tmp_path, "next"), list(rig.body.shutter.exposures)[-1])


def test_fetch_before_the_shutter_is_closed_is_refused(rig: PtpRig, tmp_path: Path) -> None:
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    with pytest.raises(ExposureError, match="shutter is open"):
        rig.readout.fetch(tmp_path, "photo", 60.0)
    rig.shutter.close()


def test_a_tick_keeps_the_camera_on_and_leaves_a_busy_one_alone(rig: PtpRig) -> None:
    kept = rig.body.kept_on
    rig.camera.tick()
    assert rig.body.kept_on == kept + 1
    with rig.camera.session.hold():
        other = threading.Thread(target=rig.camera.tick)
        other.start()
        other.join()
    assert rig.body.kept_on == kept + 1


def test_the_thread_ticks_on_past_an_error_and_ends_when_told() -> None:
    ticks: list[None] = []
    enough = threading.Event()

    def tick() -> None:
        ticks.append(None)
        if len(ticks) == 3:
            enough.set()
        raise DeviceLost("unplugged", device="camera")

    thread = KeepAlive(tick, 0.001)
    assert enough.wait(60.0)
    thread.stop()
    count = len(ticks)
    assert not thread._thread.is_alive() and len(ticks) == count


def test_a_shutter_open_for_too_long_is_closed_and_the_exposure_spoiled(rig: PtpRig) -> None:
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.wait(599.0)
    rig.camera.tick()
    assert rig.body.shutter.is_open
    rig.wait(12.0)
    rig.camera.tick()
    assert not rig.body.shutter.is_open
    with pytest.raises(ExposureError, match="max_exposure_s"):
        rig.shutter.close()
    rig.shutter.close()


def test_a_shutter_nobody_holds_any_more_is_closed() -> None:
    rig = PtpRig()
    rig.connect()
    rig.readout.disconnect()
    rig.shutter.open()
    body = rig.body
    assert body.shutter.is_open
    del rig
    gc.collect()
    assert not body.shutter.is_open and not body.session_open


@pytest.mark.long
@pytest.mark.parametrize("end", ["pass", "raise SystemExit(1)", "raise RuntimeError('x')"])
def test_the_end_of_the_interpreter_closes_the_shutter(end: str, tmp_path: Path) -> None:
    said = tmp_path / "said"
    script = f"""
import atexit, pathlib
from tests.ptp_rig import PtpRig
rig = PtpRig()
body = rig.body
atexit.register(lambda: None)
rig.connect()
rig.shutter.open()
assert body.shutter.is_open
closed = body.shutter.close
def close():
    closed()
    pathlib.Path({str(said)!r}).write_text("closed")
body.shutter.close = close
{end}
"""
    subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, check=False, timeout=60, stderr=subprocess.PIPE
    )
    assert said.read_text() == "closed"


def test_a_camera_held_by_another_program_is_named(rig: PtpRig) -> None:
    rig.disconnect()
    rig.usb.held_by_other = True
    with pytest.raises(DeviceLost, match=r"04a9:3145 on bus 1.* is held by .*gio mount"):
        rig.shutter.connect()
    rig.usb.held_by_other = False
    rig.shutter.connect()


def test_unplugged_while_it_exposes(rig: PtpRig, tmp_path: Path) -> None:
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.body.unplug()
    for _ in range(3):
        with pytest.raises(DeviceLost):
            rig.shutter.close()
    assert rig.body.shutter.is_open  # and nobody believes otherwise
    rig.body.replug()
    with pytest.raises(ExposureError, match="spoiled"):
        rig.shutter.close()
    assert not rig.body.shutter.is_open
    rig.shutter.close()
    raw = rig.photo(tmp_path, "photo")
    assert rig.is_photo_of(raw, list(rig.body.shutter.exposures)[-1])


def test_unplugged_for_good_everything_can_still_be_let_go(rig: PtpRig) -> None:
    rig.body.unplug()
    with pytest.raises(DeviceLost):
        rig.readout.arm(SETTINGS)
    rig.disconnect()
    rig.disconnect()


def test_the_options_choose_the_body(rig: PtpRig) -> None:
    other = PtpRig(camera={"serial": "7"})
    with pytest.raises(DeviceLost, match="no camera has serial number 7"):
        other.shutter.connect()
    other = PtpRig(camera={"id": "04a9:1234"})
    with pytest.raises(DeviceLost, match="no camera was found"):
        other.shutter.connect()
    other = PtpRig(camera={"serial": rig.body.model.info.serial, "id": "04A9:3145"})
    other.connect()
    other.disconnect()


def test_a_dial_with_bulb_on_it_does_as_well(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(dial=ExposureMode.BULB))
    rig.connect()
    rig.readout.arm(CameraSettings(100, None))
    rig.shutter.open()
    rig.wait(2.0)
    rig.shutter.close()
    raw = rig.readout.fetch(tmp_path, "photo", 60.0)
    assert rig.is_photo_of(raw, rig.body.shutter.exposures[0])
    rig.disconnect()


def test_the_thread_may_be_stopped_from_within_its_own_tick() -> None:
    made: list[KeepAlive] = []
    began, stopped = threading.Event(), threading.Event()

    def tick() -> None:
        assert began.wait(30.0)
        made[0].stop()
        stopped.set()

    made.append(KeepAlive(tick, 0.001))
    began.set()
    assert stopped.wait(30.0)
    made[0].stop()


def test_what_a_camera_says_when_nobody_holds_it_is_logged_but_no_fault_of_ours(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def camera(error: Exception) -> Any:
        patience = Patience(RealClock())
        return SimpleNamespace(close=Mock(side_effect=error), patience=patience)

    EosCamera.let_go(camera(DeviceLost("unplugged", device="camera")), "shutter")
    assert "unplugged" in caplog.text
    with pytest.raises(AttributeError):
        EosCamera.let_go(camera(AttributeError("bulb")), "shutter")
