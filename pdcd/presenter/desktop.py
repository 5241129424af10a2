"""What on the X server may spoil a run: a compositor, a window manager, blanking, slow drawing.

A compositor redraws windows when it pleases and makes page flips impossible; a window manager may
move, cover or decorate them; blanking turns panels off during a long exposure. Sources: ICCCM 2.0
section 2.8 (manager selections), Extended Window Manager Hints 1.5 (_NET_WM_CM_Sn,
_NET_SUPPORTING_WM_CHECK), DPMS extension 1.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from Xlib import X, error

from pdcd.errors import ConfigError
from pdcd.presenter.xconnection import guard_x_calls

_SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software")


@dataclass(frozen=True)
class Desktop:
    """State of the X server apart from its outputs.

    compositor, window_manager : its name, "unnamed" if it has no name; None when there is none.
    blank_s : seconds after which the screen saver blanks; 0 is never.
    power_s : standby, suspend and off of DPMS, in seconds; all 0 when DPMS is off or absent.
    asleep : DPMS has the panels off now.
    """

    compositor: str | None = None
    window_manager: str | None = None
    blank_s: int = 0
    power_s: tuple[int, int, int] = (0, 0, 0)
    asleep: bool = False


def inspect_desktop(display: Any) -> Desktop:
    """Ask the server; changes nothing. Raises DeviceLost when it goes away."""
    with guard_x_calls(display):
        number = display.get_default_screen()
        power, asleep = _power(display)
        return Desktop(
            _owner(display, f"_NET_WM_CM_S{number}"),
            _owner(display, f"WM_S{number}") or _checked_manager(display),
            display.get_screen_saver().timeout,
            power,
            asleep,
        )


def list_desktop_faults(desktop: Desktop, display_name: str) -> list[ConfigError]:
    """Everything that must be changed before codes are shown, each with what to do."""
    found = []
    if desktop.compositor is not None:
        found.append(
            ConfigError(
                f"a compositor owns the screen: {desktop.compositor}",
                device="display",
                hint='end it, or use the X server of pdcd-x.service with Composite "Disable"',
            )
        )
    if desktop.window_manager is not None:
        found.append(
            ConfigError(
                f"a window manager owns the screen: {desktop.window_manager}",
                device="display",
                hint="end it, or use the X server of pdcd-x.service, which has none",
            )
        )
    if desktop.blank_s:
        found.append(
            ConfigError(
                f"the screen saver blanks the panels after {desktop.blank_s} s",
                device="display",
                hint=f"xset -display {display_name} s off, and BlankTime 0 in xorg.conf",
            )
        )
    if desktop.asleep or any(desktop.power_s):
        state = "has switched the panels off"
        if not desktop.asleep:
            after_s = min(t for t in desktop.power_s if t)
            state = f"switches the panels off after {after_s} s"
        found.append(
            ConfigError(
                f"power management (DPMS) {state}",
                device="display",
                hint=f"xset -display {display_name} -dpms, and Option DPMS false in xorg.conf",
            )
        )
    return found


def is_software_renderer(renderer: str) -> bool:
    """Whether the renderer of this name (GL_RENDERER) draws on the processor."""
    return any(name in renderer.lower() for name in _SOFTWARE_RENDERERS)


def check_desktop(display: Any) -> None:
    """Raise the first of `list_desktop_faults`, if there is one."""
    for fault in list_desktop_faults(inspect_desktop(display), display.get_display_name()):
        raise fault


def _power(display: Any) -> tuple[tuple[int, int, int], bool]:
    """DPMS timeouts in s (0: never) and whether panels are off now."""
    if not display.has_extension("DPMS") or not display.dpms_capable().capable:
        return (0, 0, 0), False
    info = display.dpms_info()
    if not info.state:
        return (0, 0, 0), False
    times = display.dpms_get_timeouts()
    seconds = (times.standby_timeout, times.suspend_timeout, times.off_timeout)
    return seconds, bool(info.power_level)


def _owner(display: Any, selection: str) -> str | None:
    """Name of the window that owns a manager selection; None when no window does."""
    atom = display.intern_atom(selection, True)
    if atom == X.NONE:
        return None
    window = display.get_selection_owner(atom)
    return None if window == X.NONE else _name(display, window)


def _checked_manager(display: Any) -> str | None:
    """Window manager that announces itself on the root window and is still alive."""
    window = _window_property(display, display.screen().root)
    if window is None:
        return None
    try:
        # The property outlives a manager that crashed, but its window is gone or points elsewhere.
        alive = _window_property(display, window)
        return _name(display, window) if alive is not None and alive.id == window.id else None
    except error.BadWindow:
        return None


def _window_property(display: Any, window: Any) -> Any | None:
    atom = display.intern_atom("_NET_SUPPORTING_WM_CHECK")
    found = window.get_full_property(atom, X.AnyPropertyType)
    if found is None or len(found.value) != 1:
        return None
    return display.create_resource_object("window", found.value[0])


def _name(display: Any, window: Any) -> str:
    """_NET_WM_NAME, else WM_NAME, else "unnamed"."""
    for key in ("_NET_WM_NAME", "WM_NAME"):
        try:
            found = window.get_full_property(display.intern_atom(key), X.AnyPropertyType)
        except error.BadWindow:
            break
        if found is not None and found.value:
            value = found.value
            return value if isinstance(value, str) else bytes(value).decode("utf-8", "replace")
    return "unnamed"
