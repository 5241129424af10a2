"""From facts and choices to the tables of a configuration, without device, clock or file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from pdcd.errors import ConfigError
from pdcd.presenter.outputs import Output
from pdcd.presenter.timings import VideoTiming, match_timings
from pdcd.setup.facts import (
    MOCK,
    OWN_RELEASE,
    VIRTUAL,
    BenchChoices,
    BenchFacts,
    PortFact,
)
from pdcd.setup.grid import choose_field

SERVER = ":7"
"""The X server of pdcd-x.service."""
_ROLES = "projector", "mask"
_INSIDE = ("eDP", "LVDS", "DSI")
"""First letters of the names of a laptop's own panels."""
_BEAMS = ("projector", "beamer", " pj", "epson", "optoma")
"""Words that names of projectors contain."""
_VIRTUAL_QUADS = [480, 320]
"""Frame of the virtual camera; its full two million quads would take seconds a photo."""
_LAG_S, _JITTER_S = 0.1, 0.02
"""Typical lag and jitter of a camera body's mirror and blades."""
_BODY = (
    "on the camera: dial on M, lens on MF; long-exposure noise reduction and the rotation of "
    "pictures off"
)


@dataclass(frozen=True)
class PanelModes:
    """Two outputs that get a server of their own, the modes of both, and the names of the others
    that are connected."""

    outputs: tuple[Output, Output]
    timings: tuple[VideoTiming, VideoTiming]
    others: tuple[str, ...] = ()


@dataclass
class BenchProposal:
    """What to write, and what to tell the user.

    tables, notes : of the configuration, as `format_toml` takes them. modes : None where no server
    is to be set up, or no two modes have the same rate. port : the serial port of the release, if
    it is on one. why : what was chosen, and why. plug : what to plug in where. left : what only the
    user can do or check.
    """

    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: dict[tuple[str, ...], str] = field(default_factory=dict)
    modes: PanelModes | None = None
    port: PortFact | None = None
    why: list[str] = field(default_factory=list)
    plug: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    def put(self, table: str, **values: Any) -> None:
        """Add to a table of the configuration."""
        self.tables.setdefault(table, {}).update(values)


def suggest_choices(facts: BenchFacts, typed: dict[str, str | None]) -> BenchChoices:
    """The default choices: as projector the panel that calls itself one, else the first panel; the
    first camera, which opens its own shutter.

    typed : the user's answers by the name of the choice, None for no answer. Raises ConfigError for
    an answer that was not found.
    """
    outputs = sorted(facts.outputs, key=lambda o: (o.name.startswith(_INSIDE), not _is_beam(o)))
    names, keys = [o.name for o in outputs], [c.key for c in facts.cameras]
    found = {role: _known(role, typed.get(role), names) for role in _ROLES}
    for role in _ROLES:
        spare = [name for name in names if name not in found.values()]
        if len(names) > 1 and not found[role]:
            found[role] = spare[0]
    if found["projector"] and found["projector"] == found["mask"]:
        raise ConfigError("one output cannot be both panels", hint="give --projector and --mask")
    camera = _known("camera", typed.get("camera"), [*keys, VIRTUAL, MOCK]) or [*keys, MOCK][0]
    both = all(found.values())
    return BenchChoices(
        found["projector"] if both else "",
        found["mask"] if both else "",
        camera,
        typed.get("release") or OWN_RELEASE,
    )


def _known(what: str, typed: str | None, there: Sequence[str]) -> str:
    if typed and typed not in there:
        hint = f"give one of these: {', '.join(there) or 'none is connected'}"
        raise ConfigError(f"--{what} {typed} was not found", hint=hint)
    return typed or ""


def _is_beam(output: Output) -> bool:
    said = f" {output.edid}".lower() if output.edid else ""
    return any(word in said for word in _BEAMS)


def describe_panel(output: Output) -> str:
    """An output in words; if no server shows it, with the best of its modes."""
    if output.on or not output.timings:
        return str(output)
    width, height = output.timings[0].size
    return f"{output.name}{f' ({output.edid})' if output.edid else ''}: {width} x {height}"


def suggest_bench(facts: BenchFacts, chosen: BenchChoices) -> BenchProposal:
    """The bench of these choices. Missing panels and a missing camera are replaced by mock ones,
    and `left` says so."""
    made = BenchProposal()
    if chosen.projector:
        by_name = {output.name: output for output in facts.outputs}
        _add_panels(made, facts, (by_name[chosen.projector], by_name[chosen.mask]))
    else:
        made.left.append(
            "connect projector and mask to one graphics card and say pdcd init again: "
            f"{len(facts.outputs)} outputs are connected, so both panels are simulated"
        )
    _add_camera(made, facts, chosen)
    _add_release(made, facts, chosen)
    return made


