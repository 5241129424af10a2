"""One job as it was ordered, and who is told how it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from pdcd.bench.devices import Clock
from pdcd.errors import Cancelled
from pdcd.protocol.events import Decoded, Emit, Event, Planning, logged
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.views import OwnerView
from pdcd.recipes.arrays import Given
from pdcd.runs.folder import RunFolder
from pdcd.runs.ledger import Ledger
from pdcd.watch import Watch


@dataclass(frozen=True)
class Job:
    """What is wanted, by whom, and the two lines to whoever waits for it."""

    name: str
    request: CaptureRequest
    owner: OwnerView | None
    emit: Emit
    cancelled: Callable[[], bool]
    given: Given = field(default_factory=dict)
    """The arrays of the request."""
    report: bool = False
    """Whether a page of the run is to be made at its end, where it is soon made."""

    def look_for_cancel(self) -> None:
        """Raise Cancelled when somebody asked for it."""
        if self.cancelled():
            raise Cancelled("the job was cancelled")

    def watch(self) -> Watch:
        """Tells the client how far the making of pictures is, and looks for a cancel."""

        def step(done: float, total: float) -> None:
            self.emit(Decoded(done=done, total=total))

        return Watch(self.look_for_cancel, step)

    def planning(self) -> Watch:
        """The same for planning."""
        return planning(self.emit, self.look_for_cancel)


def planning(emit: Emit, look_for_cancel: Callable[[], None]) -> Watch:
    """Tells how far a plan is; `look_for_cancel` may raise to end it."""

    def step(done: float, total: float) -> None:
        emit(Planning(stage=watch.stage, done=done, total=total))

    watch = Watch(look_for_cancel, step)
    return watch


@dataclass(frozen=True)
class Journal:
    """Tells of a job as it goes, and writes down what the user must know at its end."""

    job: Job
    folder: RunFolder
    clock: Clock
    warnings: list[str]
    ledger: Ledger

    def notify(self, event: Event) -> None:
        """Tell the client and log.jsonl; then see whether the job is still wanted."""
        self.folder.log(logged(event, self.clock.now_ns()))
        self.job.emit(event)
        self.job.look_for_cancel()

    def warn(self, text: str) -> None:
        """Keep a warning for the manifest."""
        self.warnings.append(text)
        if self.folder.where is not None:  # before that, the manifest alone has it
            self.ledger.warn(text)
