"""One calibration on a rig, from its first photo to the folder it ends in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pdcd.bench.calibration import MeasuredValue, PhotoRecord
from pdcd.bench.devices import CameraInfo, CameraSettings
from pdcd.bench.exposure_time import describe_time_conflict, planned_open_s
from pdcd.bench.measured import choose_calibration_folder
from pdcd.bench.tables import Config
from pdcd.calibration.script import UserPrompt
from pdcd.calibration.steps import METER, order_steps
from pdcd.capture.exposure import RigExposure
from pdcd.capture.keeping import (
    CalibrationKeeper,
    PreviousCalibration,
    describe_reused_steps,
    find_reusable_steps,
    read_previous_calibration,
)
from pdcd.capture.rig import Rig
from pdcd.capture.worker.calibrating import CalibrationStart, NextPhoto, OperatorTask, StepResult
from pdcd.capture.worker.proxy import WorkerProxy
from pdcd.capture.worker.worker import Worker
from pdcd.errors import Cancelled, DeviceLost, PhotoError, SyncError
from pdcd.panels.balance import measure_still_level
from pdcd.protocol import events
from pdcd.protocol.events import Emit, Event, to_log_entry
from pdcd.protocol.request import CalibrateRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import RunFolder
from pdcd.runs.provenance import format_utc_now
from pdcd.sensor.profile import SensorProfile
from pdcd.watch import Watch
from pdcd.words import SubjectName

FOLDERS = ("raw", "preview")
"""Folders inside a calibration folder."""
_SUBJECTS: Mapping[SubjectName, str] = MappingProxyType(
    {
        "card": "put a flat, matt, white card where the scene will be, so that it fills the "
        "projector's picture, and darken the room",
        "scene": "see that nothing in the scene moves, and darken the room",
    }
)
"""What a person has to do before it begins."""


@dataclass
class CalibrationRun:
    """Runs one calibration from beginning to end: photos, figures, folder.

    `proceed(text)` returns once somebody has done what the text asks. Raises what its devices and
    steps raise; the caller makes the rig safe.
    """

    config: Config
    rig: Rig
    profile: SensorProfile
    worker: WorkerProxy
    folder: RunFolder
    job: str
    request: CalibrateRequest
    emit: Emit
    cancelled: Callable[[], bool]
    proceed: Callable[[str], None]
    typed: Config | None = None
    keeper: CalibrationKeeper | None = None
    ended_whole: bool = False

    def execute(self) -> CaptureResult:
        """Take all photos, evaluate them, archive. Raises PdcdError; what its steps found until
        then is kept all the same, in a complete folder (`ended_whole`)."""
        camera, before = (
            self._camera(),
            read_previous_calibration(choose_calibration_folder(self.config)),
        )
        names = order_steps(self.request.steps, self.request.subject)
        over = find_reusable_steps(before, self.request, names)
        names = tuple(name for name in names if name not in over)
        note = "" if before is None or not over else describe_reused_steps(before, over)
        self.folder.create(min_free_bytes=self.config.limits.min_free_bytes)
        self.keeper = self._keeper(camera, before, over)
        step = METER
        try:
            self._begin(camera, before, names)
            for number, step in enumerate((METER, *names)):
                self._step(step, number, len(names), note if not number else "")
            self._notify(events.PicturesArchived(job=self.job))
        except Exception as err:
            self.ended_whole = self.keeper.end_early(step, err)
            raise
        sha256 = self.keeper.finish("done")
        self.ended_whole = True
        return self._result(self.keeper, sha256, note)

    @property
    def kept(self) -> tuple[str, ...]:
        """Steps whose values are kept, without those taken over."""
        return () if self.keeper is None else self.keeper.names

    def _keeper(
        self, camera: CameraInfo, before: PreviousCalibration | None, over: dict[str, str]
    ) -> CalibrationKeeper:
        def write(below: str) -> dict[str, MeasuredValue]:
            return self.worker.do(self._watch(), Worker.measured, below)

        return CalibrationKeeper(
            self.config, self.typed or self.config, self.rig, self.profile, camera, self.folder,
            self.job, self.request, before, over, write,
        )  # fmt: skip

    def _begin(
        self, camera: CameraInfo, before: PreviousCalibration | None, steps: tuple[str, ...]
    ) -> None:
        """Tell the worker what is known, and ask for the subject to be put in place."""
        helped = self.request.attended or self.rig.mock
        subject, marks = self.request.subject, self.request.marks
        folder = None if before is None else before.folder
        begin = CalibrationStart(
            self.config, self.profile, camera, folder, helped, subject, marks, steps
        )
        self.worker.do(self._watch(), Worker.calibrate, begin, self.folder.path)
        if self.request.attended:
            self._ask(UserPrompt(_SUBJECTS[subject]))

    def _result(self, keeper: CalibrationKeeper, sha256: str, note: str) -> CaptureResult:
        steps = keeper.steps
        return CaptureResult(
            job=self.job,
            state="done",
            manifest_sha256=sha256,
            folder=str(self.folder.where),
            files=(*self.folder.files(),),
            summary={
                "verdict": keeper.verdict,
                "steps": len(steps),
                "photos": sum(len(step.photos) for step in steps),
                "computing_s": sum(step.seconds for step in steps),
            },
            warnings=(
                *([note] if note else []),
                *self.rig.display_warnings,
                *(f"{step.name}: {text}" for step in steps for text in step.advice),
                *(f"{name}: not used: {why}" for name, why in keeper.left_out.items()),
                *keeper.stale.values(),
            ),
            passed=keeper.verdict != "bad",
        )

    def _camera(self) -> CameraInfo:
        if self.rig.camera_info is None:
            raise DeviceLost("the rig is not open", device="camera", hint="start the engine first")
        return self.rig.camera_info

    def _step(self, name: str, number: int, count: int, note: str) -> None:
        """Run one step to its end, and keep what it found; the metering before all steps is
        reported as step 1."""
        self.rig.begin_photos()
        begun = events.StepBegun(step=name, number=max(number, 1), steps=count, note=note)
        self._notify(begun)
        wanted = self.worker.do(self._watch(), Worker.step, name, format_utc_now())
        while not isinstance(wanted, StepResult):
            if isinstance(wanted, OperatorTask):
                self._ask(wanted.ask)
                wanted = self.worker.do(self._watch(), Worker.answered)
            else:
                photo = self._photo(wanted)
                wanted = self.worker.do(self._watch(), Worker.photo, photo)
        step = wanted.step
        self.rig.recheck_photos()
        if self.keeper is not None:
            self.keeper.keep(wanted)
        self._notify(
            events.StepEnded(
                step=step.name,
                verdict=step.verdict,
                photos=len(step.photos),
                seconds=step.seconds,
                figures=step.figures,
                advice=step.advice,
            )
        )

    def _photo(self, wanted: NextPhoto) -> PhotoRecord:
        """Take one photo; a mock bench covers the lens itself where it should be covered."""
        self.rig.cover(wanted.covered)
        try:
            return self._exposed(wanted)
        finally:
            self.rig.cover(False)

    def _exposed(self, wanted: NextPhoto) -> PhotoRecord:
        """Expose; again where refreshes were missed or the photo was lost, and once more where the
        times of the exposure disagree. Raises SyncError when refreshes are missed too often,
        PhotoError when the last photo was lost, too."""
        settings = CameraSettings(wanted.iso, wanted.f_number if self._settable else None)
        number, spoilt, doubted = 0, 0, False
        while spoilt <= self.config.rig.retries:
            number += 1
            try:
                done = self._expose(wanted, settings)
            except (SyncError, PhotoError) as err:  # the display gave up, or the photo was lost
                if spoilt == self.config.rig.retries and isinstance(err, PhotoError):
                    raise
                cause, spoilt = err.message, spoilt + 1
            else:
                level = self._level(wanted, done)
                if level is None:
                    cause = f"{int(done.log.missed.sum())} refreshes were missed"
                    spoilt += 1
                else:
                    cause = self._doubt(wanted, done)
                    if not cause or doubted:  # the step says it, where it went on
                        self.folder.write_frames(wanted.name, wanted.frames, done.log)
                        return self._taken(wanted, done, level)
                    doubted = True
            name = self.folder.set_aside(wanted.name, number)
            self._notify(events.ShotDiscarded(shot=wanted.name, name=name, cause=cause))
        more = "rig.on_miss = 'flag' keeps photos in which nothing moves"
        if self.config.rig.on_miss != "abort":
            more = "this photo may miss none: leave its step out by naming the other steps"
        raise SyncError(
            f"photo {wanted.name} was spoilt {number} times: {cause}",
            device="display",
            hint=f"see that nothing else runs on this machine: pdcd timing; {more}",
        )

    def _level(self, wanted: NextPhoto, done: RigExposure) -> float | None:
        """Light of a photo over what was planned; None where missed refreshes spoilt it. Missed
        refreshes of black panels do no harm, and `on_miss` may allow them in a picture that stands
        still."""
        if not done.log.missed.any():
            return 1.0
        level = measure_still_level(wanted.frames, done.log, self.config.row_hz)
        strict = wanted.counted or self.config.rig.on_miss == "abort"
        return None if strict and level != 1.0 else level

    def _doubt(self, wanted: NextPhoto, done: RigExposure) -> str:
        """Which times of an exposure disagree, in words. The first photo also shows how the camera
        is held."""
        head = self.worker.do(self._watch(), Worker.head, self.folder.path, self._file(done))
        if self.keeper is not None and self.keeper.flip is None:
            self.keeper.flip = head.flip
        due_s = planned_open_s(done.settings, self.config, wanted.frames, done.log)
        return describe_time_conflict(due_s, done.open_s, head.exposure_s)

    def _file(self, done: RigExposure) -> str:
        return str(done.raw.path.relative_to(self.folder.path))

    def _expose(self, wanted: NextPhoto, settings: CameraSettings) -> RigExposure:
        return self.rig.expose(
            wanted.frames,
            settings,
            self.folder.path / "raw",
            wanted.name,
            notify=self._notify,
            progress=lambda frame, of, missed: self.emit(
                events.Progress(shot=wanted.name, frame=frame, frames=of, missed=missed)
            ),
            cancelled=self.cancelled,
            moving=wanted.moving,
        )

    @property
    def _settable(self) -> bool:
        return bool(self._camera().f_numbers)

    def _taken(self, wanted: NextPhoto, done: RigExposure, level: float) -> PhotoRecord:
        """The record of a photo."""
        log = done.log
        return PhotoRecord(
            name=wanted.name,
            raw=self._file(done),
            sha256=done.raw.sha256,
            size_bytes=done.raw.size_bytes,
            iso=wanted.iso,
            f_number=wanted.f_number,
            open_ns=done.open_ns,
            close_ns=done.close_ns,
            end_ns=(int(log.end_ns[0]), int(log.end_ns[1])),
            refreshes=len(log),
            missed=int(log.missed.sum()),
            mask_delay=log.mask_delay,
            source=log.source,
            verified=log.verified,
            planned_s=planned_open_s(done.settings, self.config, wanted.frames, log),
            level=level,
        )

    def _ask(self, ask: UserPrompt) -> None:
        if not self.request.attended:
            return
        self._notify(events.Attention(text=ask.text, now=ask.now, best=ask.best))
        self.proceed(ask.text)
        self._look_for_cancel()

    def _watch(self) -> Watch:
        def step(done: float, total: float) -> None:
            self.emit(events.DecodingProgress(done=done, total=total))

        return Watch(self._look_for_cancel, step)

    def _look_for_cancel(self) -> None:
        if self.cancelled():
            raise Cancelled("the calibration was cancelled", hint="the one before is still in use")

    def _notify(self, event: Event) -> None:
        self.folder.log(to_log_entry(event, self.rig.clock.now_ns()))
        self.emit(event)
        self._look_for_cancel()
