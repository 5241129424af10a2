"""A connection to the X server through python-xlib, with its failures as our own errors."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from Xlib import error
from Xlib.display import Display

from pdcd.errors import ConfigError, DeviceLost


def open_x_connection(name: str | None = None) -> Any:
    """Open a connection (an `Xlib.display.Display`) to `name`, or to $DISPLAY.

    Raises ConfigError when no server is named, DeviceLost when it does not answer.
    """
    name = name or os.environ.get("DISPLAY")
    if not name:
        raise ConfigError(
            "no X server is named: DISPLAY is not set",
            device="display",
            hint="start pdcd-x.service and set DISPLAY=:7, or [display.options] display",
        )
    local = re.fullmatch(r"(?:unix)?:(\d+)(?:\.\d+)?", name)
    if local is None:
        raise ConfigError(
            f"{name!r} is not the name of an X server on this machine",
            device="display",
            hint='write ":7"',
        )
    try:
        _knock(int(local[1]))
        # python-xlib prints on a strange cookie file; standard output may be JSON.
        with contextlib.redirect_stdout(sys.stderr):
            return Display(name)
    except (error.DisplayError, error.ConnectionClosedError, OSError) as err:
        raise make_server_lost(name, str(err)) from err


def close_x_connection(display: Any) -> None:
    """Close a connection, whatever its state."""
    with contextlib.suppress(error.ConnectionClosedError, OSError):
        display.close()
    # python-xlib does not do this on a connection that the server has ended.
    display.display.socket.close()


@contextlib.contextmanager
def guard_x_calls(display: Any) -> Iterator[None]:
    """Raise DeviceLost when the server goes away inside the block."""
    try:
        yield
    except (error.ConnectionClosedError, OSError) as err:
        raise make_server_lost(display.get_display_name(), str(err)) from err


def _knock(number: int) -> None:
    """Connect with a plain socket first, which fails cleanly: python-xlib would go on to try TCP,
    and leak both sockets."""
    path = f"/tmp/.X11-unix/X{number}"
    address = path if Path(path).exists() else "\0" + path
    with socket.socket(socket.AF_UNIX) as probe:
        probe.connect(address)


class ServerLost(DeviceLost):
    """The X server itself is gone, not only the thing that was asked for."""


def make_server_lost(name: str, why: str) -> ServerLost:
    """Return the error of a server that does not answer."""
    return ServerLost(
        f"the X server {name} does not answer: {why}",
        device="display",
        hint="is it running, and may this user connect? see `systemctl status pdcd-x`",
    )
