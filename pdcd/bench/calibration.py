"""A calibration as it is kept: what a bench measured of itself, and how, in one folder.

::

    <name>/calibration.json          all figures and values; written last
    <name>/calibration.json.sha256   its digest, as `sha256sum` writes it
    <name>/maps.npz                  where projector, mask and camera lie on the field
    <name>/arrays.npz                what further steps and checks need: covariances, references
    <name>/sensor.toml               the camera's profile, once it was measured
    <name>/raw/                      the photos, byte for byte
    <name>/frames.csv                what both panels showed in each of them, and when
    <name>/preview/                  a picture for each step, to look at

A calibration is complete: values that its own steps did not measure are taken over from the
calibration before it, each with the name of the folder that has its photos. A calibration under way
is kept step by step: `<name>.partial/kept-NN/` has the record, maps and arrays as of the end of
step NN. Such a folder is complete as soon as it has that name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta

from pdcd.bench.devices import CameraInfo
from pdcd.errors import ConfigError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import read_file
from pdcd.files.text import encode_json
from pdcd.words import MarksName, StepName, SubjectName, VerdictName

RECORD, CALIBRATION_DIGEST = "calibration.json", "calibration.json.sha256"
MAPS, CALIBRATION_ARRAYS, PROFILE = "maps.npz", "arrays.npz", "sensor.toml"
STEP_FOLDER_PREFIX = "kept-"
"""Prefix of folders that hold what was found so far."""
SCHEMA = 1
"""Schema number of `calibration.json`."""
MAX_RECORD_BYTES = 2**24

_Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
_Count = Annotated[int, Meta(ge=0, le=2**62)]
_Sigma = Annotated[float, Meta(ge=0.0)]
_Nanoseconds = Annotated[int, Meta(ge=-(2**62), le=2**62)]
_Name = Annotated[str, Meta(pattern="^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]


class MeasuredValue(msgspec.Struct, frozen=True, kw_only=True):
    """One value of the configuration that was measured.

    value : as the configuration file would have it; of a map the name of its file.
    sigma : one standard deviation, in the value's unit; None where that is no number.
    folder : of an earlier calibration that it was taken over from; None: measured in this one.
    """

    value: Any
    sigma: _Sigma | tuple[_Sigma, ...] | None = None
    step: str
    made_utc: str
    folder: str | None = None


class FigureRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One figure of a step, as `pdcd.calibration.figures.MeasuredFigure`."""

    name: str
    value: float | None
    sigma: float | None
    unit: str
    limit: str
    verdict: VerdictName


class PhotoRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One photo as it was taken. Times are ns of the rig's clock."""

    name: _Name
    raw: str
    sha256: _Sha256
    size_bytes: _Count
    iso: Annotated[int, Meta(ge=1)]
    f_number: float | None
    open_ns: _Nanoseconds
    close_ns: _Nanoseconds
    end_ns: tuple[_Nanoseconds, _Nanoseconds]
    refreshes: _Count
    missed: _Count
    mask_delay: int
    source: str
    verified: bool
    planned_s: float | None = None
    """How long the shutter was planned to be open; None where nothing was planned."""
    level: Annotated[float, Meta(gt=0.0)] = 1.0
    """Light divided by what was planned, where refreshes came late and the photo was kept."""


class StepRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What one step took, found and advises."""

    name: _Name
    made_utc: str
    seconds: float
    """Computing time, without exposures."""
    verdict: VerdictName
    figures: tuple[FigureRecord, ...]
    advice: tuple[str, ...]
    photos: tuple[PhotoRecord, ...]
    settings: dict[str, float]
    """What the step began with: `iso`, `f_number`, `full_refreshes`."""


class BenchIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """Which devices were measured; "" and None where nobody says."""

    rig: str
    camera_model: str
    camera_serial: str
    frame_quads: tuple[int, int] | None
    flip: int | None
    projector: str
    mask: str
    projector_hz: float
    mask_hz: float
    iso: int
    f_number: float | None
    truth: str = ""
    """SHA-256 of the file that says what a mock bench really is; "" where there is none."""


class CameraRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The camera as its driver told of it (`pdcd.bench.devices.CameraInfo`)."""

    model: str
    serial: str
    profile: str
    responsivity_e: tuple[float, ...]
    isos: tuple[int, ...]
    f_numbers: tuple[float, ...]
    frame_quads: tuple[int, int] | None
    cfa: str | None = "RGGB"

    @classmethod
    def of(cls, info: CameraInfo) -> CameraRecord:
        """The part of it that is kept."""
        return cls(
            model=info.model,
            serial=info.serial,
            profile=info.profile,
            responsivity_e=tuple(info.responsivity_e.tolist()),
            isos=info.isos,
            f_numbers=info.f_numbers,
            frame_quads=info.frame_quads,
            cfa=info.cfa,
        )

    @property
    def info(self) -> CameraInfo:
        """The same as scripts get it."""
        return CameraInfo(
            model=self.model,
            serial=self.serial,
            profile=self.profile,
            responsivity_e=np.array(self.responsivity_e, dtype=np.float64),
            isos=self.isos,
            f_numbers=self.f_numbers,
            frame_quads=self.frame_quads,
            cfa=self.cfa,
        )


