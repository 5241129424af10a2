"""What each method of the socket does."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import msgspec

from pdcd.bench.tables import Config
from pdcd.errors import BusyError, Cancelled, DeniedError, PdcdError
from pdcd.files.parcels import pack_arrays
from pdcd.planning.stream_set import make_set_request
from pdcd.protocol import messages
from pdcd.protocol.fields import (
    ARRAY_FIELDS,
    list_needed_fields,
    list_optional_fields,
    list_request_fields,
)
from pdcd.protocol.messages import (
    Admission,
    CalibrateParams,
    ClockAnchor,
    FrameParams,
    GoalView,
    Hello,
    HelloReply,
    JobList,
    JobParams,
    ListParams,
    LiveParams,
    PlanParams,
    Pong,
    RigDescription,
    RigState,
    ShowParams,
    ShowReply,
    StartParams,
    Status,
    StreamFrameParams,
    StreamParams,
    SubscribeParams,
    Subscription,
)
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import PackedArray, StreamFrame
from pdcd.protocol.views import ClientRole, LiveFrame, PreviewView, RigView
from pdcd.recipes.arrays import NO_ARRAYS, Given
from pdcd.recipes.goals import KEEPS
from pdcd.runs.index import search_runs
from pdcd.runs.place import HeldFolder
from pdcd.server.aside import call_in_thread
from pdcd.server.callers import Caller
from pdcd.server.engine_like import EngineLike
from pdcd.server.intake import Intake
from pdcd.server.jobs import Job, Owner
from pdcd.server.protocol import RpcRequest
from pdcd.server.reading import ReplyWithMemory
from pdcd.server.runner import Runner
from pdcd.server.turns import UserTurns
from pdcd.server.worker import EngineThread
from pdcd.version import __version__

_OWNERS = frozenset(
    {"capture.cancel", "calibrate.proceed", "preview.frame", "stream.frame", "stream.record"}
)
"""Actions on another user's job that only an administrator may take."""

_A = TypeVar("_A", PlanSummary, ShowReply, PreviewView)
_P = ParamSpec("_P")
_R = TypeVar("_R")


