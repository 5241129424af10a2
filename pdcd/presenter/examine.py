"""Checks, one by one, everything that decides whether two panels can be driven from here.

It opens the panels as the daemon would, once for each time source, because a server may advertise
more than it delivers; but never over a window that is already there, which may belong to a run.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from typing import Any, Literal, get_args

import msgspec
from Xlib import X, error

from pdcd.bench.devices import Finding, fault
from pdcd.bench.placed import describe_oblong_cells
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, PdcdError
from pdcd.panels.map import Map
from pdcd.presenter import desktop
from pdcd.presenter.client import DisplayProcess
from pdcd.presenter.levels import list_level_findings
from pdcd.presenter.messages import Open, PanelMode, Ready
from pdcd.presenter.options import VERIFIED, SourceName, X11Options, read_x11_options
from pdcd.presenter.outputs import (
    Output,
    OutputPair,
    check_nominal,
    check_rates,
    find_pair,
    has_overlap,
    place_pair,
    read_outputs,
)
from pdcd.presenter.xconnection import close_x_connection, guard_x_calls, open_x_connection

TURNED_HINT = (
    "the server may copy what it would else flip, so times may not be verified; flip and turn_deg "
    "under [projector.place] and [mask.place] do the same"
)
_NOMINAL_HZ = 60.0
"""Rate that is assumed where neither a configuration nor the server gives one."""


def examine_display(config: Config, display_name: str | None = None) -> Iterator[Finding]:
    """Yield findings; `config` names the panels if its display driver is x11.

    Takes about five seconds, during which both panels are black. Failures become findings, not
    exceptions.
    """
    options = None
    if config.display.driver == "x11":
        try:
            options = read_x11_options(config)
        except ConfigError as err:
            yield _fault("configuration", err)
    display_name = display_name or (options.display if options else None)
    try:
        display = open_x_connection(display_name)
    except PdcdError as err:
        yield _fault("X server", err)
        yield _unknown("outputs", "there is no X server")
        yield from _permissions(None)
        return
    try:
        yield from _examine(display, config, options)
    except PdcdError as err:
        yield _fault("X server", err)
    finally:
        close_x_connection(display)


def _examine(display: Any, config: Config, options: X11Options | None) -> Iterator[Finding]:
    info = display.display.info
    name = display.get_display_name()
    screen = display.screen()
    size = f"{screen.width_in_pixels} x {screen.height_in_pixels}, depth {screen.root_depth}"
    vendor = f"{info.vendor} {info.release_number}"
    yield Finding("X server", "good", f"{name}: {vendor}, {size}")
    outputs = read_outputs(display)
    pair = None
    yield from _outputs(outputs)
    try:
        pair = _pair(outputs, config, options)
    except PdcdError as err:
        yield _fault("panels", err)
    else:
        yield _panels(pair)
    yield _rates(pair)
    levels = list(_levels(pair, exact=config.display.planes_per_refresh > 1))
    yield from levels
    faults = desktop.list_desktop_faults(desktop.inspect_desktop(display), name)
    for found in faults:
        yield _fault("desktop", found)
    if not faults:
        yield Finding("desktop", "good", "no compositor, no window manager, no blanking")
    if (cells := describe_oblong_cells(config, config.code_grid())) and options is not None:
        yield Finding("cells", "warning", cells)
    if display.has_extension("Composite"):
        yield Finding(
            "Composite", "warning", "the extension is on, so a compositor could start",
            'Section "Extensions", Option "Composite" "Disable" in xorg.conf',
        )  # fmt: skip
    if _occupied(display):
        why = "not tried: a window is on the screen, perhaps the daemon's"
        yield Finding("renderer", "unknown", why, "stop pdcd.service and ask again")
        yield from _permissions(None)
    elif pair is None or any(found.state == "fault" for found in levels):
        why = "there are no two panels" if pair is None else "no code is shown over such levels"
        yield _unknown("renderer", f"not tried: {why}")
        yield from _permissions(None)
    else:
        yield from _opened(name, pair, config, options)


def _outputs(outputs: tuple[Output, ...]) -> Iterator[Finding]:
    connected = [o for o in outputs if o.connected]
    for output in connected:
        mode = f", mode {output.mode}" if output.on else ""
        edid = "" if output.edid else "; no EDID: choose it by its name"
        found = f"{output}{mode}{edid}"
        if output.turned:
            yield Finding("output", "warning", found, TURNED_HINT)
        else:
            yield Finding("output", "good", found)
    if not connected:
        yield Finding("output", "fault", "none is connected", "check cables and power")


def _pair(
    outputs: tuple[Output, ...], config: Config, options: X11Options | None
) -> OutputPair | None:
    """The panels of the configuration, or else the only two outputs that are on."""
    if options is None:
        on = [o for o in outputs if o.connected and o.on]
        return OutputPair(on[0], on[1]) if len(on) == 2 and not has_overlap(on[0], on[1]) else None
    projector = options.projector, config.projector.size_px
    mask = options.mask, config.mask.size_px
    if options.positions_px is not None:
        places = options.positions_px
        pair = place_pair(outputs, projector=projector, mask=mask, positions_px=places)
    else:
        pair = find_pair(outputs, projector=projector, mask=mask)
    rates_hz = config.projector.refresh_hz, config.mask.refresh_hz
    check_nominal(pair, projector_hz=rates_hz[0], mask_hz=rates_hz[1])
    return pair


def _panels(pair: OutputPair | None) -> Finding:
    if pair is None:
        return _unknown("panels", "not named", "give --config with an x11 display in it")
    return Finding("panels", "good", f"{pair.projector.name} and {pair.mask.name}")


def _levels(pair: OutputPair | None, *, exact: bool) -> Iterator[Finding]:
    if pair is None:
        yield _unknown("levels", "there are no two panels")
        return
    for role, output in (("projector", pair.projector), ("mask", pair.mask)):
        yield from list_level_findings(output.name, role, output.levels, exact=exact)


def _rates(pair: OutputPair | None) -> Finding:
    if pair is None:
        return _unknown("lockstep", "there are no two panels")
    first_hz, second_hz = pair.projector.refresh_hz, pair.mask.refresh_hz
    if first_hz is None or second_hz is None:
        return _unknown("lockstep", "the server knows no refresh rate")
    try:
        check_rates(first_hz, second_hz)
    except PdcdError as err:
        return _fault("lockstep", err)
    slip = "never slip" if pair.slip_s is None else f"slip a refresh every {pair.slip_s:.0f} s"
    return Finding(
        "lockstep", "good", f"{first_hz:.4f} and {second_hz:.4f} Hz by the modes: {slip}"
    )


def _occupied(display: Any) -> bool:
    """Whether any window is shown on the screen."""
    with guard_x_calls(display):
        for window in display.screen().root.query_tree().children:
            try:
                attributes = window.get_attributes()
            except error.BadWindow:  # it has just gone
                continue
            shown = attributes.map_state == X.IsViewable
            if shown and attributes.win_class == X.InputOutput:
                return True
    return False


def _opened(
    name: str, pair: OutputPair, config: Config, options: X11Options | None
) -> Iterator[Finding]:
    """The findings of the display process, with each time source in turn."""
    if options is None:
        options = X11Options(projector=pair.projector.name, mask=pair.mask.name)
    allowed, sources = options.allow_software, []
    readies: dict[SourceName, Ready] = {}
    failed = PdcdError("no time source")
    for source in get_args(SourceName):
        if source == "auto":
            continue
        tried = msgspec.structs.replace(
            options, display=name, allow_software=True, time_source=source
        )
        try:
            readies[source] = _open(tried, pair, config)
        except PdcdError as err:
            failed = err
            sources.append(_no_time(source, err))
        else:
            proof = "" if source in VERIFIED else ", proves no presentation"
            rate = f"{readies[source].refresh_hz:.3f} Hz{proof}"
            state: Literal["good", "warning"] = "good" if source in VERIFIED else "warning"
            sources.append(Finding(f"time by {source}", state, rate))
    if not readies:
        yield _fault("time", failed)
        yield from _permissions(None)
        return
    best = next(iter(readies.values()))
    renderer = best.identity["renderer"]
    if desktop.is_software_renderer(renderer):
        state_: Literal["warning", "fault"] = "warning" if allowed else "fault"
        hint = "install the graphics card's driver"
        if not allowed:
            hint += "; for tests: allow_software = true"
        yield Finding("renderer", state_, f"software: {renderer}", hint)
    else:
        yield Finding("renderer", "good", renderer)
    yield from sources
    yield from _permissions(best)


def _no_time(source: str, err: PdcdError) -> Finding:
    if isinstance(err, ConfigError):
        return Finding(f"time by {source}", "warning", err.message, err.hint)
    return Finding(f"time by {source}", "warning", "does not deliver")


def _open(options: X11Options, pair: OutputPair, config: Config) -> Ready:
    """Open both panels, black, and close them again."""
    configured = config.display.driver == "x11"
    panels = []
    for output, table in ((pair.projector, config.projector), (pair.mask, config.mask)):
        rate = table.refresh_hz if configured else output.refresh_hz or _NOMINAL_HZ
        panels.append(PanelMode(Map.filling(output.size), rate))
    presenter = DisplayProcess(Open(options, panels[0], panels[1]))
    try:
        return presenter.ready
    finally:
        presenter.close()


def _permissions(ready: Ready | None) -> Iterator[Finding]:
    """Real-time scheduling and locked memory, as the display process found them; without it, by the
    limits of this process."""
    if ready is None:
        root = os.geteuid() == 0
        priority, memory = resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK
        limits = {
            "real time": (resource.getrlimit(priority)[0] != 0, "LimitRTPRIO=20"),
            "memory lock": (
                resource.getrlimit(memory)[0] == resource.RLIM_INFINITY,
                "LimitMEMLOCK=infinity",
            ),
        }
        for what, (enough, hint) in limits.items():
            allowed = root or enough
            found = "permitted" if allowed else "not permitted"
            yield Finding(what, "good" if allowed else "warning", found, None if allowed else hint)
        return
    for what, key in (("real time", "realtime"), ("memory lock", "memory locked")):
        found = ready.identity[key]
        denied = found.startswith("no")
        yield Finding(what, "warning" if denied else "good", found)


def _fault(what: str, err: PdcdError) -> Finding:
    return fault(what, err, "display")


def _unknown(what: str, why: str, hint: str | None = None) -> Finding:
    return Finding(what, "unknown", why, hint)
