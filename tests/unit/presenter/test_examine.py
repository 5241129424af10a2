"""What decides whether two panels can be driven from here: each finding, and what it rests on."""

from __future__ import annotations

import os
import resource
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from Xlib import X, error

from pdcd.bench.devices import Finding
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, RigConfig
from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import examine as examine_module
from pdcd.presenter.desktop import Desktop
from pdcd.presenter.edid import parse_edid
from pdcd.presenter.examine import TURNED_HINT, examine_display
from pdcd.presenter.levels import OutputLevels
from pdcd.presenter.messages import Open, Ready
from pdcd.presenter.outputs import Output
from tests.edid_block import block

PANEL = parse_edid(block(name="EPSON PJ"))
STRAIGHT = OutputLevels((("gamma ramp", (tuple(range(0, 65536, 257)),) * 3),))
LEFT = Output("HDMI-1", True, 0, 0, 256, 192, "left", 60.0, edid=PANEL, levels=STRAIGHT)
RIGHT = Output("DP-1", True, 256, 0, 400, 300, "right", 60.0, edid=PANEL, levels=STRAIGHT)
IDENTITY = {"renderer": "a card", "realtime": "SCHED_FIFO 20", "memory locked": "yes"}


class Server:
    """A server, a display process and a system that are sound unless a test says otherwise."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.outputs: tuple[Output, ...] = (LEFT, RIGHT)
        self.desktop = Desktop()
        self.windows: list[Any] = []
        self.extensions: tuple[str, ...] = ()
        self.done: list[Any] = []
        self.failing: dict[str, Exception] = {}
        self.identity = dict(IDENTITY)
        self.gone: Exception | None = None
        self.display = SimpleNamespace(info=SimpleNamespace(vendor="X.Org", release_number=21))
        self.root = self
        self.width_in_pixels, self.height_in_pixels, self.root_depth = 656, 300, 24
        for name, made in (
            ("open_x_connection", self.connect), ("read_outputs", lambda display: self.read()),
            ("close_x_connection", lambda display: self.done.append("left")),
            ("DisplayProcess", self.process),
        ):  # fmt: skip
            monkeypatch.setattr(examine_module, name, made)
        monkeypatch.setattr("pdcd.presenter.desktop.inspect_desktop", lambda display: self.desktop)

    def connect(self, name: str | None) -> Any:
        self.done.append(("connect", name))
        if name == ":nobody":
            raise DeviceLost("the X server does not answer", device="display", hint="start it")
        return self

    def read(self) -> tuple[Output, ...]:
        if self.gone is not None:
            raise self.gone
        return self.outputs

    def get_display_name(self) -> str:
        return ":7"

    def screen(self) -> Any:
        return self

    def has_extension(self, name: str) -> bool:
        return name in self.extensions

    def query_tree(self) -> Any:
        return SimpleNamespace(children=self.windows)

    def process(self, request: Open) -> Any:
        source = request.options.time_source
        self.done.append(request)
        if source in self.failing:
            raise self.failing[source]
        return SimpleNamespace(
            ready=Ready(source, 59.95, dict(self.identity)), close=lambda: self.done.append("close")
        )

    def found(self, config: Config | None = None, name: str | None = None) -> list[Finding]:
        return list(examine_display(config or configured(), name))


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    return Server(monkeypatch)


def configured(options: dict[str, Any] | None = None, **tables: Any) -> Config:
    named = {"projector": "HDMI-1", "mask": "DP-1", "display": ":9", **(options or {})}
    panels = {
        "projector": PanelConfig(size_px=(256, 192), refresh_hz=60.0),
        "mask": PanelConfig(size_px=(400, 300), refresh_hz=60.0),
    }
    display = DisplayConfig(driver="x11", options=named)
    return Config(**{"rig": RigConfig(clock="real"), "display": display, **panels, **tables})


def by(findings: list[Finding]) -> dict[str, Finding]:
    return {finding.what: finding for finding in findings}


SOURCES = ("present-complete", "present-msc", "swap", "clock", "free")


def test_two_sound_panels_are_opened_once_for_each_source_of_time(server: Server) -> None:
    found = server.found()
    assert [(finding.what, finding.state) for finding in found] == [
        ("X server", "good"), ("output", "good"), ("output", "good"), ("panels", "good"),
        ("lockstep", "good"), ("projector levels", "good"), ("mask levels", "good"),
        ("desktop", "good"), ("renderer", "good"),
        ("time by present-complete", "good"),
        *((f"time by {name}", "warning") for name in SOURCES[1:]),
        ("real time", "good"), ("memory lock", "good"),
    ]  # fmt: skip
    told = by(found)
    assert told["X server"].found == ":7: X.Org 21, 656 x 300, depth 24"
    assert found[1].found == f"{LEFT}, mode left" and found[1].hint is None
    assert told["panels"].found == "HDMI-1 and DP-1"
    assert told["lockstep"].found == "60.0000 and 60.0000 Hz by the modes: never slip"
    assert told["desktop"].found == "no compositor, no window manager, no blanking"
    assert told["renderer"].found == "a card"
    assert told["time by present-complete"].found == "59.950 Hz"
    assert told["time by swap"].found == "59.950 Hz, proves no presentation"
    assert (told["real time"].found, told["memory lock"].found) == ("SCHED_FIFO 20", "yes")
    assert server.done[0] == ("connect", ":9") and server.done[-1] == "left"
    opened = [what for what in server.done if isinstance(what, Open)]
    assert [request.options.time_source for request in opened] == list(SOURCES)
    assert server.done.count("close") == len(opened)
    for request in opened:
        assert request.options.display == ":7" and request.options.allow_software
        assert (request.options.projector, request.options.mask) == ("HDMI-1", "DP-1")
        assert (request.projector.size_px, request.mask.size_px) == ((256, 192), (400, 300))


def test_without_a_configuration_the_only_two_outputs_are_taken(server: Server) -> None:
    off = Output("VGA-1", True)
    unknown = replace(RIGHT, refresh_hz=None)
    server.outputs = (LEFT, off, unknown)
    found = by(server.found(Config(), ":8"))
    assert server.done[0] == ("connect", ":8")
    assert found["panels"].found == "HDMI-1 and DP-1"
    assert (found["lockstep"].state, found["lockstep"].found) == (
        "unknown", "the server knows no refresh rate",
    )  # fmt: skip
    (request, *_) = [what for what in server.done if isinstance(what, Open)]
    assert (request.options.projector, request.options.mask) == ("HDMI-1", "DP-1")
    assert (request.projector.refresh_hz, request.mask.refresh_hz) == (60.0, 60.0)
    server.outputs = (replace(LEFT, refresh_hz=50.0), RIGHT)
    del server.done[:]
    server.found(Config())
    (request, *_) = [what for what in server.done if isinstance(what, Open)]
    assert (request.projector.refresh_hz, request.mask.refresh_hz) == (50.0, 60.0)


@pytest.mark.parametrize(
    "outputs",
    [(LEFT,), (LEFT, RIGHT, replace(RIGHT, name="DP-2", x=700)), (LEFT, replace(RIGHT, x=255)),
     (LEFT, replace(RIGHT, connected=False))],
)  # fmt: skip
def test_outputs_that_nobody_named_are_not_guessed(
    server: Server, outputs: tuple[Output, ...]
) -> None:
    server.outputs = outputs
    found = by(server.found(Config()))
    assert found["panels"] == Finding(
        "panels", "unknown", "not named", "give --config with an x11 display in it"
    )
    assert found["lockstep"] == Finding("lockstep", "unknown", "there are no two panels")
    assert found["renderer"].found == "not tried: there are no two panels"
    assert not [what for what in server.done if isinstance(what, Open)]


def test_each_output_says_what_is_odd_about_it(server: Server) -> None:
    turned = replace(LEFT, turned="upside down")
    blind = replace(RIGHT, edid=None)
    server.outputs = (turned, blind, Output("VGA-1", True), Output("DVI-1", False))
    first, second, third = [f for f in server.found() if f.what == "output"]
    assert (first.state, first.found, first.hint) == (
        "warning", f"{turned}, mode left", TURNED_HINT,
    )  # fmt: skip
    assert second.found == f"{blind}, mode right; no EDID: choose it by its name"
    assert third.found == "VGA-1: off; no EDID: choose it by its name"
    server.outputs = (Output("DVI-1", False),)
    (none,) = [f for f in server.found() if f.what == "output"]
    assert none == Finding("output", "fault", "none is connected", "check cables and power")


def test_panels_that_do_not_fit_are_a_fault_and_the_rest_is_looked_at(server: Server) -> None:
    for config, words in (
        (configured({"mask": "DP-9"}), "no output is named 'DP-9'"),
        (configured(mask=PanelConfig(size_px=(400, 301))), "not 400 x 301"),
        (configured(projector=PanelConfig(size_px=(256, 192), refresh_hz=50.0)), "not 50 Hz"),
        (configured(mask=PanelConfig(size_px=(400, 300), refresh_hz=75.0)), "not 75 Hz"),
        (configured({"positions_px": [[0, 0], [9, 9]]}), "do not lie within"),
    ):  # fmt: skip
        found = by(server.found(config))
        assert found["panels"].state == "fault" and words in found["panels"].found
        assert found["lockstep"].state == "unknown" and found["desktop"].state == "good"
    whole = Output("all", True, 0, 0, 700, 400, "all", 60.0, edid=PANEL)
    server.outputs = (whole,)
    placed = {"positions_px": [[0, 0], [256, 0]], "projector": "all", "mask": "all"}
    assert by(server.found(configured(placed)))["panels"].found == "all and all"


def test_rates_that_slip_are_told_and_refused_where_too_fast(server: Server) -> None:
    server.outputs = (LEFT, replace(RIGHT, refresh_hz=60.001))
    found = by(server.found(Config()))
    assert found["lockstep"].state == "good"
    assert found["lockstep"].found.endswith("slip a refresh every 1000 s")
    server.outputs = (LEFT, replace(RIGHT, refresh_hz=59.0))
    found = by(server.found(Config()))
    assert found["lockstep"].state == "fault" and "slip by one refresh" in found["lockstep"].found


def test_every_fault_of_the_desktop_is_a_finding(server: Server) -> None:
    server.desktop = Desktop("picom", None, 60)
    found = [finding for finding in server.found() if finding.what == "desktop"]
    assert [finding.state for finding in found] == ["fault", "fault"]
    assert "xset -display :7 s off" in str(found[1].hint)


def test_levels_are_looked_at_of_both_panels(server: Server) -> None:
    bent = OutputLevels(STRAIGHT.ramps, properties=(("underscan", ("on",)), ("dither", ("on",))))
    server.outputs = (replace(LEFT, levels=OutputLevels()), replace(RIGHT, levels=bent))
    found = by(server.found())
    assert found["projector levels"].state == "unknown"
    assert found["mask underscan"].state == "fault"
    assert found["mask underscan"].hint == "xrandr --output DP-1 --set underscan off"
    assert found["mask dither"].state == "warning" and "mask levels" not in found
    # Nothing would be opened over such levels; that is one fault and not two.
    assert found["renderer"].found == "not tried: no code is shown over such levels"
    assert not [what for what in server.done if isinstance(what, Open)]
    server.outputs = (LEFT,)
    assert by(server.found(Config()))["levels"].state == "unknown"


def window(*, shown: bool = True, kind: int = X.InputOutput, gone: bool = False) -> Any:
    def attributes() -> Any:
        if gone:
            raise error.BadWindow.__new__(error.BadWindow)
        state = X.IsViewable if shown else X.IsUnmapped
        return SimpleNamespace(map_state=state, win_class=kind)

    return SimpleNamespace(get_attributes=attributes)


@pytest.mark.parametrize(
    ("windows", "tried"),
    [
        ([window(shown=False), window(kind=X.InputOnly), window(gone=True)], True),
        ([window(gone=True), window()], False), ([window(), window(shown=False)], False),
    ],
)  # fmt: skip
def test_nothing_is_opened_over_a_window_that_shows_something(
    server: Server, windows: list[Any], tried: bool
) -> None:
    server.windows = windows
    found = by(server.found())
    assert bool([what for what in server.done if isinstance(what, Open)]) == tried
    if not tried:
        assert found["renderer"].state == "unknown"
        assert found["renderer"].hint == "stop pdcd.service and ask again"
        assert {"real time", "memory lock"} <= set(found)


def test_sources_that_fail_say_why_and_the_others_are_tried(server: Server) -> None:
    server.failing = {
        "present-complete": DeviceLost("late"), "swap": ConfigError("no pace", hint="keep it"),
    }  # fmt: skip
    found = by(server.found())
    assert found["time by present-complete"] == Finding(
        "time by present-complete", "warning", "does not deliver"
    )
    assert found["time by swap"] == Finding("time by swap", "warning", "no pace", "keep it")
    assert found["time by clock"].found == "59.950 Hz, proves no presentation"
    server.failing = {name: ConfigError(f"no {name}", hint="h") for name in SOURCES}
    found = by(server.found())
    assert found["time"] == Finding("time", "fault", "no free", "h")
    assert not [name for name in found if name.startswith("time by")] and "real time" in found


@pytest.mark.parametrize(("allowed", "state"), [(True, "warning"), (False, "fault")])
def test_a_renderer_on_the_processor_is_for_tests(
    server: Server, allowed: bool, state: str
) -> None:
    server.identity["renderer"] = "llvmpipe"
    found = by(server.found(configured({"allow_software": allowed})))["renderer"]
    assert (found.state, found.found) == (state, "software: llvmpipe")
    assert ("allow_software = true" in str(found.hint)) == (not allowed)


def test_what_the_process_was_not_permitted_is_a_warning(server: Server) -> None:
    server.identity |= {"realtime": "no: not permitted", "memory locked": "no: too much"}
    found = by(server.found())
    assert found["real time"] == Finding("real time", "warning", "no: not permitted")
    assert found["memory lock"] == Finding("memory lock", "warning", "no: too much")


@pytest.mark.parametrize(("user", "limits", "allowed"), [
    (0, (0, 0), (True, True)), (5, (0, 0), (False, False)), (5, (20, 0), (True, False)),
    (5, (0, resource.RLIM_INFINITY), (False, True)), (5, (1, 65536), (True, False)),
])  # fmt: skip
def test_without_a_process_this_ones_limits_say_what_is_permitted(
    server: Server,
    monkeypatch: pytest.MonkeyPatch,
    user: int,
    limits: tuple[int, int],
    allowed: tuple[bool, bool],
) -> None:
    soft = {resource.RLIMIT_RTPRIO: limits[0], resource.RLIMIT_MEMLOCK: limits[1]}
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (soft[kind], 7))
    found = by(server.found(name=":nobody"))
    assert found["X server"] == Finding(
        "X server", "fault", "the X server does not answer", "start it"
    )
    assert found["outputs"] == Finding("outputs", "unknown", "there is no X server")
    hints = "LimitRTPRIO=20", "LimitMEMLOCK=infinity"
    for what, fits, hint in zip(("real time", "memory lock"), allowed, hints, strict=True):
        assert found[what] == (
            Finding(what, "good", "permitted") if fits
            else Finding(what, "warning", "not permitted", hint)
        )  # fmt: skip


def test_options_that_are_wrong_are_a_fault_and_the_server_is_asked_all_the_same(
    server: Server,
) -> None:
    found = by(server.found(configured({"colour": "red"})))
    assert found["configuration"].state == "fault" and "colour" in found["configuration"].found
    assert server.done[0] == ("connect", None) and found["panels"].found == "HDMI-1 and DP-1"


def test_a_server_that_goes_meanwhile_is_a_finding(server: Server) -> None:
    server.gone = DeviceLost("gone", device="display", hint="h")
    found = server.found()
    assert [(finding.what, finding.state) for finding in found] == [
        ("X server", "good"), ("X server", "fault"),
    ]  # fmt: skip
    assert server.done[-1] == "left"


def test_a_compositor_that_could_start_is_a_warning(server: Server) -> None:
    assert "Composite" not in by(server.found())
    server.extensions = ("Composite",)
    found = by(server.found())["Composite"]
    assert (found.state, found.found) == (
        "warning", "the extension is on, so a compositor could start",
    )  # fmt: skip
    assert '"Composite" "Disable"' in str(found.hint)
