"""Transcripts of cameras and shutters, pixels of panels, figures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from tests.goldens import devices
from tests.goldens.case import Bench, Case
from tests.goldens.keep import keep_file, keep_run

SCENE = {"kind": "open-book", "grid": [6, 8]}
PTP = {
    "camera": {"driver": "ptp", "noise": "none", "f_number": 8.0, "options": {"usb": "virtual"}},
    "trigger": {"driver": "ptp"},
    "scene": SCENE,
}
LINES: dict[str, dict[str, Any]] = {
    "rts": {"release": "rts"},
    "dtr-low": {"release": "dtr", "active_low": True},
    "flash": {"release": "rts", "feedback": "cts"},
    "bytes": {
        "release": "command",
        "open_hex": "FF 01 01",
        "close_hex": "FF 01 00",
        "open_reply_hex": "06",
        "close_reply_hex": "07",
    },
    "no-answer": {
        "release": "command",
        "open_hex": "AA",
        "close_hex": "BB",
        "open_reply_hex": "06",
        "answer_s": 0.1,
    },
}
ANSWERS = {"FF 01 01": "06", "FF 01 00": "07"}
PHOTOS = "data/photos/"
"""What is left of figures that could not be made, by names that hold every line of the program."""
WINDOWS = ("whole", "quarter", "side-5/8", "side-3/4", "side-7/8")


def cases() -> list[Case]:
    """All of them."""
    found = [Case(f"ptp/{fault}", partial(_take_ptp, fault=fault), 2.0) for fault in devices.FAULTS]
    found += [
        Case("ptp/metered", _take_metered, 2.0),
        Case("ptp/cable", _take_cable, 2.0),
        Case("panels/drawn", _take_drawn, 3.0),
    ]
    found += [Case(f"serial/{name}", partial(_take_serial, name=name)) for name in LINES]
    for layout, places in (("span", "upright"), ("span", "bent"), ("windows", "upright")):
        take = partial(_take_shown, layout=layout, places=places)
        found.append(Case(f"panels/shown-{layout}-{places}", take, 9.0))
    for number in devices.figure_numbers():
        found.append(Case(f"figures/{number}", partial(_take_figure, number=number), 5.0))
    return found


def _capture(
    bench: Bench, tables: dict[str, Any], goal: str, ready: Callable[[Any], None], **keywords: Any
) -> None:
    """A capture by `import pdcd` before which the bench is made ready."""
    import pdcd

    ends: list[Any] = []

    def hear(event: Any) -> None:
        if event.type in ("done", "failed"):
            ends.append(event)

    with pdcd.local(tables, folder="runs") as rig:
        ready(rig)
        try:
            run = rig.capture(goal, progress=hear, **keywords)  # type: ignore[arg-type]
        except pdcd.errors.PdcdError as err:
            bench.keep_json("error", {"kind": err.kind, "device": err.device, "hint": err.hint})
        else:
            keep_run(bench, run.folder)
    for left in sorted((bench.scratch / "runs").glob("*.partial")):
        keep_run(bench, left, "left")


def _take_ptp(bench: Bench, fault: str) -> None:
    """All that the EOS driver and the camera say to each other during one capture."""
    with devices.usb_transcript() as told:
        codes = {"codes": 8, "parts": 1}
        _capture(bench, PTP, "indirect", partial(devices.play_faults, fault=fault), **codes)
        bench.keep_json("usb", told)


def _take_metered(bench: Bench) -> None:
    """With test exposures, and the camera's settings at the end."""
    tables = {**PTP, "camera": {**PTP["camera"], "f_number": "auto"}}  # type: ignore[dict-item]
    with devices.usb_transcript() as told:
        _capture(bench, tables, "direct", lambda rig: None, codes=8, parts=4)
        bench.keep_json("usb", told)


def _take_cable(bench: Bench) -> None:
    """The camera on the USB, its shutter on a serial cable."""
    trigger = {"driver": "serial", "options": {"port": "line://golden", "feedback": "cts"}}
    with devices.serial_line() as line, devices.usb_transcript() as told:
        tables = {**PTP, "trigger": trigger}
        _capture(bench, tables, "white", partial(devices.plug_cable, line), codes=4)
        bench.keep_json("usb", told)
        bench.keep_json("line", devices.edges_of(line))


def _take_serial(bench: Bench, name: str) -> None:
    """A shutter on a serial port, by lines or by bytes, with and without an answer."""
    options = {"port": "line://golden", **LINES[name]}
    tables = {"scene": SCENE, "trigger": {"driver": "serial", "options": options}}
    with devices.serial_line(ANSWERS) as line:
        flash = name == "flash"
        ready = partial(devices.keep_time, line, flash=flash)
        _capture(bench, tables, "indirect", ready, codes=8, parts=4)
        bench.keep_json("line", devices.edges_of(line))


def _take_drawn(bench: Bench) -> None:
    """What panels are to show, in every window, upright and bent."""
    for places in devices.PLACES:
        for window in WINDOWS:
            name = f"{places}-{window.replace('/', '-')}"
            bench.keep_arrays(name, devices.drawn_panels(window, (6, 8), places))
        bench.keep_arrays(f"{places}-odd", devices.drawn_panels("quarter", (7, 11), places))
        bench.keep_arrays(
            f"{places}-grey", devices.drawn_panels("whole", (5, 9), places, grey=True)
        )


def _take_shown(bench: Bench, layout: str, places: str) -> None:
    """What two panels on an X server do show."""
    wanted = [("whole", (12, 16), False), ("quarter", (7, 11), False), ("whole", (5, 9), True)]
    if layout == "span":
        wanted.append(("side-3/4", (7, 11), False))
    with devices.x_server() as server:
        pixels = devices.shown_panels(server, bench.scratch, wanted, places, layout)
    bench.keep_arrays("pixels", pixels)


def _take_figure(bench: Bench, number: str) -> None:
    """One figure of the paper in the smallest setting: numbers, pictures, plots."""
    bench.masks.cover({"seconds": "how long the computer took over its captures"})
    folder = bench.scratch / "figures"
    bench.keep_json("outcome", devices.make_figures(folder, [number]))
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not name.startswith(PHOTOS):
            keep_file(bench, name, path.read_bytes(), page=True)
