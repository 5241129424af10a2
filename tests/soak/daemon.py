"""The daemon of a soak: the program's own, on devices that fail when they are told to.

``python -m tests.soak.daemon CONFIG SOCKET FOLDER``. Orders lie in FOLDER: ``fault.json`` names the
next call of a device that goes wrong and how, ``clock`` holds seconds by which the wall clock is
off, and ``usb`` is a virtual USB that another process lends.
"""

from __future__ import annotations

import json
import sys
import time
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

from usb.backend import libusb1

from drivers.ptp import shutter as ptp_shutter
from pdcd.bench.config import load_config
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.errors import DeviceLost
from pdcd.server.daemon import run_daemon
from tests.remote_usb import RemoteUsb

FAULT, CLOCK, USB = "fault.json", "clock", "usb"
TYPES = "pdcd.protocol.entry"
"""Takes times, and asks no clock."""
HOWS = ("raise", "crash", "hang", "late")
HANG_S, LATE_S = 1.5, 0.3


class Faulty:
    """A device, all of whose calls look for an order first."""

    def __init__(self, device: Any, role: str, order: Path) -> None:
        self._device, self._role, self._order = device, role, order

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._device, name)
        if not callable(found):
            return found

        def call(*args: Any, **more: Any) -> Any:
            how = self._taken(name)
            if how == "raise":
                raise DeviceLost(f"{name} fails as it was told to", device=self._role)
            if how == "crash":
                raise RuntimeError(f"{name} is broken as it was told to")
            if how == "hang":
                time.sleep(HANG_S)
                raise DeviceLost(f"{name} did not answer", device=self._role)
            if how == "late":
                time.sleep(LATE_S)
            return found(*args, **more)

        return call

    def _taken(self, name: str) -> str:
        """How this call is to fail; an order counts once."""
        try:
            told = json.loads(self._order.read_text())
        except (OSError, ValueError):
            return ""
        if (told["role"], told["call"]) != (self._role, name):
            return ""
        self._order.unlink(missing_ok=True)
        return str(told["how"])


def _stepped(folder: Path) -> type[datetime]:
    """The wall clock, off by what the order says."""

    class Stepped(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Any:
            try:
                off_s = float((folder / CLOCK).read_text())
            except (OSError, ValueError):
                off_s = 0.0
            return datetime.now(tz) + timedelta(seconds=off_s)

    return Stepped


def main(config: str, socket: str, where: str) -> int:
    """Serve; returns the exit code."""
    folder = Path(where)
    stepped = _stepped(folder)
    for module in list(sys.modules.values()):
        if module.__name__ == TYPES or not module.__name__.startswith("pdcd."):
            continue
        if getattr(module, "datetime", None) is datetime:
            vars(module)["datetime"] = stepped
    usb = folder / USB
    if usb.exists():
        ptp_shutter.PTP_GUARDIAN = (sys.executable, "-m", "tests.guarded_shutter", str(usb))
        lent = RemoteUsb(usb)
        libusb1.get_backend = lambda *_, **__: lent  # before any driver asks for it

    def factory(config: Config) -> Engine:
        engine = Engine.with_child(config)
        rig = engine._rig
        for role in ("display", "shutter", "readout"):
            setattr(rig, role, Faulty(getattr(rig, role), role, folder / FAULT))
        return engine

    return run_daemon(load_config(Path(config)), socket=Path(socket), engine_factory=factory)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
