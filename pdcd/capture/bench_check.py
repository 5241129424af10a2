"""Are the devices what a run relies on: those that were calibrated, and a camera that sees all?

A photo that cannot be decoded is not worth the ones after it. So a frame that is known beforehand
is compared with the field before there is light, any other one as soon as the first photo is there;
and every photo of a run must be of the same size, orientation and camera. Before each capture the
calibration in use is compared with the devices that are there.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from pdcd.bench.calibration import RECORD, Calibration, read_calibration
from pdcd.bench.choosing import find_newest_calibration, find_other_device
from pdcd.bench.devices import CameraInfo, DriverContext, Finding, Readout, fault
from pdcd.bench.measured import compute_age_days, parse_calibration_name
from pdcd.bench.placed import make_camera_map
from pdcd.bench.registry import load_driver, name_driver_errors
from pdcd.bench.stops import are_same_stop
from pdcd.bench.tables import CalibrationConfig, Config
from pdcd.capture.job import Journal
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError, ExposureError, PdcdError
from pdcd.printable import to_one_line
from pdcd.sensor.fit import check_frame_fit, measure_frame_fit
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import RawFrame, RawHead, read_raw, read_raw_head

_COLOURS, _UNITS = {1: "no colours", 3: "colours"}, {1: "pixels", 3: "quads"}
_DAY = 1.0
_SESSION_DAYS = 1.0 / 24.0
"""With `check = "always"`, a check that is older than this belongs to another session."""


@dataclass
class FrameCheck:
    """Checks of the camera's frame in one run. grid : rows and columns of its cells. cut : whether
    any shot opens less than whole cells. Neither is known before there is a plan."""

    config: Config
    camera: CameraInfo
    journal: Journal
    grid: tuple[int, int] | None = None
    cut: bool = False
    _first: tuple[str, RawHead] | None = field(default=None, init=False)

    def foresee(self, grid: tuple[int, int], *, cut: bool) -> None:
        """Compare the frame that the camera reports with the cells of a plan.

        A camera that reports none is not checked. Raises ConfigError.
        """
        self.grid, self.cut = grid, cut
        if self.camera.frame_quads is not None:
            width, height = self.camera.frame_quads
            self._check((height, width))

    def saw(self, file: str, head: RawHead) -> None:
        """Check a photo that came. Raises ConfigError when the first one does not fit the field or
        the sensor, and ExposureError for one that differs from the first."""
        if self._first is None:
            if head.colours != self.camera.colours:
                verb = "with" if head.colours == 1 else "without"
                raise ConfigError(
                    f"{file} has {_COLOURS[head.colours]}, {_COLOURS[self.camera.colours]} were "
                    f"expected of a camera with sensor profile {self.camera.profile}",
                    device="camera",
                    hint=f"choose a camera.profile {verb} mono = true",
                )
            told = self.camera.frame_quads
            if told is not None and told != head.frame[::-1]:
                self.journal.warn(
                    f"photos have {_size(head)}, not the {told[0]} x {told[1]} that were "
                    "expected of this camera: is it set to full-size RAW?"
                )
            self._check(head.frame)
            if is_camera_turned(self.config, head.flip):
                self.journal.warn(
                    "the camera was turned since it was calibrated: calibrate the geometry"
                )
            self._first = file, head
            return
        before, first = self._first
        for what, now, then in (
            ("size", _size(head), _size(first)),
            ("orientation", head.turned, first.turned),
            ("camera", head.model or "unnamed", first.model or "unnamed"),
        ):
            if now != then:
                raise ExposureError(
                    f"{file} is unlike {before}: its {what} is {now}, not {then}",
                    device="camera",
                    hint="leave the camera and its settings alone during a run; switch off its "
                    "rotation of pictures",
                )

    def _check(self, frame: tuple[int, int]) -> None:
        if self.grid is not None:
            check_frame(self.config, frame, self.grid, cut=self.cut)


def check_frame(
    config: Config, frame: tuple[int, int], grid: tuple[int, int], *, cut: bool
) -> None:
    """Compare a frame of so many rows and columns of quads with the cells of a grid; `cut` is that
    of a plan (`Plan.cut`).

    Raises ConfigError when the camera's place is no sound map, or the frame does not fit.
    """
    check_frame_fit(
        measure_frame_fit(make_camera_map(config, frame), grid), "quarter" if cut else "whole"
    )


def examine_readout(
    context: DriverContext,
) -> Generator[Finding, None, tuple[int, int] | None]:
    """Open the camera of a configuration, close it, and yield what its readout reports; returns its
    frame in quads, where it is reported. Nothing is exposed; failures are findings."""
    name = context.config.camera.driver
    try:
        driver = load_driver("readout", name)
        with name_driver_errors("readout"):
            readout: Readout = driver.create(context)
            try:
                info = readout.connect()
            finally:
                readout.disconnect()
    except PdcdError as err:
        yield fault("camera", err, "camera")
        return None
    yield Finding("driver", "good", f"{name}, {driver.maturity}")
    yield Finding("camera", "good", f"{info.model} {info.serial}".strip())
    yield Finding("ISO", "good", ", ".join(map(str, info.isos)) or "as it is set")
    apertures = ", ".join(f"{f_number:g}" for f_number in info.f_numbers)
    yield Finding("apertures", "good", apertures or "as the lens is set")
    return info.frame_quads


def examine_frame(
    config: Config, raw: Path | None, told: tuple[int, int] | None = None
) -> Iterator[Finding]:
    """Yield what is known of the camera's frame: from a RAW file, else from what its driver `told`
    (width and height in quads), else from the sensor profile.

    Failures are findings, too.
    """
    what = "frame"
    try:
        if raw is None:
            profile, source = load_profile(config.camera.profile), "camera"
            if told is None:
                told, source = profile.frame_quads, "sensor profile"
            if told is None:
                yield Finding(
                    "frame", "unknown", "not told by the sensor profile", "give a photo: --raw FILE"
                )
                return
            frame, units = (told[1], told[0]), _UNITS[profile.colours]
            yield Finding("frame", "good", f"{told[0]} x {told[1]} {units}, by the {source}")
            if source != "camera":
                yield Finding(
                    "orientation", "unknown", "only a photo tells", "give one: --raw FILE"
                )
        else:
            head, photo = read_raw_head(raw), read_raw(raw)
            frame = photo.frame
            yield Finding("frame", "good", f"{_size(head)}, of {head.model or raw.name}")
            yield Finding("orientation", "good", f"{head.turned}; not followed, see [camera.place]")
            rows, columns = head.masked
            border = f"{rows} rows and {columns} columns beyond the picture"
            yield Finding("masked border", "good", border if rows + columns else "none")
            yield from _examine_levels(photo)
        what, grid = "view of the field", config.code_grid()
        fit = measure_frame_fit(make_camera_map(config, frame), grid)
        seen = f"{100.0 * fit.seen:.3g} % of {grid[0]} x {grid[1]} cells"
        yield Finding("field seen", "good", seen)
        low, high = fit.across
        yield Finding("pixels along a cell's side", "good", f"{low:.3g} to {high:.3g}")
        window = config.schedule.window
        check_frame_fit(fit, "whole" if window == "whole" else "quarter")
    except PdcdError as err:
        yield fault(what, err, "camera")


def _examine_levels(photo: RawFrame) -> Iterator[Finding]:
    """Black and white levels of a decoded photo, and what is odd about them."""
    black = ", ".join(f"{level:.6g}" for level in photo.black)
    source = photo.exif()["black_from"]
    found = f"black {black} DN by the {source}, white {photo.white:g} DN"
    mosaic = f"mosaic {photo.pattern}" if photo.pattern else "no colours"
    yield Finding("levels", "good", f"{found}, {mosaic}")
    for doubt in photo.doubts:
        yield Finding("levels in doubt", "warning", doubt, "see that it is the camera's own file")


def _size(head: RawHead) -> str:
    return f"{head.frame[1]} x {head.frame[0]} {_UNITS[head.colours]}"


def find_calibration_doubts(config: Config, rig: Rig, iso: int) -> Iterator[str]:
    """Doubts about the calibration in use, in words; none where no calibration is used.

    iso : of the photos to come.

    Raises ConfigError where the calibration is of another camera, of other panels, or of another
    mode.
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
    if fixed != "auto" and seen.f_number is not None and not are_same_stop(fixed, seen.f_number):
        yield f"calibration {record.name} was taken at f/{seen.f_number:g}, not at f/{fixed:g}"
    yield from _left_out(record, folder)
    yield from _bad_later(record, folder, config)
    yield from _old(record, table)


