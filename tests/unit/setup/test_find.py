"""What is found: connectors of a kernel, serial ports, cameras, and what could not be looked at."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.genicam import aravis
from drivers.ptp import usb_port
from drivers.serial_shutter import look
from pdcd.errors import DriverUnavailable, PdcdError
from pdcd.setup.facts import CameraFact
from pdcd.setup.find import find_bench_facts, list_connectors
from tests.edid_block import block


def test_connectors_have_the_names_that_the_server_gives_them(tmp_path: Path) -> None:
    for name, status, edid in (
        ("card0-HDMI-A-1", "connected", block(name="EPSON PJ", serial="X4K7")),
        ("card1-DP-2", "connected", b""),  # an adapter that says nothing
        ("card0-eDP-1", "connected", block()),
        ("card0-DP-1", "disconnected", b""),
        ("card0-HDMI-A-2", "", b""),
    ):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "status").write_text(f"{status}\n")
        (folder / "edid").write_bytes(edid)
    (tmp_path / "card0").mkdir()
    (tmp_path / "card0-Writeback-1").mkdir()  # whose files cannot be read
    found = list(list_connectors(tmp_path))
    assert [output.name for output in found] == ["HDMI-1", "eDP-1", "DP-2"]
    assert found[0].edid is not None and found[0].edid.serial == "X4K7"
    assert found[0].timings[0].size == (1600, 1200) and found[2].timings == ()
    assert list(list_connectors(tmp_path / "gone")) == []


def test_serial_ports_by_their_lasting_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ttyUSB0", "ttyUSB1", "ttyACM0", "ttyS0", "ttyS1", "tty1", "ttySomething"):
        (tmp_path / name).touch()
    lasting = tmp_path / "serial/by-id"
    lasting.mkdir(parents=True)
    (lasting / "usb-FTDI-A5").symlink_to("../../ttyUSB1")
    monkeypatch.setattr(look, "_has_chip", lambda name: name == "ttyS1")
    found = look.list_serial_ports(tmp_path)
    names = [str(Path(path).relative_to(tmp_path)) for path in found]
    assert names == ["ttyUSB0", "serial/by-id/usb-FTDI-A5", "ttyACM0", "ttyS1"]


@pytest.fixture
def nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with no server, camera or port."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("pdcd.setup.find.DRM", Path("/nowhere"))
    monkeypatch.setattr(usb_port, "find_still_image_devices", lambda _: [])
    monkeypatch.setattr(aravis, "list_cameras", list)
    monkeypatch.setattr(look, "list_serial_ports", tuple)


@pytest.mark.usefixtures("nothing")
def test_cameras_and_the_drivers_that_speak_to_them(monkeypatch: pytest.MonkeyPatch) -> None:
    devices = [
        SimpleNamespace(idVendor=vendor, idProduct=product, bus=1, address=product & 15)
        for vendor, product in ((0x04A9, 0x3145), (0x04A9, 0x3199), (0x04B0, 0x0412))
    ]
    vision = aravis.FoundCamera("Maker-S1", "Maker", "M1", "S1", "10.0.0.7", "GigEVision")
    monkeypatch.setattr(usb_port, "find_still_image_devices", lambda _: devices)
    monkeypatch.setattr(aravis, "list_cameras", lambda: [vision])
    facts = find_bench_facts()
    assert [(c.driver, c.key, c.profile) for c in facts.cameras] == [
        ("ptp", "04a9:3145", "450d"), ("ptp", "04a9:3199", "modern"),
        ("gphoto2", "04b0:0412", "modern"), ("genicam", "S1", "modern"),
    ]  # fmt: skip
    assert isinstance(facts.cameras[0], CameraFact) and "bus 1" in facts.cameras[0].words
    assert facts.outputs == () and facts.server is None
    (note,) = facts.notes
    assert "04b0:0412" in note and "gphoto2" in note


def raising(error: Exception) -> Any:
    def fail(*_: object) -> Any:
        raise error

    return fail


@pytest.mark.usefixtures("nothing")
def test_what_cannot_be_looked_at_is_said_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unavailable = DriverUnavailable("libusb is not installed", device="camera")
    monkeypatch.setattr(usb_port, "find_still_image_devices", raising(unavailable))
    monkeypatch.setattr(aravis, "list_cameras", raising(ModuleNotFoundError("aravis")))
    monkeypatch.setenv("DISPLAY", ":4711")
    notes = find_bench_facts().notes
    assert [text.split()[0] for text in notes] == ["the", "USB:", "machine-vision"]
    assert "X server :4711 does not answer" in notes[0] and "libusb" in notes[1]
    with pytest.raises(PdcdError, match=":4712 does not answer"):
        find_bench_facts(":4712")  # which was named
