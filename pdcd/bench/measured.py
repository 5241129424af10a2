"""The configuration with the values that a calibration measured in place of typed ones.

`[calibration] use` names the calibration: "latest", a folder by its path, or "none". "latest" is
the one that `pdcd calibrate use` named, else the newest of the state folder that fits.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.calibration import (
    MAPS,
    MAX_RECORD_BYTES,
    PROFILE,
    STEP_FOLDER_PREFIX,
    Calibration,
    MeasuredValue,
    make_changed_error,
    read_calibration,
)
from pdcd.bench.checks import check_config
from pdcd.bench.choosing import (
    BENCH_TABLES,
    UNFINISHED_CALIBRATION,
    describe_other_bench,
    find_calibration,
    find_other_device,
    list_candidates,
    read_candidate,
    read_pinned_name,
)
from pdcd.bench.devices import CameraInfo, DisplayInfo
from pdcd.bench.stops import STOP_SIGMA, AbsoluteScale, stop_of
from pdcd.bench.tables import CalibrationConfig, Config
from pdcd.bench.truth import TYPED
from pdcd.errors import ConfigError, disk_errors
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import hash_file
from pdcd.files.text import encode_json
from pdcd.panels.map import Map
from pdcd.panels.map_file import load_maps
from pdcd.panels.placing import Placing
from pdcd.printable import to_one_line

_DEVICES = ("projector", "mask", "camera")
TIME_KEYS = (
    "mask.skew_s",
    *(f"{p}.{t}" for p in ("projector", "mask") for t in ("rise_s", "fall_s")),
)
"""Values that must be measured before a schedule of fewer refreshes can be trusted."""


@dataclass(frozen=True)
class CalibrationChoice:
    """The calibration that is used.

    config : the configuration with its values.
    folder : None where none is used.
    passed : newer calibrations that were skipped because they do not fit, a line each.
    """

    config: Config
    folder: Path | None = None
    passed: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """What was skipped and why, for people, in one line; "" for nothing."""
        if not self.passed:
            return ""
        more = f", and {len(self.passed) - 1} more" if len(self.passed) > 1 else ""
        used = (
            "none is used"
            if self.folder is None
            else f"{parse_calibration_name(self.folder)} is used"
        )
        return f"{used}; calibration {self.passed[0]}{more}: passed over (see pdcd calibrate list)"


def apply_calibration(config: Config) -> Config:
    """The configuration with the values of the calibration that it asks for."""
    return choose_calibration(config).config


def choose_calibration(
    config: Config, camera: CameraInfo | None = None, display: DisplayInfo | None = None
) -> CalibrationChoice:
    """The calibration that a configuration asks for, and the configuration with its values.

    `calibration.use` and `calibration.sha256` of the result name the one that was taken, so that
    doing this again changes nothing. "latest" skips calibrations that do not fit, that cannot be
    read, or that are of other devices than those that are open, where these are known; if none is
    left, none is used. Raises ConfigError for a calibration that was named and cannot be used.
    """
    use = config.calibration.use
    name = read_pinned_name(config) if use == "latest" else None
    if "none" in (use, name):
        return CalibrationChoice(config)
    if use != "latest":
        return _named(config, Path(use), 'run pdcd calibrate, or set [calibration] use = "none"')
    if name is not None:
        found = read_candidate(find_calibration(config, name), config)
        folder = find_calibration(config, name) if found is None else found.folder
        return _named(config, folder, "run pdcd calibrate use latest, or name another one")
    passed: list[str] = []
    for found in list_candidates(config):
        if not found.ours or found.running:
            continue
        why, record = found.why, found.record
        if record is not None and (other := find_other_device(record, camera, display)) is not None:
            why = why or other[1]
        if not why:
            try:
                return CalibrationChoice(
                    use_calibration_folder(config, found.folder), found.folder, tuple(passed)
                )
            except ConfigError as err:
                if config.calibration.sha256 is not None:
                    raise
                why = to_one_line(err.message)
        passed.append(f"{found.name}: {why}")
    return CalibrationChoice(config, None, tuple(passed))


def choose_calibration_folder(config: Config) -> Path | None:
    """Folder of the calibration that is asked for; None for none."""
    use = config.calibration.use
    return Path(use) if use not in ("none", "latest") else choose_calibration(config).folder


def use_calibration_folder(config: Config, folder: Path) -> Config:
    """The configuration with the values of the calibration in a folder. Raises ConfigError."""
    record, digest = read_calibration(folder)
    wanted = config.calibration.sha256
    if wanted is not None and wanted != digest:
        raise ConfigError(
            f"the calibration in {folder} is not the one with the digest that is asked for",
            hint="remove [calibration] sha256, or name the folder that has it",
        )
    entries = select_measured_values(record, config.calibration)
    _check_keys(entries)
    _check_unchanged(record, entries, folder)
    used = with_guards(with_measured_values(config, entries, folder), record.measured)
    _check_values(used, config, folder)
    # What with_values says of the table stays.
    table = msgspec.structs.replace(used.calibration, use=str(folder), sha256=digest)
    return msgspec.structs.replace(used, calibration=table)


def _check_keys(entries: Iterable[str]) -> None:
    """Raise ConfigError for a measured value that does not describe a bench, such as one of the
    server's."""
    for key in entries:
        if key.partition(".")[0] not in (*BENCH_TABLES, "rig"):
            raise ConfigError(
                f"{to_one_line(key)} is no value that a calibration measures",
                hint="calibrate again with this version of pdcd",
            )


