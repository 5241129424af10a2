"""What a stream costs: ``python -m tests.stream_bench [--pictures N] [--codes K]``.

The product alone: its frames were rendered beforehand, a ring of them with noise of their own, and
come over GigE Vision from a camera in another process. Rate, latency, and processor time of the
product (the daemon's side and its worker apart) and of the camera are printed; so is how memory
grows. Panels are those of the mock bench, in real time.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.genicam.pixels import BY_NAME
from drivers.virtual_genicam.camera import PlainLight, VirtualExposure, VirtualGenicamCamera
from drivers.virtual_genicam.description import CameraDescription
from drivers.virtual_genicam.simulator import VIRTUAL_ADDRESS
from pdcd.bench.clock import RealClock
from pdcd.bench.config import from_config_tables
from pdcd.bench.devices import RawFile
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.protocol.result import make_job_id
from pdcd.protocol.stream import StreamedPicture, StreamRequest
from pdcd.runs.recording import StreamListener
from pdcd.sensor.raw import read_raw
from tests import world
from tests.genicam_rig import own_network

SIZES = {"whole": ((640, 480), [48, 64]), "small": ((160, 120), [12, 16])}
"""Pixels (columns, rows) and cells (rows, columns): a small frame is for counting many pictures."""
ROW_HZ = 4000.0
RING = 65
"""Frames that are served over and over: thirteen sets of four parts, each after a white photo."""
_DARK_S = 1e-3


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def make_config(folder: Path, *, served: bool, size: str = "whole") -> Config:
    """A bench of two fast panels and a camera without colours: the mock's, or one over GigE."""
    panel = {"refresh_hz": ROW_HZ}
    frame, grid = SIZES[size]
    camera: dict[str, Any] = {"profile": "mono", "frame_quads": frame, "f_number": 1.0}
    tables: dict[str, Any] = {
        "projector": panel,
        "mask": panel,
        "scene": {"kind": "open-book", "grid": grid},
        "rig": {"settle_s": 0.0, "clock": "virtual"},
        "camera": camera,
        "limits": {"min_free_bytes": 0},
        "server": {"state_dir": str(folder)},
    }
    if served:
        options = {
            "camera": VIRTUAL_ADDRESS, "resend": False, "wait_s": 20.0, "margin_s": 0.05,
            "margin": 0.0, "black_dn": 0,
        }  # fmt: skip
        camera |= {"driver": "genicam", "options": options}
        tables |= {"trigger": {"driver": "genicam", "lag_s": 0.0, "jitter_s": 0.0}}
        tables["rig"]["clock"] = "real"
    return from_config_tables(tables, "the bench")


def render_frames(request: StreamRequest, size: str) -> tuple[list[NDArray[np.uint16]], int, int]:
    """Frames of a stream in the order in which it takes them, how many come before its loop, and
    the level without light."""
    with tempfile.TemporaryDirectory() as folder:
        engine = Engine.from_config(make_config(Path(folder), served=False, size=size))
        engine.start()
        frames: list[NDArray[np.uint16]] = []
        before: list[int] = []
        seen: list[StreamedPicture] = []
        real = engine._rig.readout.fetch

        def fetch(folder: Path, name: str, timeout_s: float) -> Any:
            raw = real(folder, name, timeout_s)
            assert isinstance(raw, RawFile)
            frames.append(np.asarray(read_raw(raw.path).samples[0], np.uint16))
            return raw

        def tell(streamed: StreamedPicture) -> None:
            if not seen:
                before.append(len(frames))
            seen.append(streamed)

        engine._rig.readout.fetch = fetch  # type: ignore[method-assign]
        enough = RING + 8
        listener = StreamListener(tell, lambda: bool(before) and len(frames) > before[0] + enough)
        result = engine.stream(request, job=make_job_id(), listener=listener)
        engine.stop()
        if not before:
            raise SystemExit(str(result))
        # The first set ends with a look at the room; then come white, and the parts.
        first = len(frames) - (len(frames) - before[0]) - 2
        return frames, first, engine._profile.black_dn


def serve_frames(path: Path) -> None:
    """Be the camera: serve what lies there, frame after frame, until the input ends."""
    stored = np.load(path)
    frames, first = stored["frames"], int(stored["first"])
    count = 0

    def make(exposure: VirtualExposure) -> NDArray[np.uint16]:
        nonlocal count
        if exposure.exposure_s < _DARK_S:
            return np.zeros(frames.shape[1:], np.uint16)
        number = count if count < first else first + (count - first) % RING
        count += 1
        return np.asarray(frames[number])

    height, width = frames.shape[1:]
    description = CameraDescription(width, height, (BY_NAME["Mono16"],), white=int(stored["white"]))
    camera = VirtualGenicamCamera(description, PlainLight(make), RealClock())
    camera.start()
    say("ready")
    sys.stdin.read()
    camera.stop()
    used = resource.getrusage(resource.RUSAGE_SELF)
    say(f"{used.ru_utime + used.ru_stime} {count}")