class Methods:
    """The service behind the connections; used from the event loop only.

    `description` is the engine's at the start; clients may have results written only in
    `state_dir`; `connections` counts the clients.
    """

    def __init__(
        self,
        config: Config,
        engine: EngineLike,
        worker: EngineThread,
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
        self._looks = UserTurns()
        self._describing = asyncio.Lock()
        self._schema: dict[str, Any] | None = None
        self._started_ns = time.monotonic_ns()
        self._description = description
        folder = config.server.arrays
        self._intake = Intake(None if folder is None else Path(folder), description.grid)
        self._table: dict[
            str, Callable[[Caller, Any], Awaitable[msgspec.Struct | ReplyWithMemory]]
        ] = {
            "hello": self._hello,
            "ping": self._ping,
            "rig.status": self._status,
            "rig.describe": self._describe,
            "config.get": self._config_get,
            "capture.wait": self._wait,
            "capture.cancel": self._cancel,
            "capture.list": self._list,
            "calibrate.start": self._calibrate,
            "calibrate.proceed": self._proceed,
            "display.show": self._show,
            "preview.grab": self._preview,
            "preview.live": self._live,
            "preview.frame": self._frame,
            "stream.frame": self._stream_frame,
            "stream.record": self._stream_record,
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

    async def handle(self, caller: Caller, request: RpcRequest) -> msgspec.Struct | ReplyWithMemory:
        """Do what is asked and return the result. Raises PdcdError."""
        self.permit(caller, request.method)
        self._permit_job(caller, request)
        params = request.params
        if not isinstance(params, CaptureRequest):
            return await self._table[request.method](caller, params)
        params, given = await self._intake.take(params, request.fds, caller.peer)
        if isinstance(params, StartParams):
            return self._start(caller, params, given)
        if isinstance(params, StreamParams):
            return self._stream(caller, params, given)
        if isinstance(params, PlanParams):
            return await self._plan(caller, params, given)
        raise PdcdError(f"{request.method} takes no request for a photo")

    def engaged(self, caller: Caller) -> bool:
        """Whether any jobs would end with this client."""
        return bool(self._runner.table.owned_by(caller.number))

    def gone(self, caller: Caller) -> None:
        """The client has left: its jobs end."""
        caller.gone = True
        self._runner.drop(caller.number)

    def permit(self, caller: Caller, method: str) -> None:
        """Raise DeniedError when this client may not call that method, whatever its parameters
        are."""
        _require(caller, messages.METHODS[method].role, method)

    def _permit_job(self, caller: Caller, request: RpcRequest) -> None:
        """Raise DeniedError when this client may not do that to a job.

        The owner of a job is the user for whom the kernel vouched, not the connection.
        """
        if request.method in _OWNERS and isinstance(request.params, JobParams):
            owner = self._runner.table.get(request.params.job).owner
            if owner.uid != caller.peer.uid:
                what = f"{request.method} of a job of {owner.user} (uid {owner.uid})"
                _require(caller, ClientRole.ADMINISTER, what)

    async def _hello(self, caller: Caller, params: msgspec.Struct) -> HelloReply:
        return HelloReply(messages.PROTOCOL)

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

    async def _describe(self, caller: Caller, params: msgspec.Struct) -> RigDescription:
        # During a job the last description is used, because the engine's thread is busy; also while
        # a new one is being made: many such requests must not queue up before a job.
        if self.state == "idle" and not self._describing.locked():
            async with self._describing:
                self._description = await self._worker.call(self._engine.describe)
        if self._schema is None:  # it takes a while to make
            self._schema = await call_in_thread(messages.build_message_schema)
        return RigDescription(self._description, self._schema, _goals(), _arrays())

    async def _config_get(self, caller: Caller, params: msgspec.Struct) -> Config:
        return self._config

    async def _plan(self, caller: Caller, params: PlanParams, given: Given) -> PlanSummary:
        self._expect_job(caller, queue=params.queue)
        with self._place(params.out, make=False):
            pass
        job = self._runner.start(
            params.request(), given, _owner(caller), kind="plan", queue=params.queue
        )
        return await self._answer(job, PlanSummary)

    def _start(self, caller: Caller, params: StartParams, given: Given) -> Admission:
        self._expect_job(caller, queue=params.queue, detach=params.detach)
        place = self._place(params.out)
        try:
            request = params.request()
            if request.out is not None:
                request = msgspec.structs.replace(request, out=str(place.real))
            job = self._runner.start(
                request,
                given,
                _owner(caller),
                detach=params.detach,
                queue=params.queue,
                place=place,
            )
        except BaseException:
            place.close()
            raise
        return _admission(job)

    async def _wait(self, caller: Caller, params: JobParams) -> CaptureResult:
        return await self._runner.wait(params.job)

    async def _cancel(self, caller: Caller, params: JobParams) -> CaptureResult:
        return await self._runner.cancel(params.job)

    async def _calibrate(self, caller: Caller, params: CalibrateParams) -> Admission:
        self._expect_job(caller, queue=params.queue, detach=params.detach)
        job = self._runner.start(
            params.request(),
            NO_ARRAYS,
            _owner(caller),
            kind="calibrate",
            detach=params.detach,
            queue=params.queue,
        )
        return _admission(job)

    async def _proceed(self, caller: Caller, params: JobParams) -> Admission:
        return _admission(self._runner.proceed(params.job))

    async def _list(self, caller: Caller, params: ListParams) -> JobList:
        found = None
        if params.find is not None:
            found = await self._from_disk(caller, search_runs, self._state_dir, params.find)
        return JobList([job.view() for job in self._runner.table.all()], found)

    async def _from_disk(
        self, caller: Caller, look: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs
    ) -> _R:
        """What a function that reads the disk returns or raises.

        A disk may be slow, or hang: the loop, the rig and users who only want jobs must not wait
        for it. One runs at a time, because lists cost processor time and anybody may ask for them;
        so users take turns.
        """
        uid = caller.peer.uid
        await self._looks.take(uid)
        # A caller that leaves must not release the turn while the disk is still being read.
        task = asyncio.create_task(call_in_thread(look, *args, **kwargs))

        def looked(task: asyncio.Task[_R]) -> None:
            self._looks.give_back(uid)
            if not task.cancelled():
                task.exception()  # retrieved even where nobody waits for it any more

        task.add_done_callback(looked)
        return await asyncio.shield(task)

    async def _show(self, caller: Caller, params: ShowParams) -> ShowReply:
        job = self._runner.start(
            params, NO_ARRAYS, _owner(caller), kind="show", detach=params.detach
        )
        return await self._answer(job, ShowReply)

    async def _preview(self, caller: Caller, params: msgspec.Struct) -> PreviewView:
        job = self._runner.start(
            CaptureRequest(goal="white"), NO_ARRAYS, _owner(caller), kind="preview"
        )
        return await self._answer(job, PreviewView)

    async def _live(self, caller: Caller, params: LiveParams) -> Admission:
        return _admission(self._runner.start(params, NO_ARRAYS, _owner(caller), kind="live"))

    async def _frame(self, caller: Caller, params: FrameParams) -> LiveFrame:
        frame = await self._runner.see_next(params.job, params.after)
        return frame if params.picture else msgspec.structs.replace(frame, jpeg=b"")

    def _stream(self, caller: Caller, params: StreamParams, given: Given) -> Admission:
        self._expect_job(caller, queue=params.queue)
        make_set_request(params)  # what is no stream is refused at once
        job = self._runner.start(
            params.request(), given, _owner(caller), kind="stream", queue=params.queue
        )
        return _admission(job)

    async def _stream_frame(
        self, caller: Caller, params: StreamFrameParams
    ) -> StreamFrame | ReplyWithMemory:
        if params.picture == "jpeg":
            self._runner.table.get(params.job).looked_s = time.monotonic()
        streamed = await self._runner.see_next_of_stream(params.job, params.after)
        frame = streamed.frame
        if params.picture != "jpeg":
            frame = msgspec.structs.replace(frame, jpeg=b"")
        if params.picture != "arrays" or not streamed.arrays:
            return frame
        fd, places = pack_arrays(streamed.arrays)
        arrays = {name: PackedArray(*place) for name, place in places.items()}
        return ReplyWithMemory(msgspec.structs.replace(frame, arrays=arrays), fd)

    async def _stream_record(self, caller: Caller, params: JobParams) -> CaptureResult:
        return await self._runner.record(params.job, self._place(None))

    async def _subscribe(self, caller: Caller, params: SubscribeParams) -> Subscription:
        caller.interest = params.jobs
        return Subscription(caller.interest)

    async def _unsubscribe(self, caller: Caller, params: msgspec.Struct) -> Subscription:
        caller.interest = "none"
        return Subscription(caller.interest)

    async def _answer(self, job: Job, kind: type[_A]) -> _A:
        """The answer of a job that was started for it. Raises the error with which the job
        ended."""
        answer = await self._runner.answer(job.name)
        if not isinstance(answer, kind):
            raise PdcdError(f"job {job.name} gave no {kind.__name__}")
        return answer

    def _expect_job(self, caller: Caller, *, queue: bool, detach: bool = False) -> None:
        """Raise Cancelled for a job that would end with a client who left while its arrays were
        read, and BusyError for one more to wait when enough jobs of this user do; root and the
        daemon's own user have no limit."""
        if caller.gone and not detach:
            raise Cancelled("the client has gone")
        if not queue:
            return
        most = self._config.limits.queued_per_user
        waiting = sum(job.owner.uid == caller.peer.uid for job in self._runner.table.queue)
        if waiting >= most and caller.peer.uid not in (0, os.geteuid()):
            raise BusyError(
                f"{waiting} jobs of {caller.peer.user} (uid {caller.peer.uid}) are waiting already",
                hint="wait until some have ended, or raise [limits] queued_per_user",
            )

    def _place(self, out: str | None, *, make: bool = True) -> HeldFolder:
        """The folder for a run, held open. Raises RequestError.

        What a client names must lie inside the state folder; the default folder is the operator's
        choice.
        """
        if out is None and make:
            return HeldFolder.at(self._state_dir / "captures")
        return HeldFolder.below(self._state_dir, out or ".", make=make)


def _require(caller: Caller, needed: ClientRole, what: str) -> None:
    """Raise DeniedError for a client of a lower role: the only place that decides."""
    if caller.role < needed:
        raise DeniedError(
            f"uid {caller.peer.uid} may not do this: {what}",
            hint=f"the role needed is {needed.name.lower()}: see [server.look], "
            "[server.shoot] and [server.administer]",
        )


def _admission(job: Job) -> Admission:
    return Admission(job=job.name, state=job.state)


def _owner(caller: Caller) -> Owner:
    peer = caller.peer
    return Owner(peer.uid, peer.pid, peer.user, caller.number)


def _goals() -> dict[str, GoalView]:
    return {
        name: GoalView(keeps=keeps, needs=list_needed_fields(name), may=list_optional_fields(name))
        for name, keeps in KEEPS.items()
    }


def _arrays() -> dict[str, str]:
    return {name: list_request_fields()[name].text for name in ARRAY_FIELDS}


def _clock() -> ClockAnchor:
    return ClockAnchor(time.monotonic_ns(), datetime.now(UTC).isoformat())