def _check_unchanged(record: Calibration, entries: Iterable[str], folder: Path) -> None:
    """Raise ConfigError where maps or the profile differ from those that the calibration wrote.

    The record of a calibration under way lists neither.
    """
    read = {MAPS for key in entries if key.endswith(".place.map")}
    read |= {PROFILE for key in entries if key == "camera.profile"}
    for name in sorted(read & record.files.keys()):
        try:
            sound = hash_file(folder / name, MAX_RECORD_BYTES) == record.files[name].sha256
            why = f"{name} has another digest"
        except UnsoundFileError as err:
            sound, why = False, f"{name}: {err.message}"
        if not sound:
            raise make_changed_error(folder, why)


def _check_values(used: Config, config: Config, folder: Path) -> None:
    """Raise ConfigError where measured values cause faults that the configuration did not have."""
    before = check_config(config)
    if faults := [fault for fault in check_config(used) if fault not in before]:
        raise ConfigError(
            to_one_line(f"the calibration in {folder} cannot be used: {'; '.join(faults)}"),
            hint='calibrate again, or set [calibration] use = "none"',
        )


def _named(config: Config, folder: Path, hint: str) -> CalibrationChoice:
    """A calibration that somebody named. Raises ConfigError, with `hint`, where it does not fit."""
    record, _ = read_calibration(folder)
    if what := describe_other_bench(record, config, named=True):
        raise ConfigError(f"calibration {record.name} is of another bench: {what}", hint=hint)
    return CalibrationChoice(use_calibration_folder(config, folder), folder)


def link_calibration(folder: Path, calibrations: Path) -> None:
    """Link to a calibration that lies elsewhere, so that it is found among those of the state
    folder.

    Raises DiskError.
    """
    with disk_errors(str(calibrations)):
        calibrations.mkdir(parents=True, exist_ok=True)
        if folder.resolve().parent != calibrations.resolve():
            (calibrations / folder.name).symlink_to(folder.resolve())


def parse_calibration_name(folder: Path) -> str:
    """The name of the calibration whose record lies in a folder."""
    at = folder.parent if folder.name.startswith(STEP_FOLDER_PREFIX) else folder
    return at.name.removesuffix(UNFINISHED_CALIBRATION)


def find_scale(config: Config, f_number: float | None) -> AbsoluteScale:
    """The source of the absolute scale of photos at that stop, and its uncertainty.

    A responsivity holds at the stop at which it was measured. At another stop, the uncertainty is
    that of the comparison of both stops (`CameraConfig.stops`), or else the usual deviation of
    stops from 2^(k/6).
    """
    camera, table = config.camera, config.calibration
    if camera.responsivity_e is None:
        return AbsoluteScale("of a nominal camera")
    if table.sha256 is None:
        return AbsoluteScale("as typed")
    try:
        record, _ = read_calibration(Path(table.use))
    except ConfigError:
        return AbsoluteScale("as of a calibration that is gone")
    entry = select_measured_values(record, table).get("camera.responsivity_e")
    if entry is None:
        return AbsoluteScale("as typed")
    source = f"as of the calibration of {entry.made_utc[:10]}"
    sigmas = entry.sigma if isinstance(entry.sigma, tuple | list) else ()
    if len(sigmas) != len(camera.responsivity_e):
        return AbsoluteScale(source)
    own = max(s / light for s, light in zip(sigmas, camera.responsivity_e, strict=True))
    if f_number is None or camera.f_number != "auto":
        return AbsoluteScale(source, own)
    stop = stop_of(f_number, camera.stops)
    beside = stop.sigma if stop in camera.stops else math.hypot(STOP_SIGMA, stop.sigma)
    return AbsoluteScale(source, math.hypot(own, beside))


