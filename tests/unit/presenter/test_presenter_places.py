"""Where both panels lie: asked once, watched from then on, the screen black below them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from Xlib import error

from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.map import Map
from pdcd.presenter import desktop
from pdcd.presenter import places as places_module
from pdcd.presenter.levels import OutputLevels
from pdcd.presenter.messages import Open, PanelMode, Rect
from pdcd.presenter.options import X11Options
from pdcd.presenter.outputs import Output
from pdcd.presenter.places import Places

PROJECTOR = Output("HDMI-1", True, 0, 0, 256, 192, "p", 60.0)

MASK = Output("DP-1", True, 256, 7, 400, 300, "m", 60.0)


class Screen:
    """A server of two outputs that takes note; `changes` is what its watcher answers next."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[Any] = []
        self.outputs: tuple[Output, ...] = (PROJECTOR, MASK)
        self.changes: list[bool] = []
        self.anew: list[bool] = []
        self.fault: Exception | None = None
        self.width_in_pixels, self.height_in_pixels, self.black_pixel = 656, 307, 17
        self.root = SimpleNamespace(
            change_attributes=lambda **how: self.note("background", how),
            clear_area=lambda: self.note("clear"),
        )
        for name in ("open_x_connection", "Watcher", "read_outputs"):
            monkeypatch.setattr(places_module, name, getattr(self, name))
        monkeypatch.setattr(desktop, "check_desktop", lambda display: self.note("desktop"))

    def note(self, *what: Any) -> None:
        self.done.append(what[0] if len(what) == 1 else what)

    def open_x_connection(self, name: str | None) -> Any:
        self.note("connect", name)
        return self

    def get_display_name(self) -> str:
        return ":7.0"

    def screen(self) -> Any:
        return self

    def sync(self) -> None:
        if self.fault is not None:
            raise self.fault
        self.note("sync")

    def read_outputs(self, display: object, *, anew: bool) -> tuple[Output, ...]:
        assert display is self
        self.anew.append(anew)
        return self.outputs

    def Watcher(self, display: Any) -> Any:
        assert display is self
        return SimpleNamespace(fileno=lambda: 9, changed=lambda: self.changes.pop(0))


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Screen:
    return Screen(monkeypatch)


def opening(rates_hz: tuple[float, float] = (60.0, 60.0), **options: Any) -> Open:
    settings = X11Options(**{"projector": "HDMI-1", "mask": "DP-1", **options})
    first, second = Map.filling((256, 192)), Map.filling((400, 300))
    return Open(settings, PanelMode(first, rates_hz[0]), PanelMode(second, rates_hz[1]))


def test_both_panels_are_found_and_the_screen_made_black_below_them(screen: Screen) -> None:
    made = Places(":7", opening())
    assert screen.done == [
        ("connect", ":7"), "desktop", ("background", {"background_pixel": 17}), "clear", "sync",
        ("connect", ":7"),
    ]  # fmt: skip
    assert made.name == ":7.0" and made.screen_px == (656, 307) and made.fileno() == 9
    assert made.outputs == (PROJECTOR, MASK)
    assert made.panels == (Rect(0, 0, 256, 192), Rect(256, 7, 400, 300))


def test_what_the_outputs_are_and_how_they_slip_is_told(screen: Screen) -> None:
    texts = {"projector": str(PROJECTOR), "mask": str(MASK)}
    made = Places(None, opening())
    assert made.identity == {**texts, "slip": "none"} and not made.drifts
    slower = replace(MASK, refresh_hz=59.99)
    screen.outputs = (PROJECTOR, slower)
    made = Places(None, opening())
    assert made.identity["slip"] == "one refresh in 100.0 s" and made.drifts
    screen.outputs = (PROJECTOR, replace(MASK, refresh_hz=None))
    made = Places(None, opening())
    assert "slip" not in made.identity and set(made.identity) == {"projector", "mask"}


