"""`pdcd serve` as a process of its own, and clients that wait until it is there."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pdcd.bench import config as settings
from pdcd.bench.tables import CameraConfig
from pdcd.client import Client
from pdcd.protocol.events import Progress
from pdcd.protocol.line_talk import UnreachableError
from tests import bench_rig
from tests.processes import LONG_S, soon


@contextmanager
def serving(*words: str | Path, **how: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A process that serves with these words; it is killed on leaving. It hears SIGHUP also where
    the tests do not, as below nohup."""
    command = [sys.executable, "-m", "pdcd", "serve", *map(str, words)]
    with subprocess.Popen(command, preexec_fn=_hear_hangup, **how) as process:
        try:
            yield process
        finally:
            process.kill()


def _hear_hangup() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@contextmanager
def daemon(folder: Path, **tables: Any) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """The daemon of a mock bench, and its socket."""
    path, socket = folder / "pdcd.toml", folder / "s"
    given = {"camera": CameraConfig(noise="none", f_number=8.0), **tables}
    path.write_text(settings.format_config(bench_rig.config(folder, **given)))
    words = ("--config", path, "--socket", socket)
    with serving(*words, stderr=subprocess.DEVNULL) as process:
        yield process, socket


def connect(
    socket: Path,
    alive: Callable[[], bool] = lambda: True,
    say_why: Callable[[], str] = lambda: "no daemon answers",
    *,
    timeout_s: float = 5.0,
) -> Client:
    """A client, as soon as the daemon answers; fails where it has ended or takes too long."""
    until_s = time.monotonic() + LONG_S
    while True:
        try:
            return Client(socket, timeout_s=timeout_s)
        except UnreachableError:
            assert alive() and time.monotonic() < until_s, say_why()
            time.sleep(0.02)


def wait_for_codes(client: Client) -> str:
    """Start one long exposure, without a pilot's short ones in front of it, and return its job once
    codes are being shown."""
    params = {"goal": "indirect", "codes": 512, "white": False, "pilot": 0, "parts": 1}
    job = str(client.call("capture.start", params)["job"])
    client.call("events.subscribe", {"jobs": "all"})
    for event in client.events():
        if isinstance(event, Progress) and event.frame > 0:
            return job
    raise AssertionError("no progress")


def last_event(folder: Path, job: str) -> dict[str, Any]:
    """What the log of a job says in the end that was given up."""
    log = folder / "state" / "captures" / f"{job}.partial" / "log.jsonl"
    events: list[dict[str, Any]] = []

    def is_over() -> bool:
        lines = log.read_text().splitlines() if log.exists() else []
        events[:] = [json.loads(line) for line in lines]
        return bool(events) and events[-1]["event"] in ("cancelled", "failed")

    assert soon(is_over), events
    return events[-1]
