"""Who wants a stream, and wishes for run folders of what it sees right now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamedPicture
from pdcd.runs.place import HeldFolder


@dataclass(frozen=True)
class RecordOrder:
    """Make a run of the newest set of photos. place : where its folder is made; None: where the
    configuration says. done : takes how that ended, in the thread of the engine."""

    job: str
    place: HeldFolder | None
    done: Callable[[CaptureResult], object]


@dataclass(frozen=True)
class StreamListener:
    """Who wants a stream. tell : takes each picture, in a thread of its own. cancelled : whether
    it is to end, asked in any thread. draws : whether pictures are to be drawn for eyes, too.
    next_record : the next wish for a run folder, None where there is none."""

    tell: Callable[[StreamedPicture], object]
    cancelled: Callable[[], bool]
    draws: Callable[[], bool] = lambda: False
    next_record: Callable[[], RecordOrder | None] = lambda: None
