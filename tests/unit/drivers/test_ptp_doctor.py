"""What the doctor says of a camera on the USB, and of none."""

from __future__ import annotations

import pytest
import usb.core

from drivers.ptp.codes import ExposureMode
from drivers.ptp.doctor import examine_ptp
from drivers.virtual_camera import CABLE_BODY, FaultScript
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext, Finding
from pdcd.bench.tables import CameraConfig, Config
from pdcd.errors import DriverUnavailable
from tests.ptp_rig import PtpRig


def ask(rig: PtpRig) -> list[Finding]:
    return list(examine_ptp(rig.context))


def test_the_doctor_says_all_there_is() -> None:
    rig = PtpRig()
    findings = ask(rig)
    found = {finding.what: finding.found for finding in findings}
    assert found["model"] == "Canon EOS 450D" and found["release over USB"] == "bulb"
    assert found["ISO"] == "100, 200, 400, 800, 1600" and found["bulb"] == "offered"
    assert found["long-exposure noise reduction"] == "off" and found["ready to expose"] == "yes"
    assert {finding.state for finding in findings} == {"good"}
    assert not rig.body.session_open and not rig.body.shutter.opened


@pytest.mark.parametrize(
    ("script", "word"),
    [(FaultScript(dial=ExposureMode.PROGRAM), "dial"), (FaultScript(battery=0), "charge")],
)
def test_the_doctor_ends_with_the_fault(script: FaultScript, word: str) -> None:
    last = ask(PtpRig(script))[-1]
    assert last.state == "fault" and word in f"{last.found} {last.hint}"


def test_the_doctor_minds_noise_reduction_and_a_body_for_a_cable() -> None:
    found = {f.what: f for f in ask(PtpRig(FaultScript(long_exposure_nr=True)))}
    reduction = found["long-exposure noise reduction"]
    assert reduction.state == "fault" and reduction.hint is not None
    (release,) = [f for f in ask(PtpRig(model=CABLE_BODY)) if f.what == "release over USB"]
    assert release.state == "warning" and release.found == "external"


def test_the_doctor_finds_no_camera() -> None:
    rig = PtpRig()
    rig.body.unplug()
    (finding,) = ask(rig)
    assert finding.state == "fault" and "no camera was found" in finding.found


def test_the_doctor_says_that_another_program_holds_it() -> None:
    rig = PtpRig()
    rig.usb.held_by_other = True
    last = ask(rig)[-1]
    assert last.state == "fault" and "held by" in last.found and "gio mount" in str(last.hint)


def test_the_doctor_lists_cameras_that_are_not_looked_for() -> None:
    rig = PtpRig(camera={"id": "04a9:1234"})
    first, last = ask(rig)
    assert "04a9:3145" in first.found and "passed over" in first.found
    assert last.state == "fault" and "no camera was found" in last.found


def test_wrong_options_are_a_finding() -> None:
    config = Config(camera=CameraConfig(driver="ptp", options={"ubs": "virtual"}))
    (finding,) = examine_ptp(DriverContext(config, VirtualClock()))
    assert finding.state == "fault" and "ubs" in finding.found


def test_without_libusb_the_driver_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def none_there(**_: object) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", none_there)
    with pytest.raises(DriverUnavailable, match=r"install libusb"):
        PtpRig().shutter.connect()
