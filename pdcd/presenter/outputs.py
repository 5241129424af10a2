"""The two outputs of the graphics card: found by name or serial, checked, watched.

Outputs are never chosen by number: numbers change with cables, drivers and power-on order, and a
pattern on the wrong panel gives a wrong photo. Source of the protocol: X Resize, Rotate and
Reflect extension 1.6 (randrproto).
"""

from __future__ import annotations

import select
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from Xlib.ext import randr

from pdcd.bench.checks import RATE_TOLERANCE
from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter.edid import Edid, read_edid
from pdcd.presenter.levels import OutputLevels, read_levels
from pdcd.presenter.timings import VideoTiming, from_server_mode
from pdcd.presenter.xconnection import guard_x_calls

_Size = tuple[int, int]
"""(width, height) in pixels."""

_NOMINAL_TOLERANCE = 0.02
"""Largest relative error of a mode's rate against the configured one: 59.94 passes for 60."""


@dataclass(frozen=True)
class Output:
    """One connector of the graphics card, as the server has it now.

    x, y, width, height : place on the X screen in pixels; all 0 while the output is off.
    refresh_hz : from the mode's pixel clock and totals; None when off, or when the server does
        not know (Xvfb).
    """

    name: str
    connected: bool
    x: int = 0
    y: int = 0
    width: int = 0
    height: int = 0
    mode: str = ""
    refresh_hz: float | None = None
    turned: str = ""
    """How the server rotates or mirrors it, in words; x, y, width and height are in pixels of the
    screen, as drawing is."""
    edid: Edid | None = None
    levels: OutputLevels = field(default_factory=OutputLevels)
    """What is done to levels between the frame buffer and the panel."""
    timings: tuple[VideoTiming, ...] = ()
    """Modes that the server offers for it, the panel's own first."""

    @property
    def on(self) -> bool:
        """Whether it shows a part of the X screen."""
        return self.width > 0

    @property
    def size(self) -> _Size:
        """Width and height in pixels."""
        return self.width, self.height

    def __str__(self) -> str:
        panel = f" ({self.edid})" if self.edid else ""
        if not self.connected:
            return f"{self.name}{panel}: not connected"
        if not self.on:
            return f"{self.name}{panel}: off"
        rate = "unknown rate" if self.refresh_hz is None else f"{self.refresh_hz:.4f} Hz"
        turned = f", {self.turned} by the X server" if self.turned else ""
        place = f"{self.width} x {self.height} at +{self.x}+{self.y}"
        return f"{self.name}{panel}: {place}, {rate}{turned}"


@dataclass(frozen=True)
class OutputPair:
    """Projector and mask, fit to run in lockstep."""

    projector: Output
    mask: Output

    @property
    def refresh_hz(self) -> float | None:
        """Rate of both together, which is that of the slower one; None when the server does not
        know."""
        rates = [o.refresh_hz for o in (self.projector, self.mask)]
        return min((r for r in rates if r is not None), default=None) if all(rates) else None

    @property
    def slip_s(self) -> float | None:
        """Time in which one output gains a refresh on the other; None: unknown, or never."""
        return slip_s(self.projector.refresh_hz, self.mask.refresh_hz)


def slip_s(first_hz: float | None, second_hz: float | None) -> float | None:
    """Seconds in which two rates slip by one refresh; None when they are equal or unknown."""
    if first_hz is None or second_hz is None or first_hz == second_hz:
        return None
    return 1.0 / abs(first_hz - second_hz)


def read_outputs(display: Any, *, anew: bool = True) -> tuple[Output, ...]:
    """All connectors of the first X screen, as they are set; nothing is changed.

    anew : the driver probes its connectors, which may take a second: never do it between frames.
    Otherwise the server answers from what it knows, in a few milliseconds.

    Raises DeviceLost when the server goes away, ConfigError when it has no RandR.
    """
    if not display.has_extension("RANDR"):
        raise ConfigError(
            "the X server has no RandR extension",
            device="display",
            hint="take Xorg: pdcd init writes an xorg.conf",
        )
    with guard_x_calls(display):
        root = display.screen().root
        if anew:
            resources = root.xrandr_get_screen_resources()
            names = resources.mode_names
        else:
            resources = root.xrandr_get_screen_resources_current()
            names = resources.names
        modes, at = {}, 0
        for mode in resources.modes:
            name = names[at : at + mode["name_length"]]
            modes[mode["id"]] = (mode, name)
            at += mode["name_length"]
        stamp = resources.config_timestamp
        return tuple(_output(display, o, stamp, modes) for o in resources.outputs)


