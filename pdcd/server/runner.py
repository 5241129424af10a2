"""Carries jobs from the table to the engine and their events back to the event loop."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

import msgspec

from pdcd.errors import Cancelled, PdcdError, make_error
from pdcd.protocol import events
from pdcd.protocol.events import Event
from pdcd.protocol.messages import ShowParams, ShowReply, to_wire_types
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import PreviewView
from pdcd.recipes.arrays import Given
from pdcd.runs.place import HeldFolder
from pdcd.server.jobs import (
    ENDED,
    PROGRESS_INTERVAL_NS,
    Coalescer,
    EngineLike,
    Job,
    JobAnswer,
    JobRequest,
    JobTable,
    Owner,
    make_failed_result,
)
from pdcd.server.worker import EngineThread
from pdcd.words import JobKind

logger = logging.getLogger(__name__)

_PROCEED_LOOK_S = 0.1
"""Time between two looks whether a calibration that waits for somebody is to end."""

_Publish = Callable[[Job, Event], None]
"""Takes an event of a job, in the loop's thread."""


class Runner:
    """Runs the jobs of a table, one at a time, in the worker's thread.

    All methods are called from the event loop. `publish` must not block.
    """

    def __init__(self, engine: EngineLike, worker: EngineThread, publish: _Publish) -> None:
        self.table = JobTable()
        self._engine = engine
        self._worker = worker
        self._publish = publish
        self._ended: dict[str, asyncio.Event] = {}
        self._answered: dict[str, asyncio.Event] = {}
        self._let_go: dict[str, asyncio.Event] = {}
        """Set when a show is to end."""
        self._task: asyncio.Task[None] | None = None

    def start(
        self,
        request: JobRequest,
        given: Given,
        owner: Owner,
        *,
        kind: JobKind = "capture",
        detach: bool = False,
        queue: bool = False,
        place: HeldFolder | None = None,
    ) -> Job:
        """Take a job and return at once; a show of the same user ends for it.

        Raises BusyError as `JobTable.admit` does.
        """
        holder = self.table.running
        job = self.table.admit(
            request, given, owner, kind=kind, detach=detach, queue=queue, place=place
        )
        for marks in (self._ended, self._answered, self._let_go):
            marks[job.name] = asyncio.Event()
        logger.info(
            "%s admitted job=%s state=%s goal=%s uid=%d user=%s detach=%s",
            *(kind, job.name, job.state, job.goal, owner.uid, owner.user, detach),
        )
        if holder is not None and holder.gives_way_to(owner):
            holder.given_up = True
            self._let_go[holder.name].set()
        # One turn of the loop later, so that the caller learns the job's name before its events.
        asyncio.get_running_loop().call_soon(self._begin, job)
        return job

    async def wait(self, name: str) -> CaptureResult:
        """The result of a job, when it has ended. Raises RequestError for an unknown job."""
        job = self.table.get(name)
        ended = self._ended.get(name)
        if ended is not None:
            await ended.wait()
        if job.result is None:
            raise PdcdError(f"job {name} ended without a result")
        return job.result

    async def answer(self, name: str) -> JobAnswer:
        """What a plan, a show or a preview is answered with, when it is known.

        Raises the error that the job ended by, Cancelled among them.
        """
        job = self.table.get(name)
        answered = self._answered.get(name)
        if answered is not None:
            await answered.wait()
        if job.answer is None:
            error = {} if job.result is None else job.result.error or {}
            raise make_error(*(error.get(f) for f in ("kind", "message", "device", "hint")))
        return job.answer

    async def cancel(self, name: str) -> CaptureResult:
        """End a job and return its result when it has ended; harmless on an ended one.

        Raises RequestError for an unknown job.
        """
        job = self.table.get(name)
        self._cancel(job)
        return await self.wait(name)

    def proceed(self, name: str) -> Job:
        """Somebody has done what a calibration asked for. Raises RequestError for an unknown job;
        harmless on one that does not wait."""
        job = self.table.get(name)
        job.proceed_flag.set()
        return job

    def drop(self, connection: int) -> None:
        """A client is gone: end its jobs that were not detached."""
        for job in self.table.owned_by(connection):
            logger.warning("client gone, cancelling job=%s pid=%d", job.name, job.owner.pid)
            self._cancel(job)

    async def drain(self) -> None:
        """Take no more jobs, cancel all there are, and return when the last has ended."""
        self.table.stopping = True
        running = self.table.running
        for job in [*self.table.queue, *([] if running is None else [running])]:
            self._cancel(job)
        for ended in list(self._ended.values()):
            await ended.wait()
        if self._task is not None:
            await self._task

    def _begin(self, job: Job) -> None:
        """Announce an admitted job, and run it if it is the one to run."""
        if job.state in ENDED:
            return  # cancelled in the very turn in which it was admitted
        ahead = list(self.table.queue).index(job) + 1 if job in self.table.queue else 0
        self._tell(job, time.monotonic_ns(), events.JobQueued(ahead=ahead))
        if job is self.table.running and self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run(job))

    async def _run(self, job: Job) -> None:
        """Run this job and all that wait behind it."""
        current: Job | None = job
        while current is not None:
            try:
                if isinstance(current.request, ShowParams):
                    result = await self._hold(current, current.request)
                else:
                    result, current.answer = await self._worker.call(
                        self._use, current, current.request, asyncio.get_running_loop()
                    )
            # The job must end for its waiters whatever the engine did, so nothing is let through.
            except Exception as err:
                if not isinstance(err, PdcdError):
                    logger.exception("engine raised job=%s", current.name)
                result = make_failed_result(current, err)
            following = self.table.finish(current, result)
            self._announce_end(current, result)
            current = following
        self._task = None

    async def _hold(self, job: Job, shown: ShowParams) -> CaptureResult:
        """Keep a pattern on the panels until the show is to end; then both are black."""
        try:
            if not job.cancel_flag.is_set():
                await self._worker.call(self._engine.show, shown.pattern, shown.index)
                job.answer = ShowReply(shown.pattern, shown.index, job.name)
                self._answered[job.name].set()
                if shown.pattern != "black":
                    await self._let_go[job.name].wait()
        finally:
            if shown.pattern != "black":
                await self._worker.call(self._engine.show, "black", 0)
        if job.cancel_flag.is_set():
            raise Cancelled("the show was ended", hint="both panels are black")
        return CaptureResult(job=job.name, state="done")

    def _use(
        self,
        job: Job,
        request: CaptureRequest | CalibrateRequest,
        loop: asyncio.AbstractEventLoop,
    ) -> tuple[CaptureResult, JobAnswer | None]:
        """In the worker's thread: the engine call, with events thinned and sent to the loop."""
        thinned = _EventsToLoop(loop, lambda t_ns, event: self._tell(job, t_ns, event))

        def emit(event: Event) -> None:
            self._worker.beat()
            # A copy by way of JSON types: what breaks the schema shall fail here, in the engine's
            # own call.
            event = events.decode_event(to_wire_types(event))
            if isinstance(event, events.Attention):
                job.proceed_flag.clear()  # before anybody can have heard of it
            thinned.emit(event)

        def cancelled() -> bool:
            self._worker.beat()
            return job.cancel_flag.is_set()

        def proceed(text: str) -> None:
            while not job.proceed_flag.wait(_PROCEED_LOOK_S) and not cancelled():
                pass

        engine, owner = self._engine, job.owner.view()
        answer: PlanSummary | PreviewView | None = None
        result = CaptureResult(job=job.name, state="done")
        try:
            if isinstance(request, CalibrateRequest):
                result = engine.calibrate(
                    request, job=job.name, emit=emit, cancelled=cancelled, proceed=proceed
                )
            elif job.kind == "plan":
                answer = engine.plan(request, job.given, emit=emit, cancelled=cancelled)
            elif job.kind == "preview":
                answer = engine.preview(job=job.name, owner=owner, emit=emit, cancelled=cancelled)
            else:
                result = engine.capture(
                    request,
                    job.given,
                    job=job.name,
                    owner=owner,
                    emit=emit,
                    cancelled=cancelled,
                    parent=job.place,
                    report=True,
                )
        finally:
            thinned.flush()
        if result.state not in ENDED:
            raise PdcdError(f"the engine returned in state {result.state}")
        # By way of JSON types, so that nothing unencodable gets as far as the socket.
        told = None if answer is None else msgspec.convert(to_wire_types(answer), type(answer))
        return msgspec.convert(to_wire_types(result), CaptureResult), told

    def _cancel(self, job: Job) -> None:
        if job.name in self._let_go:
            self._let_go[job.name].set()
        if self.table.cancel(job) and job.result is not None:
            self._announce_end(job, job.result)

    def _announce_end(self, job: Job, result: CaptureResult) -> None:
        logger.info("%s ended job=%s state=%s", job.kind, job.name, result.state)
        for marks in (self._answered, self._ended, self._let_go):
            marks.pop(job.name).set()
        self._tell(job, time.monotonic_ns(), events.make_end_event(result))

    def _tell(self, job: Job, t_mono_ns: int, event: Event) -> None:
        self._publish(job, job.numbered(event, t_mono_ns))


