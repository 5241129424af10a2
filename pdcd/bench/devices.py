"""The interfaces that a driver must offer: one Protocol a device, and what its `create` gets.

Authors of drivers import all of it from `pdcd.driver`. The values that pass through these methods
are defined in `pdcd.bench.device_records`, and can be imported from here, too.

A driver is a class with a classmethod ``create(context) -> driver``; the registry calls it. All
methods block and are called from one worker thread of the daemon, never from two at once.
Exceptions are `Display.black` and `Shutter.close`, which must also be safe from any state, twice,
and after a failure: with them everything fails closed. Every method may raise `DeviceLost`.

Times are integer nanoseconds of the injected `Clock`; lengths in seconds end in `_s`.

Methods that were added after the first drivers were written are optional: a Protocol of its own
(`TimedShutter`, `Preview`) is used only where a driver offers it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.device_records import (
    CameraInfo,
    CameraSettings,
    DisplayInfo,
    Finding,
    PhotoFrame,
    RawFile,
    ShutterTiming,
    fault,
)
from pdcd.bench.patience import Patience
from pdcd.bench.registry import load_driver
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.pixels import ShownPictures

__all__ = [
    "CameraInfo",
    "CameraSettings",
    "Clock",
    "Display",
    "DisplayInfo",
    "DriverContext",
    "Finding",
    "PhotoFrame",
    "Preview",
    "RawFile",
    "Readout",
    "RecheckingReadout",
    "SharedState",
    "Shutter",
    "ShutterTiming",
    "TimedShutter",
    "fault",
]


class Clock(Protocol):
    """The only source of time above the drivers."""

    def now_ns(self) -> int:
        """Nanoseconds of a monotonic clock."""
        ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; at once if that time has passed."""
        ...


class Display(Protocol):
    """Two panels in lockstep: the projector (primal) and the mask (dual)."""

    def connect(self) -> DisplayInfo:
        """Open both panels, show black, measure the refresh. Both are black on return."""
        ...

    def load(self, frames: Frames) -> None:
        """Store all patterns of a shot; nothing is shown yet. Raises ConfigError if they do not fit
        the panels."""
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
    """A shutter that wants to know how long it will be open. No shutter needs to."""

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        """The next `open`, and that one alone, begins an exposure of that many seconds.

        Both times are as in `CameraSettings`. Called before each `open` of the rig, after
        `Readout.arm`; before an `open` without it, nothing is known. Nothing moves.
        """
        ...


class Readout(Protocol):
    """Sets the camera up and fetches its photo."""

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
    """A readout that finds its photos in files which another program writes. No readout needs to be
    one."""

    def recheck(self, photos: Collection[str]) -> None:
        """Check once more the files that photos came from, given by their SHA-256, before a run is
        complete.

        Photos of other runs are forgotten. Raises ExposureError where a file no longer holds what
        was fetched.
        """
        ...


class Preview(Protocol):
    """The camera's finder: small pictures, several a second, for aiming and focusing.

    A role of its own (`preview`), which a bench may lack: it has the same name as the camera's
    driver, and without one `pdcd preview` takes photos, one after the other. Such pictures are only
    looked at, never measured. It is not used while a photo is armed, and shares one camera with
    shutter and readout by `DriverContext.the`. All calls come from a separate thread, which is
    abandoned if one hangs.
    """

    def connect(self) -> dict[str, str]:
        """Make ready; returns identity strings. The shutter stays closed for photos."""
        ...

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next picture, (H, W) grey or (H, W, 3) sRGB, upright as the sensor has it.

        It must be taken after the call: pictures that waited before are skipped. Raises
        ExposureError when none comes in that time.
        """
        ...

    def disconnect(self) -> None:
        """Leave the finder, release the camera. Idempotent."""
        ...


class _KnownScene(Protocol):
    """A scene whose light transport a driver knows, as far as a bench needs it."""

    @property
    def name(self) -> str:
        """Its name in reports."""
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
    with any display. None once a shutter of the mock bench has opened."""
    exposed_ns: tuple[int, int] | None = None
    """When the last exposure surely began and ended, put here by the rig: for a virtual camera
    behind a shutter that is not its own. None while the shutter is open, and once its photo was
    made."""
    moving: bool = False
    """Whether the shutter of this exposure is meant to move while the panels show their frames: a
    camera that controls its time then leaves out its margin."""
    held: Frames | None = None
    """What the display holds for a live view, put here by the rig: virtual cameras see it. None
    while it holds nothing."""
    pixels: ShownPictures | None = None
    """The panels' own pixels for the same frames, from a display that records them: a virtual
    camera uses these instead of the frame log."""
    scene: _KnownScene | None = None
    """The scene, from a driver that knows it."""
    photographed: bool = False
    """Whether the photos show that scene; set by the camera that makes them from it. Only then are
    errors reported against the truth: a real camera in front of virtual panels sees something
    else."""
    covered: bool = False
    """Whether a virtual projector's lens is covered: none of its light, leaked or not, comes out.
    """
    cells_meet: bool = False
    """Whether the panels consist of cells only, so that nothing can be misplaced; set by the camera
    of a mock bench without pixels. Real drivers leave it False, and the places of their panels have
    to be checked."""
    usb_backend: object | None = None
    """The pyusb backend to use instead of libusb; None is libusb. See
    `DriverContext.usb_backend`."""


_LIBUSB = "libusb"
"""Name of the machine's own USB."""


def _nobody_listens() -> None:
    """The default of a rig without a watchdog."""


def _nobody_cancels() -> bool:
    """The default where no job can be cancelled."""
    return False


_T = TypeVar("_T")


@dataclass(frozen=True)
class DriverContext:
    """What a driver's `create` gets: the whole checked configuration, the clock, and objects that
    the drivers of one rig share."""

    config: Config
    clock: Clock
    shared: SharedState = field(default_factory=SharedState)
    alive: Callable[[], object] = _nobody_listens
    """A method that waits for a device calls this every few seconds, from the thread that called
    it. The daemon's watchdog then knows that it waits and is not stuck. It never blocks or
    raises."""
    cancelled: Callable[[], bool] = _nobody_cancels
    """Whether the job is to end. `patience` checks it, and knows when cancelling must wait."""
    _made: dict[type, object] = field(default_factory=dict, init=False, repr=False, compare=False)

    def the(self, kind: type[_T], make: Callable[[], _T]) -> _T:
        """The one instance of a class in this rig, made by the first driver that asks for it.

        This is how a shutter and a readout share one camera. What `make` raises is passed on; the
        next driver that asks tries again.
        """
        found = self._made.get(kind)
        if not isinstance(found, kind):
            found = self._made[kind] = make()
        return found

    @property
    def patience(self) -> Patience:
        """Called in each loop that waits for a device: sign of life, cancel and deadline in one."""
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
        """The pyusb backend that all devices of this rig use; None is the machine's libusb.

        For drivers of USB devices, whose options name it: "libusb", or a driver of the role `usb`,
        which provides a USB with virtual devices. The first name that is asked for decides. Raises
        DriverUnavailable where there is none of that name.
        """
        if self.shared.usb_backend is None and name != _LIBUSB:
            self.shared.usb_backend = load_driver("usb", name).create(self)
        return self.shared.usb_backend
