"""A step of a calibration as a script: it asks for photos one by one and ends with what it found.

A script is a generator. It yields what it wants, a photo (`PhotoRequest`) or something that only a
person can do (`UserPrompt`), and is sent the photo as it came (`CalibrationPhoto`), or None. What
it returns is its `StepOutcome`. It touches no device and reads no clock, so a step can be computed
again from its photos.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import NDArray

from pdcd.bench.devices import CameraInfo, ShutterTiming
from pdcd.bench.measured import with_values
from pdcd.bench.tables import Config
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.photo import QuadPhoto, RawSettings, make_quad_photo
from pdcd.calibration.preview import Draw
from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.timing.delayed import shift_mask
from pdcd.calibration.timing.timing_model import PhotoLog
from pdcd.errors import CalibrationError
from pdcd.panels.frames import FrameLog
from pdcd.panels.map import Map
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import RawFrame
from pdcd.words import MarksName, SubjectName

FIELD = "projector.field_px"
"""Key of the field's place in the configuration."""
_COMPARED, _REFERENCE = {"sensor", "light", "geometry", "timing", "registration"}, "check."
"""Steps whose results a check compares with; after one of them, the arrays whose names begin with
this are outdated, for they show the bench as it was calibrated before."""


@dataclass(frozen=True, eq=False)
class PhotoRequest:
    """One photo.

    iso, f_number : None is the session's own.
    covered : with the projector's lens covered, which a person was asked for before; a mock bench
        does it by itself.
    moving : for a shutter that moves while the panels show the photo; usually it moves before and
        after that.
    counted : its refreshes are a measure, and none may be late, whatever rig.on_miss says.
    """

    shown: PanelSequence
    iso: int | None = None
    f_number: float | None = None
    covered: bool = False
    moving: ShutterTiming | None = None
    counted: bool = False


@dataclass(frozen=True)
class UserPrompt:
    """Something that a person has to do before the next photo, in one sentence.

    now, best : where a number is to be maximised, its value and the largest so far.
    """

    text: str
    now: float | None = None
    best: float | None = None


@dataclass(frozen=True, eq=False)
class CalibrationPhoto:
    """One photo as it came.

    raw : decoded samples. log : when the panels showed what.
    open_ns, close_ns : when the shutter was surely open, and surely closed: `TriggerConfig.sure_ns`
        of the configuration after the commands. iso : as asked for.
    level : light over what was planned, where refreshes came late (`PhotoRecord.level`).
    """

    name: str
    raw: RawFrame
    log: FrameLog
    open_ns: int
    close_ns: int
    iso: int
    level: float = 1.0

    @property
    def open_s(self) -> float:
        """How long the shutter was surely open."""
        return (self.close_ns - self.open_ns) * 1e-9

    @property
    def ran(self) -> PhotoLog:
        """When the photo was taken, for the estimators of times."""
        return PhotoLog(self.log, self.open_ns, self.close_ns)

    @property
    def seen(self) -> RawSettings:
        """What the file says of itself."""
        return RawSettings.of(self.raw)


@dataclass(frozen=True)
class ConfigValue:
    """One value in the words of the configuration, with its standard deviation."""

    value: Any
    sigma: float | tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class StepOutcome:
    """What a step found.

    figures : each with limit and verdict. words : values by key of the configuration.
    maps : by device; they become the places of these devices. arrays : for later steps and checks,
        by name. profile : a sensor profile. advice : what to do, a sentence each.
    picture : draws a preview for people to look at (`pdcd.calibration.preview`).
    """

    figures: tuple[MeasuredFigure, ...] = ()
    words: Mapping[str, ConfigValue] = field(default_factory=dict)
    maps: Mapping[str, Map] = field(default_factory=dict)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    profile: SensorProfile | None = None
    advice: tuple[str, ...] = ()
    picture: Draw | None = None

    @property
    def verdict(self) -> Verdict:
        """The worst of its figures."""
        return max((figure.verdict for figure in self.figures), default=Verdict.GOOD)


