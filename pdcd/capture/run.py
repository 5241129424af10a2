"""One job on a rig, from its plan to the folder it ends in."""

from __future__ import annotations

import logging
import time

import msgspec

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.capture.account import (
    begun_by,
    manifest_of,
    summary_of,
    taken_words,
    told,
    warnings_of,
)
from pdcd.capture.convergence import Convergence
from pdcd.capture.job import Job, Journal
from pdcd.capture.lookout import Lookout, next_shot
from pdcd.capture.rig import Rig
from pdcd.capture.same_bench import doubts
from pdcd.capture.shots import ShotTaker
from pdcd.capture.sight import Sight
from pdcd.capture.worker.answers import Planned, record_of
from pdcd.capture.worker.desk import Desk
from pdcd.capture.worker.hands import Hands
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.errors import DeviceLost
from pdcd.planning.grey import grey_warnings
from pdcd.planning.guided import piloted, scouted
from pdcd.planning.look import last_exposed
from pdcd.planning.plan import Plan
from pdcd.protocol import events
from pdcd.protocol.request import CaptureResult
from pdcd.protocol.views import RigView
from pdcd.recipes.recipe import Shot
from pdcd.runs.folder import RunFolder
from pdcd.runs.ledger import Ledger
from pdcd.runs.manifest import DIGEST, MANIFEST
from pdcd.runs.provenance import utc_now
from pdcd.runs.record import ShotRecord
from pdcd.sensor.profile import SensorProfile
from pdcd.watch import Watch

logger = logging.getLogger(__name__)


