"""The configuration with what a calibration measured in the place of what was typed.

`[calibration] use` says which one: the newest of the state folder, a folder by its path, or none.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.calibration import MAPS, RECORD, Calibration, Entry, read_calibration
from pdcd.bench.folders import state_dir
from pdcd.bench.tables import CalibrationConfig, Config
from pdcd.bench.truth import TYPED
from pdcd.errors import ConfigError, disk_errors
from pdcd.panels.map import Map
from pdcd.panels.map_file import load_maps
from pdcd.panels.placing import Placing

FOLDER = "calibrations"
"""Below the state folder."""
UNFINISHED = ".partial"
"""How the name of a folder ends whose calibration did not come to its end, whatever lies in it."""
DEVICES = ("projector", "mask", "camera")
TIMES = ("mask.skew_s", *(f"{p}.{t}" for p in ("projector", "mask") for t in ("rise_s", "fall_s")))
"""Values by which a schedule of fewer refreshes can be trusted."""


def calibrated(config: Config) -> Config:
    """The configuration with the values of the calibration that it asks for.

    `calibration.use` and `calibration.sha256` then name the one that was taken, so that doing this
    again changes nothing. Where none is kept, "latest" is as good as "none". Raises ConfigError for
    one that was named and cannot be used.
    """
    folder = chosen(config)
    if folder is None:
        return config
    record, digest = read_calibration(folder)
    wanted = config.calibration.sha256
    if wanted is not None and wanted != digest:
        raise ConfigError(
            f"the calibration in {folder} is not the one with the digest that is asked for",
            hint="remove [calibration] sha256, or name the folder that has it",
        )
    refuse_other_bench(record, config)
    taken = with_entries(config, kept(record, config.calibration), folder)
    taken = with_guards(taken, record.measured)
    return msgspec.structs.replace(
        taken,
        calibration=msgspec.structs.replace(config.calibration, use=str(folder), sha256=digest),
    )


def chosen(config: Config) -> Path | None:
    """Folder of the calibration that is asked for; None for none."""
    use = config.calibration.use
    if use == "none":
        return None
    if use != "latest":
        return Path(use)
    return newest(state_dir(config) / FOLDER, config)


def newest(folder: Path, config: Config, *, bad: bool = False) -> Path | None:
    """The newest whole calibration of this rig in a folder, of those that are not bad or, if said,
    of all; None where there is none."""
    try:
        finished = (p for p in folder.iterdir() if not p.name.endswith(UNFINISHED))
        names = sorted((p for p in finished if (p / RECORD).is_file()), reverse=True)
    except OSError:
        return None
    for candidate in names:
        try:
            record, _ = read_calibration(candidate)
        except ConfigError:
            continue
        same = record.identity.rig == config.rig.name and not other_bench(record, config)
        if same and (bad or record.verdict != "bad"):
            return candidate.resolve() if candidate.is_symlink() else candidate
    return None


def name_among(folder: Path, calibrations: Path) -> None:
    """Have a calibration that lies elsewhere found among those of the state folder, by a link.

    Raises DiskError."""
    with disk_errors(str(calibrations)):
        calibrations.mkdir(parents=True, exist_ok=True)
        if folder.resolve().parent != calibrations.resolve():
            (calibrations / folder.name).symlink_to(folder.resolve())


def other_bench(record: Calibration, config: Config) -> str:
    """What of the configuration is of another bench than was calibrated, in words; "" for none."""
    belief = record.belief
    for name in ("projector", "mask"):
        size = belief.get(name, {}).get("size_px")
        if size is not None and tuple(size) != getattr(config, name).size_px:
            return f"{name}.size_px was {tuple(size)} and is {getattr(config, name).size_px}"
    for table in ("display", "camera", "trigger"):
        driver = belief.get(table, {}).get("driver")
        if driver is not None and driver != getattr(config, table).driver:
            return f"{table}.driver was {driver!r} and is {getattr(config, table).driver!r}"
    return ""


def refuse_other_bench(record: Calibration, config: Config) -> None:
    """Raise ConfigError where a calibration is of other panels or drivers."""
    if what := other_bench(record, config):
        raise ConfigError(
            f"calibration {record.name} is of another bench: {what}",
            hint='run pdcd calibrate, or set [calibration] use = "none"',
        )


def kept(record: Calibration, table: CalibrationConfig) -> dict[str, Entry]:
    """The measured values that replace typed ones: all but those to be kept as typed."""
    return {key: entry for key, entry in record.measured.items() if key not in table.keep}


def with_entries(config: Config, entries: Mapping[str, Entry], folder: Path) -> Config:
    """The configuration with measured values; maps and files are looked up in `folder`.

    Raises ConfigError for a value that the configuration cannot have.
    """
    maps = load_maps(folder / MAPS) if any(k.endswith(".place.map") for k in entries) else {}
    return with_values(
        config, {key: entry.value for key, entry in entries.items()}, maps, folder=folder
    )


def with_guards(config: Config, measured: Container[str]) -> Config:
    """The configuration with the schedule that the measured lag allows, where the times of both
    panels were measured, and guards are the full ones; unless that key is to be kept."""
    schedule = config.schedule
    if schedule.guards is not True or "schedule.guards" in config.calibration.keep:
        return config
    if not all(key in measured for key in TIMES):
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

    Of devices `calibration.typed` keeps what was typed there before anything was measured.
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
            f"a measured value is none of the configuration: {err}",
            hint="calibrate again with this version of pdcd",
        ) from err
    for device, map_ in maps.items():
        if device in DEVICES and (folder is None or f"{device}.place.map" in values):
            old = getattr(config, device)
            new_table = msgspec.structs.replace(old, place=Placing(map=map_))
            config = msgspec.structs.replace(config, **{device: new_table})
    return _with_typed(config, asked)


def _with_typed(config: Config, asked: Config) -> Config:
    """The configuration with what `asked` has in the place of its measured values of devices."""
    typed = dict(asked.calibration.typed)
    for table in TYPED:
        before, now = getattr(asked, table), getattr(config, table)
        for name in now.__struct_fields__:
            value = getattr(before, name)
            if value != getattr(now, name) and f"{table}.{name}" not in typed:
                typed[f"{table}.{name}"] = msgspec.json.encode(value).decode()
    if typed == asked.calibration.typed:
        return config
    table = msgspec.structs.replace(config.calibration, typed=typed)
    return msgspec.structs.replace(config, calibration=table)


def age_days(record: Calibration, now: datetime | None = None) -> float:
    """Days since it ended; NaN where its date cannot be read."""
    try:
        made = datetime.fromisoformat(record.finished_utc.replace("Z", "+00:00"))
    except ValueError:
        return math.nan
    return ((now or datetime.now(UTC)) - made).total_seconds() / 86400.0
