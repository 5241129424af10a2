"""The desk at which a job is worked out: its plan, its metering, its pictures; no device is near.

Everything here takes long, or reads bytes that came from elsewhere. So the daemon has it done in a
process of its own (`pdcd.capture.worker.keeper`); others call it where they are
(`pdcd.capture.worker.hands`). What it needs between two calls stays here, and only what the caller
must know goes back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.calibration import Entry, PhotoRecord
from pdcd.bench.devices import CameraInfo
from pdcd.bench.placed import camera_map
from pdcd.bench.tables import Config
from pdcd.capture.worker.answers import (
    Developed,
    Learnt,
    Metered,
    Planned,
    Seen,
    Stray,
    developed_of,
    record_of,
    rms_sigma,
)
from pdcd.capture.worker.stray import Ambience, leaks_in
from pdcd.errors import PdcdError, RequestError, disk_errors
from pdcd.pages.report.material import cheap, gathered
from pdcd.pages.report.write import written
from pdcd.pictures.darkroom import Darkroom, Decoded
from pdcd.pictures.decode import write_pictures
from pdcd.pictures.truth import Known, known_answer, write_truth
from pdcd.pictures.written.develop import write_png
from pdcd.pictures.written.previews import Previews
from pdcd.planning.choose import choose, wants_choice
from pdcd.planning.guided import scouted, stopped, summary, with_links
from pdcd.planning.look import quiet, with_blacks
from pdcd.planning.metering import expected_share, metered_pairs, peak_share
from pdcd.planning.outlook import Setting
from pdcd.planning.plan import Plan
from pdcd.planning.unasked import looked, plan_unasked
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import Given
from pdcd.recipes.parts import part_numbers
from pdcd.runs.folder import read_manifest, write_patterns
from pdcd.runs.record import DarkPhoto, RunRecord, ShotRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import RawHead, read_head, read_raw
from pdcd.virtual.scene.scene import Scene
from pdcd.watch import Watch

if TYPE_CHECKING:
    from pdcd.capture.worker.calibrating import Begin, Next, Study

RUNNING = "preview/running.png"
"""What is known of the answer while a run with `until_error` goes on."""


@dataclass(frozen=True)
class Facts:
    """What holds for every job of a rig; `scene` is what stands before it, where that is known."""

    config: Config
    profile: SensorProfile
    grid: tuple[int, int]
    scene: Scene | None


@dataclass
class _Job:
    """What is kept of one job between its calls."""

    request: CaptureRequest
    camera: CameraInfo | None
    plan: Plan
    before: Plan | None = None
    """The plan before the scouts of a pilot ended that."""
    folder: Path | None = None
    darkroom: Darkroom | None = None
    ratio: NDArray[np.float64] | None = None


class Desk:
    """Works out one job after the other; `plan` begins a new one, `forget` ends it.

    Every method takes a `Watch`, which hears of the work and may end it.
    """

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self._job: _Job | None = None
        self._study: Study | None = None
        self._finished: tuple[Path, RunRecord, Decoded, Known | None] | None = None

    def calibrate(self, watch: Watch, begin: Begin, folder: Path) -> None:
        """Begin a calibration, whose photos will lie in `folder`; what was kept of the job before
        is forgotten. Raises ConfigError."""
        from pdcd.capture.worker.calibrating import Study  # no capture waits for its steps

        self.forget(watch)
        self._study = Study.begun(begin, folder)

    def step(self, watch: Watch, name: str, now_utc: str) -> Next:
        """Begin a step: what it wants first. Raises CalibrationError."""
        return self._of_study().begin(name, now_utc)

    def photo(self, watch: Watch, record: PhotoRecord) -> Next:
        """Go on with the photo that was wanted, which lies in the folder with its lines of
        frames.csv. Raises DecodeError and CalibrationError."""
        return self._of_study().photo(record)

    def answered(self, watch: Watch) -> Next:
        """Go on: somebody did what was asked."""
        return self._of_study().answered()

    def measured(self, watch: Watch) -> dict[str, Entry]:
        """Write what all steps found into the folder, and return the values. Raises DiskError."""
        return self._of_study().write()

    def flip(self, watch: Watch, folder: Path, raw: str) -> int:
        """How the camera was held: `RawHead.flip` of a photo in a folder. Raises DecodeError."""
        return read_head(folder / raw).flip

    def _of_study(self) -> Study:
        if self._study is None:
            raise PdcdError("no calibration is under way")
        return self._study

    def plan(
        self,
        watch: Watch,
        request: CaptureRequest,
        given: Given,
        camera: CameraInfo | None,
        mask_lag_s: float | None,
    ) -> Planned:
        """Plan a request; what was kept of the job before is forgotten.

        `camera` may be None where the request wants no choice (`wants_choice`) and no pictures will
        be made. `given` holds the request's arrays. Raises RequestError.
        """
        self.forget(watch)
        self._study = None
        facts = self._facts
        watch.stage = "codes"
        config, grid = facts.config, facts.grid
        if not wants_choice(request):
            plan = plan_unasked(request, config, grid, camera, mask_lag_s, given, watch)
        elif camera is None:
            raise PdcdError("a plan by error or time needs to know the camera")
        else:
            setting = Setting(facts.config, camera, facts.profile, mask_lag_s)
            known = facts.scene if facts.scene and facts.scene.grid == facts.grid else None
            plan = choose(request, setting, facts.grid, known, given, watch).plan
        self._job = _Job(request, camera, plan)
        return self._planned(plan)

    def begin(self, watch: Watch, folder: Path) -> None:
        """Store the codes of the plan in a run folder; shots will lie there, too.

        Raises NoSpaceError, or DiskError for any other refusal of the disk.
        """
        job = self._of_job()
        job.folder = folder
        self._write_patterns(job)
        job.darkroom = Darkroom(folder, self._record(job, ()))

    def meter_pairs(self, watch: Watch, shot: str) -> int:
        """Pairs of patterns in a test exposure of a shot."""
        job = self._of_job()
        found = next(s for s in job.plan.recipe.shots if s.name == shot)
        pairs, job.ratio = metered_pairs(job.plan, found)
        return pairs

    def metered(self, watch: Watch, raw: str, sha256: str, saturation_dn: float) -> Metered:
        """How bright a test exposure is, after `meter_pairs` of its shot.

        raw : path below the run folder. Raises DecodeError.
        """
        job = self._of_job()
        if job.folder is None or job.ratio is None:
            raise PdcdError("a test exposure came before its shot")
        frame = read_raw(job.folder / raw, sha256=sha256, saturation_dn=saturation_dn)
        config = self._facts.config
        cells = CellMap(
            grid=job.plan.grid,
            frame=frame.frame,
            map=camera_map(config, frame.frame),
            blur_quads=config.camera.blur_quads,
        )
        return Metered(
            peak=peak_share(frame.planes, frame.saturated, saturation_dn),
            expected=expected_share(frame.planes, job.ratio, saturation_dn, cells),
        )

    def look(self, watch: Watch, raw: str, sha256: str) -> RawHead:
        """Size, orientation and camera of a photo that has just come.

        raw : path below the run folder. Raises DecodeError.
        """
        return read_head(self._folder() / raw, sha256=sha256)

    def learn(self, watch: Watch, shots: Sequence[ShotRecord]) -> Learnt:
        """Look at the photos of a pilot: at its scouts, or at all; where they call for it, the job
        goes on by another plan, whose codes are stored.

        shots : all that were taken so far, as for `see` and `develop`. Raises DecodeError.
        """
        job, darkroom = self._of_job(), self._darkroom(shots)
        scouts = scouted(job.plan, len(darkroom.record.shots))
        learned = darkroom.learned(watch)
        if learned is None or (scouts and learned.promising):
            return Learnt("go on", None)
        seed = job.request.seed
        outcome: Literal["stopped", "guided", "no use"]
        if scouts:
            limit_s = self._facts.config.limits.max_exposure_s
            plan, outcome = stopped(job.plan, seed, limit_s), "stopped"
            job.before = job.plan
        elif learned.pays:
            plan, outcome = with_links(job.plan, learned.links, seed, watch), "guided"
        else:
            plan, outcome = job.plan, "no use"
        told = looked(plan, learned, darkroom.record.shots) if job.plan.unasked else ""
        if told:
            plan = replace(plan, reasons=(*plan.reasons, f"pilot: {told}"))
        if outcome == "no use":
            job.plan = plan
            return Learnt(outcome, self._planned(plan) if told else None, told)
        job.plan = plan
        self._write_patterns(job)
        darkroom.replan(self._record(job, darkroom.record.shots, darkroom.record.cells))
        return Learnt(outcome, self._planned(plan), told)

    def stray(self, watch: Watch, shots: Sequence[ShotRecord], darks: Sequence[DarkPhoto]) -> Stray:
        """Look at one dark photo, or at two (`pdcd.planning.look`); where they call for it, the job
        goes on by a plan with black exposures.

        shots : all that were taken so far. Raises DecodeError.
        """
        job, darkroom, config = self._of_job(), self._darkroom(shots), self._facts.config
        plan = job.plan
        leaks = leaks_in(plan, darkroom, darks, watch)
        if leaks.both > leaks.limit and len(darks) == 1:
            return Stray("unsure", leaks, self._planned(plan))
        job.plan = quiet(plan, leaks)
        if leaks.both <= leaks.limit:
            return Stray("quiet", leaks, self._planned(job.plan))
        try:
            more = with_blacks(plan, leaks, config, shots)
        except RequestError as err:
            darkroom.replan(self._record(job, darkroom.record.shots, darkroom.record.cells))
            return Stray("warn", leaks, self._planned(job.plan), err.message)
        average = plan.look is not None and plan.look.average
        mended = Ambience(job.request, config, job.camera, job.before, average)

        def replan(plan: Plan) -> None:
            there = {shot.name for shot in plan.recipe.shots}
            kept = tuple(shot for shot in darkroom.record.shots if shot.name in there)
            if plan.patterns is not job.plan.patterns:
                job.plan = plan
                self._write_patterns(job)
            job.plan = plan
            darkroom.replan(self._record(job, kept, darkroom.record.cells))

        found = mended.after(more, darks[-1], darkroom, replan, watch)
        return Stray(
            "added", leaks, self._planned(job.plan), told=found.told, decided=found.decided
        )

    def see(self, watch: Watch, shots: Sequence[ShotRecord]) -> Seen:
        """Look at the pictures so far; the answer is written as `RUNNING`. Raises DecodeError."""
        decoded = self._darkroom(shots).decoded(watch)
        path = self._folder() / RUNNING
        with disk_errors(str(path.parent)):
            previews = Previews(decoded.pictures, decoded.view)
            write_png(path, previews.drawn(decoded.recipe.answer_name))
        parts = len(part_numbers(decoded.recipe))
        return Seen(parts, rms_sigma(decoded.answer), decoded.answer.kind)

    def develop(
        self, watch: Watch, shots: Sequence[ShotRecord], *, report: bool = False
    ) -> Developed:
        """Make all pictures and write them into the run folder; the job is forgotten then, but for
        what a `report` needs, where one is wanted and soon made.

        Raises DecodeError, NoSpaceError.
        """
        job, darkroom, facts = self._of_job(), self._darkroom(shots), self._facts
        decoded = darkroom.decoded(watch)
        warnings = write_pictures(self._folder(), decoded)
        record, plan = darkroom.record, job.plan
        windows = [plan.window_of(shot) for shot in plan.recipe.shots]
        known = known_answer(facts.config, facts.scene, plan.recipe, windows, record.cells, watch)
        error = None
        if known is not None:
            error = known.rms_error(decoded.answer, decoded.cell_means.image)
            write_truth(self._folder(), known)
        done = developed_of(record, decoded, error, warnings, watch, facts.scene)
        folder = self._folder()
        self.forget(watch)
        if report and cheap(record, decoded):
            self._finished = folder, record, decoded, known
        return done

    def report(self, watch: Watch) -> str | None:
        """Write the page of the run that was developed last, whose folder is finished; returns its
        name in there, or None where it would take too long. Raises DiskError and DecodeError."""
        finished, self._finished = self._finished, None
        if finished is None:
            return None
        folder, record, decoded, known = finished
        material = gathered(folder, record, decoded, known)
        return written(folder, read_manifest(folder), material).name

    def forget(self, watch: Watch) -> None:
        """Keep nothing of the job."""
        self._job = self._finished = None

    def _planned(self, plan: Plan) -> Planned:
        limit_s = self._facts.config.limits.max_exposure_s
        return Planned(plan.outline(), summary(plan, limit_s))

    def _of_job(self) -> _Job:
        if self._job is None:
            raise PdcdError("there is no plan to work on")
        return self._job

    def _darkroom(self, shots: Sequence[ShotRecord]) -> Darkroom:
        """The job's darkroom, which then knows of these shots; those it knew come first."""
        darkroom = self._of_job().darkroom
        if darkroom is None:
            raise PdcdError("the job has no run folder yet")
        for shot in shots[len(darkroom.record.shots) :]:
            darkroom.add(shot)
        return darkroom

    def _folder(self) -> Path:
        folder = self._of_job().folder
        if folder is None:
            raise PdcdError("the job has no run folder yet")
        return folder

    def _write_patterns(self, job: _Job) -> None:
        target = job.plan.recipe.target
        given: Mapping[str, NDArray[np.float64]] = {**target.planes, **target.matrices}
        write_patterns(
            self._folder(),
            job.plan.patterns,
            given,
            family=job.plan.family,
            codes=job.plan.how.coded,
            seed=job.request.seed,
        )

    def _record(
        self, job: _Job, shots: Sequence[ShotRecord], cells: CellMap | None = None
    ) -> RunRecord:
        if job.camera is None:
            raise PdcdError("pictures need to know the camera")
        facts = self._facts
        return record_of(
            job.plan, job.request, facts.config, job.camera, facts.profile, shots, cells
        )
