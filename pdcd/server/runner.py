"""Carries jobs from the table to the engine and their events back to the event loop.

Whatever is raised, and wherever, every job ends, those who wait for it hear of that, and the next
one runs. The engine, the listeners and the system may raise anything, which is handled where they
are called. Should the task that runs the jobs end all the same, by a fault here or for lack of
memory, another one takes its place and goes on from where it was.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

import msgspec

from pdcd.errors import Cancelled, PdcdError, RequestError, restore_error
from pdcd.protocol import events
from pdcd.protocol.events import Event
from pdcd.protocol.messages import LiveParams, ShowParams, ShowReply, to_wire_types
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamedPicture, StreamRequest
from pdcd.protocol.views import LiveFrame, PreviewView
from pdcd.recipes.arrays import Given
from pdcd.runs.place import HeldFolder
from pdcd.server.engine_like import EngineLike
from pdcd.server.jobs import ENDED, Job, JobAnswer, JobRequest, JobTable, Owner, make_failed_result
from pdcd.server.streams import make_stream_listener, order_record
from pdcd.server.thinning import EventsToLoop
from pdcd.server.worker import EngineThread
from pdcd.words import JobKind

logger = logging.getLogger(__name__)

_DEAF_S, _DEAF_LOOK_S = 0.5, 0.1
"""How long a cancel waits for devices that cannot be made safe, and the time between two checks."""
_NOT_SAFE_YET = (
    "a device does not let itself be made safe: until the job has ended, the panels may still be "
    "lit, or the shutter open"
)

_PROCEED_LOOK_S = 0.1
"""Time between two checks whether a calibration that waits for somebody is to end."""

_ANEW_S = 0.1
"""Time in seconds until the jobs are run again after a fault here."""

_BLACK_TRIES = 3
"""How often the panels are asked to go black after a show."""

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
        loop = asyncio.get_running_loop()
        job: Job | None = None
        try:
            job = self.table.admit(
                request, given, owner, kind=kind, detach=detach, queue=queue, place=place
            )
            if holder is not None and holder.gives_way_to(owner):
                holder.given_up = True
                holder.let_go.set()
            # One turn of the loop later: the caller learns the job's name before its events.
            loop.call_soon(self._announce, job)
            logger.info(
                "%s admitted job=%s state=%s goal=%s uid=%d user=%s detach=%s",
                *(kind, job.name, job.state, job.goal, owner.uid, owner.user, detach),
            )
        except BaseException:
            if job is not None:  # nobody learns its name
                self._cancel(job)
            raise
        finally:
            loop.call_soon(self._see_to_jobs)
        return job

    async def wait(self, name: str) -> CaptureResult:
        """The result of a job, when it has ended. Raises RequestError for an unknown job."""
        job = self.table.get(name)
        await job.ended.wait()
        if job.result is None:
            raise PdcdError(f"job {name} ended without a result")
        return job.result

    async def answer(self, name: str) -> JobAnswer:
        """The answer of a plan, a show or a preview, when it is known.

        Raises the error with which the job ended, also Cancelled.
        """
        job = self.table.get(name)
        await job.answered.wait()
        if job.answer is None:
            raise restore_error(None if job.result is None else job.result.error)
        return job.answer

    async def see_next(self, name: str, after: int) -> LiveFrame:
        """The newest picture of a live view, once there is one after that number.

        Raises RequestError for a job that is no live view, and the error with which it ended.
        """
        job = self.table.get(name)
        if job.kind != "live":
            raise RequestError(f"job {name} is no live view", hint="begin one with preview.live")
        frame = await self._next(job, after)
        if not isinstance(frame, LiveFrame):
            raise PdcdError(f"job {name} gave no picture of a live view")
        return frame

    async def see_next_of_stream(self, name: str, after: int) -> StreamedPicture:
        """The newest picture of a stream, as `see_next` for a live view."""
        frame = await self._next(self._stream(name), after)
        if not isinstance(frame, StreamedPicture):
            raise PdcdError(f"job {name} gave no picture of a stream")
        return frame

    async def record(self, name: str, place: HeldFolder) -> CaptureResult:
        """Make a run of the newest photos of a stream; `place` is closed when that has ended.

        Raises RequestError for a job that is no stream, BusyError where enough runs are ordered
        already.
        """
        with place:
            return await order_record(self._stream(name), place)

    def _stream(self, name: str) -> Job:
        job = self.table.get(name)
        if job.kind != "stream":
            raise RequestError(f"job {name} is no stream", hint="begin one with stream.start")
        return job

    async def _next(self, job: Job, after: int) -> LiveFrame | StreamedPicture:
        """The newest picture of a job, once there is one after that number."""
        while (frame := job.frame) is None or frame.number <= after:
            if job.ended.is_set():
                gone = {"kind": "cancelled", "message": f"the {job.kind} gave way to another job"}
                error = gone if job.result is None else job.result.error or gone
                if job.kind == "stream" and job.state == "done":
                    error = {"kind": "cancelled", "message": "the stream has ended"}
                raise restore_error(error)
            await job.news.wait()
        return frame

    async def cancel(self, name: str) -> CaptureResult:
        """End a job and return its result when it has ended; harmless on an ended one.

        Where a device takes long to be made safe, the answer is that the job still runs. Raises
        RequestError for an unknown job.
        """
        job = self.table.get(name)
        self._cancel(job)
        waiting = asyncio.ensure_future(job.ended.wait())
        try:
            while not job.ended.is_set():
                await asyncio.wait([waiting], timeout=_DEAF_LOOK_S)
                if self.table.running is job and self._engine.deaf_s > _DEAF_S:
                    return CaptureResult(job=name, state="running", warnings=(_NOT_SAFE_YET,))
        finally:
            waiting.cancel()
        return await self.wait(name)

    def proceed(self, name: str) -> Job:
        """Tell a calibration that somebody has done what it asked for. Raises RequestError for an
        unknown job; harmless on one that does not wait."""
        job = self.table.get(name)
        job.proceed_flag.set()
        return job

    def drop(self, connection: int) -> None:
        """End the jobs of a client that has left, except for detached ones."""
        for job in self.table.owned_by(connection):
            logger.warning("client gone, cancelling job=%s pid=%d", job.name, job.owner.pid)
            self._cancel(job)

    async def drain(self) -> None:
        """Accept no more jobs, cancel all there are, and return when the last has ended."""
        self.table.stopping = True
        running = self.table.running
        for job in [*self.table.queue, *([] if running is None else [running])]:
            self._cancel(job)
        while self.table.take_turn() is not None or not _is_over(self._task):
            self._see_to_jobs()
            if self._task is not None:
                await asyncio.wait([self._task])

    def _announce(self, job: Job) -> None:
        """Publish that a job was admitted."""
        if job.state not in ENDED:  # cancelled in the very turn in which it was admitted
            ahead = list(self.table.queue).index(job) + 1 if job in self.table.queue else 0
            self._tell(job, time.monotonic_ns(), events.JobQueued(ahead=ahead))

    def _see_to_jobs(self) -> None:
        """Where there is a job to run, make sure that a task runs it."""
        if _is_over(self._task) and self.table.take_turn() is not None:
            self._task = asyncio.get_running_loop().create_task(self._run_jobs())
            self._task.add_done_callback(self._look_after)

    def _look_after(self, task: asyncio.Task[None]) -> None:
        """The task that ran the jobs has ended: if it left any, start another one."""
        if task.cancelled() and task.cancelling():  # the loop ends
            return
        error = None if task.cancelled() else task.exception()
        if error is not None:
            logger.error("fault of the program amid jobs", exc_info=error)
        asyncio.get_running_loop().call_later(_ANEW_S, self._see_to_jobs)

    async def _run_jobs(self) -> None:
        """Run the job whose turn it is, and all that wait behind it. After an error at any line, it
        may be started again."""
        while (job := self.table.take_turn()) is not None:
            if job.state not in ENDED:
                await self._use_rig(job)
                await self._go_black(job)
            self._end(job)
            self.table.release(job)

    async def _use_rig(self, job: Job) -> None:
        """Let the engine do a job, once; afterwards there is an `outcome`."""
        if job.begun:
            job.cancel_flag.set()  # in case the engine is still at it
            lost = PdcdError("what came of the job was lost", hint="see the daemon's log")
            job.outcome = job.outcome or make_failed_result(job, lost)
            return
        job.begun = True
        # The job must end for its waiters whatever the engine did, so no error passes.
        try:
            if isinstance(job.request, ShowParams):
                job.outcome = await self._hold(job, job.request)
            else:
                job.outcome, job.answer = await self._worker.call(
                    self._use, job, job.request, asyncio.get_running_loop()
                )
        except Exception as err:
            if not isinstance(err, PdcdError):
                logger.exception("engine raised job=%s", job.name)
            job.outcome = make_failed_result(job, err)

    async def _hold(self, job: Job, shown: ShowParams) -> CaptureResult:
        """Keep a pattern on the panels until the show is to end; `_go_black` follows."""
        if not job.cancel_flag.is_set():
            job.lit = _BLACK_TRIES
            await self._worker.call(self._engine.show, shown.pattern, shown.index)
            job.answer = ShowReply(shown.pattern, shown.index, job.name)
            job.answered.set()
            if shown.pattern == "black":
                job.lit = 0
            else:
                await job.let_go.wait()
        if job.cancel_flag.is_set():
            raise Cancelled("the show was ended", hint="both panels are black")
        return CaptureResult(job=job.name, state="done")

    async def _go_black(self, job: Job) -> None:
        """Make both panels black after a show, also after one that failed."""
        while job.lit:
            job.lit -= 1
            try:
                await self._worker.call(self._engine.show, "black", 0)
                job.lit = 0
            except Exception as err:
                logger.exception("panels not black job=%s", job.name)
                job.outcome = make_failed_result(job, err)

    def _use(
        self,
        job: Job,
        request: CaptureRequest | CalibrateRequest | LiveParams | StreamRequest,
        loop: asyncio.AbstractEventLoop,
    ) -> tuple[CaptureResult, JobAnswer | None]:
        """In the engine's thread: call the engine, with events thinned and sent to the loop."""
        thinned = EventsToLoop(loop, lambda t_ns, event: self._tell(job, t_ns, event))

        def emit(event: Event) -> None:
            self._worker.beat()
            # A copy by way of JSON types: what breaks the schema must fail here, in the engine's
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

        answer: PlanSummary | PreviewView | None = None
        result = CaptureResult(job=job.name, state="done")
        try:
            if isinstance(request, CalibrateRequest):
                result = self._engine.calibrate(
                    request, job=job.name, emit=emit, cancelled=cancelled, proceed=proceed
                )
            elif isinstance(request, LiveParams):
                result = self._show_live(job, request, loop, cancelled)
            elif isinstance(request, StreamRequest):
                result = self._stream_pictures(job, request, loop, emit, cancelled)
            else:
                result, answer = self._photograph(job, request, emit, cancelled, result)
        finally:
            thinned.flush()
        if result.state not in ENDED:
            raise PdcdError(f"the engine returned in state {result.state}")
        # By way of JSON types, so that nothing unencodable gets as far as the socket.
        told = None if answer is None else msgspec.convert(to_wire_types(answer), type(answer))
        return msgspec.convert(to_wire_types(result), CaptureResult), told

    def _show_live(
        self,
        job: Job,
        asked: LiveParams,
        loop: asyncio.AbstractEventLoop,
        cancelled: Callable[[], bool],
    ) -> CaptureResult:
        return self._engine.live(
            asked.pattern,
            asked.index,
            job=job.name,
            tell=lambda frame: loop.call_soon_threadsafe(job.see, frame),
            cancelled=cancelled,
            ended=lambda: job.given_up,
        )

    def _stream_pictures(
        self,
        job: Job,
        request: StreamRequest,
        loop: asyncio.AbstractEventLoop,
        emit: events.Emit,
        cancelled: Callable[[], bool],
    ) -> CaptureResult:
        return self._engine.stream(
            request,
            job.given,
            job=job.name,
            owner=job.owner.view(),
            emit=emit,
            listener=make_stream_listener(job, loop, cancelled),
        )

    def _photograph(
        self,
        job: Job,
        request: CaptureRequest,
        emit: events.Emit,
        cancelled: Callable[[], bool],
        done: CaptureResult,
    ) -> tuple[CaptureResult, PlanSummary | PreviewView | None]:
        """A capture; or a plan or a preview, which have an answer in addition to the result
        `done`."""
        engine, owner = self._engine, job.owner.view()
        if job.kind == "plan":
            return done, engine.plan(request, job.given, emit=emit, cancelled=cancelled)
        if job.kind == "preview":
            return done, engine.preview(job=job.name, owner=owner, emit=emit, cancelled=cancelled)
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
        return result, None

    def _cancel(self, job: Job) -> None:
        """Cancel a job; one that waits has ended on return."""
        # It is checked once more later, in case an error interrupts this: no task runs a job that
        # waits.
        asyncio.get_running_loop().call_soon(self._end_cancelled, job)
        job.let_go.set()
        self.table.cancel(job)
        self._end_cancelled(job)

    def _end_cancelled(self, job: Job) -> None:
        if job.state in ENDED:
            self._end(job)

    def _end(self, job: Job) -> None:
        """Enter how a job ended, and wake and inform those who wait for it; harmless once done."""
        result = job.result or job.outcome
        if result is None:
            result = make_failed_result(job, PdcdError("the job ended without a result"))
        result = self.table.end(job, result)
        for mark in (job.answered, job.ended, job.let_go, job.news):
            mark.set()
        while job.untold:
            job.untold -= 1
            if self._tell(job, time.monotonic_ns(), events.make_end_event(result)):
                job.untold = 0
                logger.info("%s ended job=%s state=%s", job.kind, job.name, job.state)

    def _tell(self, job: Job, t_mono_ns: int, event: Event) -> bool:
        """Publish an event; returns whether that succeeded. If not, the job still goes on, and
        ends."""
        try:
            self._publish(job, job.numbered(event, t_mono_ns))
        except BaseException:
            logger.exception("event not told job=%s type=%s", job.name, event.type)
            return False
        return True


def _is_over(task: asyncio.Task[None] | None) -> bool:
    return task is None or task.done()
