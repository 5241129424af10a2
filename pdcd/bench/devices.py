"""What a driver must offer: one Protocol a device, and the values that cross it.

Authors of drivers import all of it from `pdcd.driver`.

A driver is a class with a classmethod ``create(context) -> driver``; the registry calls it. All
methods block and are called from one worker thread of the daemon, never from two at once, save
`Display.black` and `Shutter.close`, which must also be safe from any state, twice, and after a
failure: they are how everything fails closed. Every method may raise `DeviceLost`.

Times are integer nanoseconds of the injected `Clock`; lengths in seconds end in `_s`.

What was added after the first drivers were written is optional: fields have defaults, and a
Protocol of its own (`TimedShutter`, `Preview`) is asked for only where a driver answers it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal, Protocol, TypeVar, runtime_checkable

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.patience import Patience
from pdcd.bench.registry import load_driver
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, PdcdError
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.pixels import ShownPictures


class Clock(Protocol):
    """The only source of time above the drivers."""

    def now_ns(self) -> int:
        """Nanoseconds of a monotonic clock."""
        ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; at once if that time has passed."""
        ...


@dataclass(frozen=True)
class DisplayInfo:
    """The two panels as found: size in pixels (width, height), refresh rate, identity.

    `mask_lag_s` is by how much the mask's light of a row of `Frames` follows the projector's of the
    same row (negative: it leads), own delays of both streams included; None: unknown, or drifting.

    `row_times` says that `load` takes rows with `Frames.dark_s` and `Frames.delay_s`, and that the
    log tells of them. The rig gives such frames to no other display. `waits_for_edge` says that the
    shutter's opening starts what was loaded, once: each exposure loads it anew.

    `warnings` are what the user must know of the panels, each with what to do, for the run.
    """

    primal_size_px: tuple[int, int]
    dual_size_px: tuple[int, int]
    refresh_hz: float
    identity: dict[str, str] = field(default_factory=dict)
    mask_lag_s: float | None = None
    row_times: bool = False
    waits_for_edge: bool = False
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraSettings:
    """Settings of one exposure. `f_number` None means: leave the aperture as it is.

    exposure_s : how long it is planned to be, from `Shutter.open` returning to `Shutter.close`
        being called, with the time on black before and after the frames; None: nobody said.
    longest_s : for how long it may go on, late refreshes and further passes included, with a
        margin: whoever guards a shutter ends it then, and not before. None: nobody said.
    """

    iso: int
    f_number: float | None
    exposure_s: float | None = None
    longest_s: float | None = None


@dataclass(frozen=True)
class CameraInfo:
    """What the camera is and how it answers to light.

    `responsivity_e` (3,) float64: electrons per scene unit per second, for R, G, B, at f/1, or (1,)
    without colours; the signal at aperture f is this divided by f squared; `camera.responsivity_e`
    of the configuration, typed or measured, takes its place. `profile` names the sensor profile.
    """

    model: str
    serial: str
    profile: str
    responsivity_e: NDArray[np.float64]
    isos: tuple[int, ...]
    f_numbers: tuple[float, ...]
    """Apertures that can be set from here; empty for a manual lens."""
    frame_quads: tuple[int, int] | None = None
    """Width and height of its photos in Bayer quads, where that is known before the first one."""
    readout_s: float | None = None
    """Seconds that a photo costs beside its exposure: getting ready, and until its file is stored.
    None where that is not known; the rig then learns it from the first photos."""
    cfa: str | None = "RGGB"
    """Colours of the quad at the upper left corner of its photos, row by row: "RGGB", "BGGR",
    "GRBG" or "GBRG"; None for a sensor without colours. Any other word is that of a mosaic that is
    not known here; the rig refuses it before there is light."""

    @property
    def colours(self) -> int:
        """Of its pictures: 3, or 1 of a sensor without."""
        return int(self.responsivity_e.size)


@dataclass(frozen=True)
class ShutterTiming:
    """A shutter that moves while the panels show their frames, so that a photo tells when it did:
    told to open once `after` rows were shown, and to close `open_s` after it was surely open."""

    after: int
    open_s: float


@dataclass(frozen=True)
class RawFile:
    """A RAW file on disk, as fetched: byte-for-byte the camera's own.

    second : of a sensor with two buckets, the file of the second one in the same exposure: light
        that the mask's patterns kept out of the first.
    """

    path: Path
    size_bytes: int
    sha256: str
    second: RawFile | None = None