def _left_out(record: Calibration, folder: Path) -> Iterator[str]:
    """Steps that the calibration in use tried without usable results, and where it stopped."""
    if record.left_out:
        steps = "; ".join(f"{step}: {why}" for step, why in record.left_out.items())
        yield f"not all of calibration {record.name} is used ({steps}): see {folder / RECORD}"
    if record.stopped is not None:
        yield (
            f"calibration {record.name} stopped at {record.stopped.step}: "
            f"{record.stopped.message}; pdcd calibrate goes on from there"
        )


def _bad_later(record: Calibration, folder: Path, config: Config) -> Iterator[str]:
    """Whether a calibration or check of the same bench after this one found something bad."""
    last = find_newest_calibration(folder.parent, config, bad=True)
    if last is None or parse_calibration_name(last) <= parse_calibration_name(folder):
        return
    later, _ = read_calibration(last)
    same = (later.bench, later.identity.truth) == (record.bench, record.identity.truth)
    if same and later.verdict == "bad":
        yield (
            f"{last.name}, a calibration or check after {record.name}, found something bad: see "
            f"{last / RECORD}, and calibrate again"
        )


def is_camera_turned(config: Config, flip: int) -> bool:
    """Whether the camera is held differently than when it was calibrated.

    flip : of a photo, as in `RawHead`. Raises ConfigError as `read_calibration`.
    """
    if config.calibration.sha256 is None:
        return False
    then = read_calibration(Path(config.calibration.use))[0].identity.flip
    return then is not None and then != flip


def _refuse_others(record: Calibration, rig: Rig) -> None:
    """Raise ConfigError for a calibration of other devices."""
    other = find_other_device(record, rig.camera_info, rig.display_info)
    if other is not None:
        device, text = other
        hint = 'run pdcd calibrate, or set [calibration] use = "none"'
        raise ConfigError(text, device=device, hint=hint)


def _old(record: Calibration, table: CalibrationConfig) -> Iterator[str]:
    """Whether it is time to check, or to calibrate again."""
    days = compute_age_days(record)
    if math.isnan(days) or days < -_DAY:
        yield (
            f"calibration {record.name} is dated {to_one_line(record.finished_utc)!r}, which is no "
            "date in the past: set the clock of this machine, or calibrate again"
        )
    elif days > table.max_age_days:
        yield (
            f"calibration {record.name} is {days:.0f} days old, more than "
            f"calibration.max_age_days = {table.max_age_days:g}: calibrate again"
        )
    limit = {"daily": _DAY, "always": _SESSION_DAYS, "never": math.inf}[table.check]
    if days > limit:
        yield f"the bench has not been checked for {24.0 * days:.0f} h: run pdcd calibrate check"
