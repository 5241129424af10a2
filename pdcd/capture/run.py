"""One job on a rig, from its plan to the folder it ends in."""

from __future__ import annotations

import time

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.capture.account import manifest_of, record_of, summary_of, warnings_of
from pdcd.capture.convergence import Convergence
from pdcd.capture.job import Job, Journal
from pdcd.capture.rig import Rig
from pdcd.capture.shots import ShotTaker
from pdcd.errors import DeviceLost
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import write_pictures
from pdcd.pilot.codes import SCOUTS
from pdcd.planning.choose import choose, wants_choice
from pdcd.planning.guided import piloted, plan_for, scouted, stopped, with_links
from pdcd.planning.outlook import Setting
from pdcd.planning.plan import Plan
from pdcd.recipes.recipe import Shot
from pdcd.request import CaptureResult
from pdcd.runs import events
from pdcd.runs.folder import RunFolder
from pdcd.runs.provenance import utc_now
from pdcd.runs.record import RunRecord
from pdcd.runs.views import RigView
from pdcd.sensor.profile import SensorProfile


class Run:
    """Takes one job through: plan, shots, pictures, folder.

    Raises DeviceLost when the rig is not open.
    """

    def __init__(
        self, config: Config, rig: Rig, profile: SensorProfile, folder: RunFolder, job: Job
    ) -> None:
        if rig.camera_info is None:
            raise DeviceLost("the rig is not open", device="camera", hint="start the engine first")
        self._config, self._rig, self._profile = config, rig, profile
        self._camera: CameraInfo = rig.camera_info
        self._folder, self._job = folder, job
        self._journal = Journal(job, folder, rig.clock, [])
        self._taker = ShotTaker(config, rig, self._camera, profile, self._journal)

    def execute(self, rig: RigView) -> CaptureResult:
        """Plan, expose all shots, decode, archive. Raises PdcdError; the caller makes safe.

        `rig` describes the bench for the manifest.
        """
        started, begun_s = utc_now(), time.perf_counter()
        job, folder = self._job, self._folder
        plan = self._plan()
        folder.create(min_free_bytes=self._config.limits.min_free_bytes)
        self._journal.notify(events.Started(job=job.name, goal=job.request.goal))
        self._write_patterns(plan)
        darkroom = Darkroom(folder.path, self._record(plan))
        plan = self._take_all(plan, darkroom)
        self._journal.notify(events.Decoding(shots=len(darkroom.record.shots)))
        decoded = darkroom.decoded(job.watch())
        write_pictures(folder.path, decoded)
        mock = self._rig.mock
        for text in warnings_of(decoded, self._config, self._profile, mock=mock):
            self._journal.warn(text)
        summary = summary_of(plan, darkroom.record, decoded, self._rig.scene)
        deviations = decoded.deviations(job.look_for_cancel)
        summary["wall_s"] = time.perf_counter() - begun_s
        # The last line of log.jsonl: hashes come after it.
        self._journal.notify(events.Archived(job=job.name))
        manifest = manifest_of(
            job,
            plan,
            darkroom.record,
            decoded,
            deviations,
            config=self._config,
            mock=mock,
            rig=rig,
            started_utc=started,
            summary=summary,
            warnings=self._journal.warnings,
            meter=self._taker.meter,
            files=folder.hashes(),
        )
        files = (*folder.files(), "capture.json")
        return CaptureResult(
            job=job.name,
            state="done",
            manifest_sha256=folder.finish(manifest),
            folder=str(folder.final),
            files=files,
            summary=summary,
        )

    def _plan(self) -> Plan:
        """The plan as asked for, or as a wanted error or time has it."""
        request, given, rig = self._job.request, self._job.given, self._rig
        if not wants_choice(request):
            return plan_for(request, self._config, rig.grid, rig.mask_lag_s(), given)
        setting = Setting(self._config, self._camera, self._profile, rig.mask_lag_s())
        alive = self._job.look_for_cancel
        return choose(request, setting, rig.grid, rig.scene, alive, given).plan

    def _take_all(self, plan: Plan, darkroom: Darkroom) -> Plan:
        """Take shot after shot, as far as need be; returns the plan as it came to be."""
        until = self._job.request.until_error
        convergence = None if until is None else Convergence(until)
        while len(darkroom.record.shots) < len(plan.recipe.shots):
            plan = self._learn(plan, darkroom)
            shot = plan.recipe.shots[len(darkroom.record.shots)]
            darkroom.add(self._taker.take(plan, shot))
            if convergence is not None and self._good_enough(plan, darkroom, convergence, shot):
                break
        return plan

    def _learn(self, plan: Plan, darkroom: Darkroom) -> Plan:
        """After the scouts of a pilot, end it where it cannot pay; after its last photo, keep
        linked cells apart in the codes that follow."""
        taken = len(darkroom.record.shots)
        scouts = scouted(plan, taken)
        if not scouts and not piloted(plan, taken):
            return plan
        self._journal.notify(events.Learning(photos=SCOUTS if scouts else plan.how.pilot))
        learned = darkroom.learned(self._job.watch())
        if learned is None or (scouts and learned.promising):
            return plan
        seed = self._job.request.seed
        if scouts:
            plan = stopped(plan, seed, self._config.limits.max_exposure_s)
            self._journal.warn(
                f"the pilot ended after {SCOUTS} photos, which show no sharp far paths; the coded "
                f"photo took {plan.how.coded} codes"
            )
        elif learned.pays:
            plan = with_links(plan, learned.links, seed)
        else:
            self._journal.warn("the pilot found nothing that better codes could avoid")
            return plan
        self._write_patterns(plan)
        darkroom.replan(self._record(plan, darkroom.record))
        return plan

    def _good_enough(
        self, plan: Plan, darkroom: Darkroom, convergence: Convergence, shot: Shot
    ) -> bool:
        """Whether the parts taken so far reach the error asked for; tells how far they are."""
        if not convergence.after(plan.recipe, shot):
            return False
        self._journal.notify(
            convergence.see(self._folder.path, darkroom.decoded(self._job.watch()))
        )
        if not convergence.met and shot is plan.recipe.shots[-1]:
            self._journal.warn(convergence.warning)
        return convergence.met

    def _record(self, plan: Plan, so_far: RunRecord | None = None) -> RunRecord:
        shots = () if so_far is None else so_far.shots
        cells = None if so_far is None else so_far.cells
        request = self._job.request
        return record_of(plan, request, self._config, self._camera, self._profile, shots, cells)

    def _write_patterns(self, plan: Plan) -> None:
        target = plan.recipe.target
        self._folder.write_patterns(
            plan.patterns,
            {**target.planes, **target.matrices},
            family=plan.family,
            codes=plan.how.coded,
            seed=self._job.request.seed,
        )
