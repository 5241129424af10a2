"""Panels and a camera under a running systemd, and what the sandbox lets through to devices."""

from __future__ import annotations

import re
import shutil

import pytest

from pdcd.protocol.request import CaptureRequest
from tests.e2e.systemd.test_x_service import adapted
from tests.running_systemd.machine import UNITS, Machine, wait_until
from tests.running_systemd.service import CAPTURE_TOML, Line, Service
from tests.tools import missing
from tests.xserver import FULL, QUARTER, modeline

SMALL = CaptureRequest(goal="indirect", codes=16, window="whole", white=False)
PANELS_TOML = """
[rig]
clock = "real"
on_miss = "flag"
settle_s = 0.03
[projector]
size_px = [256, 192]
[mask]
size_px = [400, 300]
[display]
driver = "x11"
[display.options]
projector = "DUMMY1"
mask = "DUMMY0"
display = ":7"
allow_software = true
time_source = "present-msc"
hang_s = 20.0
[camera]
noise = "none"
f_number = 8.0
[scene]
grid = [12, 16]
"""
CAMERA_TOML = """
[rig]
clock = "real"
[camera]
driver = "ptp"
profile = "450d"
iso = 100
f_number = 8.0
[camera.options]
usb = "virtual"
[trigger]
driver = "ptp"
[scene]
grid = [12, 16]
"""


@pytest.fixture
def panels(service: Service) -> Service:
    """The X server's unit as it is, started; its configuration is for the dummy driver."""
    if gone := missing("xorg", "dummy", "xauth", "mcookie"):
        pytest.skip(gone)
    machine = service.machine
    machine.write("/etc/pdcd/xorg.conf", _small(adapted()))
    drop_ins = machine.inside("/run/systemd/system/pdcd.service.d")
    drop_ins.mkdir(parents=True, exist_ok=True)
    shutil.copy(UNITS / "pdcd.service.d/x.conf", drop_ins)
    machine.systemctl("daemon-reload")
    machine.systemctl("start", "pdcd-x.service")
    return service


def test_a_capture_on_real_windows_and_a_stop_that_leaves_them_black(
    panels: Service, line: Line
) -> None:
    """The second part has the box on the line as shutter: the mock camera needs the mock one."""
    machine = panels.machine
    panels.configure(PANELS_TOML)
    with panels.connect() as client:
        result = client.capture(SMALL)
    assert result.state == "done", result.error
    machine.systemctl("stop", "pdcd.service")
    panels.configure(PANELS_TOML + line.toml)
    with panels.connect() as client:
        panels.in_exposure(client)
        line.hears("01")
        wait_until(lambda: _lit(machine), "a code on the panels")
        machine.systemctl("stop", "pdcd.service")
        line.hears("0")
    assert not _lit(machine)
    assert machine.shows("ActiveState", "pdcd-x.service") == "active"


def test_without_its_x_server_the_daemon_stops_and_comes_back_with_it(panels: Service) -> None:
    """Bound to it by the drop-in; a connection starts both."""
    machine = panels.machine
    panels.configure(PANELS_TOML)
    with panels.connect():
        pass
    machine.systemctl("stop", "pdcd-x.service")
    wait_until(lambda: machine.shows("ActiveState") == "inactive", "the daemon's end")
    with panels.connect() as client:
        assert client.status().state == "idle"
    assert machine.shows("ActiveState", "pdcd-x.service") == "active"


def test_the_virtual_camera_takes_its_photos_in_the_sandbox(service: Service) -> None:
    service.configure(CAMERA_TOML)
    with service.connect() as client:
        result = client.capture(SMALL)
    assert result.state == "done", result.error
    (folder,) = service.captures()
    assert list((folder / "raw").glob("*.cr2")) or list((folder / "raw").glob("*.CR2"))


def test_a_port_of_another_machine_needs_a_drop_in(service: Service) -> None:
    """`rfc2217://`: no network in the sandbox, and the error is a typed one."""
    toml = '[trigger]\ndriver = "serial"\n[trigger.options]\nport = "rfc2217://127.0.0.1:9"\n'
    service.configure(CAPTURE_TOML + toml)
    machine = service.machine
    machine.run("systemctl", "start", "pdcd.service", check=False)
    assert "Address family not supported" in machine.journal("-n", "30")
    service.drop_in("RestrictAddressFamilies=AF_INET AF_INET6", "IPAddressAllow=localhost")
    machine.run("systemctl", "reset-failed")
    machine.run("systemctl", "start", "pdcd.service", check=False)
    assert "Connection refused" in machine.journal("-n", "30")  # it got as far as the network


def _small(text: str) -> str:
    """The configuration with panels of a quarter of their size, which software draws in time."""
    for size, small in zip(FULL, QUARTER, strict=True):
        name = f"{size[0]}x{size[1]}-matched"
        text = re.sub(f'Modeline "{name}".*', f"Modeline {modeline(name, small, 60.0)}", text)
    text = text.replace('"Position" "1024 0"', f'"Position" "{QUARTER[0][0]} 0"')
    return re.sub("Virtual .*", f"Virtual {QUARTER[0][0] + QUARTER[1][0]} {QUARTER[1][1]}", text)


_LOOK = "from pdcd.presenter.xgrab import RootGrabber; print(RootGrabber(':7').grab().any())"


def _lit(machine: Machine) -> bool:
    """Whether any pixel of the whole X screen is lit."""
    look = ("env", "XAUTHORITY=/run/pdcd-x/auth", "python", "-W", "ignore", "-c", _LOOK)
    return machine.run(*look).stdout == "True\n"
