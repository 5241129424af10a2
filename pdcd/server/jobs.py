"""The job table: who may use the rig when, and the state of each job. No sockets, no threads.

::

    admit ──> queued ──> running ──> done | failed | cancelled
                └── cancel ──> cancelled

Every use of the rig is a job: a capture, a plan, a picture held on the panels (show), a preview, a
live view, a stream, a calibration. One runs at a time. A show and a live view have no end of their
own, and give way to anything else that their owner asks for.
All of this is used from one thread (the event loop's); only the flags of `Job` are touched by the
thread that captures.

An error may interrupt any of the steps by which a job gets the rig and ends, between any two lines.
Each step may then be repeated, and goes on from where it was.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime

import msgspec

from pdcd.errors import BusyError, Cancelled, RequestError, to_error_fields, to_typed_error
from pdcd.files.text import encode_json
from pdcd.protocol.events import Event
from pdcd.protocol.messages import MAX_LINE, JobView, LiveParams, ShowParams, ShowReply
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.stream import StreamedPicture, StreamRequest
from pdcd.protocol.views import LiveFrame, OwnerView, PreviewView
from pdcd.recipes.arrays import NO_ARRAYS, Given
from pdcd.runs.place import HeldFolder
from pdcd.runs.recording import RecordOrder
from pdcd.words import JobKind, JobState

ENDED: frozenset[str] = frozenset({"done", "failed", "cancelled"})
"""States that a job never leaves."""

_MOST_BYTES = MAX_LINE - 4096
"""Longest result: a reply or an event adds a few fields."""


@dataclass(frozen=True)
class Owner:
    """Who started a job: kernel credentials, and the number of the connection."""

    uid: int
    pid: int
    user: str
    connection: int

    def view(self) -> OwnerView:
        """The part that others may see."""
        return OwnerView(uid=self.uid, pid=self.pid, user=self.user)


JobRequest = CaptureRequest | StreamRequest | ShowParams | LiveParams | CalibrateRequest
"""What a job was asked to do."""
JobAnswer = PlanSummary | ShowReply | PreviewView
"""The reply to the request that started a job, where that is more than its result."""


@dataclass(eq=False)
class Job:
    """One requested use of the rig, and its state."""

    name: str
    kind: JobKind
    request: JobRequest
    owner: Owner
    detach: bool
    created_utc: str
    given: Given = field(default_factory=dict)
    """Arrays of the request; dropped at the end."""
    place: HeldFolder | None = None
    """Folder for its run; held open until it has ended."""
    state: JobState = "queued"
    result: CaptureResult | None = None
    answer: JobAnswer | None = None
    begun: bool = False
    """Whether the engine was asked to do it, which happens only once."""
    lit: int = 0
    """For a show: how often the panels may still be asked to go black."""
    outcome: CaptureResult | None = None
    """Its result, before that is entered in the table."""
    untold: int = 2
    """How many more times its end may be published, as long as that fails."""
    given_up: bool = False
    """For a show or a live view: its owner wants the rig for something else."""
    frame: LiveFrame | StreamedPicture | None = None
    """For a live view or a stream: the newest picture."""
    news: asyncio.Event = field(default_factory=asyncio.Event)
    """For these: set once there is a newer picture, or the job has ended; each picture has its own
    event."""
    looked_s: float = -math.inf
    """For a stream: when a drawn picture was last asked for."""
    records: deque[RecordOrder] = field(default_factory=deque)
    """For a stream: orders for run folders."""
    ended: asyncio.Event = field(default_factory=asyncio.Event)
    answered: asyncio.Event = field(default_factory=asyncio.Event)
    let_go: asyncio.Event = field(default_factory=asyncio.Event)
    """For a show: set when it is to end."""
    cancel_flag: threading.Event = field(default_factory=threading.Event)
    proceed_flag: threading.Event = field(default_factory=threading.Event)
    """For a calibration: set when somebody has done what was asked."""
    _next_seq: int = 0

    @property
    def goal(self) -> str:
        """What it is about, in a word."""
        request = self.request
        if isinstance(request, CalibrateRequest):
            return " ".join(request.steps) or "all"
        return request.pattern if isinstance(request, ShowParams | LiveParams) else request.goal

    def gives_way_to(self, owner: Owner) -> bool:
        """Whether this user's next job may take its place: a picture that a user shows does not
        block the same user."""
        return self.kind in ("show", "live") and self.owner.uid == owner.uid

    def see(self, frame: LiveFrame | StreamedPicture) -> None:
        """Store the newest picture, and wake those who wait for it."""
        if self.state not in ENDED:
            seen, self.frame, self.news = self.news, frame, asyncio.Event()
            seen.set()

    def numbered(self, event: Event, t_mono_ns: int) -> Event:
        """The event with the job's name, its next number and its time."""
        seq = self._next_seq
        self._next_seq += 1
        return msgspec.structs.replace(event, job=self.name, seq=seq, t_mono_ns=t_mono_ns)

    def view(self) -> JobView:
        """The job as clients see it."""
        return JobView(
            job=self.name,
            state=self.state,
            goal=self.goal,
            kind=self.kind,
            owner=self.owner.view(),
            detach=self.detach,
            created_utc=self.created_utc,
            folder=None if self.result is None else self.result.folder,
        )


