"""The gphoto2 drivers on a camera that takes its time, on a virtual clock."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gphoto2 as gp
import numpy as np
import pytest

from drivers.gphoto import camera as camera_module
from drivers.gphoto.camera import GphotoReadout, GphotoShutter
from drivers.gphoto.session import GphotoSession
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from tests.cr2 import write_cr2
from tests.fake_gphoto import FakeCamera, Setting, failure

MS = 1_000_000


class Camera(FakeCamera):
    """One that takes the time that it is given to wait, and tells of things when they are due."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__(
            {
                "iso": Setting("Auto", ("Auto", "100", "200")),
                "shutterspeed": Setting("1/60", ("Bulb", "1/60")),
                "aperture": Setting("8", ("implicit auto", "f/5.6", "8", "11")),
                "imageformat": Setting("L", ("L", "raw")),
                "capturetarget": Setting("Memory card", ("Internal RAM", "Memory card")),
                "bulb": Setting(0),
            }
        )
        self.clock = clock
        self.waits_ms: list[int] = []
        self.due: list[tuple[int, str]] = []
        self.asked_for: list[tuple[str, str, int]] = []
        self.refuses_bulb: Exception | None = None
        self.busy = 0
        """How often it will say that it cannot move its shutter just now."""

    def later(self, seconds: float, name: str, data: bytes) -> None:
        """A picture, told of so long from now."""
        self.files[name] = data
        self.due.append((self.clock.now_ns() + round(seconds * 1e9), name))

    def wait_for_event(self, timeout_ms: int) -> tuple[int, Any]:
        self._fail()
        self.waits_ms.append(timeout_ms)
        if self.events:
            return self.events.pop(0)
        end_ns = self.clock.now_ns() + timeout_ms * MS
        if self.due and self.due[0][0] <= end_ns:
            at_ns, name = self.due.pop(0)
            self.clock.sleep_until_ns(at_ns)
            return gp.GP_EVENT_FILE_ADDED, SimpleNamespace(folder="/store", name=name)
        self.clock.sleep_until_ns(end_ns)
        return gp.GP_EVENT_TIMEOUT, None

    def set_single_config(self, name: str, widget: Setting) -> None:
        if name == "bulb" and self.busy:
            self.busy -= 1
            raise failure(gp.GP_ERROR_CAMERA_BUSY)
        if name == "bulb" and self.refuses_bulb is not None:
            raise self.refuses_bulb
        super().set_single_config(name, widget)

    def file_get(self, folder: str, name: str, kind: int, into: Any, context: Any) -> None:
        self.asked_for.append((folder, name, kind))
        super().file_get(folder, name, kind, into, context)


class Guard:
    """Takes the place of the process that guards the shutter; `words` is what it was told."""

    def __init__(self, command: tuple[str, ...], answer_s: float) -> None:
        self.words: list[str] = []

    def insist(self, word: str) -> None:
        self.words.append(word)

    def arm(self, word: Callable[[], str]) -> None:
        self.words.append(word())

    def disarm(self) -> None:
        self.words.append("disarm")

    def stop(self, *, wait: bool) -> None:
        self.words.append(f"stop {wait}")


class Bench:
    def __init__(self, patch: pytest.MonkeyPatch, root: Path, **options: Any) -> None:
        self.clock = VirtualClock()
        self.camera = Camera(self.clock)
        patch.setattr(gp, "Camera", lambda: self.camera)
        patch.setattr(camera_module, "ShutterGuard", Guard)
        config = Config(
            rig=RigConfig(clock="real"),
            camera=CameraConfig(
                driver="gphoto2", responsivity_e=(1.0, 2.0, 3.0), options=dict(options)
            ),
            trigger=TriggerConfig(driver="gphoto2", lag_s=0.1, jitter_s=0.02),
        )
        self.signs = 0
        self.cancelled = False
        self.on_look: Callable[[], object] = lambda: None
        context = DriverContext(
            config=config, clock=self.clock, alive=self._alive, cancelled=lambda: self.cancelled
        )
        self.shutter, self.readout = GphotoShutter.create(context), GphotoReadout.create(context)
        self.session = GphotoSession.of(context)
        self.root = root
        write_cr2(root / "source.cr2", np.full((64, 96), 2000, np.uint16))
        self.raw = (root / "source.cr2").read_bytes()

    def _alive(self) -> None:
        self.signs += 1
        self.on_look()

    def value(self, name: str) -> str | int:
        return self.camera.settings[name].value
