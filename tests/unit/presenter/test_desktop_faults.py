"""What a server says of itself beside its outputs, and what is found wrong with it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from Xlib import X, error

from pdcd.errors import DeviceLost
from pdcd.presenter.desktop import (
    Desktop,
    inspect_desktop,
    is_software_renderer,
    list_desktop_faults,
)


class Server:
    """Nobody owns anything, and nothing blanks."""

    def __init__(self) -> None:
        self.dpms = {"has": True, "capable": True, "state": True, "level": 0}
        self.times = (0, 0, 0)

    def get_default_screen(self) -> int:
        return 0

    def get_display_name(self) -> str:
        return ":7"

    def screen(self) -> Any:
        root = SimpleNamespace(get_full_property=lambda atom, kind: None)
        return SimpleNamespace(root=root)

    def intern_atom(self, name: str, only_if_exists: bool = False) -> int:
        return int(X.NONE)

    def get_screen_saver(self) -> Any:
        return SimpleNamespace(timeout=0)

    def has_extension(self, name: str) -> bool:
        return name == "DPMS" and bool(self.dpms["has"])

    def dpms_capable(self) -> Any:
        return SimpleNamespace(capable=self.dpms["capable"])

    def dpms_info(self) -> Any:
        return SimpleNamespace(state=self.dpms["state"], power_level=self.dpms["level"])

    def dpms_get_timeouts(self) -> Any:
        standby, suspend, off = self.times
        return SimpleNamespace(standby_timeout=standby, suspend_timeout=suspend, off_timeout=off)


@pytest.fixture
def server() -> Server:
    return Server()


@pytest.mark.parametrize(
    ("changed", "power_s", "asleep"),
    [
        ({}, (60, 0, 900), False), ({"level": 3}, (60, 0, 900), True),
        ({"has": False, "level": 3}, (0, 0, 0), False),
        ({"capable": False, "level": 3}, (0, 0, 0), False),
        ({"state": False, "level": 3}, (0, 0, 0), False),
    ],
)  # fmt: skip
def test_power_management_counts_where_it_is_there_and_on(
    server: Server, changed: dict[str, Any], power_s: tuple[int, int, int], asleep: bool
) -> None:
    server.dpms |= changed
    server.times = (60, 0, 900)
    assert inspect_desktop(server) == Desktop(power_s=power_s, asleep=asleep)


def test_a_server_that_goes_meanwhile_is_lost(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> int:
        raise error.ConnectionClosedError("server")

    monkeypatch.setattr(server, "get_default_screen", gone)
    with pytest.raises(DeviceLost, match=":7 does not answer"):
        inspect_desktop(server)


SLEEPY = "xset -display :9 -dpms, and Option DPMS false in xorg.conf"


@pytest.mark.parametrize(
    ("desktop", "message", "hint"),
    [
        (Desktop("picom"), "a compositor owns the screen: picom", 'Composite "Disable"'),
        (Desktop(None, "twm"), "a window manager owns the screen: twm", "pdcd-x.service"),
        (Desktop(blank_s=1), "the screen saver blanks the panels after 1 s",
         "xset -display :9 s off, and BlankTime 0 in xorg.conf"),
        (Desktop(power_s=(0, 900, 600)), "(DPMS) switches the panels off after 600 s", SLEEPY),
        (Desktop(asleep=True), "(DPMS) has switched the panels off", SLEEPY),
        (Desktop(power_s=(1, 0, 0), asleep=True), "(DPMS) has switched the panels off", SLEEPY),
    ],
)  # fmt: skip
def test_each_fault_says_what_to_do(desktop: Desktop, message: str, hint: str) -> None:
    (fault,) = list_desktop_faults(desktop, ":9")
    assert fault.message.endswith(message) and hint in str(fault.hint)
    assert fault.device == "display"


@pytest.mark.parametrize(
    ("renderer", "soft"),
    [("llvmpipe (LLVM 15)", True), ("SoftPipe", True), ("Mesa swrast", True),
     ("Software Rasterizer", True), ("NVIDIA H200", False), ("", False)],
)  # fmt: skip
def test_renderers_on_the_processor_are_told_by_their_names(renderer: str, soft: bool) -> None:
    assert is_software_renderer(renderer) is soft
