"""Compositors, window managers and blanking are seen on a real server."""

from __future__ import annotations

from collections.abc import Iterator
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


def test_a_window_manager_is_refused(display: Any, other: Any) -> None:
    own(other, "WM_S0", "twm")
    with pytest.raises(ConfigError, match="a window manager owns the screen: twm"):
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