@dataclass(frozen=True)
class PhotoFrame:
    """A photo in memory, from a camera that hands over samples: the rig writes it to disk as DNG.

    samples : (H, W) uint16
        In DN, as the sensor has them: black not taken off, nothing scaled, turned or mended.
    black : DN without light: one number, or one for each place of the quad, row by row.
    white : DN from which a sample is saturated.
    iso, f_number : what it was taken with; 0 and None where the camera does not tell.
    exposure_s : how long the camera says that it exposed.
    cfa : colours of the quad at the upper left corner, as of `CameraInfo.cfa`.
    date : when it was taken; None: just now.
    record : what the device says of this photo in its own words, pixel format, gain, number and
        temperature for example; kept in the file.
    second : as of `RawFile`.
    pulses : how many pulses of the projector's and of the mask's output the camera counted since it
        was armed; None where it counts none. Times of a display that says how many there are to be
        (`FrameLog.pulses`) are proven by them.
    pulses_hint : what to look at, of this camera, where it counted others than there were to be.
    """

    samples: NDArray[np.uint16]
    black: int | Sequence[int]
    white: int
    iso: int
    exposure_s: float
    f_number: float | None = None
    cfa: str | None = "RGGB"
    date: datetime | None = None
    record: Mapping[str, str] = field(default_factory=dict)
    second: PhotoFrame | None = None
    pulses: tuple[int, int] | None = None
    pulses_hint: str = ""


class Display(Protocol):
    """Two panels in lockstep: the projector (primal) and the mask (dual)."""

    def connect(self) -> DisplayInfo:
        """Open both panels, show black, measure the refresh. Both are black on return."""
        ...

    def load(self, frames: Frames) -> None:
        """Take over all patterns of a shot; nothing is shown yet. Raises ConfigError if they do
        not fit the panels."""
        ...

    def black(self) -> None:
        """Both panels black on return. Safe in every state, idempotent."""
        ...

    def show(self, frames: Frames) -> None:
        """Hold the first refresh of `frames` on both panels until `black` or `play`."""
        ...

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show the loaded frames once, then black; returns the log.

        `progress(frame, frames, missed)` is called about ten times a second, and may take half a
        second: a calibration moves the shutter in it. `cancelled()` is asked at least ten times a
        second and, when true, the panels go black and `Cancelled` is raised.
        Raises SyncError when the panels cannot be kept in step.
        """
        ...

    def disconnect(self) -> None:
        """Black, then close both panels. Idempotent."""
        ...


class Shutter(Protocol):
    """Opens and closes the exposure (bulb)."""

    def connect(self) -> dict[str, str]:
        """Make ready, closed; returns identity strings. Closed on return."""
        ...

    def open(self) -> int:
        """Start the exposure; returns the time in ns by which it is surely open."""
        ...

    def close(self) -> int:
        """End the exposure; returns the time in ns by which it is surely closed. Idempotent."""
        ...

    def disconnect(self) -> None:
        """Close, then release the device. Idempotent."""
        ...


@runtime_checkable
class TimedShutter(Shutter, Protocol):
    """A shutter that wants to know how long it will be open. None need."""

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        """The next `open`, and that one alone, begins an exposure of so many seconds.

        Both are as of `CameraSettings`. Called before each `open` of the rig, after
        `Readout.arm`; an `open` without it means that nothing is known. Nothing moves.
        """
        ...


class Readout(Protocol):
    """Sets the camera up and brings its photo home."""

    def connect(self) -> CameraInfo:
        """Find the camera and ask what it is."""
        ...

    def arm(self, settings: CameraSettings) -> None:
        """Apply the settings and be ready for one exposure. Raises ConfigError with the list of
        allowed values when the camera does not offer one."""
        ...

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile | PhotoFrame:
        """Wait for the photo of the last exposure and store it as `folder/name.<suffix>`.

        A camera that makes files gives them byte for byte. One that hands over samples returns
        them (`PhotoFrame`), and the rig stores them under that name; or it calls `write_dng`.
        Raises ExposureError when no photo comes, NoSpaceError when it cannot be stored.
        """
        ...

    def disconnect(self) -> None:
        """Release the camera. Idempotent."""
        ...


@runtime_checkable
class RecheckingReadout(Readout, Protocol):
    """A readout that finds its photos in files which something else writes. None need be."""

    def recheck(self, photos: Collection[str]) -> None:
        """Look once more at where photos came from, given by their SHA-256, before a run is whole.

        Those of other runs are forgotten. Raises ExposureError where one holds something else by
        now than was fetched.
        """
        ...


class Preview(Protocol):
    """The camera's finder: small pictures, several a second, to aim and to focus by.

    A role of its own (`preview`), which a bench may lack: it goes by the name of the camera's
    driver, and without one `pdcd preview` takes photos, one after the other. Such pictures are
    looked at and never measured. It is not used while a photo is armed, and shares one camera with
    shutter and readout by `DriverContext.the`. All calls come from a thread of its own, which is
    left behind where one hangs.
    """

    def connect(self) -> dict[str, str]:
        """Make ready; returns identity strings. The shutter stays closed for photos."""
        ...

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next picture, (H, W) grey or (H, W, 3) sRGB, upright as the sensor has it.

        One that was taken after the call; what waited before is passed over. Raises ExposureError
        when none comes in that time.
        """
        ...

    def disconnect(self) -> None:
        """Leave the finder, release the camera. Idempotent."""
        ...


