"""Two virtual DLPC900s on the outputs of an X server, or on nothing, before the display
`dlpc-video`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.dlpc_video import DlpcVideoDisplay
from drivers.virtual_dlpc900 import (
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdFault,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import Clock, DriverContext, SharedState
from pdcd.bench.tables import Config
from pdcd.panels.frames import Frames

SERIALS = "VIDEO-P", "VIDEO-M"
REFRESH_HZ = 60.0
DLPC = {"projector": SERIALS[0], "mask": SERIALS[1], "usb": "given"}

Words = NDArray[np.uint32]


def make_video_dmds(
    sizes_px: tuple[tuple[int, int], tuple[int, int]],
    clock: Clock | None = None,
    *,
    options: VirtualDmdOptions | None = None,
    faults: tuple[VirtualDmdFault, ...] = (),
    refresh_hz: float | None = REFRESH_HZ,
) -> tuple[VirtualDlpc900, VirtualDlpc900]:
    """Projector and mask; `faults` are the mask's. refresh_hz : None: without a signal."""
    clock = clock or RealClock()
    # What stands after a stop is what was there, which is the worse of two unknown things.
    given = options or VirtualDmdOptions(after_stop="holds", report_s=0.0)
    found = tuple(
        VirtualDlpc900(clock, choose_dmd_model(size), serial, given, faults if side else ())
        for side, (size, serial) in enumerate(zip(sizes_px, SERIALS, strict=True))
    )
    for device in found:
        if refresh_hz is not None:
            device.connect_video(refresh_hz)
    return found[0], found[1]


def make_video_display(
    config: Config,
    dmds: tuple[VirtualDlpc900, VirtualDlpc900],
    clock: Clock | None = None,
    **more: Any,
) -> DlpcVideoDisplay:
    """The driver, with these devices on its USB. more : of `DriverContext`."""
    shared = SharedState(usb_backend=VirtualDmdBus(*dmds))
    return DlpcVideoDisplay.create(DriverContext(config, clock or RealClock(), shared, **more))


def join_channels(rgb: NDArray[np.uint8]) -> Words:
    """Pixels, (H, W, 3) uint8, as 0xRRGGBB."""
    red, green, blue = (rgb[..., n].astype(np.uint32) for n in range(3))
    return np.asarray(red << 16 | green << 8 | blue, dtype=np.uint32)


def read_played(
    device: VirtualDlpc900, low_ns: int, high_ns: int
) -> list[tuple[int, NDArray[np.bool_] | None]]:
    """What its mirrors showed, and from when on; None is black."""
    return [
        (at_ns, None if one is None else (one.words >> np.uint32(one.bit) & 1).astype(np.bool_))
        for at_ns, one in device.list_changes(low_ns, high_ns)
    ]


def is_dark(device: VirtualDlpc900) -> bool:
    """Whether no mirror is on now."""
    one = device.find_content()
    return one is None or not bool((one.words >> np.uint32(one.bit) & 1).any())


def cut_rows(frames: Frames, first: int, count: int) -> Frames:
    """Some rows of the frames."""
    part = slice(first, first + count)
    return Frames(
        frames.primal_patterns,
        frames.dual_patterns,
        frames.primal_index[part],
        frames.dual_index[part],
        frames.shift[part],
        frames.code[part],
        frames.guard[part],
        frames.grid,
        frames.lattice,
        frames.window,
    )
