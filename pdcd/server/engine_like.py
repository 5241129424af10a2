"""What the daemon needs of the engine that takes photos. Tests give it another one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from pdcd.protocol.events import Emit
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamRequest
from pdcd.protocol.views import LiveFrame, OwnerView, PreviewView, RigView
from pdcd.recipes.arrays import Given
from pdcd.runs.place import HeldFolder
from pdcd.runs.recording import StreamListener


class EngineLike(Protocol):
    """What the daemon needs of the engine. All calls come from the same thread, unless noted."""

    def start(self) -> None:
        """Connect the devices; both panels are black and the shutter is closed on return.

        Raises PdcdError when the rig cannot be used.
        """
        ...

    def stop(self) -> None:
        """Panels black, shutter closed, devices released. Idempotent."""
        ...

    def break_off(self) -> None:
        """Make all drivers stop waiting, for good. For any thread."""
        ...

    def make_safe_beside(self, within_s: float) -> bool:
        """Make panels black and close the shutter while another call hangs; returns whether each
        was done within that time. For any thread."""
        ...

    @property
    def deaf_s(self) -> float:
        """For how long devices have kept a job waiting to be made safe; 0 while none does. For any
        thread."""
        ...

    def describe(self) -> RigView:
        """The rig as found."""
        ...

    def plan(
        self,
        request: CaptureRequest,
        given: Given,
        *,
        emit: Emit,
        cancelled: Callable[[], bool],
    ) -> PlanSummary:
        """What the capture would do; `given` are its arrays.

        `emit` takes the events `PlanningProgress`; `cancelled` is called as in a capture. Raises
        RequestError or ConfigError when it is impossible, Cancelled when it was cancelled.
        """
        ...

    def capture(
        self,
        request: CaptureRequest,
        given: Given,
        *,
        job: str,
        owner: OwnerView,
        emit: Emit,
        cancelled: Callable[[], bool],
        parent: HeldFolder | None = None,
        report: bool = False,
    ) -> CaptureResult:
        """Run one job to its end; a failure of the run is a result, not an exception. The run
        folder is made in `parent`; with `report` it gets its page, if that is cheap.

        `cancelled()` is called at least ten times a second, which also proves that the thread
        lives; `emit` takes the events of `pdcd.protocol.events`, all but `JobQueued` and the ends.
        On return the panels are black and the shutter is closed.
        """
        ...

    def calibrate(
        self,
        request: CalibrateRequest,
        *,
        job: str,
        emit: Emit,
        cancelled: Callable[[], bool],
        proceed: Callable[[str], None],
    ) -> CaptureResult:
        """Let the bench measure itself, with the guarantees of `capture`; `proceed(text)` returns
        once somebody has done what the text asks, or the job is to end."""
        ...

    def show(self, pattern: str, index: int) -> None:
        """Both panels show "black", "white", "checker", "grid" or pattern `index` of "code"."""
        ...

    def live(
        self,
        pattern: str,
        index: int,
        *,
        job: str,
        tell: Callable[[LiveFrame], object],
        cancelled: Callable[[], bool],
        ended: Callable[[], bool],
    ) -> CaptureResult:
        """Show what the camera's finder sees until `cancelled()` or `ended()`, with the guarantees
        of `capture`; `tell` takes each picture."""
        ...

    def stream(
        self,
        request: StreamRequest,
        given: Given,
        *,
        job: str,
        owner: OwnerView,
        emit: Emit,
        listener: StreamListener,
    ) -> CaptureResult:
        """Take photo after photo with one plan until the listener ends it, or its time is over,
        with the guarantees of `capture`."""
        ...

    def preview(
        self, *, job: str, owner: OwnerView, emit: Emit, cancelled: Callable[[], bool]
    ) -> PreviewView:
        """Take a test photo, with the guarantees of `capture`. Raises the PdcdError that ended
        it."""
        ...
