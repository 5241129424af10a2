"""The shots of a job: each metered, exposed, and taken again where codes got unequal light."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np

from pdcd.bench.devices import CameraInfo, CameraSettings, RawFile
from pdcd.bench.tables import Config
from pdcd.capture.job import Journal
from pdcd.capture.rig import Exposure, Rig
from pdcd.capture.sight import Sight
from pdcd.capture.worker.desk import Desk
from pdcd.capture.worker.hands import Hands
from pdcd.errors import ConfigError, ExposureError, SyncError
from pdcd.panels.balance import lit_weights
from pdcd.panels.frames import FrameLog, Frames
from pdcd.planning.look import dark_frames, last_exposed, phase_rows
from pdcd.planning.metering import MAX_TESTS, next_aperture
from pdcd.planning.plan import Plan
from pdcd.protocol import events
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import DarkPhoto, MeterRecord, ShotRecord
from pdcd.sensor.profile import SensorProfile

FIRST_F_NUMBER = 8.0
"""Aperture of the first test exposure."""


@dataclass
class ShotTaker:
    """Takes the shots of one job, one after the other, into its run folder."""

    config: Config
    rig: Rig
    camera: CameraInfo
    profile: SensorProfile
    hands: Hands
    journal: Journal
    sight: Sight
    meter: list[MeterRecord] = field(default_factory=list)
    """Test exposures so far."""
    apertures: dict[str, float] = field(default_factory=dict)
    """Metered f-number of each program, one for all its parts; white shots have none, so theirs is
    under ''."""

    def take(self, plan: Plan, shot: Shot) -> list[ShotRecord]:
        """Meter if needed, expose, write the frame log, check for missed refreshes. With two
        buckets the shot of the second one comes with it.

        Raises SyncError when a shot was spoilt too often, and what its devices raise.
        """
        f_number = self._aperture(plan, shot)
        can_set = bool(self.camera.f_numbers)
        settings = CameraSettings(self._iso(plan), f_number if can_set else None)
        frames = plan.frames(shot)
        done, level, harm = self._sound(plan, shot, frames, settings)
        folder = self.journal.folder
        folder.write_frames(shot.name, frames, done.log)
        self._warn(shot, done.log, level, harm)
        record = ShotRecord(
            name=shot.name,
            window=plan.window_of(shot),
            raw=self._file(done.raw),
            sha256=done.raw.sha256,
            size_bytes=done.raw.size_bytes,
            iso=settings.iso,
            f_number=f_number,
            open_ns=done.open_ns,
            close_ns=done.close_ns,
            end_ns=(int(done.log.end_ns[0]), int(done.log.end_ns[1])),
            refreshes=len(done.log),
            missed=int(done.log.missed.sum()),
            source=done.log.source,
            verified=done.log.verified,
            level=level,
        )
        self.journal.ledger.take(record)
        others = [self._beside(plan, s, record, done) for s in _along(plan, shot)]
        return [record, *others]

    def _beside(self, plan: Plan, shot: Shot, first: ShotRecord, done: Exposure) -> ShotRecord:
        """The shot of an exposure's second bucket. Raises ExposureError where there is none."""
        plane = done.raw.second
        if plane is None:
            raise ExposureError(
                "the camera gave one plane of an exposure",
                device="camera",
                hint="set camera.buckets to 1, or use a driver of a sensor that has two",
            )
        self.journal.folder.write_frames(shot.name, plan.frames(shot), done.log)
        record = msgspec.structs.replace(
            first,
            name=shot.name,
            raw=self._file(plane),
            sha256=plane.sha256,
            size_bytes=plane.size_bytes,
        )
        self.journal.ledger.take(record)
        return record

    def dark(self, plan: Plan, name: str, *, lit: bool) -> DarkPhoto:
        """Take a dark photo as `pdcd.planning.look` has it, at the aperture of the answer's light.

        Raises SyncError, and what the devices raise.
        """
        coded = last_exposed(plan)
        settings = CameraSettings(
            self._iso(plan), self._aperture(plan, coded) if self.camera.f_numbers else None
        )
        done = self._tested(dark_frames(plan, lit=lit), name, settings)
        file = self._file(done.raw)
        found = DarkPhoto(
            raw=file,
            sha256=done.raw.sha256,
            iso=settings.iso,
            f_number=self._aperture(plan, coded),
            exposure_s=(done.close_ns - done.open_ns) * 1e-9,
            phase_s=phase_rows(plan) / plan.row_hz,
        )
        self.meter.append(MeterRecord(raw=file, f_number=found.f_number, peak=None))
        self.journal.ledger.meter(self.meter[-1])
        return found

    def _warn(self, shot: Shot, log: FrameLog, level: float | None, harm: str) -> None:
        lost = int(log.missed.sum())
        if level is None:
            self.journal.warn(f"shot {shot.name}: {lost} refreshes were missed; {harm}")
        elif lost:
            self.journal.warn(
                f"shot {shot.name}: {lost} refreshes were missed, without harm to the codes"
            )
        if not log.verified:
            self.journal.warn(f"shot {shot.name}: presentation times are not verified")

    def _sound(
        self, plan: Plan, shot: Shot, frames: Frames, settings: CameraSettings
    ) -> tuple[Exposure, float | None, str]:
        """Expose, and once more where codes got unequal light, as often as the rig allows.

        Returns the exposure, its level (see `ShotRecord`), and what harm was done. Raises
        SyncError.
        """
        rig, folder = self.config.rig, self.journal.folder
        # What leaks through black goes by the time an exposure took, not by its codes: photos that
        # are to be subtracted from each other must have shown them equally often.
        paired = any(s.primal_black or s.dual_black for s in plan.recipe.shots)
        for number in range(1, rig.retries + 2):
            try:
                done = self._expose(frames, shot.name, settings)
            except SyncError as err:
                if rig.on_miss == "flag":
                    raise
                cause = err.message
                name = folder.set_aside(shot.name, number)
            else:
                level, harm = self._level(frames, done.log)
                sound = level == 1.0 if paired else level is not None
                if sound or rig.on_miss == "flag":
                    return done, level, harm
                cause = f"{int(done.log.missed.sum())} refreshes were missed; {harm}"
                name = folder.set_aside(shot.name, number)
                folder.write_frames(name, frames, done.log)
            self.journal.notify(events.Discarded(shot=shot.name, name=name, cause=cause))
            self.journal.warn(f"shot {shot.name}: exposure {number} was discarded: {cause}")
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

    def _tested(self, frames: Frames, name: str, settings: CameraSettings) -> Exposure:
        """Take a test exposure or a dark photo, again where the display gave up, as often as the
        rig allows. Raises SyncError."""
        rig = self.config.rig
        for number in range(1, rig.retries + 1):
            try:
                return self._expose(frames, name, settings)
            except SyncError as err:
                if rig.on_miss == "flag":
                    raise
                cause = err.message
            aside = self.journal.folder.set_aside(name, number)
            self.journal.notify(events.Discarded(shot=name, name=aside, cause=cause))
        return self._expose(frames, name, settings)

    def _expose(self, frames: Frames, name: str, settings: CameraSettings) -> Exposure:
        def progress(frame: int, of: int, missed: int) -> None:
            told = events.Progress(shot=name, frame=frame, frames=of, missed=missed)
            self.journal.job.emit(told)

        done = self.rig.expose(
            frames,
            settings,
            self.journal.folder.path / "raw",
            name,
            notify=self.journal.notify,
            progress=progress,
            cancelled=self.journal.job.cancelled,
        )
        # At once: every further exposure would be for nothing.
        file, watch = self._file(done.raw), self.journal.job.watch()
        self.sight.saw(file, self.hands.do(watch, Desk.look, file, done.raw.sha256))
        return done

    def _file(self, raw: RawFile) -> str:
        """Path of a RAW file in the run folder."""
        return str(raw.path.relative_to(self.journal.folder.path))

    def _iso(self, plan: Plan) -> int:
        if plan.iso is None:
            return min(self.camera.isos)
        if plan.iso not in self.camera.isos:
            raise ConfigError(
                f"ISO {plan.iso} is not offered",
                device="camera",
                hint=f"take one of {', '.join(map(str, self.camera.isos))}",
            )
        return plan.iso

    def _aperture(self, plan: Plan, shot: Shot) -> float:
        """The f-number of a shot: as configured, or by test exposures, once for each program."""
        if self.config.camera.f_number != "auto":
            return self.config.camera.f_number
        if not self.camera.f_numbers:
            raise ConfigError(
                "this lens cannot be set from here",
                device="camera",
                hint="set camera.f_number to what its ring says",
            )
        if shot.kind not in self.apertures:
            self.apertures[shot.kind] = self._metered(plan, shot)
        return self.apertures[shot.kind]

    def _metered(self, plan: Plan, shot: Shot) -> float:
        iso = self._iso(plan)
        saturation_dn = self.profile.saturation_dn(iso)
        watch = self.journal.job.watch()
        pairs = self.hands.do(watch, Desk.meter_pairs, shot.name)
        apertures = self.camera.f_numbers
        f_number = min(apertures, key=lambda f: abs(f - FIRST_F_NUMBER))
        for test in range(1, MAX_TESTS + 1):
            name = f"meter-{shot.name}-{test}"
            settings = CameraSettings(iso, f_number)
            done = self._tested(plan.frames(shot, pairs=pairs), name, settings)
            file = self._file(done.raw)
            planes = [done.raw] if done.raw.second is None else [done.raw, done.raw.second]
            seen = [
                self.hands.do(watch, Desk.metered, self._file(p), p.sha256, saturation_dn)
                for p in planes
            ]
            peak, expected = max(s.peak for s in seen), max(s.expected for s in seen)
            self.meter.append(MeterRecord(raw=file, f_number=f_number, peak=peak))
            self.journal.ledger.meter(self.meter[-1])
            f_number, settled = next_aperture(apertures, f_number, peak, expected)
            if settled:
                return f_number
        self.journal.warn(f"metering of {shot.name} did not settle; took f/{f_number:g}")
        return f_number


def _along(plan: Plan, shot: Shot) -> list[Shot]:
    """Shots that come with the exposure of another one."""
    return [other for other in plan.recipe.shots if other.beside == shot.name]