StepScript = Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, StepOutcome]
"""A step under way."""


@dataclass
class CalibrationSession:
    """What is known of the bench so far; steps read it, and `learn` adds to it.

    config : the configuration in use, in which measured values replace typed ones; places and maps
        are those on the projector's whole picture, wherever in it the field lies (`field_px`).
    iso, f_number : of the photos; f_number None where the lens is not set from here.
    full : refreshes of white light after which the brightest part of a photo is at `FULL_SHARE` of
        saturation; 0 before metering.
    arrays : of steps so far, and of the calibration before.
    helped : whether somebody does what a person is asked for (`UserPrompt`).
    subject : what is in front of the camera. marks : what the geometry step shows.
    behind_rows : rows by which the mask's pictures must be sent later than the display does: the
        display uses a measured delay only after its next start.
    field_px : the field in the projector's picture; None: all of it.
    """

    config: Config
    profile: SensorProfile
    camera: CameraInfo
    iso: int
    f_number: float | None = None
    full: int = 0
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    done: list[str] = field(default_factory=list)
    helped: bool = False
    subject: SubjectName = "card"
    marks: MarksName = "auto"
    behind_rows: int = 0
    field_px: tuple[int, int, int, int] | None = None

    def __post_init__(self) -> None:
        if self.config.projector.field_px is not None:
            self.field_px = self.config.projector.field_px
            self.config = with_values(self.config, {FIELD: None}, {})

    @property
    def on_field(self) -> Config:
        """The configuration of captures: with the field where it lies."""
        return with_values(self.config, {FIELD: self.field_px}, {})

    @property
    def refresh_s(self) -> float:
        """Length of a refresh as it is configured."""
        return 1.0 / self.config.row_hz

    @property
    def sizes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """(width, height) of projector and mask."""
        return self.config.projector.size_px, self.config.mask.size_px

    def photo(self, taken: CalibrationPhoto) -> QuadPhoto:
        """A photo as its quads, in DN, scaled to the light that was planned."""
        photo = make_quad_photo(taken.raw, self.profile, taken.iso)
        if taken.level == 1.0:
            return photo
        level = taken.level
        return replace(photo, light=photo.light / level, variance=photo.variance / level**2)

    def found(self, device: str) -> Map:
        """The measured map of a device to the field.

        Raises CalibrationError where none was measured.
        """
        map_ = getattr(self.config, device).place.map
        if not isinstance(map_, Map):
            raise CalibrationError(
                f"where the {device} lies has not been measured yet",
                device=device,
                hint="run pdcd calibrate geometry first",
            )
        return map_

    def in_step(self, shown: PanelSequence) -> PanelSequence:
        """A photo whose mask pictures are shifted so that it shows what it should, although the
        display does not know yet how late the mask is."""
        return shift_mask(shown, self.behind_rows) if self.behind_rows else shown

    def learn(self, step: str, outcome: StepOutcome) -> None:
        """Add what a step found. Where a check compares with that step, its reference is
        dropped."""
        values = {key: found.value for key, found in outcome.words.items()}
        values.pop("camera.profile", None)
        self.field_px = values.pop(FIELD, self.field_px)
        before_rows = self.config.mask_delay_rows
        self.config = with_values(self.config, values, outcome.maps)
        self.behind_rows += self.config.mask_delay_rows - before_rows
        if step in _COMPARED:
            for name in [name for name in self.arrays if name.startswith(_REFERENCE)]:
                del self.arrays[name]
        self.arrays.update(outcome.arrays)
        if outcome.profile is not None:
            self.profile = outcome.profile
        self.done.append(step)


def take_photo(
    wanted: PhotoRequest,
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, CalibrationPhoto]:
    """One photo, for `yield from`."""
    taken = yield wanted
    if taken is None:
        raise ValueError("a script that wants a photo is sent one")
    return taken
