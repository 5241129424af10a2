"""Which program holds a USB device: who has its usbfs node open.

No kernel driver claims still-image cameras on Linux: a busy camera is held by another program (a
desktop's photo monitor, a tethering tool, a second daemon), and detaching a kernel driver does not
take it away from that program. So the error has to name the program.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

_PROC = Path("/proc")
_USBFS = Path("/dev/bus/usb")

HINT = (
    "end that program; on a desktop `gio mount -s gphoto2` lets go of the camera, and the udev "
    "rule that comes with pdcd keeps it away"
)


class Holder(NamedTuple):
    """A process that has the device open."""

    pid: int
    name: str


def build_node_path(bus: int, address: int, usbfs: Path = _USBFS) -> Path:
    """The device file of a USB device."""
    return usbfs / f"{bus:03d}" / f"{address:03d}"


def list_holders(node: Path, proc: Path = _PROC) -> list[Holder]:
    """Processes that have that file open, by process id.

    Processes of other users are seen only by root; those that end meanwhile are left out.
    """
    found = []
    for folder in proc.iterdir():
        if folder.name.isdigit() and _holds(folder, node):
            found.append(Holder(int(folder.name), _name(folder)))
    return sorted(found)


def describe_holders(found: list[Holder], own_pid: int) -> str:
    """The processes other than this one, for a message, or words that none can be seen."""
    others = [f"{h.name} (process {h.pid})" for h in found if h.pid != own_pid]
    return ", ".join(others) or "a program that this user may not see"


def _holds(folder: Path, node: Path) -> bool:
    try:
        return any(_target(link) == node for link in (folder / "fd").iterdir())
    except OSError:  # another user's process, or one that has just ended
        return False


def _target(link: Path) -> Path | None:
    try:
        return link.readlink()
    except OSError:  # a file that was closed meanwhile
        return None


def _name(folder: Path) -> str:
    try:
        return (folder / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return "unknown"
