"""A calibration in the worker: scripts are sent photos, and say what they want next."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.calibration import (
    CALIBRATION_ARRAYS,
    MAPS,
    PROFILE,
    FigureRecord,
    MeasuredValue,
    PhotoRecord,
    StepRecord,
)
from pdcd.bench.devices import CameraInfo, ShutterTiming
from pdcd.bench.exposure_time import describe_time_conflict
from pdcd.bench.tables import Config
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.preview import write_step_preview
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    StepOutcome,
    StepScript,
    UserPrompt,
)
from pdcd.calibration.shown import pack_frames
from pdcd.calibration.steps import (
    METER,
    check_frame_size,
    explain_unused_step,
    start_step_script,
)
from pdcd.errors import CalibrationError, ConfigError, PdcdError, disk_errors
from pdcd.files.arrays import list_members, read_npz
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from pdcd.files.reading import read_file
from pdcd.panels.frames import Frames
from pdcd.panels.map import Map
from pdcd.panels.map_file import save_maps
from pdcd.runs.frame_table import FrameTable
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import read_raw
from pdcd.words import MarksName, SubjectName, VerdictName

HELPED = "helped"
"""Among the settings of a step: 1 where what it asked of a person was done."""
_MAX_ARRAY_VALUES = 2**24
"""Most numbers of one array that is kept for later steps."""
_MAX_ARRAYS_BYTES = 2**30
"""Most bytes of the file that holds them all."""
_FILES = {"disparity.right": "disparities.npy"}
"""Arrays that a request takes, by name: they are also written to files of their own."""
_VERDICTS: Mapping[Verdict, VerdictName] = {
    Verdict.GOOD: "good",
    Verdict.DOUBTFUL: "doubtful",
    Verdict.BAD: "bad",
}


@dataclass(frozen=True, eq=False)
class NextPhoto:
    """Take this photo; f_number is None where the lens is not set from here. covered : with the
    projector's lens covered. moving : for a shutter that moves meanwhile. counted : none of its
    refreshes may be late."""

    name: str
    frames: Frames
    iso: int
    f_number: float | None
    covered: bool = False
    moving: ShutterTiming | None = None
    counted: bool = False


@dataclass(frozen=True)
class OperatorTask:
    """Ask somebody to do this."""

    ask: UserPrompt


@dataclass(frozen=True)
class StepResult:
    """The step is done. left_out : why its values are not used; "" where they are."""

    step: StepRecord
    left_out: str = ""


Next = NextPhoto | OperatorTask | StepResult


@dataclass(frozen=True)
class CalibrationStart:
    """What a calibration starts from.

    before : folder of the calibration in use, for arrays that later steps need.
    helped : whether somebody does what a person is asked for. subject : what is in front of the
        camera. marks : what the geometry step shows. steps : to come after the metering.
    """

    config: Config
    profile: SensorProfile
    camera: CameraInfo
    before: Path | None = None
    helped: bool = False
    subject: SubjectName = "card"
    marks: MarksName = "auto"
    steps: tuple[str, ...] = ()


@dataclass
class CalibrationStudy:
    """One calibration under way: the script that runs, and the results of those before it."""

    folder: Path
    session: CalibrationSession
    table: FrameTable
    now_utc: str = ""
    script: StepScript | None = None
    step: str = ""
    photos: list[PhotoRecord] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    seconds: float = 0.0
    settings: dict[str, float] = field(default_factory=dict)
    entries: dict[str, MeasuredValue] = field(default_factory=dict)
    profile_text: str | None = None
    left_out: dict[str, str] = field(default_factory=dict)
    steps: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # What is kept: results of bad steps are used in this calibration only.
        self.kept = replace(self.session, arrays=dict(self.session.arrays), done=[])

    @classmethod
    def begun(cls, begin: CalibrationStart, folder: Path) -> CalibrationStudy:
        """A new one, whose photos will lie in `folder`. Raises ConfigError."""
        camera, config = begin.camera, begin.config
        iso = config.camera.iso if config.camera.iso is not None else min(camera.isos)
        arrays = {} if begin.before is None else read_arrays(begin.before / CALIBRATION_ARRAYS)
        session = CalibrationSession(
            config,
            begin.profile,
            camera,
            iso,
            arrays=arrays,
            helped=begin.helped,
            subject=begin.subject,
            marks=begin.marks,
        )
        return cls(folder, session, FrameTable(folder), steps=begin.steps)

    def begin(self, step: str, now_utc: str) -> Next:
        """Start the script of a step. Raises CalibrationError."""
        session = self.session
        self.step, self.now_utc, self.photos, self.seconds = step, now_utc, [], 0.0
        self.doubts = []
        self.settings = {
            "iso": float(session.iso),
            "full_refreshes": float(session.full),
            HELPED: float(session.helped),
        }
        if session.f_number is not None:
            self.settings["f_number"] = session.f_number
        if self.steps and session.camera.frame_quads is not None:
            self._check_frame(session.camera.frame_quads[::-1])
        self.script = start_step_script(step, session)
        return self._go_on(None)

    def photo(self, record: PhotoRecord) -> Next:
        """Send the photo that was asked for. Raises DecodeError and CalibrationError."""
        began_s = time.process_time()
        raw = read_raw(
            self.folder / record.raw,
            sha256=record.sha256,
            size_bytes=record.size_bytes,
            saturation_dn=self.session.profile.saturation_dn(record.iso),
        )
        log = self.table.log_of(
            record.name,
            record.refreshes,
            end_ns=record.end_ns,
            source=record.source,
            verified=record.verified,
            mask_delay=record.mask_delay,
        )
        if not self.photos:  # the others of a step are of the same camera
            self._check_frame(raw.frame)
            self.doubts += [f"photo {record.name}: {doubt}" for doubt in raw.doubts]
        self.photos.append(record)
        name = record.name.removeprefix(f"{self.step}-")
        taken = CalibrationPhoto(
            name, raw, log, record.open_ns, record.close_ns, record.iso, record.level
        )
        open_s = taken.open_s
        if doubt := describe_time_conflict(record.planned_s or open_s, open_s, raw.exposure_s):
            self.doubts.append(f"photo {record.name}: {doubt}; look at the shutter, and repeat")
        if record.level != 1.0:
            self.doubts.append(
                f"photo {record.name}: {record.missed} refreshes came late, and its light was "
                f"divided by {record.level:.4g}; see pdcd timing"
            )
        self.seconds += time.process_time() - began_s
        return self._go_on(taken)

    def _check_frame(self, frame: tuple[int, int]) -> None:
        """Check the first photo of all: if it is too small, every further one would be for
        nothing."""
        if self.step == METER and self.steps:
            check_frame_size(self.steps, self.session, frame)

    def answered(self) -> Next:
        """Go on: what was asked of a person is done."""
        return self._go_on(None)

    def _go_on(self, taken: CalibrationPhoto | None) -> Next:
        if self.script is None:
            raise PdcdError("no step of a calibration is under way")
        began_s = time.process_time()
        try:
            wanted = self.script.send(taken)
        except StopIteration as end:
            self.script = None
            self.seconds += time.process_time() - began_s
            step = self._learn(end.value)
            return StepResult(step, self.left_out.get(step.name, ""))
        self.seconds += time.process_time() - began_s
        if isinstance(wanted, UserPrompt):
            return OperatorTask(wanted)
        return self._wanted(wanted)

    def _wanted(self, wanted: PhotoRequest) -> NextPhoto:
        session = self.session
        f_number = session.f_number if wanted.f_number is None else wanted.f_number
        return NextPhoto(
            name=f"{self.step}-{wanted.shown.name}",
            frames=pack_frames(wanted.shown),
            iso=session.iso if wanted.iso is None else wanted.iso,
            f_number=f_number,
            covered=wanted.covered,
            moving=wanted.moving,
            counted=wanted.counted,
        )

    def _learn(self, outcome: StepOutcome) -> StepRecord:
        """Use what a step found, and keep it unless it is bad or depends on something bad."""
        step = self.step
        self.session.learn(step, outcome)
        why = "bad" if outcome.verdict is Verdict.BAD else explain_unused_step(step, self.left_out)
        if why:
            self.left_out[step] = why
        else:
            self._keep(step, outcome)
        if outcome.picture is not None:
            with disk_errors(str(self.folder)):
                write_step_preview(self.folder / "preview" / f"{step}.png", outcome.picture)
        return StepRecord(
            name=step,
            made_utc=self.now_utc,
            seconds=self.seconds,
            verdict=_VERDICTS[max(outcome.verdict, Verdict(bool(self.doubts)))],
            figures=tuple(map(_record, outcome.figures)),
            advice=(*outcome.advice, *self.doubts),
            photos=tuple(self.photos),
            settings=self.settings,
        )

    def _keep(self, step: str, outcome: StepOutcome) -> None:
        self.kept.learn(step, outcome)
        for key, found in outcome.words.items():
            self.entries[key] = MeasuredValue(
                value=found.value, sigma=found.sigma, step=step, made_utc=self.now_utc
            )
        if outcome.profile is not None:
            from pdcd.calibration.sensor.body import format_profile  # what a capture never needs

            self.profile_text = format_profile(outcome.profile)

    def write(self, below: str = "") -> dict[str, MeasuredValue]:
        """Write maps, arrays and profile of the results so far, into a folder `below` where it is
        given; returns the measured values. Raises DiskError."""
        folder, kept = self.folder / below, self.kept
        with disk_errors(str(self.folder)):
            if below:
                folder.mkdir()
            if maps := self._all_maps():
                save_maps(folder / MAPS, maps)
            if kept.arrays:  # the focus keeps none
                write_arrays(folder / CALIBRATION_ARRAYS, kept.arrays)
            for name, file in _FILES.items():
                if name.partition(".")[0] in kept.done:
                    np.save(folder / file, kept.arrays[name], allow_pickle=False)
            if self.profile_text is not None:
                (folder / PROFILE).write_text(self.profile_text)
        return self.entries

    def _all_maps(self) -> dict[str, Map]:
        """The maps of all devices, measured by this calibration or before."""
        places = {
            name: getattr(self.kept.config, name).place.map
            for name in ("projector", "mask", "camera")
        }
        return {name: map_ for name, map_ in places.items() if isinstance(map_, Map)}


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as .npz, the same bytes for the same numbers. Raises OSError; ValueError for an
    array that `read_arrays` would refuse."""
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"array {name} holds values that are no numbers")
    with path.open("wb") as file:
        np.savez(file, **{name: arrays[name] for name in sorted(arrays)})  # type: ignore[arg-type]


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a calibration; none where it kept none. Raises CalibrationError."""
    try:
        if not path.exists():
            return {}
        data = read_file(path, _MAX_ARRAYS_BYTES)
        return dict(
            read_npz(data, dict.fromkeys(list_members(data), ArrayLimits(_MAX_ARRAY_VALUES)))
        )
    except (OSError, ConfigError) as err:
        why = getattr(err, "strerror", None) or str(err)
        raise CalibrationError(f"{path} cannot be used: {why}") from err
    except UnsoundFileError as err:
        raise CalibrationError(
            f"{path} cannot be used: {err.message}",
            hint='name another calibration in [calibration] use, or set it to "none"',
        ) from err


def _record(figure: MeasuredFigure) -> FigureRecord:
    def number(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return FigureRecord(
        name=figure.name,
        value=number(figure.value),
        sigma=number(figure.sigma),
        unit=figure.unit,
        limit=figure.limit,
        verdict=_VERDICTS[figure.verdict],
    )