def select_measured_values(
    record: Calibration, table: CalibrationConfig
) -> dict[str, MeasuredValue]:
    """The measured values that replace typed ones: all except those to be kept as typed."""
    return {key: entry for key, entry in record.measured.items() if key not in table.keep}


def with_measured_values(
    config: Config, entries: Mapping[str, MeasuredValue], folder: Path
) -> Config:
    """The configuration with measured values; maps and files are looked up in `folder`.

    Raises ConfigError for a value that the configuration cannot have.
    """
    placed = {key.partition(".")[0] for key in entries if key.endswith(".place.map")}
    maps = load_maps(folder / MAPS) if placed else {}
    for device in sorted(placed - maps.keys()):
        raise make_changed_error(folder, f"{MAPS} holds no map of the {to_one_line(device)}")
    return with_values(
        config, {key: entry.value for key, entry in entries.items()}, maps, folder=folder
    )


def with_guards(config: Config, measured: Container[str]) -> Config:
    """The configuration with the schedule that the measured lag allows.

    It changes only where the times of both panels were measured, the guards are the full ones, and
    that key is not to be kept.
    """
    schedule = config.schedule
    if schedule.guards is not True or "schedule.guards" in config.calibration.keep:
        return config
    if not all(key in measured for key in TIME_KEYS):
        return config
    schedule = msgspec.structs.replace(schedule, guards="auto")
    return msgspec.structs.replace(config, schedule=schedule)


def with_values(
    config: Config,
    values: Mapping[str, Any],
    maps: Mapping[str, Map],
    *,
    folder: Path | None = None,
) -> Config:
    """The configuration with other values, by key, and the places of `maps`, by device.

    For devices, `calibration.typed` keeps what was typed before anything was measured.
    """
    asked, tables = config, dict[str, dict[str, Any]]()
    for key, value in values.items():
        table, _, name = key.partition(".")
        if name == "place.map":
            continue
        if key == "camera.profile" and folder is not None and "/" not in str(value):
            value = str(folder / str(value))
        tables.setdefault(table, {})[name] = value
    try:
        for table, changed in tables.items():
            old = getattr(config, table)
            kinds = {f.name: f.type for f in msgspec.structs.fields(old)}
            new = {n: msgspec.convert(v, kinds[n], strict=False) for n, v in changed.items()}
            config = msgspec.structs.replace(config, **{table: msgspec.structs.replace(old, **new)})
    except (KeyError, AttributeError, msgspec.ValidationError) as err:
        raise ConfigError(
            f"a measured value has no place in the configuration: {err}",
            hint="calibrate again with this version of pdcd",
        ) from err
    for device, map_ in maps.items():
        if device in _DEVICES and (folder is None or f"{device}.place.map" in values):
            old = getattr(config, device)
            new_table = msgspec.structs.replace(old, place=Placing(map=map_))
            config = msgspec.structs.replace(config, **{device: new_table})
    return _with_typed(config, asked)


def _with_typed(config: Config, asked: Config) -> Config:
    """The configuration with the values that `asked` had for devices stored in
    `calibration.typed`."""
    typed = dict(asked.calibration.typed)
    for table in TYPED:
        before, now = getattr(asked, table), getattr(config, table)
        for name in now.__struct_fields__:
            value = getattr(before, name)
            if value != getattr(now, name) and f"{table}.{name}" not in typed:
                typed[f"{table}.{name}"] = encode_json(value).decode()
    if typed == asked.calibration.typed:
        return config
    calibration = msgspec.structs.replace(config.calibration, typed=typed)
    return msgspec.structs.replace(config, calibration=calibration)


def compute_age_days(record: Calibration) -> float:
    """Days since it ended; NaN where its date cannot be read."""
    return compute_age_h(record.finished_utc) / 24.0


def compute_age_h(made_utc: str, now: datetime | None = None) -> float:
    """Hours since a date in the format of records; NaN where it cannot be read."""
    try:
        made = datetime.fromisoformat(made_utc.replace("Z", "+00:00"))
        return ((now or datetime.now(UTC)) - made).total_seconds() / 3600.0
    except (ValueError, TypeError):  # one without a time zone
        return math.nan
