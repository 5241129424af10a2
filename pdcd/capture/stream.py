"""A stream: one plan, its photos again and again, each picture reported as soon as it is ready.

It begins as any capture does, with its metering and a first set of photos, which are held in
memory. Then the rig takes the next part of the set, over and over, in its own thread, while a
second thread has the worker decode the photo before. Where decoding is slower the rig waits for it:
no photo is skipped, and memory does not grow.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import RawFile
from pdcd.bench.exposure_time import planned_open_s
from pdcd.bench.tables import Config
from pdcd.capture.exposure import RigExposure
from pdcd.capture.job import EngineJob
from pdcd.capture.live_frame import PictureRate
from pdcd.capture.rig import Rig
from pdcd.capture.shots import TakenShot, make_shot_records, measure_code_level
from pdcd.capture.worker.answers import PhotoOrder
from pdcd.capture.worker.proxy import WorkerProxy
from pdcd.capture.worker.rolling import RollingPicture, StreamPhoto, StreamRound
from pdcd.capture.worker.worker import Worker
from pdcd.errors import Cancelled, DecodeError, ExposureError, PhotoError, SyncError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import MAX_RAW_BYTES, read_file
from pdcd.protocol.events import Event, ShutterClosed
from pdcd.protocol.stream import StreamedPicture, StreamFrame, StreamRequest
from pdcd.runs.recording import RecordOrder, StreamListener
from pdcd.watch import Watch

logger = logging.getLogger(__name__)

_MOST_HZ = 30.0
"""Most pictures per second where the request does not say: nobody sees more."""
_MOST_SPOILT = 3
"""Spoilt photos in a row that end a stream."""
_LOOK_S = 0.05
"""Time between two checks for a cancel."""
_ENDING_S = 5.0
"""How long the worker may take for its last photo, with the panels black already."""


@dataclass(frozen=True, eq=False)
class _Photographed:
    """A photo for the worker, or why there is none. last : whether it is the last of its round."""

    photo: StreamPhoto | None
    spoilt: str
    part: int
    last: bool
    late: int
    closed_s: float


@dataclass
class _Counter:
    """Figures of the pictures so far."""

    number: int = 0
    lost: int = 0
    in_row: int = 0
    rate: PictureRate = field(default_factory=PictureRate)


class PictureMaker:
    """Has the worker make pictures in a thread of its own, one photo after the other."""

    def __init__(self, worker: WorkerProxy, goal: str, listener: StreamListener) -> None:
        self._worker, self._goal, self._listener = worker, goal, listener
        self._photos: queue.Queue[_Photographed | None] = queue.Queue()
        self._ends, self._begun = threading.Event(), threading.Event()
        self._failed: BaseException | None = None
        self._counter = _Counter()
        self._begun_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="pdcd-stream", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def count(self) -> int:
        """Pictures and spoilt photos so far."""
        return self._counter.number

    @property
    def seen_s(self) -> float:
        """How long ago the first picture came; 0 before it."""
        return 0.0 if self._begun_s is None else time.monotonic() - self._begun_s

    def give(self, photo: _Photographed, look: Callable[[], None]) -> None:
        """Hand a photo over; after the last photo of a picture, return once the worker has begun
        it, because photos taken earlier would only wait longer. `look` is called meanwhile and may
        raise. Raises the error of the work."""
        self._photos.put(photo)
        while photo.last and not self._photos.empty():
            look()
            self._raise()
            self._begun.wait(_LOOK_S)
            self._begun.clear()

    def drain(self, look: Callable[[], None]) -> None:
        """Wait until all photos handed over are decoded: then the worker is free."""
        while self._photos.unfinished_tasks:
            look()
            self._raise()
            self._ends.wait(0.005)

    def end(self) -> None:
        """Stop, whatever is not decoded yet. Idempotent."""
        self._ends.set()
        self._photos.put(None)
        if self._thread.ident is not None:
            self._thread.join(_ENDING_S)

    def _raise(self) -> None:
        if self._failed is not None:
            raise self._failed

    def _alive(self) -> None:
        if self._ends.is_set():
            raise Cancelled("the stream has ended")

    def _run(self) -> None:
        try:
            while (photo := self._photos.get()) is not None and not self._ends.is_set():
                self._begun.set()
                try:
                    self._make(photo)
                finally:
                    self._photos.task_done()
        except BaseException as err:  # it is raised where photos are taken
            self._failed = err

    def _make(self, given: _Photographed) -> None:
        """Decode a photo, and report its picture. Raises what ends the stream."""
        watch, cause, made = Watch(self._alive), given.spoilt, None
        if given.photo is not None:
            part = given.part if given.last else None
            draw = self._listener.draws()
            found = self._worker.do(watch, Worker.see, given.photo, part, draw=draw)
            cause, made = (found, None) if isinstance(found, str) else ("", found)
        now_s, counter = time.monotonic(), self._counter
        counter.in_row = counter.in_row + 1 if cause else 0
        if cause:
            counter.lost += 1
        elif made is None:
            return
        counter.number += 1
        told = StreamFrame(
            number=counter.number,
            t_mono_ns=time.monotonic_ns(),
            goal=self._goal,
            spoilt=cause,
            lost=counter.lost,
            latency_s=max(0.0, now_s - given.closed_s),
            part=given.part,
            late=given.late,
        )
        frame = told if made is None else _with_figures(told, made, counter.rate.count(now_s))
        if made is not None and self._begun_s is None:
            self._begun_s = now_s
        self._listener.tell(StreamedPicture(frame, {} if made is None else _arrays_of(made)))
        if counter.in_row >= _MOST_SPOILT:
            raise ExposureError(
                f"{counter.in_row} photos in a row were spoilt: {cause}",
                hint="see what the panels and the camera do: pdcd doctor; or take a capture, which "
                "keeps the photos that were spoilt",
            )


def _arrays_of(made: RollingPicture) -> dict[str, NDArray[np.floating]]:
    names = ("image", "sigma", "picture", "picture_sigma")
    return {name: getattr(made, name) for name in names}


def _with_figures(told: StreamFrame, made: RollingPicture, rate_hz: float) -> StreamFrame:
    return msgspec.structs.replace(
        told,
        rate_hz=rate_hz,
        over=made.over,
        rms_sigma=made.rms_sigma,
        sigma_kind=made.kind,
        unknown=made.unknown,
        jpeg=made.jpeg,
        size_px=made.size_px,
    )


class StreamTaker:
    """Takes the photos of a stream, and keeps the newest of each shot in case a run is wanted."""

    def __init__(
        self,
        config: Config,
        rig: Rig,
        job: EngineJob,
        request: StreamRequest,
        rounds: tuple[StreamRound, ...],
        folder: Path,
        first: Mapping[str, TakenShot],
    ) -> None:
        """rounds : what is taken, one after the other, and then from the first one again. folder :
        where the first set of photos was taken; `first` are its shots by name."""
        self._config, self._rig, self._job = config, rig, job
        self._request, self._rounds, self._folder = request, rounds, folder
        self._taken = {name: [shot] for name, shot in first.items()}
        """The last few of each shot: it is not known yet whether the newest is sound."""
        self._again = False
        self._closed_s = 0.0

    def run(
        self,
        maker: PictureMaker,
        next_record: Callable[[], RecordOrder | None],
        record: Callable[[RecordOrder, Mapping[str, TakenShot]], None],
    ) -> None:
        """Take photos until the time is over; a cancel or an error is raised.

        record : makes a run of some of these photos, given by their SHA-256, while the worker does
            nothing else.
        """
        due_s, step_s = 0.0, 1.0 / (self._request.rate_hz or _MOST_HZ)
        last_s = self._request.for_s

        def ended() -> bool:
            return last_s is not None and maker.seen_s >= last_s

        for round_ in cycle(self._rounds):
            if self._wait_until(due_s, ended):
                return
            due_s = max(due_s, time.monotonic() - step_s) + step_s
            for photographed in self._take_round(round_):
                maker.give(photographed, self._job.look_for_cancel)
            while (order := next_record()) is not None:
                maker.drain(self._job.look_for_cancel)
                shots = (shot for taken in self._taken.values() for shot in taken)
                record(order, {shot.record.sha256: shot for shot in shots})
                self._again = False

    def _wait_until(self, due_s: float, ended: Callable[[], bool]) -> bool:
        """Wait until the next picture is due, checking for a cancel now and then; returns whether
        the stream ended before."""
        while not ended():
            self._job.look_for_cancel()
            left_s = due_s - time.monotonic()
            if left_s <= 0.0:
                return False
            time.sleep(min(left_s, _LOOK_S))
        return True

    def _take_round(self, round_: StreamRound) -> Iterator[_Photographed]:
        """The photos of a picture; a spoilt one ends the round."""
        *_, last = round_.photos
        for order in round_.photos:
            photo, cause, late = self._take(order)
            end = order is last
            yield _Photographed(photo, cause, round_.part, end, late, self._closed_s)
            if cause:
                return

    def _take(self, order: PhotoOrder) -> tuple[StreamPhoto | None, str, int]:
        """Take one photo. Returns it, or why there is none; and the number of late refreshes."""
        self._closed_s = time.monotonic()
        try:
            done = self._rig.expose(
                order.frames,
                order.settings,
                self._folder / "raw",
                order.name,
                notify=self._hear,
                progress=lambda *_: None,
                cancelled=self._job.cancelled,
                hold=True,
                again=self._again,
            )
        except (SyncError, PhotoError) as err:
            self._again = False
            self._clear(order.name)
            return None, err.message, 0
        self._again = True
        held = self._hold(done)
        level, harm = measure_code_level(order.frames, done.log, self._config.row_hz)
        late = int(done.log.missed.sum())
        sound = level == 1.0 if order.even else level is not None
        if not sound and self._config.rig.on_miss != "flag":
            self._rig.forget_photo(done.raw.sha256)
            return None, f"{late} refreshes were missed; {harm}", late
        planned_s = planned_open_s(done.settings, self._config, order.frames, done.log)
        records = make_shot_records(order, done, level, planned_s, self._file)
        frames = {order.name: order.frames, **dict(order.beside)}
        for shot in records:
            taken = self._taken.setdefault(shot.name, [])
            taken.append(TakenShot(shot, frames[shot.name], done.log))
            for old in taken[: -_MOST_SPOILT - 1]:
                self._rig.forget_photo(old.record.sha256)
            del taken[: -_MOST_SPOILT - 1]
        return StreamPhoto(records, done.log, held), "", late

    def _hear(self, event: Event) -> None:
        if isinstance(event, ShutterClosed):
            self._closed_s = time.monotonic()
        self._job.look_for_cancel()

    def _hold(self, done: RigExposure) -> dict[str, bytes]:
        """Contents of the files of an exposure, which are removed from the disk. Raises
        DecodeError."""
        held = {}
        for plane in done.planes:
            name = plane.path.name
            if name in done.held:
                held[self._file(plane)] = done.held[name]
                continue
            try:
                held[self._file(plane)] = read_file(plane.path, MAX_RAW_BYTES)
            except UnsoundFileError as err:
                raise DecodeError(f"cannot read {name}: {err.why}", hint=err.hint) from err
            plane.path.unlink()
        return held

    def _clear(self, name: str) -> None:
        """Remove all files of a spoilt exposure."""
        for path in (self._folder / "raw").glob(f"{name}.*"):
            path.unlink(missing_ok=True)

    def _file(self, raw: RawFile) -> str:
        return str(raw.path.relative_to(self._folder))
