"""What there is to say about the camera on the USB, row by row, for a person who looks for a fault.

Nothing is exposed. A camera that is in use by a running daemon is held by it and cannot be asked.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from drivers.ptp.codes import CUSTOM_LONG_EXPOSURE_NR, SHUTTER_BULB, Property
from drivers.ptp.eos import EosCamera
from drivers.ptp.holders import holders, in_words, node_of
from drivers.ptp.options import PtpOptions
from drivers.ptp.usb_port import find, in_short
from drivers.ptp.values import f_numbers, isos
from pdcd.errors import PdcdError
from pdcd.interfaces import Clock

_ASKED_S = 60.0


class Row(NamedTuple):
    """One finding. `good` is None where there is nothing to judge."""

    what: str
    found: str
    good: bool | None = None


def camera_rows(options: PtpOptions, clock: Clock, backend: Any = None) -> list[Row]:
    """Everything that can be found out, down to the first thing that fails, which is the last row.

    backend : a pyusb backend, or None for the machine's libusb.
    """
    rows: list[Row] = []
    try:
        devices = find(backend, options.usb_id)
        rows.append(Row("still-image devices", str(len(devices)), bool(devices)))
        rows += [row for device in devices for row in _device_rows(device)]
        camera = EosCamera(options, clock, backend, _ASKED_S)
        try:
            identity = camera.open("doctor")
            rows += _camera_rows(camera, identity)
            camera.check_ready()
            rows.append(Row("ready to expose", "yes", True))
        finally:
            camera.close("doctor")
    except PdcdError as err:
        rows.append(Row("fault", str(err), False))
    return rows


def _device_rows(device: Any) -> list[Row]:
    node = node_of(device.bus, device.address)
    rows = [Row("device", in_short(device))]
    if node.exists():
        may = os.access(node, os.R_OK | os.W_OK)
        rows.append(Row("permission", f"{node} {'may' if may else 'may not'} be opened", may))
        found = holders(node)
        if found:
            rows.append(Row("held by", in_words(found, os.getpid()), False))
    return rows


def _camera_rows(camera: EosCamera, identity: dict[str, str]) -> list[Row]:
    choices = camera.choices
    found_isos = ", ".join(map(str, isos(choices.get(Property.ISO, ()))))
    found_apertures = ", ".join(f"{f:g}" for f in f_numbers(choices.get(Property.APERTURE, ())))
    speeds = choices.get(Property.SHUTTER_SPEED, ())
    reduction = camera.custom.get(CUSTOM_LONG_EXPOSURE_NR)
    return [
        *(Row(what, found) for what, found in identity.items() if what != "release"),
        Row("release over USB", identity["release"], identity["release"] != "external"),
        Row("ISO", found_isos or "none listed", bool(found_isos)),
        Row("apertures", found_apertures or "none: a manual lens"),
        Row("shutter speeds", f"{len(speeds)} listed", bool(speeds)),
        Row("bulb", "offered" if set(speeds) & set(SHUTTER_BULB) else "not offered",
            bool(set(speeds) & set(SHUTTER_BULB))),
        Row("long-exposure noise reduction",
            {None: "not told", 0: "off", 1: "auto", 2: "on"}.get(reduction, str(reduction)),
            None if reduction is None else reduction == 0),
    ]  # fmt: skip