class Run:
    """Takes one job through: plan, shots, pictures, folder.

    Raises DeviceLost when the rig is not open.
    """

    def __init__(
        self,
        config: Config,
        rig: Rig,
        profile: SensorProfile,
        hands: Hands,
        folder: RunFolder,
        job: Job,
    ) -> None:
        if rig.camera_info is None:
            raise DeviceLost("the rig is not open", device="camera", hint="start the engine first")
        self._config, self._rig, self._profile = config, rig, profile
        self._camera: CameraInfo = rig.camera_info
        self._hands, self._folder, self._job = hands, folder, job
        self._shots: list[ShotRecord] = []
        self._ledger = Ledger(folder)
        self._journal = Journal(job, folder, rig.clock, [], self._ledger)
        self._sight = Sight(config, self._camera, self._journal)
        self._taker = ShotTaker(
            config, rig, self._camera, profile, hands, self._journal, self._sight
        )
        self._lookout = Lookout(self._taker, hands, self._journal)
        self._planned: Planned | None = None
        self._decided: str | None = None

    @property
    def warnings(self) -> list[str]:
        """What the user must know so far, also of a run that fails."""
        return self._journal.warnings

    def execute(self, rig: RigView) -> CaptureResult:
        """Plan, expose all shots, decode, archive. Raises PdcdError; the caller makes safe.

        `rig` describes the bench for the manifest.
        """
        started, begun_s = utc_now(), time.perf_counter()
        job, folder = self._job, self._folder
        planned = self._plan()
        iso = min(self._camera.isos) if planned.plan.iso is None else planned.plan.iso
        doubtful = tuple(doubts(self._config, self._rig, iso))
        self._sight.foresee(planned.plan)
        folder.create(min_free_bytes=self._config.limits.min_free_bytes)
        self._journal.notify(events.Started(job=job.name, goal=job.request.goal))
        self._hands.do(job.watch(), Desk.begin, folder.path)
        mock = self._rig.mock
        begun = begun_by(
            job, planned.summary, config=self._config, mock=mock, rig=rig, started_utc=started
        )
        self._ledger.begin(begun)
        self._goes_by(planned)
        for text in (*doubtful, *grey_warnings(planned.plan, self._config)):
            self._journal.warn(text)
        if self._rig.mixed is not None:
            self._journal.warn(self._rig.mixed)
        planned = self._take_all(planned)
        self._journal.notify(events.Decoding(shots=len(self._shots)))
        developed = self._hands.do(job.watch(), Desk.develop, self._shots, report=job.report)
        for text in warnings_of(developed, self._config, self._profile, mock=mock):
            self._journal.warn(text)
        summary = summary_of(planned.summary, developed)
        decided = [text for text in (self._decided, self._lookout.decided) if text]
        if decided:
            summary["decided"] = "; ".join(decided)
        summary["wall_s"] = time.perf_counter() - begun_s
        # The last line of log.jsonl: hashes come after it.
        self._journal.notify(events.Archived(job=job.name))
        manifest = manifest_of(
            begun,
            msgspec.to_builtins(planned.summary),
            developed,
            summary=summary,
            warnings=self.warnings,
            meter=self._taker.meter,
            files=folder.hashes(job.look_for_cancel),
        )
        files = (*folder.files(), DIGEST, MANIFEST)
        digest = folder.finish(manifest, self._rig.pulse)
        return CaptureResult(
            job=job.name,
            state="done",
            manifest_sha256=digest,
            folder=str(folder.where),
            files=(*files, *self._report()),
            summary=summary,
            warnings=told(self.warnings),
        )

    def _report(self) -> tuple[str, ...]:
        """Make the page of the finished run, where one is wanted; returns its name.

        The run is whole by now: whatever goes wrong here costs the page alone.
        """
        if not self._job.report:
            return ()
        try:
            name = self._hands.do(Watch(), Desk.report)
        except Exception as err:
            logger.warning("no report was made job=%s", self._job.name, exc_info=err)
            return ()
        return () if name is None else (name,)

    @property
    def taken(self) -> str | None:
        """Which of the planned shots are there, in words; None before there is a run."""
        if self._planned is None:
            return None
        shots = self._planned.plan.recipe.shots
        taken = {shot.name for shot in self._shots}
        missing = [shot.name for shot in shots if shot.name not in taken]
        return taken_words(len(self._shots), len(shots), missing)

    def _goes_by(self, planned: Planned) -> None:
        """Write down by what plan the run goes from here on."""
        self._planned = planned
        record = record_of(
            planned.plan, self._job.request, self._config, self._camera, self._profile
        )
        self._ledger.plan(msgspec.to_builtins(planned.summary), record)

    def _plan(self) -> Planned:
        """The plan as asked for, or as a wanted error or time has it."""
        job = self._job
        return self._hands.do(
            job.planning(),
            Desk.plan,
            job.request,
            dict(job.given),
            self._rig.camera,
            self._rig.mask_lag_s(),
        )

    def _take_all(self, planned: Planned) -> Planned:
        """Take shot after shot, as far as need be; returns the plan as it came to be."""
        until = self._job.request.until_error
        convergence = None if until is None else Convergence(until)
        while True:
            planned = self._look(self._learn(planned))
            plan, shot = planned.plan, next_shot(planned, self._shots)
            if shot is None:
                break
            self._shots += self._taker.take(plan, shot)
            if convergence is not None and self._good_enough(plan, convergence, shot):
                break
        return planned

    def _learn(self, planned: Planned) -> Planned:
        """After the scouts of a pilot, end it where it cannot pay; after its last photo, keep
        linked cells apart in the codes that follow."""
        plan, taken = planned.plan, len(self._shots)
        late = plan.how.late
        if self._lookout.done and not late:  # which comes after all that a pilot may change
            return planned
        scouts = scouted(plan, taken) and not late  # by a look at ambient light these see enough
        if not scouts and not piloted(plan, taken):
            return planned
        self._journal.notify(events.Learning(photos=SCOUTS if scouts else plan.how.pilot))
        learnt = self._hands.do(self._job.watch(), Desk.learn, self._shots)
        if learnt.planned is not None:
            planned = learnt.planned
            self._goes_by(planned)
        if learnt.told:
            self._decided = learnt.told
        elif learnt.outcome == "stopped":
            self._journal.warn(
                f"the pilot ended after {SCOUTS} photos, which show no sharp far paths; the coded "
                f"photo took {planned.plan.how.coded} codes"
            )
        elif learnt.outcome == "no use":
            self._journal.warn("the pilot found nothing that better codes could avoid")
        return planned

    def _look(self, planned: Planned) -> Planned:
        """Take a dark photo where one is due, and black exposures where it calls for them."""
        after = self._lookout.look(planned, self._shots)
        if after is None:
            return planned
        self._goes_by(after)
        there = {shot.name for shot in after.plan.recipe.shots}
        self._shots = [shot for shot in self._shots if shot.name in there]
        return after

    def _good_enough(self, plan: Plan, convergence: Convergence, shot: Shot) -> bool:
        """Whether the parts taken so far reach the error asked for; tells how far they are."""
        if not convergence.after(plan.recipe, shot):
            return False
        seen = self._hands.do(self._job.watch(), Desk.see, self._shots)
        self._journal.notify(convergence.see(seen))
        last = shot is last_exposed(plan)
        if convergence.met and not last:
            self._ledger.enough()
        if not convergence.met and last:
            self._journal.warn(convergence.warning)
        return convergence.met
