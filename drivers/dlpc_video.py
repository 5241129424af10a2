"""Two DMDs as the outputs of an X server, which show 24 bits a picture: the display `dlpc-video`.

`x11` shows the pictures; this driver sets both devices up over USB, checks whether they follow
their signal, and knows when each plane is lit. Written from TI's guide, tried on virtual devices,
never on a DMD.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from pdcd.driver import (
    Config,
    ConfigError,
    Display,
    DisplayInfo,
    DriverContext,
    Finding,
    FrameLog,
    Frames,
    PdcdError,
    SyncError,
    fault,
    read_options,
)
from pdcd.presenter.client import DisplayProcess, Log, RowNumbers, make_open_request
from pdcd.presenter.examine import examine_display
from pdcd.presenter.messages import Open, Ready

from .dlpc900.device import PLANES, DmdPanel, apply_to_each
from .dlpc900.dlpc350 import Dlpc350Dmd, Dlpc350Panel, Dlpc350Ways
from .dlpc900.doctor import make_bars
from .dlpc900.link import DeviceLink, choose_device, list_devices
from .dlpc900.options import Dlpc900Options, DmdOptions
from .dlpc900.video import PlaneTimes, VideoDmd, VideoEntry, divide_picture
from .x11 import X11Display, build_frame_log

_ROLES = ("projector", "mask")
_CONTROLLERS = "DLPC900", "DLPC350"
_KINDS = " or ".join(_CONTROLLERS)
_TOLD = ("DMD", "firmware")
_SHOWN_S = 10.0


class DlpcVideoOptions(DmdOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[display.options.dlpc]: which two devices, and choices that the guide leaves open."""

    dark_us: Annotated[int, Meta(ge=0, le=20_000)] = 0
    """How long mirrors are dark after each plane."""
    vsync_bit: Literal[0, 1] = 1
    """For a DLPC900: whether the first entry waits for a trigger, which here is the picture."""
    vsync_trigger: Literal[0, 1, 2] = 1
    """For a DLPC350: trigger of the first entry: internal, external positive, external negative."""
    lock_from: Literal["signal", "main"] = "signal"
    """For a DLPC350: what shows that a signal is locked: 0x071C, or bit 3 of 0x1A0C."""


def read_video_options(config: Config) -> tuple[Config, DlpcVideoOptions]:
    """The configuration of the display `x11` below, and the options of both devices. Raises
    ConfigError."""
    given: dict[str, Any] = dict(config.display.options)
    options = read_options(
        given.pop("dlpc", {}),
        DlpcVideoOptions,
        table="display.options.dlpc",
        device="display",
        hint="docs/dlpc900.md lists the options of the driver dlpc-video",
    )
    display = config.display
    wrong = hint = None
    if options.projector == options.mask:
        wrong, hint = f"projector and mask are both {options.mask!r}", "name two devices"
    elif display.planes_per_refresh != PLANES:
        wrong, hint = f"pictures carry {PLANES} planes", f"set planes_per_refresh = {PLANES}"
    elif display.plane_starts:
        wrong, hint = "plane_starts are those of the devices' own table", "leave plane_starts out"
    elif given.get("grab_px") is not None:
        wrong, hint = "pictures of several planes are not taken apart", "leave grab_px out"
    if wrong is not None:
        raise ConfigError(wrong, device="display", hint=hint)
    below = msgspec.structs.replace(display, driver="x11", options=given)
    return msgspec.structs.replace(config, display=below), options