class _KnownScene(Protocol):
    """A scene whose light transport a driver knows, as far as a bench asks about it."""

    @property
    def name(self) -> str:
        """What reports call it."""
        ...

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        ...

    @property
    def cells(self) -> int:
        """Number of cells, rows times columns."""
        ...


@dataclass
class SharedState:
    """What the drivers of one rig tell each other. A driver of real devices needs none of it."""

    played: tuple[Frames, FrameLog] | None = None
    """What the display last played, put here by the rig: a virtual camera makes its photo from it,
    whichever display it stands before. None once a shutter of the mock bench has opened."""
    exposed_ns: tuple[int, int] | None = None
    """When the last exposure surely began and ended, put here by the rig: a virtual camera behind
    a shutter that is not its own goes by it. None while the shutter is open, and once its photo
    was made."""
    moving: bool = False
    """Whether the shutter of this exposure is meant to move while the panels show their frames: a
    camera that times it then leaves out its margin."""
    held: Frames | None = None
    """What the display holds for a live view, put here by the rig: virtual cameras see it. None
    while it holds nothing."""
    pixels: ShownPictures | None = None
    """The panels' own pixels of the same frames, from a display that looks at them: a virtual
    camera believes these rather than the frame log."""
    scene: _KnownScene | None = None
    """The scene, from a driver that knows it."""
    photographed: bool = False
    """Whether the photos show that scene, said by the camera that makes them of it: only then are
    errors reported against the truth. A real camera before virtual panels sees something else."""
    covered: bool = False
    """Whether a virtual projector's lens is covered: none of its light, leaked or not, comes out.
    """
    cells_meet: bool = False
    """Whether cells are all there is to the panels, so that nothing can be misplaced: said by the
    camera of a mock bench without pixels. Real drivers leave it False, and whether their panels
    lie where they are believed to has to be looked at."""
    usb_backend: object | None = None
    """The pyusb backend to use instead of libusb, which is None; see `DriverContext.usb_backend`.
    """


_LIBUSB = "libusb"
"""Name of the machine's own USB."""


def _nobody_listens() -> None:
    """A rig without a watchdog."""


def _nobody_cancels() -> bool:
    """No job that could be cancelled."""
    return False


_T = TypeVar("_T")


@dataclass(frozen=True)
class DriverContext:
    """What a driver's `create` gets: the whole checked configuration, the clock, and a place
    where drivers of one rig meet."""

    config: Config
    clock: Clock
    shared: SharedState = field(default_factory=SharedState)
    alive: Callable[[], object] = _nobody_listens
    """A method that waits for a device calls this every few seconds, from the thread that called
    it: so the daemon's watchdog knows that it waits and is not stuck. It never blocks or raises."""
    cancelled: Callable[[], bool] = _nobody_cancels
    """Whether the job is to end. `patience` asks it, and says when not to."""
    _made: dict[type, object] = field(default_factory=dict, init=False, repr=False, compare=False)

    def the(self, kind: type[_T], make: Callable[[], _T]) -> _T:
        """The one instance of a class in this rig, made by the first driver that asks for it.

        So a shutter and a readout use one camera. What `make` raises is passed on; whoever asks
        next tries again.
        """
        found = self._made.get(kind)
        if not isinstance(found, kind):
            found = self._made[kind] = make()
        return found

    @property
    def patience(self) -> Patience:
        """What each loop that waits for a device asks: sign of life, cancel and deadline in one."""
        return self.the(Patience, lambda: Patience(self.clock, self.alive, self.cancelled))

    def require_real_time(self, what: str, device: str) -> None:
        """For drivers of real devices: raise ConfigError where the rig's clock is a virtual one.

        what : the device in words, such as "camera". device : the role that the error names.
        """
        if self.config.rig.clock != "real":
            raise ConfigError(
                f"a real {what} cannot keep up with a virtual clock",
                device=device,
                hint='set rig.clock = "real"',
            )

    def usb_backend(self, name: str = _LIBUSB) -> object | None:
        """The pyusb backend that all devices of this rig are on; None is the machine's libusb.

        For drivers of devices on the USB, whose options name it: "libusb", or a driver of the role
        `usb`, which brings a USB with virtual devices. The first that names one decides. Raises
        DriverUnavailable where there is none of that name.
        """
        if self.shared.usb_backend is None and name != _LIBUSB:
            self.shared.usb_backend = load_driver("usb", name).create(self)
        return self.shared.usb_backend


_State = Literal["good", "warning", "fault", "unknown"]


class Finding(msgspec.Struct, frozen=True):
    """One thing looked at. `state` "unknown" means that it could not be looked at."""

    what: str
    state: _State
    found: str
    hint: str | None = None


def fault(what: str, err: PdcdError, device: str | None = None) -> Finding:
    """What an error says, `device` being the one that this doctor is about."""
    where = f"{err.device}: " if err.device not in (None, device) else ""
    return Finding(what, "fault", where + err.message, err.hint)