class JobTable:
    """All jobs: the running one, those that wait, and of each kind the last `history` that ended,
    so that many plans do not displace a capture."""

    def __init__(self, *, history: int = 64, queue_limit: int = 64) -> None:
        self._history = history
        self._queue_limit = queue_limit
        self._jobs: dict[str, Job] = {}
        self._ended: dict[JobKind, deque[Job]] = {}
        self.queue: deque[Job] = deque()
        self.running: Job | None = None
        self.stopping = False
        """True once no more jobs are accepted."""

    def admit(
        self,
        request: JobRequest,
        given: Given,
        owner: Owner,
        *,
        kind: JobKind = "capture",
        detach: bool,
        queue: bool,
        place: HeldFolder | None = None,
    ) -> Job:
        """Take a job: it runs at once (state running) if the rig is free, else waits its turn.

        A show of the same owner is no reason to refuse it: the job then comes next, and the caller
        ends the show. An accepted job owns its `place`, and closes it when it has ended. Raises
        BusyError when the rig is taken and `queue` is false, when the queue is full, or when the
        daemon is stopping.
        """
        if self.stopping:
            raise BusyError("the daemon is stopping", hint="ask again in a moment")
        if self.running is not None and not self._next_after_show(owner):
            if not queue:
                raise self.busy()
            if len(self.queue) >= self._queue_limit:
                raise BusyError(
                    f"{len(self.queue)} jobs are waiting already", hint="wait until some have ended"
                )
        job = Job(self._new_name(), kind, request, owner, detach, _utc_now(), given, place)
        if self._next_after_show(owner):
            self.queue.appendleft(job)
        else:
            self.queue.append(job)
        self._jobs[job.name] = job
        self.take_turn()
        return job

    def _next_after_show(self, owner: Owner) -> bool:
        """Whether the running job is a show of this user for which no successor waits yet."""
        show = self.running
        free = show is not None and (not show.given_up or not self.queue)
        return free and show is not None and show.gives_way_to(owner)

    def busy(self) -> BusyError:
        """The refusal that names the holder of the rig."""
        holder = self.running
        if holder is None:
            return BusyError("the rig is busy", hint="try again in a moment")
        owner = holder.owner
        return BusyError(
            f"job {holder.name} ({holder.kind}) of {owner.user} (uid {owner.uid}) holds the rig",
            hint='wait for it with capture.wait, or start with "queue": true',
        )

    def get(self, name: str) -> Job:
        """The job of that name. Raises RequestError when it is unknown or forgotten."""
        try:
            return self._jobs[name]
        except KeyError as err:
            raise RequestError(
                f"no job {name!r}",
                hint=f"capture.list names the jobs; of each kind the last {self._history} that "
                "ended are kept",
            ) from err

    def all(self) -> list[Job]:
        """Every job known, oldest first."""
        return list(self._jobs.values())

    def cancel(self, job: Job) -> bool:
        """Cancel a job; true if that ended it at once (it was waiting).

        A running job is told by its flag and ends through `finish`; an ended one stays as it is.
        """
        if job.state in ENDED:
            return False
        job.cancel_flag.set()
        if job.state != "queued":
            return False
        error = Cancelled("cancelled before it began", hint="the rig was not touched")
        self.end(job, CaptureResult(job=job.name, state="cancelled", error=to_error_fields(error)))
        return True

    def owned_by(self, connection: int) -> list[Job]:
        """The jobs that must end when this connection does."""
        active = [*([] if self.running is None else [self.running]), *self.queue]
        return [j for j in active if j.owner.connection == connection and not j.detach]

    def take_turn(self) -> Job | None:
        """The job that has the rig; where the rig is free, the first waiting job gets it."""
        while self.queue and self.queue[0].state in ENDED:
            self.queue.popleft()
        if self.running is None and self.queue:
            self.running = self.queue[0]
        if self.queue and self.queue[0] is self.running:
            self.queue.popleft()
        if self.running is not None and self.running.state == "queued":
            self.running.state = "running"
        return self.running

    def end(self, job: Job, result: CaptureResult) -> CaptureResult:
        """Enter the result of a job, and release all that it was given. Returns the result as
        entered."""
        if job.result is None:
            job.result = fit_into_line(result)
        job.state = job.result.state
        job.given = NO_ARRAYS
        job.frame = None
        with suppress(ValueError):
            self.queue.remove(job)
        ended = self._ended.setdefault(job.kind, deque())
        if job not in ended:
            ended.append(job)
        while len(ended) > self._history:
            self._jobs.pop(ended[0].name, None)
            ended.popleft()
        place, job.place = job.place, None
        if place is not None:
            with suppress(OSError):  # it is let go of all the same
                place.close()
        return job.result

    def release(self, job: Job) -> None:
        """Free the rig after a job has ended."""
        if self.running is job:
            self.running = None

    def _new_name(self) -> str:
        # Four random digits per second may collide by chance; folders must not.
        while (name := make_job_id()) in self._jobs:
            pass
        return name


def make_failed_result(job: Job, error: BaseException) -> CaptureResult:
    """The result of a job whose engine call raised instead of returning one."""
    typed = to_typed_error(error)
    state: JobState = "cancelled" if isinstance(typed, Cancelled) else "failed"
    return CaptureResult(job=job.name, state=state, error=to_error_fields(typed))


def fit_into_line(result: CaptureResult) -> CaptureResult:
    """The result in a form that can be sent. What is too long for a line of the socket is left out,
    with a note, because whoever waits must hear of the end."""
    if len(encode_json(result)) <= _MOST_BYTES:
        return result
    left_out = f"{len(result.files)} files, and what else was long, are left out: see its folder"
    error = result.error and {name: text and text[:1000] for name, text in result.error.items()}
    cut = msgspec.structs.replace(
        result,
        files=(),
        error=error,
        warnings=(*(text[:1000] for text in result.warnings[:63]), left_out),
    )
    if len(encode_json(cut)) > _MOST_BYTES:
        cut = msgspec.structs.replace(cut, summary={})
    return cut


def _utc_now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
