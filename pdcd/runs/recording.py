"""A wish for a run folder of what a stream sees right now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdcd.protocol.result import CaptureResult
from pdcd.runs.place import HeldFolder


@dataclass(frozen=True)
class RecordOrder:
    """Make a run of the newest set of photos. place : where its folder is made; None: where the
    configuration says. done : takes how that ended, in the thread of the engine."""

    job: str
    place: HeldFolder | None
    done: Callable[[CaptureResult], object]
