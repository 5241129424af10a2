"""The stranger's bench with one call that never returns, and a file of all calls that were made.

Which one, how it hangs, and the file are in the variable STRANGER_HANGS, a word each.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from pathlib import Path

from pdcd.driver import (
    CameraInfo,
    CameraSettings,
    DisplayInfo,
    DriverContext,
    FrameLog,
    Patience,
    RawFile,
)

from . import Blades, Camera, Panels

CALL, HOW, NOTES = os.environ["STRANGER_HANGS"].split()


def begin(call: str, patience: Patience | None = None) -> None:
    """Note a call of a driver, and hang in it if it is the one; with patience, if that is how."""
    with Path(NOTES).open("a") as file:
        file.write(f"{call}\n")
    if call != CALL:
        return
    if patience is not None and HOW == "patient":
        patience.sleep(1e6)
    if HOW == "held":  # in C, with the interpreter's lock
        ctypes.PyDLL(None).sleep(1_000_000)
    while HOW == "loop":
        pass
    time.sleep(1e6)


class HangingPanels(Panels):
    """Notes what it does."""

    def connect(self) -> DisplayInfo:
        begin("display.connect")
        return super().connect()

    def black(self) -> None:
        begin("display.black")
        super().black()

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        begin("display.play")
        return super().play(progress, cancelled)

    def disconnect(self) -> None:
        begin("display.disconnect")
        super().disconnect()


class HangingBlades(Blades):
    """Notes what it does."""

    def connect(self) -> dict[str, str]:
        begin("shutter.connect")
        return super().connect()

    def open(self) -> int:
        begin("shutter.open")
        return super().open()

    def close(self) -> int:
        begin("shutter.close")
        return super().close()


class HangingCamera(Camera):
    """Notes what it does."""

    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self._patience = context.patience

    def connect(self) -> CameraInfo:
        begin("readout.connect", self._patience)
        return super().connect()

    def arm(self, settings: CameraSettings) -> None:
        begin("readout.arm")
        super().arm(settings)

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        begin("readout.fetch", self._patience)
        return super().fetch(folder, name, timeout_s)

    def disconnect(self) -> None:
        begin("readout.disconnect")
        super().disconnect()
