"""A folder that is watched for photos, the readout that watches it, and another program at work."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.folder import FolderReadout
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig, Config
from pdcd.sensor.dng import encode_dng


def dng(iso: int = 100, f_number: float | None = 8.0, seed: int = 0, side: int = 24) -> bytes:
    """A small RAW file."""
    mosaic = np.random.default_rng(seed).integers(512, 16383, (side, side)).astype(np.uint16)
    return encode_dng(
        mosaic, black=512, white=16383, iso=iso, exposure_s=0.5, f_number=f_number, model="m",
        date=datetime(2024, 1, 1),
    )  # fmt: skip


DNG = dng()


class Script(VirtualClock):
    """A clock that does things when it gets there: another program at work in the folder."""

    def __init__(self) -> None:
        super().__init__()
        self._plan: list[tuple[int, Callable[[], object]]] = []

    def at(self, seconds: float, do: Callable[[], object]) -> None:
        """Do that `seconds` from now."""
        self._plan.append((self.now_ns() + round(seconds * 1e9), do))

    def sleep_until_ns(self, t_ns: int) -> None:
        due = [entry for entry in self._plan if entry[0] <= t_ns]
        self._plan = [entry for entry in self._plan if entry[0] > t_ns]
        for _, do in sorted(due, key=lambda entry: entry[0]):
            do()
        super().sleep_until_ns(t_ns)


class WatchedBench:
    """A folder that is watched, one for the run, and the readout between them."""

    def __init__(
        self, root: Path, f_number: float | str = 8.0, profile: str = "modern", **options: Any
    ) -> None:
        self.card, self.run = root / "card", root / "run"
        self.card.mkdir()
        self.run.mkdir()
        self.clock, self.signs = Script(), 0
        self.on_sign: Callable[[], object] = lambda: None
        """Called with each sign of life; what it raises ends the wait, as a cancel does."""
        camera = CameraConfig(
            f_number=f_number,  # type: ignore[arg-type]
            profile=profile,
            responsivity_e=(1.0, 2.0, 3.0),
            options={"folder": str(self.card), **options},
        )
        context = DriverContext(config=Config(camera=camera), clock=self.clock, alive=self._alive)
        self.readout = FolderReadout.create(context)

    def _alive(self) -> None:
        self.signs += 1
        self.on_sign()

    def arm(self, f_number: float | None = None) -> None:
        self.readout.arm(CameraSettings(iso=100, f_number=f_number))

    def put(self, name: str, data: bytes = DNG) -> None:
        (self.card / name).write_bytes(data)

    def fetch(self, timeout_s: float = 5.0) -> Path:
        raw = self.readout.fetch(self.run, "shot", timeout_s)
        data = raw.path.read_bytes()
        assert (raw.size_bytes, raw.sha256) == (len(data), hashlib.sha256(data).hexdigest())
        return raw.path

    def nothing_was_kept(self) -> bool:
        return not list(self.run.iterdir())
