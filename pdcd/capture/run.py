"""One job on a rig: its shots, metered and exposed, and the folder they end in."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from pdcd.bench.devices import CameraInfo, CameraSettings
from pdcd.bench.tables import Config
from pdcd.capture.convergence import Convergence, rms_sigma
from pdcd.capture.rig import Exposure, Rig
from pdcd.errors import Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.frames.balance import lit_weights
from pdcd.frames.frames import FrameLog, Frames
from pdcd.pictures.decode import Decoded, decode, write_pictures
from pdcd.pictures.watch import Watch
from pdcd.pilot.codes import SCOUTS
from pdcd.planning.choose import choose, wants_choice
from pdcd.planning.guided import piloted, plan_for, scouted, stopped, with_links
from pdcd.planning.guided import summary as plan_summary
from pdcd.planning.metering import (
    MAX_TESTS,
    expected_share,
    metered_pairs,
    next_aperture,
    peak_share,
)
from pdcd.planning.outlook import Setting
from pdcd.planning.plan import Plan
from pdcd.planning.truth import answer
from pdcd.recipes.parts import part_numbers
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.request import CaptureRequest, CaptureResult
from pdcd.runs import events
from pdcd.runs.events import Emit, Event
from pdcd.runs.folder import RunFolder
from pdcd.runs.provenance import git_commit, utc_now, versions
from pdcd.runs.record import SCHEMA_VERSION, Manifest, RunRecord, ShotRecord
from pdcd.runs.views import OwnerView, RigView
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import read_raw

logger = logging.getLogger(__name__)

FIRST_F_NUMBER = 8.0
"""Aperture of the first test exposure."""


@dataclass
class Run:
    """One job: its folder and what it has gathered so far."""

    config: Config
    rig: Rig
    profile: SensorProfile
    folder: RunFolder
    shots: list[ShotRecord] = field(default_factory=list)
    meter: list[dict[str, Any]] = field(default_factory=list)
    apertures: dict[str, float] = field(default_factory=dict)
    """Metered f-number of each program, one for all its parts; white shots have none, so theirs is
    under ''."""
    warnings: list[str] = field(default_factory=list)
    convergence: Convergence | None = None
    """Of a job that may end before all its parts are taken."""

    def watch(self, emit: Emit, cancelled: Callable[[], bool]) -> None:
        """Who is told, and who may cancel."""
        self._emit = emit
        self._cancelled = cancelled

    def execute(
        self,
        request: CaptureRequest,
        grid: tuple[int, int],
        job: str,
        owner: OwnerView | None,
        description: RigView,
    ) -> CaptureResult:
        """Plan, expose all shots, decode, archive. Raises PdcdError; the caller makes safe."""
        started, begun_s = utc_now(), time.perf_counter()
        camera = self.rig.camera_info
        if camera is None:
            raise DeviceLost("the rig is not open", device="camera", hint="start the engine first")
        plan = self._plan(request, grid, camera)
        if request.until_error is not None:
            self.convergence = Convergence(request.until_error)
        self.folder.create(min_free_bytes=self.config.limits.min_free_bytes)
        self.notify(events.Started(job=job, goal=request.goal))
        self._write_patterns(plan, request.seed)
        while len(self.shots) < len(plan.recipe.shots):
            plan = self._learn(plan, request, camera)
            shot = plan.recipe.shots[len(self.shots)]
            self._take(plan, shot, camera)
            if self._good_enough(plan, request, camera, shot):
                break
        self.notify(events.Decoding(shots=len(self.shots)))
        record = self._record(plan, request, camera)
        watch = self._watch()
        decoded = decode(self.folder.path, record, watch, report=True)
        write_pictures(self.folder.path, decoded)
        self._warn(decoded)
        deviations = decoded.deviations(watch)
        summary = self._summary(plan, request.method, decoded)
        summary["wall_s"] = time.perf_counter() - begun_s
        self.notify(events.Archived(job=job))  # the last line of log.jsonl: hashes come after it
        manifest = Manifest(
            schema=SCHEMA_VERSION,
            job=job,
            state="done",
            mock=self.rig.mock,
            owner={} if owner is None else msgspec.to_builtins(owner),
            started_utc=started,
            finished_utc=utc_now(),
            request=msgspec.to_builtins(request),
            plan=msgspec.to_builtins(plan_summary(plan, self.config.limits.max_exposure_s)),
            run=record,
            realised={name: msgspec.to_builtins(d) for name, d in deviations.items()},
            summary=summary,
            warnings=tuple(self.warnings),
            versions=versions(),
            git_commit=git_commit(),
            exif={name: shot.exif for name, shot in decoded.shots.items()},
            drivers=msgspec.to_builtins(description),
            config=msgspec.to_builtins(self.config),
            meter=tuple(self.meter),
            files=self.folder.hashes(),
        )
        files = (*self.folder.files(), "capture.json")
        digest = self.folder.finish(manifest)
        return CaptureResult(
            job=job,
            state="done",
            folder=str(self.folder.final),
            manifest_sha256=digest,
            files=files,
            summary=summary,
        )

    def _write_patterns(self, plan: Plan, seed: int) -> None:
        goal = plan.recipe.goal
        self.folder.write_patterns(
            plan.patterns,
            {**goal.planes, **goal.matrices},
            family=plan.family,
            codes=plan.count,
            seed=seed,
        )

    def _plan(self, request: CaptureRequest, grid: tuple[int, int], camera: CameraInfo) -> Plan:
        """The plan as asked for, or as a wanted error or time has it, which sets the ISO too."""
        if not wants_choice(request):
            return plan_for(request, self.config, grid, self.rig.mask_lag_s())
        setting = Setting(self.config, camera, self.profile, self.rig.mask_lag_s())
        choice = choose(request, setting, grid, self.rig.scene, self.look_for_cancel)
        own_camera = msgspec.structs.replace(self.config.camera, iso=choice.iso)
        self.config = msgspec.structs.replace(self.config, camera=own_camera)
        return choice.plan

    def failed(self, job: str, error: PdcdError, *, safe: bool) -> CaptureResult:
        """The result of a job that did not finish; its folder keeps the name that says so.

        `safe` is whether panels are black and the shutter is closed; log.jsonl keeps it.
        """
        cancelled = isinstance(error, Cancelled)
        fields = {
            "kind": error.kind,
            "message": error.message,
            "device": error.device,
            "hint": error.hint,
        }
        exists = self.folder.path.is_dir()
        if exists:
            end = {
                "t_mono_ns": self.rig.clock.now_ns(),
                "event": "cancelled" if cancelled else "failed",
                **fields,
                "safe": safe,
            }
            try:
                self.folder.log(end)
            except PdcdError as err:
                logger.warning("cannot write log.jsonl error=%s", err)
        return CaptureResult(
            job=job,
            state="cancelled" if cancelled else "failed",
            folder=str(self.folder.path) if exists else None,
            error=fields,
            files=self.folder.files(),
        )

    def notify(self, event: Event) -> None:
        """Tell the client and log.jsonl; then see whether the job is still wanted."""
        self.folder.log(events.logged(event, self.rig.clock.now_ns()))
        self._emit(event)
        self.look_for_cancel()

    def look_for_cancel(self) -> None:
        """Raise Cancelled when somebody asked for it."""
        if self._cancelled():
            raise Cancelled("the job was cancelled")

    def _watch(self) -> Watch:
        """Tells the client how far the decoding is, and sees whether the job is still wanted."""

        def step(done: float, total: float) -> None:
            self._emit(events.Decoded(done=done, total=total))

        return Watch(self.look_for_cancel, step)

    def _learn(self, plan: Plan, request: CaptureRequest, camera: CameraInfo) -> Plan:
        """After the scouts of a pilot, end it where it cannot pay; after its last photo, keep
        linked cells apart in the codes that follow."""
        scouts = scouted(plan, len(self.shots))
        if not scouts and not piloted(plan, len(self.shots)):
            return plan
        self.notify(events.Learning(photos=SCOUTS if scouts else plan.pilot))
        record = self._record(plan, request, camera)
        learned = decode(self.folder.path, record, self._watch()).learned
        if learned is None or (scouts and learned.promising):
            return plan
        if scouts:
            plan = stopped(plan, request.seed, self.config.limits.max_exposure_s)
            self.warnings.append(
                f"the pilot ended after {SCOUTS} photos, which show no sharp far paths; the coded "
                f"photo took {plan.count} codes"
            )
        elif learned.pays:
            plan = with_links(plan, learned.links, request.seed)
        else:
            self.warnings.append("the pilot found nothing that better codes could avoid")
            return plan
        self._write_patterns(plan, request.seed)
        return plan

    def _good_enough(
        self, plan: Plan, request: CaptureRequest, camera: CameraInfo, shot: Shot
    ) -> bool:
        """Whether the parts taken so far reach the error asked for; tells how far they are."""
        state = self.convergence
        if state is None or not state.after(plan.recipe, shot):
            return False
        record = self._record(plan, request, camera)
        decoded = decode(self.folder.path, record, self._watch(), known=state.known)
        self.notify(state.see(self.folder.path, decoded))
        if not state.met and shot is plan.recipe.shots[-1]:
            self.warnings.append(state.warning)
        return state.met

    def _take(self, plan: Plan, shot: Shot, camera: CameraInfo) -> None:
        """Meter if needed, expose, write the frame log, check for missed refreshes."""
        f_number = self._aperture(plan, shot, camera)
        settings = CameraSettings(self._iso(camera), f_number if camera.f_numbers else None)
        frames = plan.frames(shot)
        done, level, harm = self._sound(plan, shot, frames, settings)
        self.folder.write_frames(shot.name, frames, done.log)
        lost = int(done.log.missed.sum())
        if level is None:
            self.warnings.append(f"shot {shot.name}: {lost} refreshes were missed; {harm}")
        elif lost:
            self.warnings.append(
                f"shot {shot.name}: {lost} refreshes were missed, without harm to the codes"
            )
        if not done.log.verified:
            self.warnings.append(f"shot {shot.name}: presentation times are not verified")
        self.shots.append(
            ShotRecord(
                name=shot.name,
                window=plan.window_of(shot),
                raw=str(done.raw.path.relative_to(self.folder.path)),
                sha256=done.raw.sha256,
                size_bytes=done.raw.size_bytes,
                iso=settings.iso,
                f_number=f_number,
                open_ns=done.open_ns,
                close_ns=done.close_ns,
                end_ns=(int(done.log.end_ns[0]), int(done.log.end_ns[1])),
                refreshes=len(done.log),
                missed=lost,
                source=done.log.source,
                verified=done.log.verified,
                level=level,
            )
        )

    def _sound(
        self, plan: Plan, shot: Shot, frames: Frames, settings: CameraSettings
    ) -> tuple[Exposure, float | None, str]:
        """Expose, and once more where codes got unequal light, as often as the rig allows.

        Returns the exposure, its level (see `ShotRecord`), and what harm was done. Raises
        SyncError.
        """
        rig = self.config.rig
        # What leaks through black goes by the time an exposure took, not by its codes: photos that
        # are to be subtracted from each other must have shown them equally often.
        paired = any(s.primal_black or s.dual_black for s in plan.recipe.shots)
        for number in range(1, rig.retries + 2):
            try:
                done = self._expose(plan, shot, shot.name, settings)
            except SyncError as err:
                if rig.on_miss == "flag":
                    raise
                cause = err.message
                name = self.folder.set_aside(shot.name, number)
            else:
                level, harm = self._level(frames, done.log)
                sound = level == 1.0 if paired else level is not None
                if sound or rig.on_miss == "flag":
                    return done, level, harm
                cause = f"{int(done.log.missed.sum())} refreshes were missed; {harm}"
                name = self.folder.set_aside(shot.name, number)
                self.folder.write_frames(name, frames, done.log)
            self.notify(events.Discarded(shot=shot.name, name=name, cause=cause))
            self.warnings.append(f"shot {shot.name}: exposure {number} was discarded: {cause}")
        raise SyncError(
            f"shot {shot.name} was spoilt {rig.retries + 1} times: {cause}",
            device="display",
            hint="see frames.csv; rig.on_miss = 'flag' keeps such shots and reports the error",
        )

    def _level(self, frames: Frames, log: FrameLog) -> tuple[float | None, str]:
        """Times that every code was shown over what was planned, None where that differs; and the
        same in words."""
        try:
            weights = lit_weights(frames, log, self.config.row_hz)
        except SyncError as err:
            return None, err.message
        shares = weights.realised / weights.planned if weights.planned.size else np.ones(1)
        words = f"codes were lit {shares.min():.3g} to {shares.max():.3g} times as long as planned"
        return weights.level or None, words

    def _expose(
        self,
        plan: Plan,
        shot: Shot,
        name: str,
        settings: CameraSettings,
        *,
        pairs: int | None = None,
    ) -> Exposure:
        def progress(frame: int, frames: int, missed: int) -> None:
            told = events.Progress(shot=name, frame=frame, frames=frames, missed=missed)
            self._emit(told)

        return self.rig.expose(
            plan.frames(shot, pairs=pairs),
            settings,
            self.folder.path / "raw",
            name,
            notify=self.notify,
            progress=progress,
            cancelled=self._cancelled,
        )

    def _iso(self, camera: CameraInfo) -> int:
        iso = self.config.camera.iso
        if iso is None:
            return min(camera.isos)
        if iso not in camera.isos:
            raise ConfigError(
                f"ISO {iso} is not offered",
                device="camera",
                hint=f"take one of {', '.join(map(str, camera.isos))}",
            )
        return iso

    def _aperture(self, plan: Plan, shot: Shot, camera: CameraInfo) -> float:
        """The f-number of a shot: as configured, or by test exposures, once for each program."""
        if self.config.camera.f_number != "auto":
            return self.config.camera.f_number
        if not camera.f_numbers:
            raise ConfigError(
                "this lens cannot be set from here",
                device="camera",
                hint="set camera.f_number to what its ring says",
            )
        if shot.kind not in self.apertures:
            self.apertures[shot.kind] = self._metered(plan, shot, camera)
        return self.apertures[shot.kind]

    def _metered(self, plan: Plan, shot: Shot, camera: CameraInfo) -> float:
        iso = self._iso(camera)
        saturation_dn = self.profile.saturation_dn(iso)
        pairs, ratio = metered_pairs(plan, shot)
        aligned = self.config.camera.homography is None
        f_number = min(camera.f_numbers, key=lambda f: abs(f - FIRST_F_NUMBER))
        for test in range(1, MAX_TESTS + 1):
            name = f"meter-{shot.name}-{test}"
            done = self._expose(plan, shot, name, CameraSettings(iso, f_number), pairs=pairs)
            raw = read_raw(done.raw.path, sha256=done.raw.sha256, saturation_dn=saturation_dn)
            peak = peak_share(raw.planes, raw.saturated, saturation_dn)
            file = str(done.raw.path.relative_to(self.folder.path))
            self.meter.append({"raw": file, "f_number": f_number, "peak": peak})
            expected = expected_share(raw.planes, ratio, saturation_dn, aligned=aligned)
            f_number, settled = next_aperture(camera.f_numbers, f_number, peak, expected)
            if settled:
                return f_number
        self.warnings.append(f"metering of {shot.name} did not settle; took f/{f_number:g}")
        return f_number

    def _record(self, plan: Plan, request: CaptureRequest, camera: CameraInfo) -> RunRecord:
        red, green, blue = (float(r) for r in camera.responsivity_e)
        return RunRecord(
            goal=request.goal,
            p=request.p,
            shift=request.shift,
            radius=request.radius,
            mix=request.mix,
            period=request.period,
            codes=plan.count,
            method=request.method,
            pilot=plan.pilot,
            smooth=plan.smooth,
            parts=plan.parts,
            repeat=plan.repeat,
            black_level=plan.black_level,
            normalise=request.normalise or self.config.schedule.normalise,
            white=request.white,
            grid=plan.grid,
            projector=self.config.projector,
            mask=self.config.mask,
            responsivity_e=(red, green, blue),
            profile=self.profile,
            shots=tuple(self.shots),
            homography=self.config.camera.homography,
        )

    def _warn(self, decoded: Decoded) -> None:
        for name, shot in decoded.shots.items():
            blown = int(shot.saturated.sum())
            if blown:
                self.warnings.append(f"shot {name}: {blown} pixels are saturated")
        if self.config.camera.responsivity_e is None and not self.rig.mock:
            self.warnings.append(
                "camera.responsivity_e is not set: the scale of the pictures, and what errors were "
                "foreseen, are those of a nominal camera"
            )
        if self.profile.estimated:
            self.warnings.append(f"sensor profile {self.profile.name} is an estimate")

    def _summary(
        self, plan: Plan, method: str, decoded: Decoded
    ) -> dict[str, float | int | str | None]:
        answer = next(iter(decoded.pictures.values()))
        sigma = rms_sigma(answer)
        truth = self._truth(plan.recipe)
        error = None
        if truth is not None:
            scale = float(np.sqrt(np.mean(truth**2)))
            error = float(np.sqrt(np.mean((answer.image - truth) ** 2))) / scale if scale else None
        known = answer.sigma[np.isfinite(answer.sigma)]
        parts = max(len(part_numbers(decoded.recipe)), 1)
        exposures = [(s.close_ns - s.open_ns) * 1e-9 for s in self.shots]
        return {
            "goal": plan.recipe.goal.name,
            "method": method,
            "family": plan.family,
            "codes": plan.count * parts // plan.parts + plan.pilot,
            "parts": parts,
            "pilot": plan.pilot,
            "passes": plan.passes,
            "repeat": plan.repeat,
            "shots": len(self.shots),
            "refreshes": sum(s.refreshes for s in self.shots),
            "exposure_s": sum(exposures),
            "missed_refreshes": sum(s.missed for s in self.shots),
            "rms_sigma": sigma if np.isfinite(sigma) else None,
            "sigma_kind": answer.kind,
            "rms_error": error,
            "sigma_mean": float(known.mean()) if known.size else None,
            "predicted_error": None if plan.prediction is None else plan.prediction.error,
        }

    def _truth(self, recipe: Recipe) -> np.ndarray[Any, np.dtype[np.float64]] | None:
        """What the goal's image is in truth, (h, w, 3), where the scene is known.

        A picture that was warped has no cell left to compare with.
        """
        scene = self.rig.scene
        if scene is None or self.config.camera.homography is not None:
            return None
        truth = answer(scene, recipe)
        per_cell = self.config.camera.quads_per_cell
        image = truth.reshape(*scene.grid, 3)
        return image.repeat(per_cell, axis=0).repeat(per_cell, axis=1)
