"""One job on a rig, from its plan to the folder it ends in."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping

import msgspec

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.capture.bench_check import FrameCheck, find_calibration_doubts
from pdcd.capture.job import (
    EngineJob,
    Journal,
    describe_shots_taken,
    list_run_warnings,
    make_manifest,
    make_run_start,
    merge_warnings,
    summarise_run,
)
from pdcd.capture.rig import Rig
from pdcd.capture.shots import ShotTaker, TakenShot
from pdcd.capture.worker.answers import (
    AdoptedPlan,
    ConvergenceNote,
    OrderNote,
    PhotoOutcome,
    PlannedRun,
)
from pdcd.capture.worker.proxy import WorkerProxy
from pdcd.capture.worker.worker import Worker
from pdcd.errors import DeviceLost, NoSpaceError, PdcdError
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.schedule_fit import is_lag_needed
from pdcd.protocol import events
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import RigView
from pdcd.runs.folder import RunFolder
from pdcd.runs.ledger import RunLedger, RunStart
from pdcd.runs.manifest import MANIFEST, MANIFEST_DIGEST
from pdcd.runs.provenance import format_utc_now
from pdcd.runs.record import FileRecord, MeterRecord
from pdcd.sensor.profile import SensorProfile
from pdcd.watch import Watch

logger = logging.getLogger(__name__)


class CaptureRun:
    """Runs one job from beginning to end: plan, shots, pictures, folder.

    Raises DeviceLost when the rig is not open.
    """

    def __init__(
        self,
        config: Config,
        rig: Rig,
        profile: SensorProfile,
        worker: WorkerProxy,
        folder: RunFolder,
        job: EngineJob,
        notes: tuple[str, ...] = (),
        shown: dict[str, TakenShot] | None = None,
    ) -> None:
        """notes : what else the user should know of the bench. shown : receives all shots by
        name."""
        if rig.camera_info is None:
            raise DeviceLost("the rig is not open", device="camera", hint="start the engine first")
        self._config, self._rig, self._profile = config, rig, profile
        self._camera: CameraInfo = rig.camera_info
        self._notes = notes
        self._worker, self._folder, self._job = worker, folder, job
        self._adopted: AdoptedPlan | None = None
        self._taken: list[str] = []
        self._meter: list[MeterRecord] = []
        held: dict[str, FileRecord] = {}
        self._ledger = RunLedger(folder, held)
        self._journal = Journal(job, folder, rig.clock, [], self._ledger)
        self._check = FrameCheck(config, self._camera, self._journal)
        keep = job.request.keep_raw or config.camera.keep
        self._taker = ShotTaker(
            config, rig, worker, self._journal, self._check, keep, held, shown=shown
        )

    @property
    def warnings(self) -> list[str]:
        """What the user must know so far, also for a run that fails."""
        return self._journal.warnings

    def execute(self, rig: RigView) -> CaptureResult:
        """Plan, expose all shots, decode, archive. Raises PdcdError; the caller makes safe.

        `rig` describes the bench for the manifest.
        """
        begun_s = time.perf_counter()
        begun = self.take_photos(rig)
        try:
            return self._finish(begun, begun_s)
        except NoSpaceError as err:
            if self._taker.held:  # photos that were in memory are gone
                raise
            raise NoSpaceError(
                err.message,
                device=err.device,
                hint="all RAW files are safe: free some space and run pdcd decode --partial "
                f"{self._folder.where}",
            ) from err

    def take_photos(self, rig: RigView) -> RunStart:
        """The first half of `execute`, which is all that a stream needs to begin: plan, and expose
        all shots."""
        started, job, folder = format_utc_now(), self._job, self._folder
        planned = self._plan()
        iso = min(self._camera.isos) if planned.iso is None else planned.iso
        doubtful = tuple(find_calibration_doubts(self._config, self._rig, iso))
        self._rig.begin_photos()
        self._check.foresee(self._rig.grid, cut=planned.cut)
        folder.create(min_free_bytes=self._config.limits.min_free_bytes)
        self._journal.notify(events.JobStarted(job=job.name, goal=job.request.goal))
        adopted = self._worker.do(job.watch(), Worker.begin, folder.path)
        mock = self._rig.mock
        begun = make_run_start(
            job, planned.summary, config=self._config, mock=mock, rig=rig, started_utc=started
        )
        self._ledger.begin(begun)
        self._adopt(adopted)
        for text in (*self._notes, *doubtful, *planned.warnings):
            self._journal.warn(text)
        if self._rig.mixed is not None:
            self._journal.warn(self._rig.mixed)
        self._take_all()
        return begun

    def record(
        self, first: CaptureRun, taken: Mapping[str, TakenShot], rig: RigView
    ) -> CaptureResult:
        """Make a run of the newest photos of a stream that began with the photos of `first`; the
        worker has them. taken : their shots, by SHA-256. Raises PdcdError."""
        started, begun_s = format_utc_now(), time.perf_counter()
        job, folder = self._job, self._folder
        folder.create(min_free_bytes=self._config.limits.min_free_bytes)
        self._journal.notify(events.JobStarted(job=job.name, goal=job.request.goal))
        adopted, kept = self._worker.do(job.watch(), Worker.keep, folder.path)
        begun = make_run_start(
            job, adopted.summary, config=self._config, mock=self._rig.mock, rig=rig,
            started_utc=started,
        )  # fmt: skip
        self._ledger.begin(begun)
        self._adopt(adopted)
        for text in first.warnings:
            self._journal.warn(text)
        for meter in first._meter:
            self._meter.append(meter)
            self._ledger.meter(meter)
        for record in kept:
            shot = taken[record.sha256]
            folder.write_frames(record.name, shot.frames, shot.log)
            self._ledger.take(record)
            self._taken.append(record.name)
        return self._finish(begun, begun_s)

    def _finish(self, begun: RunStart, begun_s: float) -> CaptureResult:
        """Decode what was taken, and archive. begun_s : when the run began."""
        job, folder = self._job, self._folder
        if self._adopted is None:
            raise PdcdError("the run has no plan")
        plan = self._adopted.summary
        self._journal.notify(events.DecodingStarted(shots=len(self._taken)))
        developed = self._worker.do(job.watch(), Worker.develop, report=job.report)
        for text in list_run_warnings(developed, self._config, self._profile, mock=begun.mock):
            self._journal.warn(text)
        summary = summarise_run(plan, developed)
        summary["wall_s"] = time.perf_counter() - begun_s
        self._rig.recheck_photos()
        self._write_last()
        # The last line of log.jsonl: hashes come after it.
        self._journal.notify(events.PicturesArchived(job=job.name))
        files, not_kept = self._sort_out(folder.hashes(job.look_for_cancel))
        manifest = make_manifest(
            begun,
            msgspec.to_builtins(plan),
            developed,
            summary=summary,
            warnings=self.warnings,
            meter=self._meter,
            files=files,
            not_kept=not_kept,
        )
        digest = folder.finish(manifest, self._rig.pulse)
        folder.drop(not_kept)  # whole without them by now
        return CaptureResult(
            job=job.name,
            state="done",
            manifest_sha256=digest,
            folder=str(folder.where),
            files=(*files, MANIFEST_DIGEST, MANIFEST, *self._report()),
            summary=summary,
            warnings=merge_warnings(self.warnings),
        )

    def _write_last(self) -> None:
        """Write the photo of the last shot where it is to be kept but is only in memory."""
        if self._taker.keep == "last":
            for path, data in self._taker.last.items():
                if data is not None:
                    self._folder.write_raw(path, data)

    def _sort_out(
        self, found: dict[str, FileRecord]
    ) -> tuple[dict[str, FileRecord], dict[str, FileRecord]]:
        """Files of the folder that stay, and RAW files that do not, including those in memory."""
        keep = self._taker.keep
        last = self._taker.last if keep == "last" else ()
        stay = {
            name: file
            for name, file in found.items()
            if keep == "all" or name in last or not name.startswith("raw/")
        }
        gone = {**found, **self._taker.held}
        return stay, {name: gone[name] for name in sorted(gone) if name not in stay}

    def _report(self) -> tuple[str, ...]:
        """Make the page of the finished run, where one is wanted; returns its name.

        The run is complete by now: an error here costs only the page.
        """
        if not self._job.report:
            return ()
        try:
            name = self._worker.do(Watch(), Worker.report)
        except Exception as err:
            known = isinstance(err, PdcdError)  # such as a full disk, which is no fault of ours
            logger.warning(
                "no report was made job=%s error=%s",
                self._job.name,
                self._folder.put_own_path(str(err)),
                exc_info=None if known else err,
            )
            return ()
        return () if name is None else (name,)

    @property
    def taken(self) -> str | None:
        """Which of the planned shots are there, in words; None before there is a plan."""
        if self._adopted is None:
            return None
        shots = self._adopted.shots
        missing = [name for name in shots if name not in self._taken]
        return describe_shots_taken(len(self._taken), len(shots), missing)

    def _plan(self) -> PlannedRun:
        """The plan as asked for, or as chosen for a wanted error or time."""
        job, rig = self._job, self._rig
        request, given = job.request, dict(job.given)
        needs_lag = is_search_needed(request) or is_lag_needed(request, self._config)
        lag_s = rig.mask_lag_s(look=needs_lag)
        return self._worker.do(job.planning(), Worker.plan, request, given, rig.camera, lag_s)

    def _adopt(self, adopted: AdoptedPlan) -> None:
        """Record the plan by which the run goes on; shots that it does not contain are dropped."""
        self._adopted = adopted
        self._ledger.plan(msgspec.to_builtins(adopted.summary), adopted.record)
        self._taken = [name for name in self._taken if name in adopted.shots]

    def _take_all(self) -> None:
        """Take what the worker wants, photo after photo, and keep its notes."""
        taken: PhotoOutcome = None
        while True:
            order = self._worker.do(self._job.watch(), Worker.next_exposure, taken)
            for note in order.notes:
                self._keep(note)
            if order.done:
                return
            taken = None if order.photo is None else self._taker.take(order.photo)
            if isinstance(taken, tuple):
                self._taken += [record.name for record in taken]

    def _keep(self, note: OrderNote) -> None:
        """Report and record one note."""
        if isinstance(note, str):
            self._journal.warn(note)
        elif isinstance(note, MeterRecord):
            self._meter.append(note)
            self._ledger.meter(note)
        elif isinstance(note, AdoptedPlan):
            self._adopt(note)
        elif isinstance(note, ConvergenceNote):
            self._ledger.enough()
        else:
            self._journal.notify(note)