@contextmanager
def camera_process(path: Path) -> Iterator[subprocess.Popen[str]]:
    """The camera, ready."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.stream_bench", "--camera", str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        yield process
    finally:
        process.kill()
        process.wait()


def read_cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def read_rss_kib(pid: int | str) -> int:
    """Memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


class _Meter:
    """Takes pictures and notes what they cost, from the eighth one on."""

    def __init__(self, engine: Engine, pictures: int) -> None:
        self.engine, self.pictures = engine, pictures
        self.latency_s: list[float] = []
        self.sigmas: list[float] = []
        self.lost = 0
        self.begun: tuple[float, float, float] | None = None
        self.ended: tuple[float, float, float] | None = None
        self.memory: list[tuple[int, int]] = []

    def _now(self) -> tuple[float, float, float]:
        return time.monotonic(), time.process_time(), read_cpu_s(self._pid)

    @property
    def _pid(self) -> int:
        return int(self.engine._worker.pid)  # type: ignore[attr-defined]

    def tell(self, streamed: StreamedPicture) -> None:
        self.lost = streamed.frame.lost
        if not streamed.arrays:
            say(f"spoilt: {streamed.frame.spoilt}")
            return
        self.latency_s.append(streamed.frame.latency_s)
        self.sigmas.append(streamed.frame.rms_sigma or np.nan)
        if len(self.latency_s) == 8:
            self.begun, self.latency_s = self._now(), [0.0] * 8
        if len(self.latency_s) % max(50, self.pictures // 20) == 10:
            self.memory.append((read_rss_kib("self"), read_rss_kib(self._pid)))
        if len(self.latency_s) == self.pictures + 8:
            self.ended = self._now()

    def report(self, camera_s: float) -> None:
        """Print the figures."""
        assert self.begun is not None and self.ended is not None
        wall_s, own_s, worker_s = (b - a for a, b in zip(self.begun, self.ended, strict=True))
        latency = np.array(self.latency_s[8 : self.pictures + 8])
        say(f"{self.pictures} pictures in {wall_s:.1f} s: {self.pictures / wall_s:.1f} a second")
        say(
            f"latency: median {1e3 * np.median(latency):.0f} ms, "
            f"95 % {1e3 * np.quantile(latency, 0.95):.0f} ms, most {1e3 * latency.max():.0f} ms"
        )
        both = (own_s + worker_s) / self.pictures
        say(
            f"processor time a picture: rig {1e3 * own_s / self.pictures:.1f} ms, worker "
            f"{1e3 * worker_s / self.pictures:.1f} ms; at 15 a second {15.0 * both:.2f} of a core"
        )
        say(f"camera and ring, in all: {camera_s:.1f} s")
        say(f"RMS sigma: {100.0 * np.nanmedian(self.sigmas[8:]):.2f} %; spoilt photos {self.lost}")
        grown = ", ".join(f"{a / 1024:.0f}+{b / 1024:.0f}" for a, b in self.memory)
        say(f"memory of rig and worker, MiB: {grown}")


def measure(pictures: int, request: StreamRequest, size: str) -> None:
    """Render, serve, stream and report."""
    frames, first, black = render_frames(request, size)
    say(f"{len(frames)} frames rendered, {first} before the loop")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.npz"
        np.savez(path, frames=np.stack(frames), first=first, white=65535)
        with own_network(), camera_process(path) as camera:
            config = make_config(Path(folder), served=True, size=size)
            options = {**config.camera.options, "black_dn": black}
            bench = msgspec.structs.replace(config.camera, options=options)
            engine = Engine.with_child(msgspec.structs.replace(config, camera=bench))
            engine.start()
            meter = _Meter(engine, pictures)
            begun_s = time.monotonic()
            listener = StreamListener(meter.tell, lambda: meter.ended is not None)
            result = engine.stream(request, job=make_job_id(), listener=listener)
            engine.stop()
            say(f"{result.state} after {time.monotonic() - begun_s:.1f} s: {result.error}")
            told, _ = camera.communicate()
            meter.report(float(told.split()[0]))


def main() -> None:
    """Measure, or be the camera."""
    parser = argparse.ArgumentParser(prog="python -m tests.stream_bench", description=__doc__)
    parser.add_argument("--pictures", type=int, default=300)
    parser.add_argument("--codes", type=int, default=32)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--size", choices=SIZES, default="whole")
    parser.add_argument("--camera", type=Path)
    args = parser.parse_args()
    if args.camera is not None:
        serve_frames(args.camera)
        return
    world.enter()
    measure(
        args.pictures,
        StreamRequest(
            goal="indirect",
            codes=args.codes,
            window="whole",
            rate_hz=args.rate,
            exposure_s=3.0 * args.codes / ROW_HZ,
        ),
        args.size,
    )


if __name__ == "__main__":
    main()