def _output(display: Any, number: int, stamp: int, modes: dict[int, tuple[Any, str]]) -> Output:
    """Describe one connector."""
    info = display.xrandr_get_output_info(number, stamp)
    connected = info.connection == randr.Connected
    edid = read_edid(display, number)
    offered = (from_server_mode(modes[number][0]) for number in info.modes if number in modes)
    timings = tuple(timing for timing in offered if timing is not None)
    crtc = display.xrandr_get_crtc_info(info.crtc, stamp) if info.crtc else None
    if crtc is None or not crtc.mode:
        return Output(info.name, connected, edid=edid, timings=timings)
    mode, name = modes[crtc.mode]
    rate_hz = mode_hz(mode["dot_clock"], mode["h_total"], mode["v_total"], mode["flags"])
    preferred = info.modes[: info.num_preferred]
    levels = read_levels(
        display,
        number,
        info.crtc,
        clocked=rate_hz is not None,
        native=not preferred or crtc.mode in preferred,
    )
    return Output(
        info.name,
        connected,
        crtc.x,
        crtc.y,
        crtc.width,
        crtc.height,
        name,
        rate_hz,
        describe_rotation(crtc.rotation),
        edid,
        levels,
        timings,
    )


def describe_rotation(rotation: int) -> str:
    """RandR's rotation of an output in words; empty where the output is upright."""
    words = {
        randr.Rotate_90: "rotated by 90 degrees",
        randr.Rotate_180: "rotated by 180 degrees",
        randr.Rotate_270: "rotated by 270 degrees",
        randr.Reflect_X: "mirrored left to right",
        randr.Reflect_Y: "mirrored top to bottom",
    }
    return " and ".join(word for bit, word in words.items() if rotation & bit)


def mode_hz(clock_hz: int, htotal_px: int, vtotal_px: int, flags: int = 0) -> float | None:
    """Refresh rate of a mode; None when the server leaves clock or totals at 0."""
    if not (clock_hz and htotal_px and vtotal_px):
        return None
    rate = clock_hz / (htotal_px * vtotal_px)
    if flags & randr.Interlace:
        rate *= 2.0
    if flags & randr.DoubleScan:
        rate /= 2.0
    return rate


def find_output(outputs: Sequence[Output], wanted: str, role: str) -> Output:
    """The one output with this connector name or EDID serial; `role` is for messages.

    Raises ConfigError when no output or several match, or the matching one is off; DeviceLost when
    it is known but not connected.
    """
    found = [
        o for o in outputs if wanted == o.name or (o.edid is not None and wanted in o.edid.serials)
    ]
    there = "; ".join(str(o) for o in outputs if o.connected) or "none"
    if len(found) != 1:
        how = "no output is" if not found else f"{len(found)} outputs are"
        raise ConfigError(
            f"{how} named {wanted!r}, by connector or EDID serial; connected: {there}",
            device=role,
            hint=f"set [display.options] {role} to exactly one of them",
        )
    (output,) = found
    if not output.connected:
        raise DeviceLost(
            f"output {wanted!r} is not connected; connected: {there}",
            device=role,
            hint="check cable and power of the panel",
        )
    if not output.on:
        raise ConfigError(
            f"output {wanted!r} is connected but switched off",
            device=role,
            hint=f"xrandr --output {output.name} --auto, and mend xorg.conf",
        )
    return output


def find_pair(
    outputs: Sequence[Output],
    *,
    projector: tuple[str, _Size],
    mask: tuple[str, _Size],
) -> OutputPair:
    """Projector and mask, each found by (name or serial, size in pixels), fit for lockstep.

    Raises
    ------
    ConfigError
        `find_output` does not find one of them, or it has another size; they overlap; or their
        rates differ by more than `RATE_TOLERANCE`.
    DeviceLost
        One of them is not connected.
    """
    found = []
    for role, (wanted, size) in (("projector", projector), ("mask", mask)):
        output = find_output(outputs, wanted, role)
        _check_mode(output, size, role)
        found.append(output)
    pair = OutputPair(found[0], found[1])
    _check_apart(pair)
    check_rates(pair.projector.refresh_hz, pair.mask.refresh_hz)
    return pair


