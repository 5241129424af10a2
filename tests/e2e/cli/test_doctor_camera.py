"""`pdcd doctor camera` and `doctor trigger`: virtual bodies, fake lines, and nothing at all."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usb.core

from drivers.mock import MockBench, MockShutter
from drivers.virtual_camera import FaultScript, VirtualUsb
from pdcd.bench.click import examine_shutter
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import Finding
from pdcd.bench.tables import CameraConfig, Config, TriggerConfig
from pdcd.cli.main import main
from tests.fake_serial import FakeLine, fake_line
from tests.form_dng import DngFile, write_dng_form
from tests.genicam_rig import needs_aravis, turn
from tests.placed_film import Shot, masked_dng

BODY = {"usb": "virtual"}


def config(folder: Path, text: str) -> str:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def ask(capfd: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    """Exit code, and findings by what was looked at."""
    code = main(["doctor", *words, "--json"])
    (line,) = capfd.readouterr().out.splitlines()
    answer = json.loads(line)
    assert answer["fit"] is (code == 0)
    return code, {f["what"]: f for f in answer["findings"]}


def test_a_body_on_the_virtual_usb(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = config(tmp_path, '[camera]\ndriver = "ptp"\noptions = {usb = "virtual"}\n')
    code, found = ask(capfd, "camera", "--config", path)
    assert code == 0
    assert found["model"]["found"] == "Canon EOS 450D"
    assert found["release over USB"]["found"] == "bulb"
    assert found["long-exposure noise reduction"]["found"] == "off"
    assert found["frame"]["state"] == "unknown"  # the sensor profile "modern" is of no body
    assert main(["doctor", "camera", "--config", path]) == 0
    assert capfd.readouterr().out.endswith("nothing to mend so far; not tried: frame\n")


def test_the_frame_of_a_450d(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """By its profile, and by a photo that was taken on its side."""
    text = '[camera]\ndriver = "ptp"\nprofile = "450d"\noptions = {usb = "virtual"}\n'
    path = config(tmp_path, text)
    code, found = ask(capfd, "camera", "--config", path)
    assert code == 0
    assert found["frame"]["found"] == "2145 x 1428 quads, by the sensor profile"
    assert found["orientation"]["state"] == "unknown"
    assert found["pixels along a cell's side"]["found"] == "29.8 to 33.5"
    assert found["field seen"]["found"] == "100 % of 48 x 64 cells"
    photo = tmp_path / "photo.dng"
    samples = np.full((80, 120), 600, np.uint16)
    photo.write_bytes(masked_dng(Shot(samples, 512, 16383, 100, 8.0, 1.0, orientation=6)))
    code, found = ask(capfd, "camera", "--config", path, "--raw", str(photo))
    assert found["frame"]["found"] == "60 x 40 quads, of test camera"
    assert found["orientation"]["found"].startswith("turned by 90 right; not followed")
    assert found["masked border"]["found"] == "6 rows and 30 columns beyond the picture"
    # 60 x 40 quads for 64 x 48 cells, in quarter windows unless told otherwise.
    (fault,) = [f for f in found.values() if f["state"] == "fault"]
    assert code == 5 and "does not resolve single cells" in fault["found"]
    photo.write_bytes(photo.read_bytes()[:100])
    code, found = ask(capfd, "camera", "--config", path, "--raw", str(photo))
    assert code == 5 and "cannot decode photo.dng" in found["frame"]["found"]


def test_a_photo_is_decoded_as_a_capture_would(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, photo = config(tmp_path, '[camera]\nprofile = "450d"\n'), tmp_path / "photo.dng"
    image = np.random.default_rng(0).normal(1500.0, 20.0, (160, 200)).astype(np.uint16)
    file = DngFile(black=((250.5, 256.0), (256.0, 256.0)), masked=(0, 0, 160, 20))
    data = write_dng_form(photo, image, file)
    _, found = ask(capfd, "camera", "--config", path, "--raw", str(photo))
    levels = "black 250.5, 256, 256, 256 DN by the tags, white 4095 DN, mosaic RGGB"
    assert found["levels"]["found"] == levels
    assert found["levels in doubt"]["state"] == "warning"
    assert "lie in the picture" in found["levels in doubt"]["found"]
    photo.write_bytes(data[:-20_000] + bytes(20_000))  # the head is whole
    code, found = ask(capfd, "camera", "--config", path, "--raw", str(photo))
    assert code == 5 and "not all samples are in it" in found["frame"]["found"]
    assert found["frame"]["hint"] == "fetch it from the camera again"


@pytest.mark.parametrize("libusb", [True, False])
def test_without_any_usb(
    libusb: bool, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def nothing(**_: object) -> list[object]:
        if libusb:
            return []
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", nothing)
    code, found = ask(capfd, "camera")
    assert code == 5
    assert found["configuration"]["state"] == "warning"  # the mock bench names no body
    assert found["camera"]["state"] == "fault"
    assert ("no camera was found" if libusb else "libusb") in found["camera"]["found"]
    assert found["camera"]["hint"]


@needs_aravis
def test_the_virtual_machine_vision_camera(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = "".join(f'[{table}]\ndriver = "virtual-genicam"\n' for table in ("trigger", "camera"))
    path = config(tmp_path, text + 'profile = "mono"\nframe_quads = [200, 150]\n')
    with turn():
        code, found = ask(capfd, "camera", "--config", path)
        assert code == 0 and {f["state"] for f in found.values()} <= {"good", "unknown"}, found
        assert "virtual GenICam V1 at 127.0.0.1" in found["camera that answers"]["found"]
        assert found["picture"]["found"] == "200 x 150 pixels of Mono12p"
        assert found["frame"]["found"] == "200 x 150 pixels, by the camera"
        assert found["field seen"]["found"] == "100 % of 48 x 64 cells"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 3956))  # somebody else is a camera
            code, found = ask(capfd, "camera", "--config", path)
        assert code == 5 and "cannot listen" in found["camera"]["found"]


@pytest.mark.parametrize(("options", "state", "told"), [
    ('folder = "."', "good", "folder, "), ('file = "."', "fault", "folder: must be given"),
])  # fmt: skip
def test_a_camera_that_no_doctor_knows_is_asked_by_its_readout(
    options: str, state: str, told: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = config(tmp_path, f'[camera]\ndriver = "folder"\n[camera.options]\n{options}\n')
    code, found = ask(capfd, "camera", "--config", path)
    finding = found["driver" if state == "good" else "camera"]
    assert finding["state"] == state and told in finding["found"]
    assert code == (0 if state == "good" else 5)
    assert "configuration" not in found  # no other camera is looked for


def test_no_click_without_the_word(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """To open a port is to move its lines: that is not done either."""
    with fake_line("box", VirtualClock()) as line:
        path = config(tmp_path, '[trigger]\ndriver = "serial"\noptions = {port = "line://box"}\n')
        code, found = ask(capfd, "trigger", "--config", path)
        assert code == 0 and line.opened == 0 and not line.edges
    assert found["click"]["state"] == "unknown" and "--click" in found["click"]["hint"]


SERIAL = """
[trigger]
driver = "serial"
lag_s = 0.05
jitter_s = 0.01
options = {port = "line://box", feedback = "cts", answer_s = 0.2}
"""


def test_a_click_of_the_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with fake_line("box", VirtualClock()) as line:
        line.cts = lambda: line.levels("rts")[-1]
        code, found = ask(capfd, "trigger", "--config", config(tmp_path, SERIAL), "--click")
        assert line.levels("rts").count(True) == 1 and line.levels("rts")[-1] is False
    assert code == 0
    assert found["feedback"]["found"] == "cts" and found["watchdog"]["found"] == "alarm"
    assert found["open"]["found"] == "surely open 0.0 ms after the order"  # by the contact
    assert found["close"]["found"] == "surely closed 90.0 ms after the order"  # lag + 4 jitters


def test_feedback_that_does_not_come(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with fake_line("box", VirtualClock()) as line:
        code, found = ask(capfd, "trigger", "--config", config(tmp_path, SERIAL), "--click")
        assert line.levels("rts").count(True) == 1 and line.levels("rts")[-1] is False
    assert code == 5 and "open" not in found
    assert "CTS" in found["trigger"]["found"] and "cable" in found["trigger"]["hint"]


def test_a_port_that_is_not_there(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = '[rig]\nclock = "real"\n' + SERIAL.replace("line://box", "/dev/pdcd-none")
    code, found = ask(capfd, "trigger", "--config", config(tmp_path, text), "--click")
    assert code == 5 and "/dev/pdcd-none" in found["trigger"]["found"]


def click(**tables: Any) -> dict[str, Finding]:
    return {f.what: f for f in examine_shutter(Config(**tables), click=True, seconds=2.0)}


def test_a_body_is_armed_and_its_photo_fetched() -> None:
    """Without that it would not open, or keep the photo for the next capture."""
    found = click(
        camera=CameraConfig(driver="ptp", f_number=8.0, options=BODY),
        trigger=TriggerConfig(driver="ptp"),
    )
    assert all(finding.state == "good" for finding in found.values()), found
    assert found["camera"].found == "Canon EOS 450D" and "bytes" in found["photo"].found


def test_a_body_that_sends_no_photo(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[VirtualUsb] = []
    first = VirtualUsb.__init__

    def init(self: VirtualUsb, body: Any) -> None:
        body.shutter._script = FaultScript(file="none")
        first(self, body)
        made.append(self)

    monkeypatch.setattr(VirtualUsb, "__init__", init)
    found = click(
        camera=CameraConfig(driver="ptp", f_number=8.0, options=BODY),
        trigger=TriggerConfig(driver="ptp"),
    )
    assert found["close"].state == "good" and found["trigger"].state == "fault"
    assert "no photo" in found["trigger"].found
    (backend,) = made
    assert backend.body.shutter.opened == 1 and not backend.body.shutter.is_open


def test_the_mock_bench_and_panels_that_stay_black() -> None:
    assert "bytes" in click()["photo"].found


def test_an_interrupt_closes_the_shutter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    benches: list[MockBench] = []
    opened = MockShutter.open

    def open_then_signal(self: MockShutter) -> int:
        benches.append(self._bench)
        opened(self)
        signal.raise_signal(signal.SIGTERM)
        return 0

    monkeypatch.setattr(MockShutter, "open", open_then_signal)
    assert main(["doctor", "trigger", "--click"]) == 130
    assert not benches[0].shutter_open
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    capfd.readouterr()


def test_a_driver_that_does_not_import(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = config(tmp_path, '[trigger]\ndriver = "none-such"\n')
    code, found = ask(capfd, "trigger", "--config", path)
    assert code == 5 and "none-such" in found["trigger"]["found"]


def test_the_line_is_not_left_pressed_when_nobody_reads_on() -> None:
    """The findings are made one by one; who stops half-way leaves a closed shutter."""
    line: FakeLine
    with fake_line("box", VirtualClock()) as line:
        trigger = TriggerConfig(driver="serial", options={"port": "line://box"})
        findings = examine_shutter(Config(trigger=trigger), click=True)
        next(f for f in findings if f.what == "open")
        assert line.levels("rts")[-1] is True
        findings.close()  # type: ignore[attr-defined]
        assert line.levels("rts")[-1] is False


def look(folder: Path, capfd: pytest.CaptureFixture[str], port: Path | str) -> tuple[int, Any]:
    """Exit code and finding of a port that is looked at only."""
    text = (
        f"""[rig]\nclock = "real"\n[trigger]\ndriver = "serial"\noptions = {{port = "{port}"}}\n"""
    )
    code, found = ask(capfd, "trigger", "--config", config(folder, text))
    return code, found["port"]


def test_a_port_that_is_a_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "port").touch()
    code, port = look(tmp_path, capfd, tmp_path / "port")
    assert code == 5 and "is no device" in port["found"]


def test_a_port_that_is_there_is_not_opened(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = pty.openpty()
    (tmp_path / "trigger").symlink_to(os.ttyname(theirs))
    try:
        code, port = look(tmp_path, capfd, tmp_path / "trigger")
        assert code == 0 and port["state"] == "good"
        assert port["found"] == f"{tmp_path / 'trigger'}, which is {os.ttyname(theirs)}"
        monkeypatch.setattr(os, "access", lambda *_: False)  # root may always
        code, port = look(tmp_path, capfd, os.ttyname(theirs))
        assert code == 5 and "may not be read" in port["found"] and "group" in port["hint"]
    finally:
        os.close(ours)
        os.close(theirs)
