"""Whole captures on the mock bench: in this process, and through a daemon on its socket."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType

import msgspec

import pdcd
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.client import Client
from pdcd.planning.given import read_request_arrays
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.place import HeldFolder
from tests.bench.measure import REPEATS, peak_mib, timed
from tests.bench.photo import SCENE
from tests.bench_rig import from_path, scene_of
from tests.taken import started

PDCD = Path(sys.executable).with_name("pdcd")
SOCKET, LOG = "pdcd.sock", "log"
START_LIMIT_S = 60.0
POLL_S = 0.001


def config_for(scene: str, grid: tuple[int, int] | None = None) -> Config:
    """The mock bench before a preset scene of that grid, or before a matrix of tests/data."""
    return msgspec.structs.replace(Config(), scene=scene_of(scene, grid))


def noisy_errors(cases: Sequence[tuple[str, int, str, int]]) -> list[float]:
    """RMS errors of indirect captures with full sensor noise, as their summaries state them.

    cases : scene, codes, family and seed of each. As many at a time as there are processors.
    """
    requests = []
    for scene, count, family, seed in cases:
        config = msgspec.to_builtins(config_for(scene).scene)
        changes = {"scene": config, "camera": {"seed": seed}}
        asked = {"goal": "indirect", "codes": count, "family": family, "seed": seed}
        requests.append({**asked, "white": False, "config": changes})
    with tempfile.TemporaryDirectory() as folder:
        table = pdcd.sweep(Config(), requests, folder=folder)
    if len(table.failed):
        raise RuntimeError(f"captures failed: {[*table.failed['error']]}")
    return [float(error) for error in table["rms_error_quads"]]


def measure_engine(grid: tuple[int, int], count: int, window: str) -> dict[str, float]:
    """Seconds and peak MiB of a default indirect capture (and its white shot), in process."""
    request = _request(count, window)
    with started(config_for(SCENE, (grid[0], grid[1]))) as engine:
        with tempfile.TemporaryDirectory() as folder:
            jobs = iter(range(1000))
            time_s, _ = timed(
                lambda: capture_with(engine, request, Path(folder), f"job-{next(jobs)}")
            )
    return {"time_s": time_s, "peak_mib": peak_mib()}


def measure_socket(count: int, window: str) -> dict[str, float]:
    """A real `pdcd serve`: seconds to its first words, seconds of a capture, its peak in MiB."""
    request = _request(count, window)
    with tempfile.TemporaryDirectory() as folder:
        hello_s = statistics.median(_hello_s(Path(folder)) for _ in range(REPEATS))
        with _daemon(Path(folder)) as process:
            with _connected(process, Path(folder)) as client:
                time_s, result = timed(lambda: client.capture(request))
                if result.state != "done":
                    raise RuntimeError(f"the capture over the socket failed: {result.error}")
            peak = peak_mib(process.pid)
    return {"hello_s": hello_s, "time_s": time_s, "peak_mib": peak}


def measure_help(repeats: int) -> float:
    """Seconds that `pdcd --help` takes, from start to end of the process."""
    time_s, _ = timed(
        lambda: subprocess.run([PDCD, "--help"], stdout=subprocess.DEVNULL, check=True), repeats
    )
    return time_s


def _request(count: int, window: str) -> CaptureRequest:
    values = {"goal": "indirect", "codes": count, "window": window, "pilot": 0, "parts": 1}
    return msgspec.convert(values, CaptureRequest)


def capture_with(
    engine: Engine,
    request: CaptureRequest,
    folder: Path,
    job: str,
    files: Mapping[str, Path] = MappingProxyType({}),
) -> CaptureResult:
    """A finished capture; `files` are those of the request, by field."""
    sources = {name: from_path(path) for name, path in files.items()}
    with HeldFolder.at(folder) as parent:
        result = engine.capture(
            *read_request_arrays(request, sources, engine.grid),
            job=job,
            emit=lambda _: None,
            cancelled=lambda: False,
            parent=parent,
        )
    if result.state != "done":
        raise RuntimeError(f"a capture failed: {result.error}")
    return result


def _hello_s(folder: Path) -> float:
    """From the start of a daemon to its first words, which it says when the rig is open."""
    begun_s = time.perf_counter()
    with _daemon(folder) as process, _connected(process, folder):
        return time.perf_counter() - begun_s


@contextmanager
def _daemon(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A daemon that keeps its socket, its state and its log in `folder`."""
    command = [str(PDCD), "serve", "--socket", str(folder / SOCKET), "--state-dir", str(folder)]
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(command, stderr=log)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=START_LIMIT_S)


def _connected(process: subprocess.Popen[bytes], folder: Path) -> Client:
    """A client, as soon as the daemon answers."""
    limit_s = time.perf_counter() + START_LIMIT_S
    while process.poll() is None and time.perf_counter() < limit_s:
        try:
            return Client(folder / SOCKET, timeout_s=START_LIMIT_S)
        except UnreachableError:
            time.sleep(POLL_S)
    raise RuntimeError(f"the daemon does not answer:\n{(folder / LOG).read_text()}")
