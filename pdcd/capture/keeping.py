"""Keeps the results of a calibration as each step ends; where one stopped, the next goes on."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

import msgspec

from pdcd.bench import calibration as kept
from pdcd.bench.calibration import (
    STEP_FOLDER_PREFIX,
    BenchIdentity,
    Calibration,
    CalibrationFile,
    CalibrationStop,
    CameraRecord,
    MeasuredValue,
    StepRecord,
    read_calibration,
)
from pdcd.bench.choosing import hash_truth_file, select_mock_tables
from pdcd.bench.devices import CameraInfo
from pdcd.bench.measured import compute_age_h
from pdcd.bench.tables import Config
from pdcd.calibration.steps import GOES_BY, STALE
from pdcd.capture.rig import Rig
from pdcd.capture.worker.calibrating import StepResult
from pdcd.errors import Cancelled, PdcdError, disk_errors, to_typed_error
from pdcd.files.reading import read_file
from pdcd.protocol.request import CalibrateRequest
from pdcd.runs.folder import LOG, RunFolder, write_through
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.provenance import format_utc_now
from pdcd.sensor.profile import SensorProfile
from pdcd.version import __version__
from pdcd.words import VerdictName

logger = logging.getLogger(__name__)

_GOES_ON_H = 12.0
"""Hours after which the results of a stopped calibration are measured again: lamp and room may
differ on another day."""
_ORDER: tuple[VerdictName, ...] = ("good", "doubtful", "bad")
_State = Literal["running", "done", "failed", "cancelled"]


@dataclass(frozen=True)
class PreviousCalibration:
    """The calibration that is in use when another one begins."""

    folder: Path
    record: Calibration
    digest: str


@dataclass
class CalibrationKeeper:
    """The folder of one calibration, which is a sound calibration after every step.

    config : in use. typed : the same without measured values. before : the previous calibration,
        whose steps `taken_over` are not measured again. write : writes the results so far into a
        new folder of that name, and returns the values.
    """

    config: Config
    typed: Config
    rig: Rig
    profile: SensorProfile
    camera: CameraInfo
    folder: RunFolder
    job: str
    request: CalibrateRequest
    before: PreviousCalibration | None
    taken_over: Mapping[str, str]
    write: Callable[[str], dict[str, MeasuredValue]]
    started_utc: str = field(default_factory=format_utc_now)
    steps: list[StepRecord] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    stale: dict[str, str] = field(default_factory=dict)
    flip: int | None = None
    _measured: dict[str, MeasuredValue] = field(default_factory=dict)
    _kept: Path | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Steps whose values are used, without those taken over."""
        return tuple(step.name for step in self._kept_steps)

    @property
    def verdict(self) -> VerdictName:
        """The worst verdict of all steps so far."""
        return _ORDER[max((_ORDER.index(step.verdict) for step in self.steps), default=0)]

    def keep(self, found: StepResult) -> None:
        """Keep what a step found, durably. Raises NoSpaceError and DiskError."""
        self.steps.append(found.step)
        if found.left_out:
            self.left_out[found.step.name] = found.left_out
        if len(self.steps) == 1:
            return  # the metering before all steps tells nothing that is kept
        name = f"{STEP_FOLDER_PREFIX}{len(self.steps) - 1:02d}"
        new, root = self.folder.path / f"{name}.new", self.folder.path
        measured = self.write(new.name)
        self._carry_over(measured, new)
        with disk_errors(str(self.folder.where)):
            for file in (FRAMES, *(photo.raw for photo in found.step.photos)):
                if (root / file).exists():
                    write_through(root / file)
            data = kept.encode_calibration(self._record("running", measured, self._files(new)))
            (new / kept.RECORD).write_bytes(data)
            (new / kept.CALIBRATION_DIGEST).write_bytes(kept.format_digest_line(data))
            for path in (*new.iterdir(), new, root / "raw"):
                write_through(path)
            new.rename(root / name)
            write_through(root)
            if self._kept is not None:
                shutil.rmtree(self._kept)
        self._kept, self._measured = root / name, measured

    def finish(self, state: _State, stopped: CalibrationStop | None = None) -> str:
        """Complete the folder with what is kept, and give it its final name; returns its digest.

        Raises NoSpaceError and DiskError; what is kept then stays.
        """
        root = self.folder.path
        if self._kept is not None:
            with disk_errors(str(self.folder.where)):
                for path in self._kept.iterdir():
                    if path.name not in (kept.RECORD, kept.CALIBRATION_DIGEST):
                        shutil.copyfile(path, root / path.name)
        files = {
            name: CalibrationFile(found.sha256, found.size_bytes)
            for name, found in self.folder.hashes(self.rig.pulse).items()
            if not name.startswith(STEP_FOLDER_PREFIX)
        }
        data = kept.encode_calibration(self._record(state, self._measured, files, stopped))
        line = kept.format_digest_line(data)
        sha256 = self.folder.finish_with(
            data, kept.RECORD, line, kept.CALIBRATION_DIGEST, self.rig.pulse
        )
        for path in self.folder.path.glob(f"{STEP_FOLDER_PREFIX}*"):
            shutil.rmtree(path, ignore_errors=True)
        return sha256

    def end_early(self, step: str, err: Exception) -> bool:
        """Complete the folder of a calibration that ends with an error, with the results until
        then. Returns whether there are any. Raises nothing."""
        if not self.names:
            return False
        state: _State = "cancelled" if isinstance(err, Cancelled) else "failed"
        typed = to_typed_error(err)
        stopped = CalibrationStop(
            step=step,
            kind=typed.kind,
            message=self.folder.put_own_path(typed.message),
            hint=typed.hint,
        )
        try:
            line = {"t_mono_ns": self.rig.clock.now_ns(), "event": state}
            self.folder.log({**line, **msgspec.structs.asdict(stopped)})
            self.finish(state, stopped)
        except (PdcdError, OSError) as fault:  # what the steps left below the folder is still there
            logger.warning("a stopped calibration could not be finished: %s", fault)
            return False
        return True

    @property
    def _kept_steps(self) -> list[StepRecord]:
        return [step for step in self.steps[1:] if step.name not in self.left_out]

    def _files(self, new: Path) -> dict[str, CalibrationFile]:
        """The files that belong to what is kept: all photos, and other files as they are now."""
        photos = [photo for step in self.steps for photo in step.photos]
        files = {photo.raw: CalibrationFile(photo.sha256, photo.size_bytes) for photo in photos}
        for name, found in self.folder.hashes(
            self.rig.pulse, skip=("raw/", LOG, STEP_FOLDER_PREFIX)
        ).items():
            files[name] = CalibrationFile(found.sha256, found.size_bytes)
        return files

    def _carry_over(self, measured: dict[str, MeasuredValue], into: Path) -> None:
        """Take over from the previous calibration what this one did not measure, except for what it
        invalidated. Raises NoSpaceError and DiskError."""
        if self.before is None:
            return
        folder, names = self.before.folder, {step.name for step in self._kept_steps}
        stale = {key: step for step in names for key in STALE.get(step, ())}
        self.stale = {}
        for key, entry in self.before.record.measured.items():
            if key in measured:
                continue
            if key in stale:
                self.stale[key] = (
                    f"{key} is no longer used: {stale[key]} was measured again after {entry.step} "
                    f"found it; run pdcd calibrate {entry.step}"
                )
                continue
            measured[key] = msgspec.structs.replace(entry, folder=entry.folder or str(folder))
        own, old = into / kept.PROFILE, folder / kept.PROFILE
        if "camera.profile" in measured and not own.exists() and old.exists():
            with disk_errors(str(self.folder.where)):
                own.write_bytes(read_file(old, kept.MAX_RECORD_BYTES))

    def _record(
        self,
        state: _State,
        measured: dict[str, MeasuredValue],
        files: dict[str, CalibrationFile],
        stopped: CalibrationStop | None = None,
    ) -> Calibration:
        before = self.before
        return Calibration(
            schema=kept.SCHEMA,
            name=self.job,
            version=__version__,
            started_utc=self.started_utc,
            finished_utc=format_utc_now(),
            verdict=self.verdict,
            identity=self._identity(),
            belief=msgspec.to_builtins(self.config),
            camera=CameraRecord.of(self.camera),
            profile=msgspec.to_builtins(self.profile),
            measured=measured,
            config=kept.to_config_tables(measured),
            steps=tuple(self.steps),
            before=None if before is None else before.digest,
            subject=self.request.subject,
            marks=self.request.marks,
            files=files,
            state=state,
            stopped=stopped,
            left_out=self.left_out,
            asked=self.request.steps,
            taken_over=dict(self.taken_over),
            bench=select_mock_tables(self.typed),
        )

    def _identity(self) -> BenchIdentity:
        config, display, camera = self.config, self.rig.display_info, self.camera
        settings = self.steps[-1].settings if self.steps else {}
        named = {} if display is None else display.identity
        return BenchIdentity(
            rig=config.rig.name,
            camera_model=camera.model,
            camera_serial=camera.serial,
            frame_quads=camera.frame_quads,
            flip=self.flip,
            projector=named.get("projector", ""),
            mask=named.get("mask", ""),
            projector_hz=config.projector.refresh_hz,
            mask_hz=config.mask.refresh_hz,
            iso=int(settings.get("iso", 0)),
            f_number=settings.get("f_number"),
            truth=hash_truth_file(self.typed),
        )


