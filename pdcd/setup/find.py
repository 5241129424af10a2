"""Looks for the devices of a bench on a machine: opens nothing that could move, shows nothing."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from pdcd.bench.registry import import_driver_module
from pdcd.errors import ConfigError, DriverUnavailable, PdcdError
from pdcd.extras import suggest_install
from pdcd.presenter.desktop import inspect_desktop
from pdcd.presenter.edid import parse_edid
from pdcd.presenter.outputs import Output, has_overlap, read_outputs
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from pdcd.setup.facts import BenchFacts, CameraFact, PortFact

DRM = Path("/sys/class/drm")
"""The kernel's folder of connectors."""
_CARDS = Path("/dev/dri")
_PROFILES = {"04a9:3145": "450d"}
"""Sensor profiles by USB vendor and product."""
_CANON = "04a9:"


def find_bench_facts(display_name: str | None = None) -> BenchFacts:
    """Everything that can be seen from here.

    display_name : X server to examine; None: $DISPLAY, if set. A server with a desktop on it is
    used only for its outputs, and only if the kernel lists none: drivers name outputs differently.
    """
    notes: list[str] = []
    outputs, server = _ask_server(display_name, notes)
    if server is None:
        outputs = tuple(list_connectors(DRM)) or outputs
    return BenchFacts(
        tuple(o for o in outputs if o.connected),
        server,
        _CARDS.exists(),
        (*_usb_cameras(notes), *_genicam_cameras(notes)),
        tuple(_ports()),
        tuple(notes),
    )


def _ask_server(name: str | None, notes: list[str]) -> tuple[tuple[Output, ...], str | None]:
    """Outputs of an X server, and its name if nothing but a bench is on it."""
    if not (name or os.environ.get("DISPLAY")):
        return (), None
    try:
        display = open_x_connection(name)
    except PdcdError as err:
        if name is not None:
            raise
        notes.append(err.message)
        return (), None
    try:
        outputs = sorted(read_outputs(display), key=lambda o: (not o.on, o.x, o.y, o.name))
        on = [o for o in outputs if o.connected and o.on]
        desktop = inspect_desktop(display)
        bare = desktop.compositor is None and desktop.window_manager is None
        apart = not any(has_overlap(a, b) for a, b in pairwise(on))
        fit = bare and apart and len(on) > 1
        return tuple(on if fit else outputs), display.get_display_name() if fit else None
    except ConfigError as err:  # it has no RandR
        notes.append(err.message)
        return (), None
    finally:
        close_x_connection(display)


def list_connectors(folder: Path) -> Iterator[Output]:
    """Connectors with something plugged in, by the names that Xorg's driver `modesetting` gives
    them, with the modes in their EDIDs. folder : `DRM`."""
    for found in sorted(folder.glob("card*-*")):
        name = re.sub(r"^card\d+-", "", found.name).replace("HDMI-A-", "HDMI-")
        with suppress(OSError):
            if (found / "status").read_text().strip() == "connected":
                edid = parse_edid((found / "edid").read_bytes())
                yield Output(name, True, edid=edid, timings=edid.timings if edid else ())


def _usb_cameras(notes: list[str]) -> Iterator[CameraFact]:
    """Cameras that speak PTP. Those of makers other than Canon use gphoto2."""
    port = import_driver_module("ptp.usb_port")
    try:
        devices = port.find_still_image_devices(None)
    except (DriverUnavailable, PdcdError) as err:
        notes.append(f"USB: {err.message}")
        return
    for device in devices:
        key = f"{device.idVendor:04x}:{device.idProduct:04x}"
        canon = key.startswith(_CANON)
        words = f"{'Canon' if canon else 'still-image device'} {port.describe_device(device)}"
        driver = "ptp" if canon else "gphoto2"
        if not canon:
            notes.append(f"{words}: its driver is gphoto2: {suggest_install('gphoto2')}")
        yield CameraFact(driver, key, words, _PROFILES.get(key, "modern"))


def _genicam_cameras(notes: list[str]) -> Iterator[CameraFact]:
    """Machine-vision cameras that answer, if Aravis is installed."""
    aravis = import_driver_module("genicam.aravis")
    try:
        found = aravis.list_cameras()
    except ModuleNotFoundError:
        notes.append("machine-vision cameras were not looked for: Aravis is not installed")
        return
    except aravis.AravisError as err:
        notes.append(f"machine-vision cameras: {err}")
        return
    for camera in found:
        words = f"{camera.vendor} {camera.model}, serial {camera.serial} ({camera.protocol})"
        yield CameraFact("genicam", camera.serial or camera.id, words)


def _ports() -> Iterator[PortFact]:
    """Serial ports, with the serial numbers that udev keeps of their adapters."""
    for path in import_driver_module("serial_shutter.look").list_serial_ports():
        told = ""
        with suppress(OSError):
            number = Path(path).stat().st_rdev
            kept = Path(f"/run/udev/data/c{os.major(number)}:{os.minor(number)}")
            found = re.search(r"^E:ID_SERIAL_SHORT=(.+)$", kept.read_text(), re.MULTILINE)
            told = found[1] if found else ""
        yield PortFact(path, told)