def _add_panels(made: BenchProposal, facts: BenchFacts, pair: tuple[Output, Output]) -> None:
    """Add [projector], [mask], [display] and the cells."""
    made.put("rig", name="bench", clock="real")
    options: dict[str, Any] = {}
    serials = [s for output in facts.outputs if output.edid for s in output.edid.serials]
    for role, output in zip(_ROLES, pair, strict=True):
        own = [s for s in output.edid.serials if serials.count(s) == 1] if output.edid else []
        options[role] = own[0] if own else output.name
        if own:
            made.notes["display", "options", role] = f"serial number; it is on {output.name}"
        made.plug.append(f"{role}: {describe_panel(output)}")
    made.plug.append(
        "the mask is mounted upside down where a lens between it and the scene turns its picture"
    )
    options["display"] = facts.server or SERVER
    made.put("display", driver="x11", options=options)
    sizes, rates = [o.size for o in pair], [o.refresh_hz for o in pair]
    if facts.server is None:
        timings = match_timings(pair[0].timings, pair[1].timings)
        if timings is None:
            made.left.append(_unmatched(pair))
            return
        others = tuple(o.name for o in facts.outputs if o not in pair)
        made.modes = PanelModes(pair, timings, others)
        sizes, rates = [t.size for t in timings], [t.refresh_hz for t in timings]
    elif not facts.card:
        options["allow_software"] = True
        made.put("rig", on_miss="flag")
        made.notes["rig", "on_miss"] = "drawn by the processor, many refreshes come late"
        made.left.append("this machine has no graphics card: fit to try things, not to measure")
    for role, size, rate in zip(_ROLES, sizes, rates, strict=True):
        made.put(
            role, size_px=list(size), **({} if rate is None else {"refresh_hz": round(rate, 4)})
        )
    _add_cells(made, sizes[0], sizes[1])


def _unmatched(pair: tuple[Output, Output]) -> str:
    unknown = [output.name for output in pair if not output.timings]
    if unknown:
        return f"{' and '.join(unknown)} told no modes: switch the panel on and say pdcd init again"
    return (
        "the panels have no modes of one rate: give both modelines of one rate in an xorg.conf "
        "(docs/display.md), and sizes and rates in pdcd.toml"
    )


def _add_cells(made: BenchProposal, projector: tuple[int, int], mask: tuple[int, int]) -> None:
    """Add cells that are square on the scene, and the part of the projector's picture they fill."""
    width, height = projector
    (left, top, wide, tall), (rows, cols) = choose_field(projector, mask)
    made.put("scene", grid=[rows, cols])
    made.notes["scene", "grid"] = f"cells of {wide // cols} x {tall // rows} projector pixels"
    whole = (wide, tall) == projector
    made.why.append(
        f"{rows} x {cols} cells, squares of {wide // cols} projector pixels, on "
        f"{'all' if whole else f'{wide} x {tall}'} of the projector's {width} x {height}"
        f"{'' if whole else ': the part that has the shape of the mask, in the middle'}"
    )
    if whole:
        return
    made.put("projector", field_px=[left, top, wide, tall])
    made.notes["projector", "field_px"] = "of the mask's shape; pdcd calibrate geometry measures it"
    across, down = wide / width / mask[0], tall / height / mask[1]
    homography = [across, 0.0, left / width, 0.0, down, top / height, 0.0, 0.0, 1.0]
    made.put("mask", place={"homography": homography})
    made.notes["mask", "place"] = "fills the field, until pdcd calibrate geometry measures it"


def _add_camera(made: BenchProposal, facts: BenchFacts, chosen: BenchChoices) -> None:
    """Add [camera]."""
    if chosen.camera == MOCK:
        made.left.append(
            "plug in a camera, switch it on and say pdcd init again: none was "
            f"{'chosen' if facts.cameras else 'found'}, so photos are simulated"
        )
    elif chosen.camera == VIRTUAL:
        made.put("camera", driver="ptp", profile="450d", frame_quads=_VIRTUAL_QUADS)
        made.put("camera", options={"usb": VIRTUAL})
        made.left.append("the camera is a virtual EOS 450D, which sees a simulated scene")
    else:
        camera = next(c for c in facts.cameras if c.key == chosen.camera)
        alike = [c for c in facts.cameras if c.driver == camera.driver]
        made.put("rig", clock="real")
        made.put("camera", driver=camera.driver, profile=camera.profile)
        if len(alike) > 1 and camera.driver != "gphoto2":
            made.put("camera", options={"id" if camera.driver == "ptp" else "camera": camera.key})
        made.plug.append(f"camera: {camera.words}")
        if camera.driver != "genicam":
            made.plug.append(_BODY)
        if chosen.f_number is None and camera.driver == "genicam":
            made.left.append("write the lens's f-number into pdcd.toml: [camera] f_number")
    if chosen.f_number is not None:
        made.put("camera", f_number=chosen.f_number)


def _add_release(made: BenchProposal, facts: BenchFacts, chosen: BenchChoices) -> None:
    """Add [trigger]."""
    if chosen.release == OWN_RELEASE:
        driver = made.tables.get("camera", {}).get("driver")
        if driver is not None:
            made.put("trigger", driver=driver)
            made.why.append("the camera opens its own shutter")
            if driver != "genicam":
                made.put("trigger", lag_s=_LAG_S, jitter_s=_JITTER_S)
                made.notes["trigger", "lag_s"] = "pdcd calibrate shutter measures it"
        if facts.ports:
            names = ", ".join(port.path for port in facts.ports)
            made.why.append(f"no release on a serial port ({names}): --release PORT takes one")
        return
    known = [port for port in facts.ports if port.path == chosen.release]
    made.port = known[0] if known else PortFact(chosen.release)
    options: dict[str, Any] = {"port": chosen.release, "release": chosen.line}
    if chosen.line == "command":
        options |= {"open_hex": chosen.open_hex, "close_hex": chosen.close_hex}
    made.put("rig", clock="real")
    made.put("trigger", driver="serial", lag_s=_LAG_S, jitter_s=_JITTER_S, options=options)
    made.notes["trigger", "lag_s"] = "pdcd calibrate shutter measures it"
    how = "the box" if chosen.line == "command" else f"line {chosen.line.upper()}"
    made.plug.append(f"release: {how} on {chosen.release} to the camera's jack (docs/cameras.md)")
