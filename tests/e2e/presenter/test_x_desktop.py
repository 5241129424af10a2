"""Compositors, window managers and blanking are seen on a real server; DPMS by a recorder."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from Xlib import X

from pdcd.errors import ConfigError
from pdcd.presenter import desktop
from pdcd.presenter.desktop import Desktop
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from tests.xserver import XServer, run


@pytest.fixture(scope="module")
def server() -> Iterator[XServer]:
    with run() as server:
        yield server


@pytest.fixture
def display(server: XServer) -> Iterator[Any]:
    """What the daemon looks with."""
    display = open_x_connection(server.display)
    yield display
    close_x_connection(display)


@pytest.fixture
def other(server: XServer) -> Iterator[Any]:
    """The desktop's own connection: what it sets ends with it."""
    display = open_x_connection(server.display)
    yield display
    display.set_screen_saver(0, 600, X.DefaultBlanking, X.DefaultExposures)
    display.screen().root.delete_property(display.intern_atom("_NET_SUPPORTING_WM_CHECK"))
    close_x_connection(display)


def window(display: Any, name: str = "") -> Any:
    root = display.screen().root
    made = root.create_window(0, 0, 1, 1, 0, X.CopyFromParent)
    if name:
        made.set_wm_name(name)
    return made


def own(display: Any, selection: str, name: str = "") -> None:
    made = window(display, name)
    made.set_selection_owner(display.intern_atom(selection), X.CurrentTime)
    display.sync()


def announce(display: Any, name: str) -> Any:
    """Say on the root window that a window manager runs, as EWMH wants it."""
    made = window(display)
    atom = display.intern_atom("_NET_SUPPORTING_WM_CHECK")
    for place in (made, display.screen().root):
        place.change_property(atom, 33, 32, [made.id])
    text = name.encode("utf-8")
    made.change_property(display.intern_atom("_NET_WM_NAME"), 31, 8, text)
    display.sync()
    return made


def test_a_bare_server_is_fit(display: Any) -> None:
    assert desktop.inspect_desktop(display) == Desktop()
    desktop.check_desktop(display)


def test_a_compositor_is_refused(display: Any, other: Any) -> None:
    own(other, "_NET_WM_CM_S0", "picom")
    with pytest.raises(ConfigError, match="a compositor owns the screen: picom"):
        desktop.check_desktop(display)


@pytest.mark.parametrize("name", ["twm", ""])
def test_a_window_manager_is_refused(display: Any, other: Any, name: str) -> None:
    own(other, "WM_S0", name)
    with pytest.raises(ConfigError, match=f"a window manager owns the screen: {name or 'unnamed'}"):
        desktop.check_desktop(display)


def test_a_manager_that_only_announces_itself_is_refused(display: Any, other: Any) -> None:
    announce(other, "Öpenbox")
    assert desktop.inspect_desktop(display).window_manager == "Öpenbox"


def test_the_announcement_of_a_dead_manager_does_not_count(display: Any, other: Any) -> None:
    announce(other, "crashed").destroy()
    other.sync()
    assert desktop.inspect_desktop(display).window_manager is None


def test_the_compositor_of_another_screen_does_not_count(display: Any, other: Any) -> None:
    own(other, "_NET_WM_CM_S1")
    desktop.check_desktop(display)


def test_blanking_is_refused(display: Any, other: Any) -> None:
    other.set_screen_saver(300, 600, X.DefaultBlanking, X.DefaultExposures)
    other.sync()
    with pytest.raises(ConfigError, match="blanks the panels after 300 s") as caught:
        desktop.check_desktop(display)
    assert f"xset -display {display.get_display_name()} s off" in str(caught.value)


def test_every_fault_is_named_at_once() -> None:
    worst = Desktop("picom", "twm", 600, (0, 900, 1200))
    texts = [str(fault) for fault in desktop.list_desktop_faults(worst, ":7")]
    assert len(texts) == 4
    assert "after 900 s (xset -display :7 -dpms" in texts[3]
    assert desktop.list_desktop_faults(Desktop(), ":7") == []


class PowerRecorder:
    """A server with DPMS, which neither the dummy driver nor Xvfb has."""

    def __init__(self, *, capable: bool = True, state: bool = True, level: int = 0) -> None:
        self._capable, self._state, self._level = capable, state, level

    def __getattr__(self, name: str) -> Any:
        answers = {
            "has_extension": True,
            "dpms_capable": SimpleNamespace(capable=self._capable),
            "dpms_info": SimpleNamespace(state=self._state, power_level=self._level),
            "dpms_get_timeouts": SimpleNamespace(
                standby_timeout=0, suspend_timeout=600, off_timeout=900
            ),
            "get_default_screen": 0,
            "get_screen_saver": SimpleNamespace(timeout=0),
            "intern_atom": X.NONE,
            "screen": SimpleNamespace(root=SimpleNamespace(get_full_property=lambda *_: None)),
        }
        return lambda *_: answers[name]


def test_power_management_is_read() -> None:
    assert desktop.inspect_desktop(PowerRecorder()) == Desktop(power_s=(0, 600, 900))
    assert desktop.inspect_desktop(PowerRecorder(state=False)) == Desktop()
    assert desktop.inspect_desktop(PowerRecorder(capable=False)) == Desktop()


def test_a_panel_that_sleeps_is_refused() -> None:
    (fault,) = desktop.list_desktop_faults(desktop.inspect_desktop(PowerRecorder(level=3)), ":7")
    assert "has switched the panels off" in str(fault)
