"""Examines both DMDs, for a person who looks for a fault, and shows 24 bars on them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.driver import DriverContext, Finding, Frames, PdcdError, fault

from .device import PLANES
from .display import Dlpc900Display
from .link import list_devices
from .options import read_dlpc900_options

_SHOWN_S = 10.0
_ORDER_HINT = (
    "else name the thirds by brightness, the darkest first, and write their letters in that order: "
    "the left third is the first letter of plane_order, the middle one the second"
)


def examine_dlpc900(context: DriverContext) -> Iterator[Finding]:
    """Yield everything that can be found out, down to the first thing that fails.

    Shows the bars for ten seconds, on both devices. Failures become findings, not exceptions.
    """
    try:
        options = read_dlpc900_options(context.config)
        for found in list_devices(context.usb_backend(options.usb)):
            named = found.serial in (options.projector, options.mask)
            ours = named or found.port in (options.projector, options.mask)
            yield Finding("DLPC900", "good", found.name + ("" if ours else "; not of this bench"))
        display = Dlpc900Display.create(context)
        try:
            yield from _examine_open(display, context)
        finally:
            display.disconnect()
    except PdcdError as err:
        yield fault("panels", err, "display")


def _examine_open(display: Dlpc900Display, context: DriverContext) -> Iterator[Finding]:
    info = display.connect()
    for what, found in info.identity.items():
        yield Finding(what, "good", found)
    for warning in info.warnings:
        yield Finding("panels", "warning", *warning.rsplit("; ", 1))
    row_us = 1e6 / info.refresh_hz
    yield Finding("rows", "good", f"{row_us:.0f} us each; the devices' least is {display.least_us}")
    if not context.config.display.row_times:
        yield Finding(
            "dark times",
            "warning",
            "plans do not use them",
            "set display.row_times = true: codes are then twice as fast",
        )
    display.hold(make_bars(info.primal_size_px, info.dual_size_px))
    context.patience.sleep(_SHOWN_S)
    display.black()
    yield Finding(
        "planes",
        "unknown",
        f"{PLANES} bars were on projector and mask for {_SHOWN_S:.0f} s: they get brighter from "
        "left to right where plane_order is right",
        _ORDER_HINT,
    )


def make_bars(primal_px: tuple[int, int], dual_px: tuple[int, int]) -> Frames:
    """Frames whose plane n is bar n of 24 from the left, and is shown n + 1 times. Shown over and
    over they are a wedge; a look or a photo shows whether the planes are in order."""
    patterns = []
    for width, height in (primal_px, dual_px):
        bar = np.arange(width) * PLANES // width
        lit = np.repeat((bar == np.arange(PLANES)[:, None])[:, None], height, axis=1)
        patterns.append(np.packbits(lit.reshape(PLANES, -1), axis=1))
    index = np.repeat(np.arange(PLANES, dtype=np.int32), np.arange(1, PLANES + 1))
    none = np.zeros(index.size, dtype=np.uint8)
    return Frames(
        primal_patterns=patterns[0],
        dual_patterns=patterns[1],
        primal_index=index,
        dual_index=index,
        shift=none,
        code=index,
        guard=none > 0,
        grid=(1, 1),
        lattice=(1, 1),
        window="pixels",
    )
