"""The listener of a stream, and its orders for run folders of the newest photos."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamedPicture
from pdcd.runs.place import HeldFolder


@dataclass(frozen=True)
class RecordOrder:
    """An order to make a run of the newest set of photos. place : where its folder is made; None:
    where the configuration says. done : takes the result, in the engine's thread."""

    job: str
    place: HeldFolder | None
    done: Callable[[CaptureResult], object]


@dataclass(frozen=True)
class StreamListener:
    """The listener of a stream. tell : takes each picture, in a thread of its own. cancelled :
    whether the stream is to end, called in any thread. draws : whether pictures are also drawn for
    viewing. next_record : the next order for a run folder, None where there is none."""

    tell: Callable[[StreamedPicture], object]
    cancelled: Callable[[], bool]
    draws: Callable[[], bool] = lambda: False
    next_record: Callable[[], RecordOrder | None] = lambda: None
