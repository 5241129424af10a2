"""What can be asked of a bench, whether in this process or behind a daemon's socket."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack

from pdcd.api.arguments import Arguments, make_request
from pdcd.api.progress import EventListener, ProgressChoice, show_progress
from pdcd.api.run import Run, open_run
from pdcd.api.stream import PictureStream
from pdcd.errors import RequestError, restore_error
from pdcd.files.opening import Sendable
from pdcd.protocol.fields import FieldError, convert_fields
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamRequest, to_stream_request

if TYPE_CHECKING:
    from pdcd.words import GoalName

Arrays = Mapping[str, Sendable]
"""Arrays of a request by field."""
NONE: Arrays = MappingProxyType({})


class Bench(ABC):
    """A bench that takes photos; a context manager that releases its devices at the end.

    It is for one thread. Whatever happens in a capture, panels are black and the shutter is closed
    when it returns or raises.
    """

    @property
    @abstractmethod
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""

    @abstractmethod
    def described(self) -> dict[str, Any]:
        """A description in plain values; to a sweep, equal descriptions mean the same bench."""

    @abstractmethod
    def close(self) -> None:
        """Release the bench and its devices. Idempotent."""

    @abstractmethod
    def foresee(self, request: CaptureRequest, arrays: Arrays = NONE) -> PlanSummary:
        """What a request would do, without doing it; `plan` does the same from keywords."""

    @abstractmethod
    def take(
        self,
        request: CaptureRequest,
        arrays: Arrays = NONE,
        *,
        on_event: EventListener | None = None,
        report: bool = False,
    ) -> CaptureResult:
        """Take the photo of a request and return how the job ended; failures after the job has
        begun raise no error. `capture` does the same from keywords.

        report : write its page (`pdcd.pages.report`) at once, if that costs little.

        An interrupt ends the job in good order and is delivered afterwards.
        """

    def plan(self, goal: GoalName, **arguments: Unpack[Arguments]) -> PlanSummary:
        """What a capture would do, without doing it; goal and keywords are those of `capture`.

        Raises RequestError, and BusyError on a local bench that takes a photo or a stream.
        """
        return self.foresee(*make_request(goal, arguments, lambda: self.grid))

    def capture(
        self, goal: GoalName, *, progress: ProgressChoice = True, **arguments: Unpack[Arguments]
    ) -> Run:
        """Take a photo.

        Parameters
        ----------
        goal : which light to keep, such as "indirect" (`pdcd.recipes.goals`).
        progress : whether to show progress, in a notebook or on the terminal; or a function that
            takes each event.
        arguments : fields of `pdcd.protocol.request.CaptureRequest`. Arrays are numpy arrays, rows
        of
            numbers, or paths.

        Raises
        ------
        RequestError
            A keyword is unknown or wrong, or the bench cannot do this.
        PdcdError
            The job failed: this is the error that ended it. What was taken is kept; a note on the
            error says where.
        """
        request, arrays = make_request(goal, arguments, lambda: self.grid)
        with show_progress(progress) as on_event:
            result = self.take(request, arrays, on_event=on_event, report=True)
        return open_finished_run(result)

    def begin_stream(self, request: StreamRequest, arrays: Arrays = NONE) -> PictureStream:
        """Begin a stream; `stream` does the same from keywords. Raises RequestError where the bench
        cannot stream."""
        raise RequestError("this bench has no streams", hint="take captures, one after the other")

    def stream(
        self,
        goal: GoalName,
        *,
        over: int = 1,
        rate_hz: float | None = None,
        for_s: float | None = None,
        **arguments: Unpack[Arguments],
    ) -> PictureStream:
        """Take photo after photo by one plan, and loop over the pictures: the newest each time.

        Parameters
        ----------
        goal, arguments : as for `capture`; `codes` is the number for each photo, 32 by default,
            and `parts` the photos of a set, 4 at least: each takes the next part of the set.
        over : number of the newest photos that make a picture.
        rate_hz : pictures a second at most; None: 30.
        for_s : end after this many seconds of pictures; None: when it is closed.

        Raises RequestError; looping raises the error that ended the stream.
        """
        request, arrays = make_request(goal, arguments, lambda: self.grid)
        try:
            own = convert_fields(StreamRequest, {"over": over, "rate_hz": rate_hz, "for_s": for_s})
        except FieldError as err:
            raise RequestError(str(err)) from err
        return self.begin_stream(to_stream_request(request, **own), arrays)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_finished_run(result: CaptureResult) -> Run:
    """The run of a job that is done; for any other job, raises the error that ended it."""
    if result.state == "done" and result.folder is not None:
        return open_run(Path(result.folder))
    told = result.error or {"message": f"the job is {result.state}"}
    error = restore_error(told)
    if result.folder is not None:
        error.add_note(f"What was taken lies in {result.folder}")
    raise error
