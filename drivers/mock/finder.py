"""The finder of the mock camera: what the bench looks like while the panels hold a picture."""

from __future__ import annotations

import threading
import time

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import CameraConfig, DriverContext

from .bench import MockBench
from .camera import FINDER_S, BenchSensor


class MockPreview:
    """Fifteen pictures a second of real time, whatever clock the rig uses: they are for viewing."""

    maturity = "stable"

    def __init__(self, bench: MockBench, config: CameraConfig) -> None:
        self._sensor = BenchSensor(bench, config)
        fixed = config.f_number
        self._f_number = 8.0 if fixed == "auto" else float(fixed)
        self._due_s = 0.0

    @classmethod
    def create(cls, context: DriverContext) -> MockPreview:
        """The finder of this rig's bench."""
        return cls(MockBench.of(context), context.config.camera)

    def connect(self) -> dict[str, str]:
        """Say what it is."""
        return {"model": f"mock {self._sensor.profile.name}"}

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next picture, when it is due."""
        now_s = time.monotonic()
        self._due_s = max(self._due_s + FINDER_S, now_s)
        threading.Event().wait(self._due_s - now_s)
        return self._sensor.finder(self._f_number)

    def disconnect(self) -> None:
        """Nothing is held."""
