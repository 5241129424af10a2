"""One job as it was ordered, and who is told how it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pdcd.bench.devices import Clock
from pdcd.errors import Cancelled
from pdcd.request import CaptureRequest
from pdcd.runs.folder import RunFolder

Emit = Callable[[str, dict[str, Any]], None]


@dataclass(frozen=True)
class Job:
    """What is wanted, by whom, and the two lines to whoever waits for it."""

    name: str
    request: CaptureRequest
    owner: dict[str, Any]
    emit: Emit
    cancelled: Callable[[], bool]

    def look_for_cancel(self) -> None:
        """Raise Cancelled when somebody asked for it."""
        if self.cancelled():
            raise Cancelled("the job was cancelled")


@dataclass(frozen=True)
class Journal:
    """Tells of a job as it goes, and writes down what the user must know at its end."""

    job: Job
    folder: RunFolder
    clock: Clock
    warnings: list[str]

    def notify(self, event: str, fields: dict[str, Any]) -> None:
        """Tell the client and log.jsonl; then see whether the job is still wanted."""
        self.folder.log(event, self.clock.now_ns(), fields)
        self.job.emit(event, fields)
        self.job.look_for_cancel()

    def warn(self, text: str) -> None:
        """Keep a warning for the manifest."""
        self.warnings.append(text)