def place_pair(
    outputs: Sequence[Output],
    *,
    projector: tuple[str, _Size],
    mask: tuple[str, _Size],
    positions_px: tuple[tuple[int, int], tuple[int, int]],
) -> OutputPair:
    """Both panels as parts of larger outputs, at given places of the X screen.

    For servers with one output for all (Xvfb): each panel must lie within the output that it names.
    Its rate is that output's. Raises what `find_pair` raises.
    """
    found = []
    wanted = (("projector", projector), ("mask", mask))
    for (role, (name, size)), (x, y) in zip(wanted, positions_px, strict=True):
        whole = find_output(outputs, name, role)
        part = replace(whole, x=x, y=y, width=size[0], height=size[1])
        inside = whole.x <= x and whole.y <= y
        fits = x + size[0] <= whole.x + whole.width and y + size[1] <= whole.y + whole.height
        if not (inside and fits):
            raise ConfigError(
                f"{size[0]} x {size[1]} pixels at +{x}+{y} do not lie within {whole}",
                device=role,
                hint="mend [display.options] positions_px, or make the X screen larger",
            )
        found.append(part)
    pair = OutputPair(found[0], found[1])
    _check_apart(pair)
    return pair


def check_rates(projector_hz: float | None, mask_hz: float | None) -> None:
    """Refuse two rates that drift apart too fast; unknown rates pass.

    Raises ConfigError.
    """
    apart_s = slip_s(projector_hz, mask_hz)
    if apart_s is None or projector_hz is None or mask_hz is None:
        return
    if abs(projector_hz - mask_hz) > RATE_TOLERANCE * projector_hz:
        raise ConfigError(
            f"projector {projector_hz:.4f} Hz and mask {mask_hz:.4f} Hz slip by one refresh "
            f"every {apart_s:.1f} s",
            device="display",
            hint="give both modes the same rate: matched modelines in xorg.conf",
        )


def check_nominal(pair: OutputPair, *, projector_hz: float, mask_hz: float) -> None:
    """Refuse modes whose rates are not the configured ones; unknown rates pass.

    Raises ConfigError.
    """
    for role, output, wanted_hz in (
        ("projector", pair.projector, projector_hz),
        ("mask", pair.mask, mask_hz),
    ):
        found_hz = output.refresh_hz
        if found_hz is not None and abs(found_hz - wanted_hz) > _NOMINAL_TOLERANCE * wanted_hz:
            width, height = output.size
            raise ConfigError(
                f"{output.name} runs at {found_hz:.4f} Hz, not {wanted_hz:g} Hz",
                device=role,
                hint=f"xrandr --output {output.name} --mode {width}x{height} --rate {wanted_hz:g}, "
                f"or mend refresh_hz of [{role}]",
            )


def has_overlap(first: Output, second: Output) -> bool:
    """Whether two outputs show any common pixel of the X screen."""
    return (
        first.x < second.x + second.width
        and second.x < first.x + first.width
        and first.y < second.y + second.height
        and second.y < first.y + first.height
    )


def _check_apart(pair: OutputPair) -> None:
    if has_overlap(pair.projector, pair.mask):
        raise ConfigError(
            f"both panels show the same part of the screen: {pair.projector}; {pair.mask}",
            device="display",
            hint=f"xrandr --output {pair.mask.name} --right-of {pair.projector.name}",
        )


def _check_mode(output: Output, size: _Size, role: str) -> None:
    if output.size != size:
        width, height = size
        raise ConfigError(
            f"{output.name} shows {output.width} x {output.height} pixels, not {width} x {height}",
            device=role,
            hint=f"xrandr --output {output.name} --mode {width}x{height}, or mend size_px of "
            f"[{role}]",
        )


class Watcher:
    """Notices when outputs change: unplugged, switched off, another mode.

    `changed` costs about a microsecond while nothing happens and never waits, so that a loop may
    ask between frames. It belongs to a connection of its own, `display`.
    """

    def __init__(self, display: Any) -> None:
        self._display = display
        self._poller = select.poll()
        mask = (
            randr.RRScreenChangeNotifyMask
            | randr.RRCrtcChangeNotifyMask
            | randr.RROutputChangeNotifyMask
        )
        with guard_x_calls(display):
            display.screen().root.xrandr_select_input(mask)
            # A round trip: from here on nothing is missed, and nothing old is waiting.
            display.sync()
            while display.pending_events():
                display.next_event()
        self._poller.register(display.fileno(), select.POLLIN)

    def fileno(self) -> int:
        """File descriptor that is readable when the server has sent something."""
        return int(self._display.fileno())

    def changed(self) -> bool:
        """Whether anything has changed since the last call.

        Raises DeviceLost when the server is gone.
        """
        if not self._poller.poll(0):
            return False
        found = False
        with guard_x_calls(self._display):
            while self._display.pending_events():
                self._display.next_event()
                found = True
        return found
