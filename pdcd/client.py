"""A blocking client of the daemon, for the command line and for scripts.

::

    with Client(socket_path(config)) as client:
        result = client.capture(CaptureRequest(goal="indirect", codes=128), on_event=print)
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, TypeVar

import msgspec

from pdcd.errors import PdcdError, ProtocolError
from pdcd.files.opening import Sendable, open_parcels
from pdcd.files.parcels import unpack_arrays
from pdcd.files.system import require_linux
from pdcd.protocol.entry import Page, RunQuery
from pdcd.protocol.events import Attention, Event
from pdcd.protocol.line_talk import EventHandler, LineTalk, UnreachableError
from pdcd.protocol.messages import (
    Admission,
    Hello,
    JobList,
    JobView,
    RigDescription,
    ShowReply,
    Status,
    check_version,
    convert_reply,
    decode_error,
    read_event,
)
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest, SentArray
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamedPicture, StreamFrame, StreamRequest
from pdcd.protocol.views import LiveFrame, RigView

_T = TypeVar("_T")


_Arrays = Mapping[str, Sendable]
"""Arrays of a request by field: paths, or numpy arrays."""
_NONE: _Arrays = MappingProxyType({})
_Jobs = list[JobView]
"""Defined here, as inside `Client` the name `list` is a method."""

INTAKE_TIMEOUT_S = 30.0
"""Longest time for the daemon to read the arrays of a request, in seconds."""
_DISK_TIMEOUT_S = 60.0
"""Longest time for an answer that reads many files, in seconds."""
_ENGINE_TIMEOUT_S = 60.0
"""Longest time for an answer that needs the devices, in seconds."""


class Client(LineTalk):
    """One connection to the daemon; a context manager that closes it.

    `hello` holds the server's first words (see `docs/protocol.md`). Closing the connection ends
    the jobs that were started on it, unless they were detached. `timeout_s` bounds the wait for
    an answer that needs no device.

    Raises Unreachable when nobody answers, BusyError when too many wait before us, and the error
    that the daemon gave when it refuses.
    """

    def __init__(self, socket_path: Path | str, timeout_s: float = 5.0) -> None:
        require_linux("a daemon")
        super().__init__(socket_path, timeout_s)
        try:
            self._connect()
            first = self._receive(timeout_s)
            if "error" in first:
                raise decode_error(first["error"])
            if first.get("method") != "hello":
                raise ProtocolError("the server did not say hello", hint="is this pdcd's socket?")
            check_version(first["params"])
            self.hello = convert_reply(first["params"], Hello)
        except BaseException:
            self._sock.close()
            raise

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def daemon_pid(self) -> int:
        """The process that listens at the other end."""
        told = self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        return int(struct.unpack("3i", told)[0])

    def call(
        self,
        method: str,
        params: Mapping[str, object] | None = None,
        *,
        timeout_s: float | None = None,
        on_event: EventHandler | None = None,
    ) -> Any:
        """Send one request and wait for the answer, up to `timeout_s` of silence.

        Events that come meanwhile go to `on_event`, or are kept for `events`. Raises the PdcdError
        that the daemon answered with, or Unreachable.
        """
        request_id = self._send(method, params)
        limit_s = self._timeout_s if timeout_s is None else timeout_s
        return self._answer(request_id, limit_s, on_event)

    def answer(self, method: str, params: Mapping[str, object], *, timeout_s: float | None) -> Any:
        """As `call`, but without a limit where `timeout_s` is None."""
        return self._answer(self._send(method, params), timeout_s, None)

    def capture(
        self,
        request: CaptureRequest,
        *,
        arrays: _Arrays = _NONE,
        detach: bool = False,
        queue: bool = False,
        on_event: EventHandler | None = None,
    ) -> CaptureResult:
        """Take a photo and wait for its end; with `detach`, only start it.

        `arrays` are those of the request by field, as paths that this process may read, or as
        numpy arrays: "illumination", "kernel" ..., and "prior" and "codes_from", which are files.
        They are passed on as open files; the daemon needs no right to them.

        A detached job is returned in its present state (queued or running). On KeyboardInterrupt
        the job is cancelled, its end is awaited, and its result is returned. An exception from
        `on_event` is raised again once the job has been cancelled and has ended.
        """
        if on_event is not None:
            self.call("events.subscribe", {"jobs": "own"})
        params = {**msgspec.to_builtins(request), "detach": detach, "queue": queue}
        request_id = self._send_with(arrays, "capture.start", params)
        return self._see_through(request_id, on_event, on_event, detach=detach)

    def calibrate(
        self,
        request: CalibrateRequest,
        *,
        queue: bool = False,
        on_event: EventHandler | None = None,
        answer: Callable[[str], None] | None = None,
    ) -> CaptureResult:
        """Have the bench measure itself and wait for the end.

        With `request.attended`, `answer(text)` is called for each thing that the user has to do,
        and returns when it is done. On KeyboardInterrupt the job is cancelled, and its end awaited.
        """
        self.call("events.subscribe", {"jobs": "own"})

        def hear(event: Event) -> None:
            if on_event is not None:
                on_event(event)
            if isinstance(event, Attention) and answer is not None:
                answer(event.text)
                self._send("calibrate.proceed", {"job": event.job})

        params = {**msgspec.to_builtins(request), "queue": queue}
        return self._see_through(self._send("calibrate.start", params), hear, on_event)

    def wait(self, job: str, on_event: EventHandler | None = None) -> CaptureResult:
        """Wait for the end of any job; `on_event` gets the events of this job from now on."""
        if on_event is not None:
            self.call("events.subscribe", {"jobs": "all"})
        return self._wait(job, on_event)

    def cancel(self, job: str) -> CaptureResult:
        """End a job; returns when the panels are black and the shutter is closed.

        If a device takes long, the result is returned within a second, in state "running": then
        `wait` for the end.
        """
        return self._result("capture.cancel", job, None)

    def status(self) -> Status:
        """State of the rig, the running job and the waiting jobs."""
        return convert_reply(self.call("rig.status"), Status)

    def describe(self) -> RigView:
        """The rig: drivers, panels, camera, cells."""
        answer = self.call("rig.describe", timeout_s=_ENGINE_TIMEOUT_S)
        return convert_reply(answer, RigDescription).rig

    def list(self) -> _Jobs:
        """The jobs that the daemon knows, oldest first."""
        return convert_reply(self.call("capture.list"), JobList).jobs

    def find(self, query: RunQuery) -> Page:
        """A page of the runs in the daemon's state folder, newest first."""
        params = {"find": msgspec.to_builtins(query)}
        found = convert_reply(
            self.call("capture.list", params, timeout_s=_DISK_TIMEOUT_S), JobList
        ).found
        if found is None:
            raise ProtocolError("the server did not look for runs")
        return found

    def plan(
        self, request: CaptureRequest, *, arrays: _Arrays = _NONE, queue: bool = False
    ) -> PlanSummary:
        """What a capture would do; `arrays` as in `capture`. With `queue`, waits without limit for
        whatever holds the rig."""
        params = {**msgspec.to_builtins(request), "queue": queue}
        request_id = self._send_with(arrays, "capture.plan", params)
        limit_s = None if queue else _ENGINE_TIMEOUT_S
        return convert_reply(self._answer(request_id, limit_s, None), PlanSummary)

    def show(self, pattern: str, index: int = 0, *, detach: bool = False) -> ShowReply:
        """Put a pattern on both panels, where it stays until its job ends: see `cancel`."""
        params = {"pattern": pattern, "index": index, "detach": detach}
        return convert_reply(
            self.call("display.show", params, timeout_s=_ENGINE_TIMEOUT_S), ShowReply
        )

    def live(
        self, on_frame: Callable[[LiveFrame], bool], pattern: str, index: int, *, picture: bool
    ) -> CaptureResult:
        """Show what the camera's finder sees while the panels hold a pattern of `show`.

        `on_frame` takes each picture, always the newest, and returns whether that is enough.
        KeyboardInterrupt also ends the view. picture : whether JPEGs are wanted.
        """
        begun = self.call("preview.live", {"pattern": pattern, "index": index})
        job, number, enough = convert_reply(begun, Admission).job, 0, False
        with contextlib.suppress(KeyboardInterrupt):
            while not enough:
                asked = {"job": job, "after": number, "picture": picture}
                request_id = self._send("preview.frame", asked)
                try:
                    frame = convert_reply(self._answer(request_id, None, None), LiveFrame)
                except PdcdError:  # it has ended
                    break
                number, enough = frame.number, on_frame(frame)
        return self._end(job, None)

    def start_stream(
        self, request: StreamRequest, *, arrays: _Arrays = _NONE, queue: bool = False
    ) -> str:
        """Begin a stream, and return the name of its job, which ends with this connection. `arrays`
        as in `capture`."""
        params = {**msgspec.to_builtins(request), "queue": queue}
        request_id = self._send_with(arrays, "stream.start", params)
        return convert_reply(self._answer(request_id, INTAKE_TIMEOUT_S, None), Admission).job

    def see_stream(
        self,
        job: str,
        after: int = 0,
        picture: str = "arrays",
        *,
        timeout_s: float | None = None,
    ) -> StreamedPicture:
        """Wait for the newest picture of a stream after that number. picture : "none", "jpeg" or
        "arrays". Raises the error that ended the stream, which may be Cancelled."""
        asked = {"job": job, "after": after, "picture": picture}
        request_id = self._send("stream.frame", asked)
        message = self._hear_answer(request_id, timeout_s, None)
        fds = [self._fds.popleft() for _ in range(min(int(message.get("fds", 0)), len(self._fds)))]
        try:
            frame = convert_reply(message["result"], StreamFrame)
            if not fds:
                return StreamedPicture(frame)
            places = {name: (p.dtype, p.shape, p.offset) for name, p in frame.arrays.items()}
            return StreamedPicture(frame, unpack_arrays(fds[0], places.items()))
        except ValueError as err:
            raise ProtocolError(f"the server sent something that is no picture: {err}") from err
        finally:
            for fd in fds:
                os.close(fd)

    def record_stream(self, job: str) -> CaptureResult:
        """Make a run of the newest photos of a stream, and wait for it."""
        return self._result("stream.record", job, None)

    def events(self, jobs: str = "all") -> Iterator[Event]:
        """Subscribe, then yield events as they come, until the daemon closes the connection."""
        self.call("events.subscribe", {"jobs": jobs})
        while True:
            while self._events:
                yield self._events.popleft()
            try:
                message = self._receive(None)
            except UnreachableError:
                return
            if message.get("method") == "event":
                self._events.append(read_event(message))

    def _see_through(
        self,
        request_id: int,
        hear: EventHandler | None,
        on_event: EventHandler | None,
        *,
        detach: bool = False,
    ) -> CaptureResult:
        """Wait for a job that was just requested; `hear` gets its events. KeyboardInterrupt cancels
        the job, and `on_event` gets the events from then on. An exception from `hear` also cancels
        it."""
        started, hearing = None, False

        def heard(event: Event) -> None:
            nonlocal hearing
            if hear is not None:
                hearing = True
                hear(event)
                hearing = False

        ear = None if hear is None else heard
        try:
            # The job's first events may come before the answer that names it.
            started = convert_reply(self._answer(request_id, INTAKE_TIMEOUT_S, ear), Admission)
            if detach:
                return CaptureResult(job=started.job, state=started.state)
            return self._wait(started.job, ear)
        except KeyboardInterrupt:
            return self._ended(request_id, started, on_event)
        except Exception:
            if hearing:  # else it came from the daemon, which knows how the job ended
                with contextlib.suppress(PdcdError, UnreachableError):
                    self._ended(request_id, started, _unheard)
            raise

    def _ended(
        self, request_id: int, started: Admission | None, on_event: EventHandler | None
    ) -> CaptureResult:
        """Cancel a requested job, and wait for its end; first for its name, if not yet known."""
        if started is None:
            started = convert_reply(self._answer(request_id, self._timeout_s, on_event), Admission)
        return self._end(started.job, on_event)

    def _end(self, job: str, on_event: EventHandler | None) -> CaptureResult:
        """Cancel a job, and wait for its end without limit."""
        result = self._result("capture.cancel", job, on_event)
        return self._wait(job, on_event) if result.state == "running" else result

    def _wait(self, job: str, on_event: EventHandler | None) -> CaptureResult:
        return self._result("capture.wait", job, on_event)

    def _result(self, method: str, job: str, on_event: EventHandler | None) -> CaptureResult:
        """Ask for a job's result and wait for it without limit; only events of this job count."""

        def only_this(event: Event) -> None:
            if on_event is not None and event.job == job:
                on_event(event)

        request_id = self._send(method, {"job": job})
        return convert_reply(self._answer(request_id, None, only_this), CaptureResult)

    def _send_with(self, arrays: _Arrays, method: str, params: Mapping[str, object]) -> int:
        """Send a request with its arrays as open files. Raises RequestError."""
        with open_parcels(arrays) as opened:
            sent = {
                name: SentArray(fd=index, file=parcel.file)
                for index, (name, parcel) in enumerate(opened.items())
            }
            descriptors = [parcel.descriptor for parcel in opened.values()]
            return self._send(method, {**params, **msgspec.to_builtins(sent)}, descriptors)


def _unheard(event: Event) -> None:
    """Ignore an event: nobody listens any more."""
