"""Examines the camera on the USB, for a person who looks for a fault.

Nothing is exposed. A camera that is in use by a running daemon is held by it and cannot be asked.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from pdcd.driver import DriverContext, Finding, PdcdError, fault

from .codes import CUSTOM_LONG_EXPOSURE_NR, SHUTTER_BULB, Property
from .eos import EosCamera
from .faults import DEVICE
from .holders import HINT, build_node_path, describe_holders, list_holders
from .options import PtpOptions, read_ptp_options
from .usb_port import PERMISSION_HINT, describe_device, find_cameras, find_still_image_devices
from .values import list_f_numbers, list_isos

_ASKED_S = 60.0
_DIAL_HINT = "turn the mode dial to M"
_NOISE = "long-exposure noise reduction"
_NOISE_HINT = "switch it off in the custom functions"
_REDUCTION = {
    None: Finding(_NOISE, "unknown", "not told"),
    0: Finding(_NOISE, "good", "off"),
    1: Finding(_NOISE, "fault", "auto", _NOISE_HINT),
    2: Finding(_NOISE, "fault", "on", _NOISE_HINT),
}


def examine_ptp(context: DriverContext) -> Iterator[Finding]:
    """Yield everything that can be found out, down to the first thing that fails.

    The options are those of the drivers `ptp` in the configuration; without any, any Canon is
    looked for. A camera that does not answer is given up as in `drivers.ptp.session`. Failures
    become findings, not exceptions.
    """
    config = context.config
    try:
        if "ptp" in (config.camera.driver, config.trigger.driver):
            options = read_ptp_options(config)
        else:
            options = PtpOptions()
            yield Finding(
                "configuration",
                "warning",
                f"the camera's driver is {config.camera.driver}: any Canon is looked for",
                "give --config with driver = 'ptp' in it",
            )
        backend = context.usb_backend(options.usb)
        chosen = [describe_device(device) for device in find_cameras(backend, options.usb_id)]
        for device in find_still_image_devices(backend):
            yield from _device(device, ours=describe_device(device) in chosen)
        camera = EosCamera(options, context.clock, backend, _ASKED_S)
        try:
            yield from _camera(camera, camera.open("doctor"))
            camera.check_ready()
            yield Finding("ready to expose", "good", "yes")
        finally:
            camera.close("doctor")
    except PdcdError as err:
        yield fault("camera", err, DEVICE)


def _device(device: Any, *, ours: bool) -> Iterator[Finding]:
    """One still-image device and, if it is the wanted one, who may open it."""
    node = build_node_path(device.bus, device.address)
    if not ours:
        other = f"{describe_device(device)}: another one, passed over"
        yield Finding("still-image device", "good", other)
        return
    yield Finding("still-image device", "good", describe_device(device))
    if node.exists():
        if os.access(node, os.R_OK | os.W_OK):
            yield Finding("permission", "good", f"{node} may be opened")
        else:
            yield Finding("permission", "fault", f"{node} may not be opened", PERMISSION_HINT)
        found = list_holders(node)
        if found:
            yield Finding("held by", "fault", describe_holders(found, os.getpid()), HINT)


def _camera(camera: EosCamera, identity: dict[str, str]) -> Iterator[Finding]:
    choices = camera.choices
    for what, found in identity.items():
        if what != "release":
            yield Finding(what, "good", found)
    yield _release(identity["release"], camera.options)
    found_isos = ", ".join(map(str, list_isos(choices.get(Property.ISO, ()))))
    yield _listed("ISO", found_isos)
    apertures = ", ".join(f"{f:g}" for f in list_f_numbers(choices.get(Property.APERTURE, ())))
    yield Finding("apertures", "good", apertures or "none: a manual lens, or its dial off M")
    speeds = choices.get(Property.SHUTTER_SPEED, ())
    yield _listed("shutter speeds", f"{len(speeds)}" if speeds else "")
    yield _listed("bulb", "offered" if set(speeds) & set(SHUTTER_BULB) else "")
    reduction = camera.custom.get(CUSTOM_LONG_EXPOSURE_NR)
    yield _REDUCTION.get(reduction, Finding(_NOISE, "unknown", str(reduction)))


def _release(method: str, options: PtpOptions) -> Finding:
    how = f"{method}, as asked for" if options.release != "auto" else method
    if method != "external":
        return Finding("release over USB", "good", how)
    return Finding(
        "release over USB", "warning", how, "a cable release does it: see [trigger] in cameras.md"
    )


def _listed(what: str, found: str) -> Finding:
    if found:
        return Finding(what, "good", found)
    return Finding(what, "fault", "none listed", _DIAL_HINT)
