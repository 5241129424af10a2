"""Captures with a camera on GigE Vision that loses packets, or dies at a drawn moment.

``python -m tests.genicam_trials [--kills 50] [--captures 20] [--seed N]`` prints what became of
them. Whatever happens, no photo may be another than the mock camera's, a job that does not end well
says why, and after it panels are black and no light falls on the sensor.
"""

from __future__ import annotations

import argparse
import contextlib
import secrets
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.genicam.aravis import AravisCamera
from drivers.genicam.camera import GenicamCamera
from drivers.virtual_genicam.bench import HostedCamera
from drivers.virtual_genicam.camera import VirtualGenicamCamera
from pdcd.bench.tables import CameraConfig, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.genicam_rig import turn

REQUEST = CaptureRequest(goal="indirect", codes=16)
LOSSES = (0.001, 0.01, 0.05)
WAIT_S = 1.0
"""How long a frame that never comes is waited for."""
_AWAY_S = 3.0
"""A camera that comes back does so within that."""
LIMIT_S = 10.0
"""Within that a job has the right photos, or says why not."""


def make_engine(folder: Path, driver: str, **options: Any) -> Engine:
    """A small bench with that camera, started."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = CameraConfig(driver=driver, noise="none", f_number=8.0, options=options)
    trigger = TriggerConfig(driver=driver, lag_s=0.001, jitter_s=0.0)
    engine = Engine(bench_rig.config(folder, camera=camera, trigger=trigger))
    engine.start()
    return engine


def find_virtual(engine: Engine) -> VirtualGenicamCamera:
    """The camera that is not there, of an engine that has it; no frame is waited for long."""
    camera = GenicamCamera.of(engine._rig._context)
    assert isinstance(camera, HostedCamera)
    camera.options = msgspec.structs.replace(camera.options, wait_s=WAIT_S)
    return camera.virtual


def read_photos(result: CaptureResult) -> dict[str, NDArray[Any]]:
    """Samples of all photos that a job has left, however it ended."""
    if result.folder is None:
        return {}
    raw = Path(result.folder) / "raw"
    return {path.name: read_raw(path).samples for path in sorted(raw.glob("*.dng"))}


@dataclass
class Trials:
    """One engine that goes through them, and what became of each.

    ended : of every kind of trial, how often a job ended in what way: "right", or its error's kind.
    longest_s : of every kind, from the fault to the end of the job.
    """

    folder: Path
    seed: int
    ended: dict[str, Counter[str]] = field(default_factory=dict)
    longest_s: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        plain = make_engine(self.folder / "mock", "mock")
        self._expected = read_photos(bench_rig.capture(plain, REQUEST))
        plain.stop()
        assert {"white.dng", "coded.dng"} <= set(self._expected)
        self._engine = make_engine(self.folder / "camera", "virtual-genicam")
        self._virtual = find_virtual(self._engine)
        self._jobs = self._called = 0
        self._due: int | None = None
        self._back_s: float | None = None
        self._back: threading.Timer | None = None
        self._watch = contextlib.ExitStack()
        for name in ("_checked", "pop"):
            self._watch.enter_context(self._watched(name))
        for _ in range(2):  # the first one opens it
            called = self._called
            assert self._take("undisturbed") == "right", self.ended
        self._calls = self._called - called

    def close(self) -> None:
        """End the engine."""
        self._engine.stop()
        self._watch.close()

    def lose(self, share: float, captures: int) -> None:
        """So many captures, of whose packets that share is lost."""
        self._virtual.faults.lost = share
        for _ in range(captures):
            self._take(f"{1000.0 * share:g} in 1000 lost")
        self._virtual.faults.lost = 0.0
        self._take("after losses")

    def kill(self, times: int) -> None:
        """So many captures in which the camera dies before a drawn one of the calls to it, or of
        every four before the first one; half of them come back by themselves. One that is there
        when the next job begins costs it nothing."""
        for number in range(times):
            back, between = number % 2 == 1, number % 4 >= 2
            self._back_s = float(self._rng.uniform(0.0, _AWAY_S)) if back else None
            if between:
                self._die()
            else:
                self._due = self._called + 1 + int(self._rng.integers(self._calls))
            kind = "dies and comes back" if back else "dies"
            since_s = self._fault_s if between else None
            how = self._take(kind + between * ", between two jobs", since_s)
            assert not between or how == ("right" if back else "device_lost"), self.ended
            self._due = None
            if self._back is not None:
                self._back.join()
            with contextlib.suppress(AttributeError):
                del self._virtual.start
            assert self._take("after a death") == "right", self.ended

    def _watched(self, name: str) -> contextlib.AbstractContextManager[object]:
        """Count the calls to the camera by that method, before one of which it dies."""
        original = getattr(AravisCamera, name)

        def call(camera: AravisCamera, *words: Any, **named: Any) -> Any:
            self._called += 1
            if self._called == self._due:
                self._die()
            return original(camera, *words, **named)

        return mock.patch.object(AravisCamera, name, call)

    def _die(self) -> None:
        self._fault_s = time.monotonic()
        self._virtual.stop()
        start = self._virtual.start
        self._virtual.start = lambda: None  # type: ignore[method-assign]  # the driver may not
        if self._back_s is not None:
            self._back = threading.Timer(self._back_s, start)
            self._back.start()

    def _take(self, kind: str, since_s: float | None = None) -> str:
        """One capture, judged: how it ended. What disturbs it began at `since_s`, or in it."""
        self._jobs += 1
        self._fault_s = since_s or time.monotonic()
        result = bench_rig.capture(self._engine, REQUEST, f"job-{self._jobs}")
        ended_s = time.monotonic()
        where = f"{kind}, seed {self.seed}, job {self._jobs}"
        for name, samples in read_photos(result).items():
            assert np.array_equal(samples, self._expected[name]), f"{where}: {name} is wrong"
        if result.state == "done":
            assert set(read_photos(result)) == set(self._expected), where
        else:
            assert result.error is not None and result.error["hint"], (where, result)
        bench = bench_rig.bench_of(self._engine)
        for _ in range(1000):  # the camera's thread may yet be at it
            if not bench.shutter_open:
                break
            time.sleep(0.01)
        assert bench_rig.are_panels_black(bench) and not bench.shutter_open, where
        how = "right" if result.error is None else str(result.error["kind"])
        self.ended.setdefault(kind, Counter())[how] += 1
        took_s = max(0.0, ended_s - self._fault_s)
        self.longest_s[kind] = max(self.longest_s.get(kind, 0.0), took_s)
        return how

    def describe(self) -> list[str]:
        """A line for each kind."""
        return [
            f"{kind}: {', '.join(f'{count} {how}' for how, count in sorted(ended.items()))}; "
            f"over {self.longest_s[kind]:.1f} s after it began at the latest"
            for kind, ended in self.ended.items()
        ]


def run_trials(folder: Path, *, kills: int, captures: int, seed: int) -> Trials:
    """All trials, in a network of their own where that may be."""
    with turn():
        trials = Trials(folder, seed)
        try:
            for share in LOSSES:
                trials.lose(share, captures)
            trials.kill(kills)
        finally:
            trials.close()
    return trials


def main() -> None:
    """Run them, and print what became of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--captures", type=int, default=20, help="at each share of lost packets")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(2**31))
    words = parser.parse_args()
    sys.stdout.write(f"seed {words.seed}\n")
    with tempfile.TemporaryDirectory() as folder:
        trials = run_trials(
            Path(folder), kills=words.kills, captures=words.captures, seed=words.seed
        )
    sys.stdout.write("\n".join(trials.describe()) + "\n")
    if max(trials.longest_s.values()) >= LIMIT_S:
        sys.exit(f"over {LIMIT_S:g} s")


if __name__ == "__main__":
    main()