class DlpcVideoDisplay(X11Display):
    """Projector and mask, each a DMD on a video signal; the registry's name is `dlpc-video`."""

    def __init__(
        self, config: Config, request: Open, context: DriverContext, options: DlpcVideoOptions
    ) -> None:
        super().__init__(config, request, context.shared, context.alive, context.patience.look)
        self._context, self._options = context, options
        self._dmds: list[VideoDmd] = []
        self._times: PlaneTimes | None = None
        self._lock = threading.RLock()

    @classmethod
    def create(cls, context: DriverContext) -> DlpcVideoDisplay:
        """Check the options; panels and devices are opened by `connect`."""
        config, options = read_video_options(context.config)
        return cls(config, make_open_request(config), context, options)

    def connect(self) -> DisplayInfo:
        """Start the display process, and let both devices follow their signal; black on return."""
        info = super().connect()
        warnings, lag_s = list(info.warnings), info.mask_lag_s
        assert self._times is not None  # noqa: S101
        dark_us = self._times.dark_us
        if lag_s is None or abs(lag_s) * 1e6 > dark_us:
            by = "an unknown time" if lag_s is None else f"{1e6 * lag_s:.0f} us"
            warnings.append(
                f"the mask's pictures come {by} after the projector's, and planes are dark for "
                f"{dark_us} us, so that light of one code may pass the mask of another; feed both "
                "from outputs whose vblanks are locked, and set dlpc.dark_us"
            )
        identity = dict(info.identity)
        for dmd in self._dmds:
            name = dmd.link.found.serial or dmd.link.found.port
            identity[f"DMD of the {dmd.role}"] = f"{dmd.panel.kind} {name}"
            identity[f"firmware of the {dmd.role}"] = dmd.panel.firmware or "unknown"
        identity["planes"] = f"{PLANES} of {self._times.exposure_us} us, {dark_us} us dark"
        return replace(info, identity=identity, warnings=tuple(warnings))

    def black(self) -> None:
        """Both panels black: by black pictures if the devices follow them, else by a plane of their
        own."""
        with self._lock, self._context.patience.deaf():
            try:
                super().black()
            except BaseException:
                self._on_each(VideoDmd.make_black)
                raise
            self._on_each(self._see_that_black)

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all loaded frames, then black. Raises SyncError if a device did not follow."""
        log = super().play(progress, cancelled)
        with self._lock:
            try:
                self._on_each(VideoDmd.check)
            except PdcdError:
                with suppress(PdcdError), self._context.patience.deaf():
                    self._on_each(self._see_that_black)
                raise
        return log

    def disconnect(self) -> None:
        """Black, then end the display process and let both devices go."""
        with self._lock, self._context.patience.deaf():
            dmds, self._dmds, self._times = self._dmds, [], None
            try:
                apply_to_each(dmds, VideoDmd.close)  # while their signal is still black
            finally:
                super().disconnect()

    def show_wedge(self, frames: Frames) -> None:
        """Hold a picture in which both devices light plane n longer than plane n - 1; `black` or
        `load` ends it."""
        self.load(frames)
        process = self._running()
        longest = self._divide(process.ready.refresh_hz, 0)
        with self._lock:
            for dmd in self._dmds:
                dmd.follow(dmd.make_wedge(longest))
                dmd.follows = False  # not as frames need it: the next `load` sets it up anew
        process.show(0)

    def _running(self) -> DisplayProcess:
        """The display process, and both devices on its signal."""
        process = super()._running()
        with self._lock:
            if any(dmd.link.lost for dmd in self._dmds):
                for dmd in self._dmds:
                    dmd.link.close()
                self._dmds = []
            try:
                if not self._dmds:
                    self._open_dmds()
                self._follow(process.ready.refresh_hz)
            except BaseException:
                with suppress(PdcdError):
                    process.black()
                raise
        return process

    def _follow(self, refresh_hz: float) -> None:
        times = self._divide(refresh_hz, self._options.dark_us)
        for dmd in self._dmds:
            if dmd.follows and times == self._times:
                try:
                    dmd.check()
                    continue
                except SyncError:
                    pass  # set up anew, before any light
            dmd.follow([VideoEntry(bit, times) for bit in range(PLANES)])
        self._times = times

    def _divide(self, refresh_hz: float, dark_us: int) -> PlaneTimes:
        """The planes of a picture at the fastest rate that it may have, for both devices."""
        dmds, panels = self._dmds, (self._config.projector, self._config.mask)
        return divide_picture(
            max(refresh_hz, *(panel.refresh_hz for panel in panels)),
            dark_us,
            max(dmd.panel.least_us for dmd in dmds),
            black_us=max(dmd.black_us for dmd in dmds),
            least_dark_us=max(dmd.least_dark_us for dmd in dmds),
        )

    def _open_dmds(self) -> None:
        """Find both devices, and make them black; if one fails, none is kept open."""
        options, config, patience = self._options, self._config, self._context.patience
        found = list_devices(self._context.usb_backend(options.usb), *_CONTROLLERS)
        opened: list[VideoDmd] = []
        try:
            for role, table in zip(_ROLES, (config.projector, config.mask), strict=True):
                device = choose_device(found, getattr(options, role), role, _KINDS)
                link = DeviceLink(device, role, patience.look)
                opened.append(self._make_dmd(link, table.size_px))
                opened[-1].make_black()
        except BaseException:
            with suppress(PdcdError), patience.deaf():
                apply_to_each(opened, VideoDmd.make_black)  # the last one as well, once more
            for dmd in opened:
                dmd.link.close()
            raise
        self._dmds = opened

    def _make_dmd(self, link: DeviceLink, size_px: tuple[int, int]) -> VideoDmd:
        """The class that drives the controller that was found."""
        options, patience = self._options, self._context.patience
        if link.found.controller == "DLPC350":
            parked = partial(Dlpc350Panel, link, options.rest, size_px, patience)
            ways = Dlpc350Ways(options.led, options.vsync_trigger, options.lock_from)
            return Dlpc350Dmd(link, parked, ways, patience)
        shared = {name: getattr(options, name) for name in DmdOptions.__struct_fields__}
        known = Dlpc900Options(**shared)
        make = partial(DmdPanel, link, known, self._context.clock, size_px)
        return VideoDmd(link, make, (options.led, options.trigger_bit, options.vsync_bit), patience)

    def _see_that_black(self, dmd: VideoDmd) -> None:
        """With black pictures: check that it shows them, or make it black without them."""
        if dmd.follows:
            try:
                return dmd.check()
            except SyncError:
                pass
        dmd.make_black()

    def _on_each(self, work: Callable[[VideoDmd], None]) -> None:
        apply_to_each(self._dmds, work)

    def _build_log(self, primal: RowNumbers, dual: RowNumbers, log: Log, ready: Ready) -> FrameLog:
        """The log as for any display of planes, but with the times of the devices' table: mirrors
        are dark after each plane, and from the last one until the next picture."""
        times = self._times
        assert times is not None  # noqa: S101
        share = 1e-6 * times.plane_us * ready.refresh_hz
        starts = tuple(share * plane for plane in range(PLANES))
        found = build_frame_log(primal, dual, log, ready, starts)
        lit_ns = 1000 * times.exposure_us
        dark_ns = np.diff(found.primal_ns, append=found.primal_ns[-1] + lit_ns) - lit_ns
        dark_ns[dark_ns < 1000] = 0  # remainder of rounding
        end_ns = np.full(2, found.primal_ns[-1] + lit_ns)
        return replace(found, dark_s=1e-9 * dark_ns, end_ns=end_ns)


def examine_dlpc_video(context: DriverContext) -> Iterator[Finding]:
    """Yield everything that can be found out about the X server, its outputs and both devices, down
    to the first thing that fails. Shows bars for ten seconds. Failures become findings, not
    exceptions."""
    try:
        config, options = read_video_options(context.config)
        yield from examine_display(config)
        for found in list_devices(context.usb_backend(options.usb), *_CONTROLLERS):
            yield Finding(found.controller, "good", found.name)
        display = DlpcVideoDisplay.create(context)
        try:
            info = display.connect()
            for what in ("planes", *(f"{of} of the {r}" for r in _ROLES for of in _TOLD)):
                yield Finding(what, "good", info.identity[what])
            for warning in info.warnings:
                yield Finding("panels", "warning", *warning.rsplit("; ", 1))
            display.show_wedge(_make_still_bars(info.primal_size_px, info.dual_size_px))
            context.patience.sleep(_SHOWN_S)
            display.black()
        finally:
            display.disconnect()
    except PdcdError as err:
        yield fault("DMDs", err, "display")
        return
    yield Finding(
        "order of planes",
        "unknown",
        f"{PLANES} bars were on projector and mask for {_SHOWN_S:.0f} s: they get brighter from "
        "left to right where display.plane_order is right",
        "else name the thirds by brightness, the darkest first, and write the letters of "
        "plane_order in that order",
    )


def _make_still_bars(primal_px: tuple[int, int], dual_px: tuple[int, int]) -> Frames:
    """A picture whose plane n is bar n of 24 from the left."""
    bars = make_bars(primal_px, dual_px)
    index = np.arange(PLANES, dtype=np.int32)
    none = np.zeros(PLANES, dtype=np.uint8)
    return replace(
        bars, primal_index=index, dual_index=index, shift=none, code=index, guard=none > 0
    )


def _conforms(driver: DlpcVideoDisplay) -> Display:
    """Let the type checker compare the class with its Protocol."""
    return driver
