"""The worker: it computes a job's plan, its next photo and its pictures; it touches no device.

Everything here takes long, or reads bytes that came from elsewhere. So the daemon has it done in a
process of its own (`pdcd.capture.worker.spawned`); others call it directly
(`pdcd.capture.worker.proxy`). It keeps what it needs between two calls, above all the plan
(`pdcd.capture.worker.plan_owner`), and returns only what the caller must know.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from pdcd.bench.calibration import MeasuredValue, PhotoRecord
from pdcd.bench.devices import CameraInfo
from pdcd.capture.worker.answers import (
    AdoptedPlan,
    DevelopedRun,
    Order,
    PhotoOutcome,
    PlannedRun,
    RigFacts,
    make_developed_run,
)
from pdcd.capture.worker.plan_owner import Course, PlannedJob
from pdcd.errors import PdcdError
from pdcd.pages.render import load_template
from pdcd.pages.report.material import gather_material, is_cheap
from pdcd.pages.report.write import TEMPLATE, write_gathered_report
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import write_pictures
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.truth import KnownAnswer, find_known_answer, write_known_answer
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.grey import list_grey_warnings
from pdcd.planning.make import plan_request
from pdcd.probing.deviation import Deviation
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import Given
from pdcd.runs.folder import read_manifest
from pdcd.runs.record import RunRecord, ShotRecord
from pdcd.sensor.raw import RawHead, read_raw_head
from pdcd.watch import Watch

if TYPE_CHECKING:
    from pdcd.capture.worker.calibrating import CalibrationStart, CalibrationStudy, Next
    from pdcd.capture.worker.rolling import (
        RollingPicture,
        StreamCourse,
        StreamPhoto,
        StreamRound,
    )


_Finished = tuple[Path, RunRecord, DecodedRun, KnownAnswer | None, dict[str, Deviation]]
"""Folder, record and pictures of a run that is to get a page, its truth and its matrices."""


class Worker:
    """Works on one job after the other; `plan` begins a new one, `forget` ends it.

    Every method takes a `Watch`, which hears of the work and may end it.
    """

    def __init__(self, facts: RigFacts) -> None:
        self._facts = facts
        self._job: PlannedJob | None = None
        self._course: Course | None = None
        self._decoded = False
        """Whether the first photo of the course could be decoded."""
        self._study: CalibrationStudy | None = None
        self._stream: StreamCourse | None = None
        self._kept: tuple[Path, Darkroom] | None = None
        """Folder and photos of a stream that are to become a run."""
        self._finished: _Finished | None = None

    def plan(
        self,
        watch: Watch,
        request: CaptureRequest,
        given: Given,
        camera: CameraInfo | None,
        mask_lag_s: float | None,
    ) -> PlannedRun:
        """Plan a request; what was kept of the previous job is forgotten.

        `camera` may be None where the request needs no search (`is_search_needed`) and no pictures
        will be made. `given` holds the request's arrays. Raises RequestError.
        """
        self.forget(watch)
        self._study = None
        facts = self._facts
        watch.stage = "codes"
        config, grid = facts.config, facts.grid
        if not is_search_needed(request):
            plan = plan_request(request, config, grid, camera, mask_lag_s, given, watch)
        elif camera is None:
            raise PdcdError("a plan by error or time needs to know the camera")
        else:
            from pdcd.planning.choose import choose_plan  # no plain capture waits for a search
            from pdcd.planning.predict import RigSetting

            setting = RigSetting(facts.config, camera, facts.profile, mask_lag_s)
            known = facts.scene if facts.scene and facts.scene.grid == facts.grid else None
            plan = choose_plan(request, setting, facts.grid, known, given, watch)
        self._job = PlannedJob(request, camera, plan)
        return PlannedRun(
            summary=plan.summary(config.limits.max_exposure_s),
            iso=plan.iso,
            cut=plan.cut,
            warnings=tuple(list_grey_warnings(plan.patterns.values(), config)),
        )

    def begin(self, watch: Watch, folder: Path) -> AdoptedPlan:
        """Store the codes of the plan in a run folder; shots will lie there, too.

        Raises NoSpaceError, or DiskError for any other refusal of the disk.
        """
        if self._job is None:
            raise PdcdError("there is no plan to work on")
        self._course, self._decoded = Course(self._facts, self._job, folder), False
        return self._course.adopted()

    def next_exposure(self, watch: Watch, taken: PhotoOutcome) -> Order:
        """Go on after what was `taken`: what to report and to keep, and what to expose next. Raises
        DecodeError for a photo that cannot be read, ConfigError where the camera cannot do it."""
        return self._of_course().next_exposure(watch, taken)

    def look(
        self, watch: Watch, raw: str, sha256: str, held: Mapping[str, bytes] = MappingProxyType({})
    ) -> RawHead:
        """Size, orientation and camera of a photo that has just come. The first photo is decoded,
        because photos in a format that cannot be decoded are not worth taking.

        raw : path below the run folder. held : contents of the files of its planes, by path, where
            these are only in memory. Raises DecodeError.
        """
        shelf = self._of_course().shelf
        for path in {raw, *held}:
            shelf.hold(path, held.get(path))
        if not self._decoded:
            shelf.read(raw, sha256=sha256)
            self._decoded = True
        return shelf.read_head(raw, sha256=sha256)

    def develop(self, watch: Watch, *, report: bool = False) -> DevelopedRun:
        """Make all pictures and write them into the run folder. The job is then forgotten, except
        for what a `report` needs, where one is wanted and quick. After `keep`, the pictures are of
        what was kept, and the job goes on.

        Raises DecodeError, NoSpaceError.
        """
        course, facts = self._of_course(), self._facts
        if report:
            load_template(TEMPLATE)
        kept, self._kept = self._kept, None
        folder, darkroom = kept or (course.folder, course.darkroom)
        plan = course.plan
        decoded = darkroom.decoded(watch)
        warnings = write_pictures(folder, decoded)
        record = darkroom.record
        windows = [plan.window_of(shot) for shot in plan.recipe.shots]
        known = find_known_answer(
            facts.config, facts.scene, plan.recipe, windows, record.cells, watch,
            colours=len(record.responsivity_e),
        )  # fmt: skip
        errors: tuple[float | None, float | None] = (None, None)
        if known is not None:
            errors = known.rms_errors(decoded.answer, decoded.cell_means, decoded.cells)
            write_known_answer(folder, known)
        done = make_developed_run(record, decoded, errors, warnings, watch, facts.scene)
        if kept is None:
            self.forget(watch)
        if report and is_cheap(record, decoded):
            self._finished = folder, record, decoded, known, done.deviations
        return replace(done, decided=course.decided)

    def report(self, watch: Watch) -> str | None:
        """Write the page of the run that was developed last, whose folder is finished; returns its
        name in the folder, or None where it would take too long. Raises DiskError and
        DecodeError."""
        finished, self._finished = self._finished, None
        if finished is None:
            return None
        folder, record, decoded, known, deviations = finished
        material = gather_material(folder, record, decoded, known, deviations)
        return write_gathered_report(folder, read_manifest(folder), material).name

    def forget(self, watch: Watch) -> None:
        """Forget all of the job."""
        self._job = self._course = self._finished = self._stream = self._kept = None

    def roll(self, watch: Watch, over: int) -> tuple[StreamRound, ...]:
        """Go on with the photos of a finished course, again and again; returns what to take, round
        after round. over : how many of the newest parts make a picture. Raises DecodeError."""
        from pdcd.capture.worker.rolling import StreamCourse  # no capture waits for it

        self._stream = StreamCourse(self._of_course(), over, watch)
        return self._stream.rounds

    def see(
        self, watch: Watch, photo: StreamPhoto, part: int | None, *, draw: bool
    ) -> RollingPicture | str | None:
        """Take a photo of a stream; with `part` it is the last one of that part, and its picture is
        made, with `draw` also as a JPEG. Returns in words what is wrong with a bad photo, which
        does not end the stream."""
        return self._of_stream().see(watch, photo, part, draw=draw)

    def keep(self, watch: Watch, folder: Path) -> tuple[AdoptedPlan, tuple[ShotRecord, ...]]:
        """Write codes and newest photos of a stream into a run folder, of which `develop` makes the
        pictures; returns the plan, and these photos. Raises NoSpaceError and DiskError."""
        adopted, darkroom = self._of_stream().keep(folder)
        self._kept = folder, darkroom
        return adopted, darkroom.record.shots

    def calibrate(self, watch: Watch, begin: CalibrationStart, folder: Path) -> None:
        """Begin a calibration, whose photos will lie in `folder`; the previous job is forgotten.
        Raises ConfigError."""
        from pdcd.capture.worker.calibrating import (
            CalibrationStudy,  # no capture waits for its steps
        )

        self.forget(watch)
        self._study = CalibrationStudy.begun(begin, folder)

    def step(self, watch: Watch, name: str, now_utc: str) -> Next:
        """Begin a step; returns what it wants first. Raises CalibrationError."""
        return self._of_study().begin(name, now_utc)

    def photo(self, watch: Watch, record: PhotoRecord) -> Next:
        """Go on with the ordered photo, which lies in the folder with its lines of frames.csv.
        Raises DecodeError and CalibrationError."""
        return self._of_study().photo(record)

    def answered(self, watch: Watch) -> Next:
        """Go on: somebody has done what was asked."""
        return self._of_study().answered()

    def measured(self, watch: Watch, below: str = "") -> dict[str, MeasuredValue]:
        """Write what all steps found so far into a folder inside that of the calibration, and
        return the values. Raises DiskError."""
        return self._of_study().write(below)

    def head(self, watch: Watch, folder: Path, raw: str) -> RawHead:
        """What the header of a photo in a folder says. Raises DecodeError."""
        return read_raw_head(folder / raw)

    def _of_course(self) -> Course:
        if self._course is None:
            known = self._job is not None
            raise PdcdError(
                "the job has no run folder yet" if known else "there is no plan to work on"
            )
        return self._course

    def _of_stream(self) -> StreamCourse:
        if self._stream is None:
            raise PdcdError("no stream is under way")
        return self._stream

    def _of_study(self) -> CalibrationStudy:
        if self._study is None:
            raise PdcdError("no calibration is under way")
        return self._study
