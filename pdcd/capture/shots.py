"""Photos of a job: each is exposed, and taken again where codes got unequal light, or where its
times disagree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import PurePath

import msgspec
import numpy as np

from pdcd.bench.devices import RawFile
from pdcd.bench.exposure_time import describe_time_conflict, planned_open_s
from pdcd.bench.stops import refuse_other_settings
from pdcd.bench.tables import Config
from pdcd.capture.bench_check import FrameCheck
from pdcd.capture.exposure import RigExposure
from pdcd.capture.job import Journal
from pdcd.capture.rig import Rig
from pdcd.capture.worker.answers import AuxiliaryPhoto, PhotoOrder, PhotoOutcome, SpoiltPhoto
from pdcd.capture.worker.proxy import WorkerProxy
from pdcd.capture.worker.worker import Worker
from pdcd.errors import ExposureError, PhotoError, SyncError
from pdcd.panels.balance import count_lit_weights
from pdcd.panels.frames import FrameLog, Frames
from pdcd.protocol import events
from pdcd.runs.record import FileRecord, ShotRecord
from pdcd.words import KeepRawName


@dataclass(frozen=True, eq=False)
class TakenShot:
    """A shot as last taken: its record, and its rows of frames.csv."""

    record: ShotRecord
    frames: Frames
    log: FrameLog


@dataclass
class ShotTaker:
    """Takes the photos of one job, one after the other, into its run folder."""

    config: Config
    rig: Rig
    worker: WorkerProxy
    journal: Journal
    check: FrameCheck
    keep: KeepRawName = "all"
    held: dict[str, FileRecord] = field(default_factory=dict)
    """Photos in memory, by the path that their files would have below the run folder."""
    last: dict[str, bytes | None] = field(default_factory=dict)
    """RAW files of the last shot, with the contents of those that are only in memory."""
    shown: dict[str, TakenShot] | None = None
    """Receives all shots by name, where the caller needs their logs."""

    def take(self, wanted: PhotoOrder) -> PhotoOutcome:
        """Take a photo that was ordered. Returns `SpoiltPhoto` where it cannot be had and the run
        can do without it.

        Raises SyncError when any other photo was spoilt too often, and what its devices raise.
        """
        if wanted.kind == "shot":
            return self._shot(wanted)
        refused = self.rig.refusal(wanted.frames) if wanted.kind == "look" else None
        if refused is not None:
            return SpoiltPhoto(refused)
        try:
            done = self._tested(wanted)
        except SyncError as err:
            if wanted.kind in ("dark", "look"):
                return SpoiltPhoto(err.message)
            raise
        return AuxiliaryPhoto(
            tuple((self._file(plane), plane.sha256) for plane in done.planes), done.open_s
        )

    def _shot(self, wanted: PhotoOrder) -> tuple[ShotRecord, ...]:
        """Expose, write the frame log, check for missed refreshes. With two buckets, also returns
        the shot of the second one."""
        done, level, harm = self._sound(wanted)
        folder, log = self.journal.folder, done.log
        folder.write_frames(wanted.name, wanted.frames, log)
        self._warn(wanted.name, log, level, harm)
        first, *others = make_shot_records(
            wanted, done, level, self._planned_s(wanted, done), self._file
        )
        self.last = {self._file(plane): done.held.get(plane.path.name) for plane in done.planes}
        self.journal.ledger.take(first)
        for record, (name, frames) in zip(others, wanted.beside, strict=True):
            folder.write_frames(name, frames, log)
            self.journal.ledger.take(record)
        if self.shown is not None:
            shown = {wanted.name: wanted.frames, **dict(wanted.beside)}
            for one in (first, *others):
                self.shown[one.name] = TakenShot(one, shown[one.name], log)
        return (first, *others)

    def _warn(self, name: str, log: FrameLog, level: float | None, harm: str) -> None:
        lost = int(log.missed.sum())
        if level is None:
            self.journal.warn(f"shot {name}: {lost} refreshes were missed; {harm}")
        elif lost:
            self.journal.warn(
                f"shot {name}: {lost} refreshes were missed, without harm to the codes"
            )
        if not log.verified:
            self.journal.warn(f"shot {name}: presentation times are not verified")

    def _sound(self, wanted: PhotoOrder) -> tuple[RigExposure, float | None, str]:
        """Expose; again where codes got unequal light or the photo was lost, as often as the rig
        allows; once more where the times of the exposure disagree.

        Returns the exposure, its level (see `ShotRecord`), and the harm that was done. Raises
        SyncError, and PhotoError where the last photo was lost.
        """
        rig, folder, shot = self.config.rig, self.journal.folder, wanted.name
        number, spoilt, doubted = 0, 0, False
        while spoilt <= rig.retries:
            number += 1
            try:
                done, doubt = self._expose(wanted)
            except (SyncError, PhotoError) as err:
                if rig.on_miss == "flag" and isinstance(err, SyncError):
                    raise
                if spoilt == rig.retries and isinstance(err, PhotoError):
                    raise
                cause, spoilt = err.message, spoilt + 1
                name = self._set_aside(shot, number)
            else:
                level, harm = measure_code_level(wanted.frames, done.log, self.config.row_hz)
                sound = level == 1.0 if wanted.even else level is not None
                if sound or rig.on_miss == "flag":
                    if not doubt or doubted:
                        if doubt:
                            self.journal.warn(f"shot {shot}: {doubt}")
                        return done, level, harm
                    cause, doubted = doubt, True
                else:
                    cause = f"{int(done.log.missed.sum())} refreshes were missed; {harm}"
                    spoilt += 1
                name = self._set_aside(shot, number)
                folder.write_frames(name, wanted.frames, done.log)
            self.journal.notify(events.ShotDiscarded(shot=shot, name=name, cause=cause))
            self.journal.warn(f"shot {shot}: exposure {number} was discarded: {cause}")
        raise SyncError(
            f"shot {shot} was spoilt {rig.retries + 1} times: {cause}",
            device="display",
            hint="see frames.csv; rig.on_miss = 'flag' keeps such shots and reports the error",
        )

    def _tested(self, wanted: PhotoOrder) -> RigExposure:
        """Take a test exposure or a dark photo; again where the display gave up or the photo was
        lost, as often as the rig allows; once more where the times of the exposure disagree. Raises
        SyncError, PhotoError."""
        rig, shot = self.config.rig, wanted.name
        number, spoilt, doubted = 0, 0, False
        while True:
            number += 1
            try:
                done, cause = self._expose(wanted)
            except (SyncError, PhotoError) as err:
                flagged = rig.on_miss == "flag" and isinstance(err, SyncError)
                if flagged or spoilt == rig.retries:
                    raise
                cause, spoilt = err.message, spoilt + 1
            else:
                if not cause or doubted:
                    if cause:
                        self.journal.warn(f"photo {shot}: {cause}")
                    return done
                doubted = True
            aside = self._set_aside(shot, number)
            self.journal.notify(events.ShotDiscarded(shot=shot, name=aside, cause=cause))

    def _planned_s(self, wanted: PhotoOrder, done: RigExposure) -> float:
        return planned_open_s(done.settings, self.config, wanted.frames, done.log)

    def _expose(self, wanted: PhotoOrder) -> tuple[RigExposure, str]:
        """Take one exposure; returns it, and which of its times disagree, in words."""

        def progress(frame: int, of: int, missed: int) -> None:
            told = events.Progress(shot=wanted.name, frame=frame, frames=of, missed=missed)
            self.journal.job.emit(told)

        done = self.rig.expose(
            wanted.frames,
            wanted.settings,
            self.journal.folder.path / "raw",
            wanted.name,
            notify=self.journal.notify,
            progress=progress,
            cancelled=self.journal.job.cancelled,
            hold=self.keep != "all",
        )
        held = {}
        for plane in done.planes:
            if plane.path.name in done.held:
                path = self._file(plane)
                held[path] = done.held[plane.path.name]
                self.held[path] = FileRecord(plane.sha256, plane.size_bytes)
        # Decode it at once: if it cannot be read, every further exposure would be for nothing.
        file, watch = self._file(done.raw), self.journal.job.watch()
        head = self.worker.do(watch, Worker.look, file, done.raw.sha256, held)
        self.check.saw(file, head)
        said = head.iso, head.f_number
        refuse_other_settings(file, said, wanted.settings.iso, wanted.f_number)
        doubt = describe_time_conflict(self._planned_s(wanted, done), done.open_s, head.exposure_s)
        return done, doubt

    def _set_aside(self, shot: str, number: int) -> str:
        """Rename the photo of an exposure that is to be taken again; returns the new name."""
        name = self.journal.folder.set_aside(shot, number)
        for path in [path for path in self.held if PurePath(path).stem == shot]:
            self.held[str(PurePath(path).with_stem(name))] = self.held.pop(path)
        return name

    def _file(self, raw: RawFile) -> str:
        """Path of a RAW file in the run folder."""
        return str(raw.path.relative_to(self.journal.folder.path))


def make_shot_records(
    wanted: PhotoOrder,
    done: RigExposure,
    level: float | None,
    planned_s: float,
    file: Callable[[RawFile], str],
) -> tuple[ShotRecord, ...]:
    """The records of an exposure: its shot, and those of its other buckets. file : path of a RAW
    file in the run folder. Raises ExposureError where there is no second bucket."""
    log = done.log
    first = ShotRecord(
        name=wanted.name,
        window=wanted.window,
        raw=file(done.raw),
        sha256=done.raw.sha256,
        size_bytes=done.raw.size_bytes,
        iso=wanted.settings.iso,
        f_number=wanted.f_number,
        open_ns=done.open_ns,
        close_ns=done.close_ns,
        end_ns=(int(log.end_ns[0]), int(log.end_ns[1])),
        refreshes=len(log),
        missed=int(log.missed.sum()),
        source=log.source,
        verified=log.verified,
        planned_s=planned_s,
        level=level,
    )
    plane = done.raw.second
    if wanted.beside and plane is None:
        raise ExposureError(
            "the camera gave one plane of an exposure",
            device="camera",
            hint="set camera.buckets to 1, or use a driver of a sensor that has two",
        )
    others = [
        msgspec.structs.replace(
            first, name=name, raw=file(plane), sha256=plane.sha256, size_bytes=plane.size_bytes
        )
        for name, _ in wanted.beside
        if plane is not None
    ]
    return (first, *others)


def measure_code_level(frames: Frames, log: FrameLog, row_hz: float) -> tuple[float | None, str]:
    """How long every code was shown, over what was planned, None where codes differ; and the same
    in words."""
    try:
        weights = count_lit_weights(frames, log, row_hz)
    except SyncError as err:
        return None, err.message
    shares = weights.realised / weights.planned if weights.planned.size else np.ones(1)
    words = f"codes were lit {shares.min():.3g} to {shares.max():.3g} times as long as planned"
    return weights.level or None, words
