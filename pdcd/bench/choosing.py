"""The calibrations of a bench, the newest first, and the reason against each that cannot be used.

"latest" skips calibrations that do not fit the bench. `pdcd calibrate use` stores the name of one
for each rig, and "latest" then means that one.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.calibration import (
    RECORD,
    STEP_FOLDER_PREFIX,
    Calibration,
    read_calibration,
)
from pdcd.bench.devices import CameraInfo, DisplayInfo
from pdcd.bench.folders import find_state_dir
from pdcd.bench.placed import compute_mock_frame
from pdcd.bench.tables import Config
from pdcd.bench.truth import restore_typed_values
from pdcd.errors import BusyError, ConfigError, disk_errors
from pdcd.files.opening import UnsoundFileError
from pdcd.files.put import replace_file
from pdcd.files.reading import hash_file, read_file
from pdcd.files.system import locks, system
from pdcd.files.text import encode_json
from pdcd.printable import to_one_line

CALIBRATIONS_FOLDER = "calibrations"
"""Below the state folder."""
UNFINISHED_CALIBRATION = ".partial"
"""Suffix of the folder of a calibration that did not come to its end."""
PINNED = "in-use.json"
"""File in that folder: for each rig the name of the calibration that it is to use."""
_MAX_BYTES = 2**20
"""Most bytes that are read of that file, and of the truth of a mock bench."""
BENCH_TABLES = ("projector", "mask", "camera", "display", "trigger")
"""Tables of a configuration that make a mock bench; scene and schedule may change."""
_SAME_RATE = 1e-3
"""Relative difference up to which two refresh rates may be those of the same mode."""


@dataclass(frozen=True)
class Candidate:
    """One calibration that is kept.

    name : as people call it.
    folder : where its record lies.
    why : the reason why this bench cannot use it; "" where it can.
    ours : whether it may be of this rig at all.
    running : whether it is being made now.
    """

    name: str
    folder: Path
    record: Calibration | None
    why: str
    ours: bool = True
    running: bool = False


def list_candidates(config: Config) -> Iterator[Candidate]:
    """All calibrations of the state folder, the newest first, with those under way. They are read
    one by one, so that a search can stop early."""
    yield from _candidates_in(find_state_dir(config) / CALIBRATIONS_FOLDER, config)


def _candidates_in(folder: Path, config: Config) -> Iterator[Candidate]:
    """The same for any folder."""
    try:
        # Hidden ones have no name yet, or are being removed.
        there = (p for p in folder.iterdir() if not p.name.startswith("."))
        entries = sorted(there, key=_name, reverse=True)
    except OSError:
        return
    for at in entries:
        found = read_candidate(at, config)
        if found is not None:
            yield found


def read_candidate(at: Path, config: Config, *, named: bool = False) -> Candidate | None:
    """One calibration; None for what is not one: a file, or a folder without a record. named : as
    in `describe_other_bench`."""
    name, running = _name(at), False
    try:
        folder = at.resolve(strict=True) if at.is_symlink() else at
        if at.name.endswith(UNFINISHED_CALIBRATION):
            running, newest = _locked(folder), _last_kept(folder)
            if newest is None:
                return None
            folder = newest
        elif not (folder / RECORD).exists():
            return None if folder.is_file() or not at.is_symlink() else _unread(name, at, "gone")
        record, _ = read_calibration(folder)
    except ConfigError as err:
        return _unread(name, at, err.message)
    except (OSError, RuntimeError) as err:  # links that lead in circles
        return _unread(name, at, getattr(err, "strerror", None) or str(err))
    ours = record.identity.rig == config.rig.name
    why = f"it is of the rig {record.identity.rig!r}"
    if ours:
        why = describe_other_bench(record, config, named=named)
    if not why and not record.usable:
        why = "its verdict is bad"
    why = "it is being made" if running else to_one_line(why)
    return Candidate(name, folder, record, why, ours, running)


def find_newest_calibration(folder: Path, config: Config, *, bad: bool = False) -> Path | None:
    """The newest calibration of this rig in a folder that fits the bench; None where there is none.

    bad : whether it may be one whose values are all bad.
    """
    for found in _candidates_in(folder, config):
        record = found.record
        if (
            record is None
            or found.running
            or not found.ours
            or describe_other_bench(record, config)
        ):
            continue
        if record.usable or bad:
            return found.folder
    return None


def describe_other_bench(record: Calibration, config: Config, *, named: bool = False) -> str:
    """The first difference between the bench that was calibrated and this one, in words; "" for
    none.

    config : as it was typed. A configuration with measured values (`calibration.sha256`) has been
        compared before.
    named : whether somebody asked for this calibration. A mock bench may then have changed since,
        like a real one that was bumped.
    """
    belief = record.belief
    for name in ("projector", "mask"):
        size = belief.get(name, {}).get("size_px")
        then, now = tuple(size) if isinstance(size, list) else size, getattr(config, name).size_px
        if size is not None and then != now:
            return f"{name}.size_px was {then} and is {now}"
    for table in ("display", "camera", "trigger"):
        driver = belief.get(table, {}).get("driver")
        if driver is not None and driver != getattr(config, table).driver:
            return f"{table}.driver was {driver!r} and is {getattr(config, table).driver!r}"
    if config.camera.driver != "mock" or config.calibration.sha256 is not None:
        return ""
    return ("" if named else _changed_mock(record, config)) or _other_frame(record, config)


def _changed_mock(record: Calibration, config: Config) -> str:
    """The same for a mock bench, which is whatever its configuration and its truth say."""
    now = _flat(select_mock_tables(config))
    for key, then in _flat(record.bench).items():
        if key in now and now[key] != then:
            return f"{key} was {_short(then)} and is {_short(now[key])}"
    if record.bench and record.identity.truth != hash_truth_file(config):
        return "the truth of the mock bench (bench.truth) was another one"
    return ""


def _other_frame(record: Calibration, config: Config) -> str:
    """The same for the size of a mock camera's photos: with another size its map fits none of
    them."""
    seen = record.identity.frame_quads
    if seen is not None and config.scene.kind != "matrix":
        rows, cols = compute_mock_frame(config, config.code_grid())
        if (cols, rows) != tuple(seen):
            return f"its camera has {seen[0]} x {seen[1]} pixels, and this one {cols} x {rows}"
    return ""


def select_mock_tables(config: Config) -> dict[str, Any]:
    """The tables that make a mock bench, in plain values; none for a real camera."""
    if config.camera.driver != "mock":
        return {}
    typed = restore_typed_values(config)
    tables = {name: getattr(typed, name) for name in BENCH_TABLES}
    return dict(msgspec.json.decode(encode_json(tables)))


def hash_truth_file(config: Config) -> str:
    """SHA-256 of the file that says what a mock bench really is; "" where there is none."""
    path = config.bench.truth
    if path is None or config.camera.driver != "mock":
        return ""
    try:
        return hash_file(path, _MAX_BYTES)
    except UnsoundFileError:
        return ""


def find_other_device(
    record: Calibration, camera: CameraInfo | None, display: DisplayInfo | None
) -> tuple[str, str] | None:
    """The device that differs from the one that was calibrated, and the difference in words. None
    where nothing differs, as far as the open devices show."""
    seen, name = record.identity, record.name
    if camera is not None:
        then, now = (seen.camera_model, seen.camera_serial), (camera.model, camera.serial)
        if then != now:
            words = (" ".join(each).strip() for each in (then, now))
            return "camera", "calibration {} is of {}, and this is {}".format(name, *words)
        frames = seen.frame_quads, camera.frame_quads
        if None not in frames and frames[0] != frames[1]:
            sizes = (f"{f[0]} x {f[1]}" for f in frames if f is not None)
            return "camera", "calibration {} is of photos of {} pixels, not {}".format(name, *sizes)
    if display is None:
        return None
    for panel, before in (("projector", seen.projector), ("mask", seen.mask)):
        there = display.identity.get(panel, "")
        if before and there and before != there:
            said = f"calibration {name} is of the {panel} {before!r}, and this is {there!r}"
            return panel, said
    if all(" Hz" in display.identity.get(panel, "") for panel in ("projector", "mask")):
        return None  # the modes were compared; measured rates scatter where times are not exact
    rate_hz = min(seen.projector_hz, seen.mask_hz)
    if abs(display.refresh_hz / rate_hz - 1.0) > _SAME_RATE:
        text = f"calibration {name} was made at {rate_hz:g} Hz, and the panels run at"
        return "display", f"{text} {display.refresh_hz:g} Hz"
    return None


def read_pinned_name(config: Config) -> str | None:
    """The calibration that `pdcd calibrate use` stored for this rig: its name, or "none"; None
    where it stored none. Raises ConfigError for a file that it cannot have written."""
    return _pins(config).get(config.rig.name)


def pin_calibration(config: Config, name: str | None) -> None:
    """Store which calibration this rig is to use; None: the latest again. Raises DiskError."""
    try:
        pins = _pins(config)
    except ConfigError:
        pins = {}  # naming a calibration replaces the damaged file
    pins.pop(config.rig.name, None)
    if name is not None:
        pins[config.rig.name] = name
    path = find_state_dir(config) / CALIBRATIONS_FOLDER / PINNED
    with disk_errors(str(path)):
        path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, encode_json(pins) + b"\n")


def find_calibration(config: Config, name: str) -> Path:
    """The folder of the calibration with that name. Raises ConfigError where there is none."""
    folder = find_state_dir(config) / CALIBRATIONS_FOLDER
    plain = name.removesuffix(UNFINISHED_CALIBRATION)
    if plain and "/" not in plain and not plain.startswith("."):
        for at in (folder / plain, folder / f"{plain}{UNFINISHED_CALIBRATION}"):
            if at.is_symlink() or at.is_dir():
                return at
    raise ConfigError(
        f"no calibration is called {to_one_line(name)!r} in {folder}",
        hint="pdcd calibrate list has their names; pdcd calibrate use latest takes the newest",
    )


def forget_calibration(config: Config, at: Path) -> None:
    """Remove a calibration for good, or the link to it, and the stored choice of it.

    Raises BusyError where a daemon or a capture uses it, or where it is being made; and DiskError.
    """
    name = _name(at)
    with disk_errors(str(at)):
        descriptor = lock_calibration(at, locks.LOCK_EX) if at.is_dir() else None
        if descriptor is None and at.is_dir():
            raise BusyError(
                f"calibration {name} is in use, or being made",
                hint="end the daemon or the capture that uses it, or use another one",
            )
        try:
            if at.is_symlink():
                at.unlink()
            else:
                gone = at.with_name(f".{name}.forgotten")
                at.rename(gone)
                shutil.rmtree(gone)
        finally:
            if descriptor is not None:
                system.close(descriptor)
    if _pins(config).get(config.rig.name) == name:
        pin_calibration(config, None)


def lock_calibration(folder: Path, how: int = locks.LOCK_SH) -> int | None:
    """A descriptor that keeps a calibration from being removed as long as it is open; None where
    another lock prevents this. Raises OSError where there is no folder."""
    descriptor = system.open(folder, system.O_RDONLY | system.O_DIRECTORY | system.O_CLOEXEC)
    try:
        locks.flock(descriptor, how | locks.LOCK_NB)
    except BlockingIOError:
        system.close(descriptor)
        return None
    except OSError:  # a disk without locks
        return descriptor
    return descriptor


def lock_calibration_in_use(folder: Path) -> int | None:
    """The same for a process that uses the record in a folder; None where it cannot be locked."""
    try:
        return lock_calibration(
            folder.parent if folder.name.startswith(STEP_FOLDER_PREFIX) else folder
        )
    except OSError:
        return None


def _pins(config: Config) -> dict[str, str]:
    path = find_state_dir(config) / CALIBRATIONS_FOLDER / PINNED
    try:
        return msgspec.json.decode(read_file(path, _MAX_BYTES), type=dict[str, str])
    except (UnsoundFileError, ValueError, RecursionError) as err:
        if not path.exists() and not path.is_symlink():
            return {}
        raise ConfigError(
            f"{path}, which says what calibration to use, cannot be read",
            hint="run pdcd calibrate use latest, or name one",
        ) from err


def _name(at: Path) -> str:
    return at.name.removesuffix(UNFINISHED_CALIBRATION)


def _unread(name: str, at: Path, why: str) -> Candidate:
    return Candidate(name, at, None, to_one_line(why))


def _last_kept(folder: Path) -> Path | None:
    """The folder of the last step that an unfinished calibration has ended; None where there is
    none."""
    kept = (p for p in folder.iterdir() if p.name.startswith(STEP_FOLDER_PREFIX) and p.suffix == "")
    return max(kept, key=lambda p: p.name, default=None)


def _locked(folder: Path) -> bool:
    """Whether somebody is making a calibration in this folder."""
    descriptor = lock_calibration(folder)
    if descriptor is None:
        return True
    system.close(descriptor)
    return False


def _flat(table: dict[str, Any], before: str = "") -> dict[str, Any]:
    """The values of nested tables by their dotted keys."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        below = _flat(value, f"{before}{name}.") if isinstance(value, dict) and value else {}
        found |= below or {f"{before}{name}": value}
    return found


def _short(value: object) -> str:
    text = "unset" if value is None else encode_json(value).decode()
    return text if len(text) <= 40 else f"{text[:37]}..."
