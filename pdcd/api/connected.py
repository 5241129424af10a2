"""The bench of a daemon, over its socket."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from pdcd.api.bench import NONE, Arrays, Bench
from pdcd.api.progress import EventListener
from pdcd.api.signals import hold_signals
from pdcd.api.stream import ConnectedStream, PictureStream
from pdcd.bench.config import load_config
from pdcd.bench.folders import find_socket_path
from pdcd.client import Client
from pdcd.errors import DeniedError, PdcdError
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamRequest


def connect(socket: Path | str | None = None, *, queue: bool = False) -> DaemonBench:
    """The bench that a daemon holds.

    Parameters
    ----------
    socket : path of the daemon's socket; None: the one that the configuration names.
    queue : wait while others use the bench, for any time, instead of being refused.

    Raises `pdcd.errors.BusyError` when too many wait, and ConnectionError when no daemon answers.
    """
    return DaemonBench(
        Client(find_socket_path(load_config()) if socket is None else Path(socket)), queue=queue
    )


class DaemonBench(Bench):
    """The bench of a daemon; leaving the context disconnects, and ends jobs that still run."""

    def __init__(self, client: Client, *, queue: bool = False) -> None:
        self.client = client
        """The connection, for what else the socket offers besides photos: `events`, `status` ..."""
        self._queue = queue
        self._grid: tuple[int, int] | None = None

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""
        if self._grid is None:
            self._grid = self.client.describe().grid
        return self._grid

    def described(self) -> dict[str, Any]:
        """The rig as the daemon describes it, and the daemon's configuration without its table
        `server`; None in its place if this user may not read it."""
        found: dict[str, Any] = msgspec.to_builtins(self.client.describe())
        try:
            config = {**self.client.call("config.get")}
        except DeniedError:
            return {**found, "config": None}
        config.pop("server", None)
        return {**found, "config": config}

    def close(self) -> None:
        """Disconnect from the daemon. Idempotent."""
        self.client.close()

    def foresee(self, request: CaptureRequest, arrays: Arrays = NONE) -> PlanSummary:
        """What a request would do. An interrupt ends the plan, so that others need not wait."""
        try:
            return self.client.plan(request, arrays=arrays, queue=self._queue)
        except KeyboardInterrupt:
            with suppress(PdcdError, ConnectionError):
                self._end_plans()
            raise

    def _end_plans(self) -> None:
        """End the plans of this process; all of them, as a plan's name is not known before it is
        made."""
        for job in self.client.list():
            ours = job.kind == "plan" and job.owner.pid == os.getpid()
            if ours and job.state in ("queued", "running"):
                self.client.cancel(job.job)

    def begin_stream(self, request: StreamRequest, arrays: Arrays = NONE) -> PictureStream:
        """Begin a stream (see `Bench.begin_stream`)."""
        job = self.client.start_stream(request, arrays=arrays, queue=self._queue)
        return ConnectedStream(self.client, job)

    def take(
        self,
        request: CaptureRequest,
        arrays: Arrays = NONE,
        *,
        on_event: EventListener | None = None,
        report: bool = False,
    ) -> CaptureResult:
        """Take the photo of a request (see `Bench.take`); the daemon decides on the page."""
        with hold_signals(raises=True):
            return self.client.capture(request, arrays=arrays, queue=self._queue, on_event=on_event)
