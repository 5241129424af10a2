"""What can be found out about a serial port without opening it, as opening moves its lines."""

from __future__ import annotations

import grp
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from pdcd.driver import Finding

_PATTERNS = ("ttyUSB*", "ttyACM*", "ttyS[0-9]*", "serial/by-id/*")
"""Patterns below /dev of ports to suggest when the configured one does not exist."""
_SHOWN = 6


def inspect_port(port: str) -> Iterator[Finding]:
    """Yield one finding: whether the port exists, is a serial device, and may be opened by us.

    Ports given as URLs of pyserial (``rfc2217://...``) are not looked for. Opens nothing.
    """
    if "://" in port:
        yield Finding("port", "unknown", f"{port}: only --click asks it", None)
        return
    try:
        found = Path(port).stat()
    except (OSError, ValueError) as err:
        yield Finding("port", "fault", f"{port}: {_why(err)}", _others())
        return
    if not stat.S_ISCHR(found.st_mode):
        yield Finding("port", "fault", f"{port} is no device", _others())
    elif not os.access(port, os.R_OK | os.W_OK):
        hint = f"add the user to the group {_group(found.st_gid)}, which owns the port"
        yield Finding("port", "fault", f"{port} may not be read and written by this user", hint)
    else:
        real = os.path.realpath(port)
        yield Finding("port", "good", port if real == port else f"{port}, which is {real}")


def list_serial_ports(devices: Path = Path("/dev")) -> tuple[str, ...]:
    """Ports to which a release may be connected, adapters first, by persistent name if they have
    one. The kernel names more ports of the board than exist; those without a chip are left out.
    """
    lasting = {os.path.realpath(path): str(path) for path in devices.glob("serial/by-id/*")}
    found = []
    for pattern in _PATTERNS[:3]:
        for path in sorted(devices.glob(pattern)):
            if not path.name.startswith("ttyS") or _has_chip(path.name):
                found.append(lasting.get(os.path.realpath(path), str(path)))
    return tuple(found)


def _has_chip(name: str) -> bool:
    try:
        return Path(f"/sys/class/tty/{name}/type").read_text().strip() != "0"
    except OSError:
        return True


def _why(err: OSError | ValueError) -> str:
    return (err.strerror if isinstance(err, OSError) else None) or str(err)


def _others() -> str:
    """Name the ports that exist instead."""
    found = sorted(str(path) for pattern in _PATTERNS for path in Path("/dev").glob(pattern))
    if not found:
        return "is it plugged in? this machine has no serial port at all"
    more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
    return f"is it plugged in? there are {', '.join(found[:_SHOWN])}{more}"


def _group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)
