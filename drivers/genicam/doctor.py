"""Examines machine-vision cameras here, for a person who looks for a fault.

Nothing is exposed. A camera that a running daemon holds is reported as held.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from pathlib import Path

from pdcd.driver import DriverContext, Finding, PdcdError, fault

from .aravis import list_cameras
from .device import CAMERA_DEVICE, GenicamDevice, describe_camera
from .library import load_library
from .options import GenicamOptions, read_genicam_options

_SEE = "see docs/genicam.md"
_FRAMES = 4
"""Frames that the buffers of socket and USB should hold."""
_USB_MB = 1000
_JUMBO = 8000
_RMEM = Path("/proc/sys/net/core/rmem_max")
_USBFS = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")


def examine_genicam(
    context: DriverContext, options: GenicamOptions | None = None
) -> Generator[Finding, None, tuple[int, int] | None]:
    """Yield everything that can be found out, down to the first thing that fails: the library, the
    cameras that answer, the one of the configuration with its settings, and what lies between.

    options : None: those of the configuration. Returns the frame in quads, if it got that far.
    Failures become findings, not exceptions.
    """
    try:
        library = load_library()
    except ModuleNotFoundError as err:
        yield Finding("Aravis", "fault", f"{err}", f"install it; {_SEE}")
        return None
    yield Finding("Aravis", "good", f"{library.version} ({library.path})")
    try:
        options = options or read_genicam_options(context.config)
        found = list_cameras()
        for camera in found:
            yield Finding("camera that answers", "good", describe_camera(camera))
        if not found and options.camera is None:
            yield Finding("camera that answers", "fault", "none", f"check its cable; {_SEE}")
            return None
        device = GenicamDevice(options)
        try:
            yield from _examine_device(device)
            return device.frame_quads
        finally:
            device.close()
    except PdcdError as err:
        yield fault("camera", err, CAMERA_DEVICE)
    return None


def _examine_device(device: GenicamDevice) -> Iterator[Finding]:
    for what, text in device.identity.items():
        yield Finding(what, "good", text)
    width, height = device.size
    yield Finding("picture", "good", f"{width} x {height} pixels of {device.pixel_format.name}")
    yield Finding("ISO", "good", ", ".join(map(str, device.isos)))
    yield Finding("exposure", "good", f"{device.shortest_s:.3g} to {device.longest_s:.3g} s")
    if device.white_known:
        yield Finding("white level", "good", f"{device.levels.white_dn} DN")
    else:
        yield Finding(
            "white level",
            "warning",
            f"not told by {device.pixel_format.name}",
            "take a 12p format, or set camera.options.white_dn; a saturated photo shows it, too",
        )
    for refused in device.unset:
        yield Finding("left as it is", "warning", refused, "switch it off in the maker's viewer")
    for feature, value in device.record().items():
        yield Finding(feature, "good", value)
    yield from _examine_way(device)


def _examine_way(device: GenicamDevice) -> Iterator[Finding]:
    """Whether buffers on the way here have room for frames."""
    if not device.on_network:
        yield _judge_room("usbfs_memory_mb", _USBFS, _USB_MB, "usbcore.usbfs_memory_mb=1000")
        return
    packet = device.packet_bytes
    yield Finding(
        "packets",
        "good" if packet >= _JUMBO else "warning",
        f"{packet} bytes",
        None if packet >= _JUMBO else f"set an MTU of 9000 on the way to the camera; {_SEE}",
    )
    wanted = _FRAMES * device.payload_bytes
    yield _judge_room("net.core.rmem_max", _RMEM, wanted, f"net.core.rmem_max={wanted}")


def _judge_room(what: str, path: Path, wanted: int, setting: str) -> Finding:
    try:
        found = int(path.read_text())
    except (OSError, ValueError):
        return Finding(what, "unknown", "not told by this kernel")
    if found >= wanted:
        return Finding(what, "good", f"{found}")
    how = "as root: " if os.geteuid() else ""
    return Finding(what, "warning", f"{found}, {wanted} would do", f"{how}set {setting}; {_SEE}")