def test_a_server_that_goes_at_the_start_is_lost(screen: Screen) -> None:
    screen.fault = error.ConnectionClosedError("server")
    with pytest.raises(DeviceLost, match=r":7\.0 does not answer"):
        Places(None, opening())


def test_parts_of_one_output_lie_where_the_options_say(screen: Screen) -> None:
    screen.outputs = (replace(PROJECTOR, name="screen", width=656, height=307, refresh_hz=None),)
    places: dict[str, Any] = {
        "positions_px": ((0, 3), (256, 7)),
        "projector": "screen",
        "mask": "screen",
    }
    made = Places(None, opening(**places))
    assert made.panels == (Rect(0, 3, 256, 192), Rect(256, 7, 400, 300))


def test_a_change_is_remembered_until_it_is_looked_into(screen: Screen) -> None:
    made = Places(None, opening())
    screen.changes = [False, True, False, False, False]
    assert [made.changed() for _ in range(3)] == [False, True, True]
    made.check()  # the outputs are as they were
    screen.changes = [False]
    assert not made.changed()


def test_outputs_that_became_others_are_lost_and_none_is_read_without_need(
    screen: Screen,
) -> None:
    made = Places(None, opening())
    moved = replace(MASK, x=300)
    screen.outputs = (PROJECTOR, moved)
    screen.changes = [False]
    made.check()
    screen.changes = [True]
    with pytest.raises(DeviceLost) as told:
        made.check()
    assert told.value.message == (
        f"the outputs have changed: {PROJECTOR}; {MASK} became {PROJECTOR}; {moved}"
    )
    assert told.value.device == "display" and "restore the modes" in str(told.value.hint)
    screen.outputs, screen.changes = (PROJECTOR, replace(MASK, width=0)), [True]
    with pytest.raises(ConfigError, match="switched off"):
        made.check()


RAMP = tuple(range(0, 65536, 257))
BENT = tuple(round(65535 * (k / 255) ** 0.8) for k in range(256))


def levels(ramp: tuple[int, ...] = RAMP, **properties: str) -> OutputLevels:
    named = tuple((name, (value,)) for name, value in properties.items())
    return OutputLevels((("gamma ramp", (ramp,) * 3),), properties=named)


def test_no_code_is_shown_over_levels_that_are_not_its_own(screen: Screen) -> None:
    screen.outputs = (PROJECTOR, replace(MASK, levels=levels((0,) * 256)))
    with pytest.raises(ConfigError) as told:
        Places(None, opening())
    assert told.value.message == "mask gamma ramp: DP-1: all 0: the panel stays black"
    assert told.value.hint == "xrandr --output DP-1 --gamma 1:1:1"
    screen.outputs = (replace(PROJECTOR, levels=levels(BENT, dither="on")), MASK)
    first, second = Places(None, opening()).warnings
    assert first.startswith("projector gamma ramp: HDMI-1: levels 0, 128, 255 come out as 0, 147,")
    assert first.endswith(": xrandr --output HDMI-1 --gamma 1:1:1")
    assert second.endswith(": xrandr --output HDMI-1 --set dither off")
    bits = replace_plane_order(opening(), "GRB")
    with pytest.raises(ConfigError, match="projector gamma ramp"):
        Places(None, bits)


def replace_plane_order(request: Open, order: str) -> Open:
    return Open(request.options, request.projector, request.mask, order)


def test_ramps_of_which_no_server_tells_are_looked_at_before_and_after_light(
    screen: Screen,
) -> None:
    made = Places(None, opening())
    screen.changes = [False] * 4
    made.check(unheard=True)
    assert screen.anew == [True, False]
    screen.outputs = (PROJECTOR, replace(MASK, levels=levels((0,) * 256)))
    made.check()  # which asks nobody
    with pytest.raises(ConfigError, match="all 0"):
        made.check(unheard=True)
    screen.outputs = (PROJECTOR, replace(MASK, levels=levels(BENT)))
    with pytest.raises(DeviceLost, match=r"mask gamma ramp DP-1: levels .* come out"):
        made.check(unheard=True)
