"""Does the calibration that is in use describe the devices that are there? Before each capture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from pdcd.bench.calibration import RECORD, Calibration, read_calibration
from pdcd.bench.measured import age_days, newest
from pdcd.bench.tables import CalibrationConfig, Config
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError

DAY = 1.0
SESSION_DAYS = 1.0 / 24.0
"""A check that is so old is none of this session's, with `check = "always"`."""
SAME_RATE = 1e-3
"""Share by which a refresh rate may differ and be of the same mode."""


def doubts(config: Config, rig: Rig, iso: int) -> Iterator[str]:
    """What speaks against the calibration in use, in words; nothing where none is used.

    iso : of the photos to come.

    Raises ConfigError where it is one of another camera, of other panels, or of another mode.
    """
    table = config.calibration
    if table.sha256 is None:
        return
    folder = Path(table.use)
    record, _ = read_calibration(folder)
    _refuse_others(record, rig)
    seen = record.identity
    if "camera.profile" in record.measured and seen.iso != iso:
        yield f"calibration {record.name} measured the sensor at ISO {seen.iso}, not at ISO {iso}"
    fixed = config.camera.f_number
    if fixed != "auto" and seen.f_number is not None and abs(fixed / seen.f_number - 1.0) > 0.06:
        yield f"calibration {record.name} was taken at f/{seen.f_number:g}, not at f/{fixed:g}"
    last = newest(folder.parent, config, bad=True)
    if last is not None and last.name > folder.name:
        yield (
            f"{last.name}, a calibration or check after {record.name}, found what is bad: see "
            f"{last / RECORD}, and calibrate again"
        )
    yield from _old(record, table)


def held_otherwise(config: Config, flip: int) -> bool:
    """Whether the camera is held another way than when it was calibrated.

    flip : of a photo, as of `RawHead`. Raises ConfigError as `read_calibration`.
    """
    if config.calibration.sha256 is None:
        return False
    then = read_calibration(Path(config.calibration.use))[0].identity.flip
    return then is not None and then != flip


def _refuse_others(record: Calibration, rig: Rig) -> None:
    """Raise ConfigError for a calibration of other devices."""
    seen, hint = record.identity, 'run pdcd calibrate, or set [calibration] use = "none"'
    camera, display = rig.camera_info, rig.display_info
    if camera is not None and (camera.model, camera.serial) != (
        seen.camera_model,
        seen.camera_serial,
    ):
        raise ConfigError(
            f"calibration {record.name} is of {seen.camera_model} {seen.camera_serial}, and this "
            f"is {camera.model} {camera.serial}",
            device="camera",
            hint=hint,
        )
    if display is None:
        return
    for name, then in (("projector", seen.projector), ("mask", seen.mask)):
        now = display.identity.get(name, "")
        if then and now and then != now:
            raise ConfigError(
                f"calibration {record.name} is of the {name} {then!r}, and this is {now!r}",
                device=name,
                hint=hint,
            )
    rate_hz = min(seen.projector_hz, seen.mask_hz)
    if abs(display.refresh_hz / rate_hz - 1.0) > SAME_RATE:
        raise ConfigError(
            f"calibration {record.name} was made at {rate_hz:g} Hz, and the panels run at "
            f"{display.refresh_hz:g} Hz",
            device="display",
            hint=hint,
        )


def _old(record: Calibration, table: CalibrationConfig) -> Iterator[str]:
    """Whether it is time to check, or to calibrate again."""
    days = age_days(record)
    if math.isnan(days) or days > table.max_age_days:
        yield (
            f"calibration {record.name} is {days:.0f} days old, more than "
            f"calibration.max_age_days = {table.max_age_days:g}: calibrate again"
        )
    limit = {"daily": DAY, "always": SESSION_DAYS, "never": math.inf}[table.check]
    if days > limit:
        yield f"the bench was not checked for {24.0 * days:.0f} h: pdcd calibrate check"