class CalibrationFile(msgspec.Struct, frozen=True):
    """A file of the folder as it was when the calibration ended."""

    sha256: _Sha256
    size_bytes: _Count


class CalibrationStop(msgspec.Struct, frozen=True, kw_only=True):
    """What a calibration ended by that did not come to its end."""

    step: str
    kind: str
    message: str
    hint: str | None = None


class Calibration(msgspec.Struct, frozen=True, kw_only=True):
    """`calibration.json`."""

    schema: Annotated[int, Meta(ge=SCHEMA, le=SCHEMA)]
    name: _Name
    version: str
    started_utc: str
    finished_utc: str
    verdict: VerdictName
    identity: BenchIdentity
    belief: dict[str, dict[str, Any]]
    """The configuration when the calibration began, so that it can be computed again."""
    camera: CameraRecord
    profile: dict[str, Any]
    """The sensor's profile when the calibration began."""
    measured: dict[str, MeasuredValue]
    """By key of the configuration: "mask.skew_s"."""
    config: dict[str, Any] = {}
    """The values alone, in the tables of a configuration file."""
    steps: tuple[StepRecord, ...]
    before: str | None
    """Digest of the calibration that was in use when it began, where there was one."""
    subject: SubjectName = "card"
    marks: MarksName = "auto"
    """What it was made on, and which marks were asked for."""
    files: dict[str, CalibrationFile]
    """Every other file of the folder, except the digest."""
    state: Literal["running", "done", "failed", "cancelled"] | None = None
    """"running": the state at the end of its last step. None: written by a version that kept no
    steps; `verdict` then holds for all of it."""
    stopped: CalibrationStop | None = None
    left_out: dict[str, str] = {}
    """Steps whose values are not among those measured, and why not."""
    asked: tuple[StepName, ...] = ()
    """Steps that were asked for by name; empty: all that a bench needs."""
    taken_over: dict[str, str] = {}
    """Steps that were taken over from the calibration before, which had stopped, and when they were
    measured."""
    bench: dict[str, dict[str, Any]] = {}
    """For a mock bench, the tables that make it, as they were typed. On another mock bench,
    "latest" never means this calibration."""

    @property
    def found(self) -> dict[str, str]:
        """Steps whose values it has, and when they were measured."""
        return {**self.taken_over, **self._own}

    @property
    def usable(self) -> bool:
        """Whether any of it may be used. Bad values are left out, unless all of them are bad."""
        return self.verdict != "bad" or (self.state is not None and bool(self._own))

    @property
    def _own(self) -> dict[str, str]:
        names = set(get_args(StepName)) - self.left_out.keys()
        return {step.name: step.made_utc for step in self.steps if step.name in names}


def to_config_tables(measured: Mapping[str, MeasuredValue]) -> dict[str, Any]:
    """Measured values as tables of a configuration file."""
    found: dict[str, Any] = {}
    for key, entry in sorted(measured.items()):
        *tables, name = key.split(".")
        table = found
        for part in tables:
            table = table.setdefault(part, {})
        table[name] = entry.value
    return found


def encode_calibration(record: Calibration) -> bytes:
    """The bytes of `calibration.json`."""
    return msgspec.json.format(encode_json(record), indent=1) + b"\n"


def format_digest_line(data: bytes, name: str = RECORD) -> bytes:
    """The line of `sha256sum` for a file with these bytes and that name."""
    return f"{hashlib.sha256(data).hexdigest()}  {name}\n".encode()


def read_calibration(folder: Path) -> tuple[Calibration, str]:
    """The record of a calibration folder, and its digest.

    Raises ConfigError for a folder that holds none, a damaged one, or one of another schema. The
    other files are not checked here: whoever reads them, and `pdcd verify`, does that.
    """
    try:
        data, said = (
            read_file(folder / n, m)
            for n, m in ((RECORD, MAX_RECORD_BYTES), (CALIBRATION_DIGEST, 200))
        )
        record = msgspec.json.decode(data, type=Calibration)
    except (
        UnsoundFileError,
        msgspec.MsgspecError,
        ValueError,
        RecursionError,
    ) as err:
        why = getattr(err, "message", None) or str(err)
        raise ConfigError(
            f"the calibration in {folder} cannot be used: {why}",
            hint="name a folder that pdcd calibrate made, or set [calibration] use",
        ) from err
    if said != format_digest_line(data):
        raise make_changed_error(folder, f"{RECORD} has another digest")
    return record, hashlib.sha256(data).hexdigest()


def make_changed_error(folder: Path, why: str) -> ConfigError:
    """The error for a calibration with a file that is not as the calibration wrote it."""
    return ConfigError(
        f"the calibration in {folder} is not as it was written: {why}",
        hint="restore it from a copy, or calibrate again",
    )
