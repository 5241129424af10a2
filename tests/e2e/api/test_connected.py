"""The bench of a daemon from Python: the same as one in this process, and as careful."""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import pdcd
from pdcd.api.connected import DaemonBench
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.client import Client
from pdcd.protocol.events import Event
from pdcd.protocol.request import CaptureRequest
from pdcd.server.daemon import serve_daemon
from tests.bench_rig import GRID, config
from tests.e2e.server._server_harness import threaded_daemon
from tests.real_daemon import connect

PATIENCE_S = 60.0


@contextmanager
def daemon(rig: Config, socket: Path) -> Iterator[DaemonBench]:
    """A daemon with a real engine in a thread, and its bench."""
    loop, stop = asyncio.new_event_loop(), asyncio.Event()
    body = serve_daemon(rig, socket=socket, engine_factory=Engine.from_config, stop=stop)
    thread = threading.Thread(target=loop.run_until_complete, args=(body,))
    thread.start()
    try:
        connect(socket).close()
        with pdcd.connect(socket) as bench:
            yield bench
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join(PATIENCE_S)
        loop.close()


def test_the_bench_of_a_daemon_is_that_of_this_process(tmp_path: Path) -> None:
    rig = config(tmp_path)
    plane = np.linspace(0.2, 1.0, 12).reshape(GRID)
    told: list[Event] = []

    def interrupt(event: Event) -> None:
        if event.type == "queued":  # long before a mock exposure could be over
            signal.raise_signal(signal.SIGINT)

    with pdcd.local(rig, folder=tmp_path / "here") as own:
        here = own.capture("illuminated", illumination=plane, progress=False)
    with daemon(rig, tmp_path / "s") as bench:
        assert bench.grid == GRID
        there = bench.capture("illuminated", illumination=plane, progress=told.append)
        assert (told[0].type, told[-1].type) == ("queued", "done")
        assert there.folder.parent == tmp_path / "state" / "captures"
        assert np.array_equal(here.image, there.image) and np.array_equal(here.sigma, there.sigma)
        assert bench.plan("indirect", codes=16).codes == 16
        with pytest.raises(pdcd.errors.RequestError, match="takes no radius"):
            bench.capture("white", radius=1, progress=False)
        with pytest.raises(pdcd.errors.RequestError, match="radios: no such keyword"):
            bench.capture("white", radios=1, progress=False)  # type: ignore[call-arg]
        with pytest.raises(KeyboardInterrupt):
            bench.capture("indirect", codes=512, progress=interrupt)
        assert bench.client.list()[-1].state == "cancelled"
        assert bench.capture("white", progress=False).goal == "white"


def test_an_interrupted_plan_ends_and_the_next_photo_is_taken(tmp_path: Path) -> None:
    """In a notebook the connection stays: the plan would hold the rig for as long as it takes."""
    slow = CaptureRequest(goal="indirect", note="slow")
    main = threading.get_ident()

    def interrupt() -> None:
        with Client(running.path) as other:
            while other.status().running is None:
                time.sleep(0.001)
        signal.pthread_kill(main, signal.SIGINT)

    with threaded_daemon(tmp_path) as running, pdcd.connect(running.path) as bench:
        thread = threading.Thread(target=interrupt)
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            bench.foresee(slow)
        thread.join()
        assert [(job.kind, job.state) for job in bench.client.list()] == [("plan", "cancelled")]
        assert bench.client.capture(CaptureRequest(goal="white")).state == "done"


def test_where_no_daemon_answers(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match="no daemon answers"):
        pdcd.connect(tmp_path / "none")