def read_previous_calibration(folder: Path | None) -> PreviousCalibration | None:
    """The calibration in use, where there is one that can be read."""
    if folder is None:
        return None
    try:
        return PreviousCalibration(folder, *read_calibration(folder))
    except PdcdError as err:
        logger.warning("calibration before cannot be used: %s", err)
        return None


def find_reusable_steps(
    before: PreviousCalibration | None,
    request: CalibrateRequest,
    names: tuple[str, ...],
    now: datetime | None = None,
) -> dict[str, str]:
    """Steps of `names` that need not be repeated, and when they were measured: those that an equal
    calibration, which stopped recently, has completed. Empty where steps were named."""
    if before is None or request.anew or request.steps:
        return {}
    record = before.record
    same = (record.subject, record.marks, record.asked) == (request.subject, request.marks, ())
    if record.state in (None, "done") or not same:
        return {}
    over: dict[str, str] = {}
    again: set[str] = set()
    for name in names:
        made = record.found.get(name)
        if (
            made is None
            or measure_age_h(made, now) > _GOES_ON_H
            or again & GOES_BY.get(name, frozenset())
        ):
            again.add(name)
        else:
            over[name] = made
    return over if again else {}


def describe_reused_steps(before: PreviousCalibration, over: Mapping[str, str]) -> str:
    """Which steps are taken over, and how old they are, in a line."""
    oldest = max(map(measure_age_h, over.values()))
    return (
        f"goes on where {before.record.name} stopped: {', '.join(over)} taken over, at most "
        f"{oldest:.1f} h old (--anew measures all again)"
    )


def measure_age_h(made_utc: str, now: datetime | None = None) -> float:
    """Hours since then; infinite where the time is unknown, or in the future."""
    hours = compute_age_h(made_utc, now)
    return hours if hours > -0.1 else float("inf")
