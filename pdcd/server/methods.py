"""What each method of the socket does."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pdcd import __version__
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, PdcdError
from pdcd.request import CaptureRequest, CaptureResult, PlanSummary
from pdcd.runs.views import Preview, RigView
from pdcd.server import messages
from pdcd.server.callers import Caller
from pdcd.server.jobs import EngineLike, Job, Owner
from pdcd.server.messages import (
    Admitted,
    Agreed,
    ClockAnchor,
    Described,
    Hello,
    JobList,
    JobParams,
    PlanParams,
    Pong,
    RigState,
    Shown,
    ShowParams,
    StartParams,
    Status,
    SubscribeParams,
    Subscription,
)
from pdcd.server.protocol import Request
from pdcd.server.runner import Runner
from pdcd.server.worker import Worker

A = TypeVar("A", PlanSummary, Shown, Preview)


class Methods:
    """The service behind the connections; used from the event loop only.

    `description` is the engine's at the start; `state_dir` bounds where clients may have results
    written; `connections` counts the clients.
    """

    def __init__(
        self,
        config: Config,
        engine: EngineLike,
        worker: Worker,
        runner: Runner,
        *,
        description: RigView,
        state_dir: Path,
        connections: Callable[[], int],
    ) -> None:
        self._config = config
        self._engine = engine
        self._worker = worker
        self._runner = runner
        self._state_dir = state_dir
        self._connections = connections
        self._started_ns = time.monotonic_ns()
        self._description = description
        self._table: dict[str, Callable[[Caller, Any], Awaitable[msgspec.Struct]]] = {
            "hello": self._hello,
            "ping": self._ping,
            "rig.status": self._status,
            "rig.describe": self._describe,
            "config.get": self._config_get,
            "capture.plan": self._plan,
            "capture.start": self._start,
            "capture.wait": self._wait,
            "capture.cancel": self._cancel,
            "capture.list": self._list,
            "display.show": self._show,
            "preview.grab": self._preview,
            "events.subscribe": self._subscribe,
            "events.unsubscribe": self._unsubscribe,
        }

    @property
    def state(self) -> RigState:
        """Idle, busy with a job, or about to end."""
        if self._runner.table.stopping:
            return "stopping"
        return "idle" if self._runner.table.running is None else "busy"

    def hello(self) -> Hello:
        """The first words to a new client."""
        config = self._config
        return Hello(
            server="pdcd",
            version=__version__,
            protocol=messages.PROTOCOL,
            max_line=messages.MAX_LINE,
            drivers={
                "display": config.display.driver,
                "shutter": config.trigger.driver,
                "readout": config.camera.driver,
            },
            state=self.state,
            clock=_clock(),
        )

    async def handle(self, caller: Caller, request: Request) -> msgspec.Struct:
        """Do what is asked and return the result. Raises PdcdError."""
        return await self._table[request.method](caller, request.params)

    def gone(self, caller: Caller) -> None:
        """The client has left: its jobs end."""
        self._runner.drop(caller.number)

    async def _hello(self, caller: Caller, params: msgspec.Struct) -> Agreed:
        return Agreed(messages.PROTOCOL)

    async def _ping(self, caller: Caller, params: msgspec.Struct) -> Pong:
        return Pong(_clock())

    async def _status(self, caller: Caller, params: msgspec.Struct) -> Status:
        table = self._runner.table
        return Status(
            version=__version__,
            state=self.state,
            running=None if table.running is None else table.running.view(),
            queued=[job.view() for job in table.queue],
            connections=self._connections(),
            uptime_s=(time.monotonic_ns() - self._started_ns) / 1e9,
            clock=_clock(),
        )

    async def _describe(self, caller: Caller, params: msgspec.Struct) -> Described:
        # During a job the last description must do: the engine's thread is taken.
        if self.state == "idle":
            self._description = await self._worker.call(self._engine.describe)
        return Described(self._description, messages.schema())

    async def _config_get(self, caller: Caller, params: msgspec.Struct) -> Config:
        return self._config

    async def _plan(self, caller: Caller, params: PlanParams) -> PlanSummary:
        request = self._confined(params.request())
        job = self._runner.start(request, _owner(caller), kind="plan", queue=params.queue)
        return await self._answer(job, PlanSummary)

    async def _start(self, caller: Caller, params: StartParams) -> Admitted:
        request = self._confined(params.request())
        job = self._runner.start(request, _owner(caller), detach=params.detach, queue=params.queue)
        return Admitted(job=job.name, state=job.state)

    async def _wait(self, caller: Caller, params: JobParams) -> CaptureResult:
        return await self._runner.wait(params.job)

    async def _cancel(self, caller: Caller, params: JobParams) -> CaptureResult:
        return await self._runner.cancel(params.job)

    async def _list(self, caller: Caller, params: msgspec.Struct) -> JobList:
        return JobList([job.view() for job in self._runner.table.all()])

    async def _show(self, caller: Caller, params: ShowParams) -> Shown:
        job = self._runner.start(params, _owner(caller), kind="show", detach=params.detach)
        return await self._answer(job, Shown)

    async def _preview(self, caller: Caller, params: msgspec.Struct) -> Preview:
        job = self._runner.start(CaptureRequest(goal="white"), _owner(caller), kind="preview")
        return await self._answer(job, Preview)

    async def _subscribe(self, caller: Caller, params: SubscribeParams) -> Subscription:
        caller.interest = params.jobs
        return Subscription(caller.interest)

    async def _unsubscribe(self, caller: Caller, params: msgspec.Struct) -> Subscription:
        caller.interest = "none"
        return Subscription(caller.interest)

    async def _answer(self, job: Job, kind: type[A]) -> A:
        """The answer of a job that was started for it. Raises the error that the job ended by."""
        answer = await self._runner.answer(job.name)
        if not isinstance(answer, kind):
            raise PdcdError(f"job {job.name} gave no {kind.__name__}")
        return answer

    def _confined(self, request: CaptureRequest) -> CaptureRequest:
        """The request with `out` made absolute. Raises ConfigError when it leaves the state folder.

        A relative path is taken from the state folder; symbolic links are followed first.
        """
        if request.out is None:
            return request
        try:
            home = self._state_dir.resolve()
            out = (home / request.out).resolve()
        except (OSError, ValueError, RuntimeError) as err:
            raise ConfigError(
                f"out is not a usable path: {err}", hint="name a folder below the state folder"
            ) from err
        if not out.is_relative_to(home):
            raise ConfigError(
                f"out leaves the daemon's state folder: {out}",
                hint=f"choose a folder below {home}, or run pdcd capture --local",
            )
        return msgspec.structs.replace(request, out=str(out))


def _owner(caller: Caller) -> Owner:
    peer = caller.peer
    return Owner(peer.uid, peer.pid, peer.user, caller.number)


def _clock() -> ClockAnchor:
    return ClockAnchor(time.monotonic_ns(), datetime.now(UTC).isoformat())