class _EventsToLoop:
    """Events of one job on their way from the engine's thread to the loop, progress thinned.

    tell : takes the time in ns and the event, in the loop.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, tell: Callable[[int, Event], None]) -> None:
        self._loop, self._tell = loop, tell
        self._thinned = Coalescer()
        self._late_s = PROGRESS_INTERVAL_NS * 1e-9

    def emit(self, event: Event) -> None:
        """In the engine's thread: send it on, or hold it back for a while."""
        now_ns = time.monotonic_ns()
        if not isinstance(event, events.THINNED):
            self.flush()
            self._send(now_ns, event)
        elif self._thinned.offer(now_ns, event) is not None:
            self._send(now_ns, event)
        elif self._thinned.wants_timer():
            self._loop.call_soon_threadsafe(self._loop.call_later, self._late_s, self._tell_late)

    def flush(self) -> None:
        """In the engine's thread: send what was held back."""
        held = self._thinned.flush()
        if held is not None:
            self._send(*held)

    def _send(self, t_ns: int, event: Event) -> None:
        self._loop.call_soon_threadsafe(self._tell, t_ns, event)

    def _tell_late(self) -> None:
        """In the loop: nothing followed what was held, for the rig waits, or hangs."""
        held = self._thinned.due(time.monotonic_ns())
        if held is not None:
            self._tell(*held)
        elif self._thinned.timed:
            self._loop.call_later(self._late_s, self._tell_late)
