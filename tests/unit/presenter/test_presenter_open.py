"""How the display process opens its panels: in which order, with what, and what it says of it."""

from __future__ import annotations

import os
import select
from types import SimpleNamespace
from typing import Any

import glfw
import pytest

from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, RigConfig
from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.map import Map
from pdcd.presenter import process, realtime
from pdcd.presenter.client import make_open_request
from pdcd.presenter.messages import Open, PanelMode, Rect
from pdcd.presenter.options import X11Options, read_x11_options
from pdcd.presenter.phase import VblankPhase
from pdcd.presenter.process import Presenter

SIZES = (256, 192), (400, 300)
PANELS = Rect(0, 0, 256, 192), Rect(256, 0, 400, 300)
PHASE = VblankPhase((1 / 60, 1 / 59.5), 0.0025)


class Parts:
    """All that a presenter is made of; `done` is what happened, in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[Any] = []
        self.renderer, self.drifts, self.queues = "NVIDIA H200", False, False
        self.phase: VblankPhase | None = PHASE
        self.registered: list[tuple[int, int]] = []
        for name, made in (
            ("Places", self._places),
            ("_start_glfw", lambda name: self.note("glfw", name)),
            ("PanelWindows", self._windows),
            ("PresentEvents", self._events),
            ("measure_vblank_phase", self._measure),
            ("measure_period_ns", self._probe),
            ("Grabs", lambda *words: self.note("grabs", *words)),
        ):
            monkeypatch.setattr(process, name, made)
        system = {
            "raise_priority": "SCHED_FIFO 20",
            "lock_memory": "yes",
            "stop_garbage_collection": None,
        }
        for name, said in system.items():
            monkeypatch.setattr(
                realtime,
                name,
                lambda *w, name=name, said=said: self.note(name, *w) and said,
            )
        monkeypatch.setattr(select, "poll", lambda: self)

    def note(self, *what: Any) -> bool:
        self.done.append(what[0] if len(what) == 1 else what)
        return True

    def register(self, fd: int, events: int) -> None:
        self.registered.append((fd, events))

    def _places(self, name: str | None, request: Open) -> Any:
        self.note("places", name)
        return SimpleNamespace(
            name=":7.0", fileno=lambda: 9, screen_px=(656, 300), panels=PANELS, drifts=self.drifts,
            identity={"projector": "P", "mask": "M"}, warnings=("mind the mask",),
        )  # fmt: skip

    def _windows(self, *words: Any) -> Any:
        self.note("windows", *words)
        names = ("black", "swap", "finish", "draw_black", "settle")
        return SimpleNamespace(
            renderer=self.renderer, timed_window=42,
            **{name: lambda name=name: self.note(name) for name in names},
        )  # fmt: skip

    def _events(self, name: str, window: int) -> Any:
        self.note("events", name, window)
        return "events"

    def _measure(self, name: str, panels: Any) -> VblankPhase | None:
        self.note("phase", name, panels)
        return self.phase

    def _probe(self, source: Any, frame: Any, nominal_ns: float) -> float:
        self.note("probe", source.name, round(nominal_ns))
        return 16_000_000.0

    def open(self, rates_hz: tuple[float, float] = (60.0, 50.0), **options: Any) -> Presenter:
        options = {"projector": "A", "mask": "B", "time_source": "clock", **options}
        modes = [
            PanelMode(Map.filling(size), rate) for size, rate in zip(SIZES, rates_hz, strict=True)
        ]
        request = Open(X11Options(**options), modes[0], modes[1], "GRB")
        return Presenter(request, lambda: False, 5)

    def words(self) -> list[Any]:
        return [what[0] if isinstance(what, tuple) else what for what in self.done]


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Parts:
    return Parts(monkeypatch)


def test_panels_are_opened_in_order_and_black_before_they_are_called_ready(parts: Parts) -> None:
    ready = parts.open(display=":7", layout="windows", realtime_priority=7).ready
    assert parts.words() == [
        "places", "glfw", "windows", "raise_priority", "events", "probe", "black", "phase",
        "lock_memory", "stop_garbage_collection",
    ]  # fmt: skip
    told = {what[0]: what[1:] for what in parts.done if isinstance(what, tuple)}
    # A source is judged by the slower of both rates.
    assert told["probe"] == ("clock", 20_000_000)
    assert parts.registered == [(5, select.POLLHUP), (9, select.POLLIN)]
    assert (ready.source, ready.refresh_hz, ready.lag_s) == ("clock", 62.5, 0.0025)
    assert ready.warnings == ("mind the mask",)
    assert ready.identity == {
        "projector": "P", "mask": "M", "layout": "windows", "renderer": "NVIDIA H200",
        "time source": "clock",
        "phase": "projector 60.000 Hz, mask 59.500 Hz, mask later by 2.50 ms",
        "realtime": "SCHED_FIFO 20", "memory locked": "yes",
    }  # fmt: skip


def test_a_lag_that_drifts_or_was_not_measured_is_none(parts: Parts) -> None:
    parts.drifts = True
    ready = parts.open().ready
    assert ready.lag_s is None and "later by 2.50 ms" in ready.identity["phase"]
    parts.drifts, parts.phase = False, None
    ready = parts.open().ready
    assert ready.lag_s is None
    assert ready.identity["phase"] == "not measured: no vblanks of two screens"


GRAB_PX = ((0, 3), (256, 7))


def test_a_screen_is_looked_at_where_the_bench_has_its_panels(parts: Parts) -> None:
    parts.open(grab_px=GRAB_PX, time_source="present-msc")
    ((name, boxes, settle),) = [what[1:] for what in parts.done if what[0] == "grabs"]
    assert (name, boxes) == (":7.0", ((0, 3, 256, 192), (256, 7, 400, 300)))
    settle()
    assert parts.done[-1] == "settle"


def test_a_source_that_queues_shows_what_comes_next_and_is_not_looked_at(parts: Parts) -> None:
    with pytest.raises(ConfigError, match=r"present-complete the screen may be a refresh ahead"):
        parts.open(grab_px=GRAB_PX, time_source="present-complete")
    parts.open(time_source="present-complete")


def test_a_library_that_cannot_open_the_display_is_a_lost_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise glfw.GLFWError("no server")

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(glfw, "ERROR_REPORTING", "warn")
    monkeypatch.setattr(glfw, "init", fail)
    with pytest.raises(DeviceLost, match=r"cannot open the display ':7': .*pdcd-x\.service"):
        process._start_glfw(":7")
    assert os.environ["DISPLAY"] == ":7" and glfw.ERROR_REPORTING == "raise"
    opened: list[str] = []
    monkeypatch.setattr(glfw, "init", lambda: opened.append(os.environ["DISPLAY"]))
    process._start_glfw(":9")
    assert opened == [":9"]


# What is asked of it, out of a configuration.


def config(planes: Any = 1, **tables: Any) -> Config:
    options = {"projector": "HDMI-1", "mask": "DP-1", "hang_s": 1.5}
    shown = DisplayConfig(
        driver="x11", options=options, planes_per_refresh=planes, plane_order="BRG"
    )
    panels = {
        "projector": PanelConfig(size_px=SIZES[0], refresh_hz=50.0),
        "mask": PanelConfig(size_px=SIZES[1], refresh_hz=75.0),
    }
    return Config(**{"rig": RigConfig(clock="real"), "display": shown, **panels, **tables})


@pytest.mark.parametrize(("planes", "order"), [(1, None), (24, "BRG")])
def test_a_configuration_says_what_is_opened(planes: int, order: str | None) -> None:
    request = make_open_request(config(planes))
    assert request.options == X11Options(projector="HDMI-1", mask="DP-1", hang_s=1.5)
    assert (request.projector.size_px, request.projector.refresh_hz) == (SIZES[0], 50.0)
    assert (request.mask.size_px, request.mask.refresh_hz) == (SIZES[1], 75.0)
    assert request.plane_order == order


def test_panels_that_are_simulated_or_badly_named_are_not_opened() -> None:
    with pytest.raises(ConfigError, match=r"panels keep real time \(set rig\.clock = \"real\"\)"):
        make_open_request(config(rig=RigConfig(clock="virtual")))
    with pytest.raises(ConfigError, match="has 'mock'"):
        read_x11_options(Config())
    wrong = DisplayConfig(driver="x11", options={"projector": "A", "mask": "B", "colour": 3})
    with pytest.raises(ConfigError, match=r"display\.options.*colour.*docs/display\.md") as told:
        read_x11_options(config(display=wrong))
    assert told.value.device == "display"


@pytest.mark.parametrize(
    ("key", "good", "bad"),
    [
        ("realtime_priority", (0, 99), (-1, 100)), ("hang_s", (0.1, 60.0), (0.09, 60.1)),
        ("stall_exposures", (0, 7), (-1,)), ("stalls_ms", ({"0": 0.0},), ({"0": -0.1}, {"a": 1.0})),
    ],
)  # fmt: skip
def test_options_have_limits(key: str, good: tuple[Any, ...], bad: tuple[Any, ...]) -> None:
    def read(value: Any) -> Any:
        options = {"projector": "A", "mask": "B", key: value}
        found = read_x11_options(config(display=DisplayConfig(driver="x11", options=options)))
        return getattr(found, key)

    assert [read(value) for value in good] == list(good)
    for value in bad:
        with pytest.raises(ConfigError, match=key):
            read(value)
