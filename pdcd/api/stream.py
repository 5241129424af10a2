"""A stream of pictures to loop over: `for picture in bench.stream("indirect")`.

Only the newest picture is kept: a slow reader gets that one when it asks, and memory stays level.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from pdcd.api.run import Run, open_run
from pdcd.errors import Cancelled, PdcdError, restore_error
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.stream import StreamedPicture, StreamFrame
from pdcd.runs.recording import RecordOrder, StreamListener

if TYPE_CHECKING:
    from pdcd.client import Client

_LOOK_S = 0.2
"""Time between two checks for a signal while waiting for a picture."""


@dataclass(frozen=True, eq=False)
class LivePicture:
    """A picture of a stream.

    image, sigma : (rows, cols, C) float64, means over cells and their standard deviation, in scene
    units, as in `pdcd.api.run.Run`. picture, picture_sigma : (h, w, C), a pixel for each of the
    camera's quads. told : all figures; the most useful ones are also attributes.
    """

    image: NDArray[np.floating]
    sigma: NDArray[np.floating]
    picture: NDArray[np.floating]
    picture_sigma: NDArray[np.floating]
    told: StreamFrame

    @property
    def number(self) -> int:
        """Number of the picture in the stream; spoilt photos are counted, too."""
        return self.told.number

    @property
    def latency_s(self) -> float:
        """Time from the end of its exposure until the picture was ready."""
        return self.told.latency_s

    @property
    def rate_hz(self) -> float:
        """Recent rate of pictures per second."""
        return self.told.rate_hz

    @property
    def late(self) -> int:
        """Refreshes that came late in its last photo, without harm to the codes."""
        return self.told.late

    @property
    def lost(self) -> int:
        """Number of spoilt photos of the stream so far; they give no pictures."""
        return self.told.lost

    @property
    def sigma_kind(self) -> str:
        """ "measured": `sigma` includes the error of the codes, measured by the newest photos;
        "sensor": it does not, as there are too few photos yet."""
        return self.told.sigma_kind

    @property
    def rms_sigma(self) -> float | None:
        """RMS of `sigma` over that of `image`."""
        return self.told.rms_sigma


class PictureStream(ABC):
    """Pictures without end; an iterator and a context manager, which ends the stream.

    The stream also ends when nothing holds this object any more. Panels are then black and the
    shutter is closed. The iterator ends with the stream's time, or raises the error that ended it.
    """

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> LivePicture:
        while True:
            streamed = self.take()
            if streamed is None:
                self.close()
                raise StopIteration
            if streamed.arrays:  # else a photo was spoilt
                return LivePicture(**streamed.arrays, told=streamed.frame)

    @abstractmethod
    def take(self) -> StreamedPicture | None:
        """Wait for the newest picture that was not taken yet, which may be a spoilt photo; None at
        the end. For callers that show figures. Raises the error that ended the stream."""

    @abstractmethod
    def record(self) -> Run:
        """Make a run folder of the newest set of photos. Pictures pause meanwhile. Raises the error
        if that fails."""

    @abstractmethod
    def close(self) -> None:
        """End the stream. Idempotent."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __del__(self) -> None:
        with suppress(AttributeError):  # a stream that did not begin
            self.close()


class LocalStream(PictureStream):
    """A stream of the rig in this process; a thread takes its photos."""

    def __init__(
        self, run: Callable[[StreamListener], CaptureResult], *, draw: bool = False
    ) -> None:
        """run : takes the stream and returns how it ended. draw : also draw pictures as JPEGs."""
        self._shared = _Shared()
        self._draw, shared = draw, self._shared
        self._thread = threading.Thread(
            target=shared.run, args=(run, draw), name="pdcd-stream-rig", daemon=True
        )
        self._thread.start()

    def take(self) -> StreamedPicture | None:
        """See `PictureStream.take`."""
        return self._shared.take()

    def record(self) -> Run:
        """See `PictureStream.record`."""
        made = threading.Event()
        results: list[CaptureResult] = []

        def done(result: CaptureResult) -> None:
            results.append(result)
            made.set()

        self._shared.records.append(RecordOrder(make_job_id(), None, done))
        while not made.wait(_LOOK_S):
            if not self._thread.is_alive():
                raise Cancelled("the stream ended before a run was made of it")
        return _open_recorded(results[0])

    def close(self) -> None:
        """See `PictureStream.close`."""
        self._shared.ends.set()
        self._thread.join()


class _Shared:
    """What the thread of a stream and its reader share; it refers to neither of them."""

    def __init__(self) -> None:
        self.ends = threading.Event()
        self.records: deque[RecordOrder] = deque()
        self._changed = threading.Condition()
        self._newest: StreamedPicture | None = None
        self._result: CaptureResult | None = None
        self._error: BaseException | None = None

    def run(self, run: Callable[[StreamListener], CaptureResult], draw: bool) -> None:
        """Take the stream to its end."""
        try:
            result = run(
                StreamListener(self._tell, self.ends.is_set, lambda: draw, self._next_record)
            )
            with self._changed:
                self._result = result
                self._changed.notify_all()
        except BaseException as err:
            with self._changed:
                self._error = err
                self._changed.notify_all()

    def take(self) -> StreamedPicture | None:
        """Wait for the newest picture; None at the end. Raises the error that ended the stream."""
        with self._changed:
            while self._newest is None and self._result is None and self._error is None:
                self._changed.wait(_LOOK_S)
            if self._error is not None:
                raise self._error
            newest, self._newest = self._newest, None
            if newest is None and self._result is not None:
                _raise_failure(self._result)
            return newest

    def _tell(self, streamed: StreamedPicture) -> None:
        with self._changed:
            self._newest = streamed
            self._changed.notify_all()

    def _next_record(self) -> RecordOrder | None:
        return self.records.popleft() if self.records else None


class ConnectedStream(PictureStream):
    """A stream of the bench of a daemon."""

    def __init__(self, client: Client, job: str, picture: str = "arrays") -> None:
        """picture : which form of pictures is wanted, as for `Client.see_stream`."""
        self._client: Client | None = client
        self._job, self._after, self._picture = job, 0, picture

    def take(self) -> StreamedPicture | None:
        """See `PictureStream.take`."""
        if self._client is None:
            return None
        try:
            streamed = self._client.see_stream(self._job, self._after, self._picture)
        except Cancelled:
            return None
        self._after = streamed.number
        return streamed

    def record(self) -> Run:
        """See `PictureStream.record`."""
        if self._client is None:
            raise Cancelled("the stream has ended")
        return _open_recorded(self._client.record_stream(self._job))

    def close(self) -> None:
        """See `PictureStream.close`."""
        client, self._client = self._client, None
        if client is not None:
            with suppress(PdcdError, ConnectionError):
                client.cancel(self._job)


def _raise_failure(result: CaptureResult) -> None:
    """Raise the error that ended a stream; do nothing if it was ended on request."""
    if result.state == "failed":
        raise restore_error(result.error)


def _open_recorded(result: CaptureResult) -> Run:
    if result.state != "done" or result.folder is None:
        raise restore_error(result.error)
    return open_run(Path(result.folder))
