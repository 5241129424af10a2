"""A calibration computed again from its photos: every number must be the same, bit for bit."""

from __future__ import annotations

import tempfile
from pathlib import Path

import msgspec

from pdcd.bench.calibration import (
    CALIBRATION_ARRAYS,
    MAPS,
    MAX_RECORD_BYTES,
    PROFILE,
    RECORD,
    Calibration,
    StepRecord,
    read_calibration,
)
from pdcd.bench.tables import Config
from pdcd.capture.worker.calibrating import (
    HELPED,
    CalibrationStart,
    CalibrationStudy,
    OperatorTask,
    StepResult,
)
from pdcd.errors import CalibrationError, ConfigError, disk_errors
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import MAX_PICTURE_BYTES, hash_file
from pdcd.files.text import encode_json
from pdcd.sensor.profile import SensorProfile

_LOOK, _FIRST = "check.", "check.dots"
"""Prefix of the arrays of a snapshot that is kept for checks, and a figure that only the first
snapshot has."""


class _Item(msgspec.Struct, frozen=True):
    """One thing that was computed again: a step's figures, a value, a file."""

    name: str
    identical: bool


class _Again(msgspec.Struct, frozen=True, kw_only=True):
    """The results of computing a calibration again."""

    folder: str
    items: tuple[_Item, ...]
    identical: bool


def recompute_calibration(folder: Path) -> _Again:
    """Compute all steps of a calibration folder from its photos, in their order.

    Nothing in the folder is changed. Raises ConfigError for a folder that is not a calibration,
    DecodeError for a photo that has changed, CalibrationError where a step now asks for other
    photos.
    """
    record, _ = read_calibration(folder)
    with (
        disk_errors("scratch"),
        tempfile.TemporaryDirectory(prefix="pdcd-again-") as scratch,
    ):
        work = Path(scratch)
        (work / "preview").mkdir()
        for name in ("raw", "frames.csv"):
            (work / name).symlink_to((folder / name).resolve())
        study = CalibrationStudy.begun(_begin(record, folder), work)
        if _looked_first(record):
            for name in [name for name in study.session.arrays if name.startswith(_LOOK)]:
                del study.session.arrays[name]
        items = [
            _Item(f"step {step.name}", _same(step, _computed(study, step))) for step in record.steps
        ]
        entries = study.write()
        for key, entry in sorted(record.measured.items()):
            if entry.folder is None:
                items.append(_Item(key, key in entries and _plain(entries[key]) == _plain(entry)))
        items += [
            _Item(
                name,
                (work / name).exists()
                and hash_file(work / name, MAX_PICTURE_BYTES) == record.files[name].sha256,
            )
            for name in (MAPS, CALIBRATION_ARRAYS, PROFILE)
            # A profile may be that of the previous calibration.
            if name in record.files and (name != PROFILE or (work / name).exists())
        ]
    return _Again(
        folder=str(folder), items=tuple(items), identical=all(item.identical for item in items)
    )


def _begin(record: Calibration, folder: Path) -> CalibrationStart:
    """What the calibration started from. Raises ConfigError."""
    try:
        config = msgspec.convert(record.belief, Config, strict=False)
        profile = msgspec.convert(record.profile, SensorProfile, strict=False)
    except msgspec.ValidationError as err:
        raise ConfigError(f"the calibration in {folder} cannot be computed again: {err}") from err
    before = _before(record, folder)
    helped = any(step.settings.get(HELPED) for step in record.steps)
    return CalibrationStart(
        config, profile, record.camera.info, before, helped, record.subject, record.marks
    )


def _before(record: Calibration, folder: Path) -> Path | None:
    """Folder of the previous calibration, found by its digest: beside this one, or where values
    were taken over from. Where it is gone, this folder itself: its arrays include those of the
    previous one, except for what its own steps measured again."""
    if record.before is None:
        return None
    named = {Path(entry.folder) for entry in record.measured.values() if entry.folder}
    for candidate in sorted(named | set(folder.resolve().parent.iterdir())):
        try:
            found = hash_file(candidate / RECORD, MAX_RECORD_BYTES)
        except UnsoundFileError:
            continue
        if found == record.before:
            return candidate
    return folder


def _looked_first(record: Calibration) -> bool:
    """Whether a check had no reference to compare with, so that the one that is kept now is its
    own."""
    return any(figure.name == _FIRST for step in record.steps for figure in step.figures)


def _computed(study: CalibrationStudy, step: StepRecord) -> StepRecord:
    """Compute a step again from its photos."""
    photos = list(step.photos)
    wanted = study.begin(step.name, step.made_utc)
    while not isinstance(wanted, StepResult):
        if isinstance(wanted, OperatorTask):
            wanted = study.answered()
            continue
        if not photos or photos[0].name != wanted.name:
            raise CalibrationError(
                f"step {step.name} of this pdcd takes a photo {wanted.name}, which the one that "
                "made the folder did not",
                hint=f"compute it again with that version, or run pdcd calibrate {step.name}",
            )
        wanted = study.photo(photos.pop(0))
    return wanted.step


def _same(old: StepRecord, new: StepRecord) -> bool:
    return (old.figures, old.advice, old.verdict) == (new.figures, new.advice, new.verdict)


def _plain(value: object) -> object:
    return msgspec.json.decode(encode_json(value))
