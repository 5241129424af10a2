"""The devices of one bench, and the order in which they are opened, used and made safe."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import (
    CameraInfo,
    CameraSettings,
    Clock,
    Display,
    DisplayInfo,
    DriverContext,
    PhotoFrame,
    RawFile,
    Readout,
    RecheckingReadout,
    Shutter,
    ShutterTiming,
)
from pdcd.bench.exposure_time import tell_exposure_time, with_exposure_times, with_open_time
from pdcd.bench.placed import find_place_faults
from pdcd.bench.registry import load_driver, name_driver_errors
from pdcd.bench.tables import Config
from pdcd.capture.exposure import RigExposure, verify_times, with_row_times
from pdcd.capture.mask_lag import tell_mask_lag_s
from pdcd.capture.pulse import Pulse
from pdcd.capture.safety import make_safe, make_safe_beside, release_device
from pdcd.errors import (
    Cancelled,
    ConfigError,
    DeviceLost,
    PdcdError,
    SyncError,
    disk_errors,
)
from pdcd.panels.frames import FrameLog, Frames, check_row_times
from pdcd.printable import keep_standard_streams
from pdcd.protocol.events import Emit, ShotArmed, ShutterClosed, ShutterOpen
from pdcd.sensor.dng import keep_photo
from pdcd.sensor.dng_form import BAYER
from pdcd.sensor.profile import load_profile
from pdcd.virtual.scene.scene import Scene

if TYPE_CHECKING:
    from pdcd.capture.moving import MovingShutter

logger = logging.getLogger(__name__)

_LAST_PHOTOS = 9
"""Photos over which the median time of a readout is taken."""

_Progress = Callable[[int, int, int], None]


class _StoredPhoto(NamedTuple):
    """A photo's file, the contents of its files where these are only in memory, and what the
    camera's driver handed over."""

    raw: RawFile
    held: Mapping[str, bytes]
    fetched: RawFile | PhotoFrame


class Rig:
    """Display, shutter and readout of a configuration, on one clock."""

    def __init__(self, config: Config, broken_off: Callable[[], bool] = lambda: False) -> None:
        """`broken_off()`: whether no waiting is wanted any more; called in any thread.

        Raises ConfigError for an impossible place of a device on the field, before any driver is
        made; DriverUnavailable for a driver that is not there.
        """
        for device, why in find_place_faults(config):
            raise ConfigError(f"{device}.place: {why}", device=device)
        self.config = config
        self.clock: Clock = VirtualClock() if config.rig.clock == "virtual" else RealClock()
        self.pulse = pulse = Pulse(broken_off)
        context = DriverContext(
            config=config, clock=self.clock, alive=pulse, cancelled=pulse.cancelled
        )
        self._context = self.context = context
        classes = {
            "display": load_driver("display", config.display.driver),
            "shutter": load_driver("shutter", config.trigger.driver),
            "readout": load_driver("readout", config.camera.driver),
        }
        self.maturity = {role: str(cls.maturity) for role, cls in classes.items()}
        with name_driver_errors("display"):
            self.display: Display = classes["display"].create(context)
        with name_driver_errors("shutter"):
            self.shutter: Shutter = classes["shutter"].create(context)
        with name_driver_errors("readout"):
            self.readout: Readout = classes["readout"].create(context)
        self.display_info: DisplayInfo | None = None
        self.shutter_info: dict[str, str] = {}
        self.camera_info: CameraInfo | None = None
        self._arming_ns = 0
        self._readouts_ns: deque[int] = deque(maxlen=_LAST_PHOTOS)
        self._photos: set[str] = set()
        self.deaf_since_s: float | None = None
        """Time, on a monotonic clock, since which devices are being made safe; for any thread."""
        self._left: tuple[Frames | None, int | None] = None, None
        """Frames of the last exposure, and the time since which panels are black."""
        self.look_at_finder: Callable[[], object] = lambda: None
        """Raises DeviceLost while the camera hangs in a live view that was left behind."""

    @property
    def camera(self) -> CameraInfo | None:
        """What is known of an open camera, including the measured time of a readout."""
        info = self.camera_info
        if info is None or not self._readouts_ns:
            return info
        return replace(info, readout_s=1e-9 * median(self._readouts_ns))

    @property
    def scene(self) -> Scene | None:
        """The scene in the photos, where a driver knows it (the mock camera does); None for a real
        camera, whatever it is pointed at."""
        return self._virtual_scene if self._context.shared.photographed else None

    @property
    def _virtual_scene(self) -> Scene | None:
        """The scene of a mock bench of which any part is in use."""
        scene = self._context.shared.scene
        return scene if isinstance(scene, Scene) else None

    @property
    def display_warnings(self) -> tuple[str, ...]:
        """Warnings of the display about its panels, for the user."""
        return () if self.display_info is None else self.display_info.warnings

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""
        scene = self._virtual_scene
        return self.config.code_grid(None if scene is None else scene.grid)

    @property
    def cells_meet(self) -> bool:
        """Whether panels cannot be misplaced, as on a mock bench of cells."""
        return self._context.shared.cells_meet

    @property
    def mock(self) -> bool:
        """Whether the photos come from a virtual scene."""
        return self.scene is not None

    @property
    def mixed(self) -> str | None:
        """A note for a rig with a real camera and virtual devices; None for any other."""
        config = self.config
        virtual = [
            role
            for role, driver in (
                ("display", config.display.driver),
                ("shutter", config.trigger.driver),
            )
            if driver == "mock"
        ]
        if self.mock or self._virtual_scene is None or not virtual:
            return None
        verb = "is" if len(virtual) == 1 else "are"
        return (
            f"{' and '.join(virtual)} {verb} virtual (driver mock) and the camera is not "
            f"({config.camera.driver}): photos show what really stands in front of it, and are not "
            "compared with the mock scene"
        )

    def look_at_camera(self) -> CameraInfo:
        """What the camera is; one that is not open is opened just for the question."""
        if self.camera_info is not None:
            return self.camera_info
        try:
            return self._as_measured(self.readout.connect())
        finally:
            self.readout.disconnect()

    def _as_measured(self, camera: CameraInfo) -> CameraInfo:
        """The driver's description of its camera, with what the configuration gives instead: that
        was measured, or typed by somebody, while a driver may only guess.

        Raises ConfigError for a sensor whose photos cannot be read, or whose responsivity has
        another number of colours.
        """
        if load_profile(self.config.camera.profile).colours == 1:
            camera = replace(camera, cfa=None)
        if camera.cfa not in (None, *BAYER):
            raise ConfigError(
                f"{camera.model} has a sensor with a mosaic {camera.cfa}, which cannot be read",
                device="camera",
                hint=f"use a camera without colours, or with a Bayer mosaic: {', '.join(BAYER)}",
            )
        known, colours = self.config.camera.responsivity_e, 1 if camera.cfa is None else 3
        light = camera.responsivity_e if known is None else np.array(known)
        if known is None and colours == 1:  # of a driver that tells of three filters
            light = light.sum(keepdims=True)
        if (told := light.size) != colours:
            raise ConfigError(
                f"camera.responsivity_e has {told} numbers, colours of {camera.model}: {colours}",
                device="camera",
                hint="give one number for each, or remove it and calibrate light",
            )
        return replace(camera, responsivity_e=light)

    def cover(self, covered: bool) -> None:
        """Cover or uncover the projector's lens for the exposures to come, on a mock bench. On any
        other, a person has to do it."""
        self._context.shared.covered = covered

    def mask_lag_s(self, *, look: bool = True) -> float | None:
        """Lag of the mask; see `pdcd.capture.mask_lag`. A display that is not open is opened just
        for the question. look : whether a plan depends on the lag; black refreshes are not shown
        merely to mention it among a plan's reasons."""
        info = self.display_info
        try:
            return tell_mask_lag_s(
                self.display, info or self.display.connect(), self.config, self.grid, look=look
            )
        finally:
            if info is None:
                self.display.disconnect()

    def connect(self) -> None:
        """Open all devices: panels black first, then the shutter closed, then the camera."""
        try:
            with name_driver_errors("display"):
                self.display_info = self.display.connect()
            with name_driver_errors("shutter"):
                self.shutter_info = self.shutter.connect()
            with name_driver_errors("readout"):
                self.camera_info = self._as_measured(self.readout.connect())
            keep_standard_streams()
        except BaseException:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Make safe, then release all devices, also where one of them fails."""
        self.make_safe()
        for device in (self.readout, self.shutter, self.display):
            release_device(type(device).__name__, device.disconnect, self._context.patience)

    def make_safe(self) -> bool:
        """Make both panels black and close the shutter; returns whether that succeeded. See
        `pdcd.capture.safety`."""
        with self._deaf():
            return make_safe(self.display, self.shutter, self._context.patience)

    def make_safe_beside(self, within_s: float) -> bool:
        """The same from another thread, while the rig's own may hang in a driver."""
        return make_safe_beside(self.display, self.shutter, self._context.patience, within_s)

    def _close(self) -> int:
        """Close the shutter, also after a cancel."""
        with self._deaf():
            return self.shutter.close()

    @contextmanager
    def _deaf(self) -> Iterator[None]:
        """While devices are made safe, ignore cancels; `deaf_since_s` shows it."""
        self.deaf_since_s = time.monotonic()
        try:
            with self._context.patience.deaf():
                yield
        finally:
            self.deaf_since_s = None

    def refusal(self, frames: Frames) -> str | None:
        """Why the display refuses such frames, in words; None where it takes them. It is asked for
        frames of pixels, which a driver that draws cells need not support. Raises DeviceLost."""
        try:
            self.display.load(frames)
        except (DeviceLost, Cancelled):
            raise
        except Exception as err:
            said = err.message if isinstance(err, PdcdError) else f"{type(err).__name__}: {err}"
            return f"the display takes no frames of pixels ({said})"
        return None

    def expose(
        self,
        frames: Frames,
        settings: CameraSettings,
        folder: Path,
        name: str,
        *,
        notify: Emit,
        progress: _Progress,
        cancelled: Callable[[], bool],
        moving: ShutterTiming | None = None,
        hold: bool = False,
        again: bool = False,
    ) -> RigExposure:
        """Take one exposure of the frames and fetch its RAW file; `hold` keeps samples in memory.
        `again` : nothing was done with the rig since the last exposure, so what is loaded and dark
        stays so.

        The shutter opens and closes on panels that have settled to black, so neither its lag and
        jitter nor what the panels showed before matter. When the display gives up (SyncError), the
        file of the spoilt exposure is fetched before that is raised.

        With `moving` the shutter opens and closes while the frames are shown: such a photo shows
        when it did, and is good for nothing else. Raises ExposureError when the frames ended first,
        and ConfigError for rows with times of their own where the display does not support them.
        """
        settle_ns = round(self.config.rig.settle_s * 1e9)
        settings = self._timed(settings, frames, moving)
        black_ns = self._prepare(frames, settings, again=again)
        notify(ShotArmed(shot=name, frames=len(frames)))
        tell_exposure_time(self.shutter, settings)
        self._context.patience.sleep_until_ns(black_ns + settle_ns)
        shared = self._context.shared
        shared.exposed_ns = shared.played = None
        shared.moving = moving is not None
        if moving is not None:
            from pdcd.capture.moving import MovingShutter  # calibrations alone have it

            mover = MovingShutter(
                self.shutter, self.clock, moving, name, notify, progress, cancelled
            )
            log, open_ns, close_ns = self._moved(mover, frames, folder)
            return RigExposure(open_ns, close_ns, log, self._fetched(folder, name).raw, settings)
        open_ns = self.shutter.open()
        notify(ShutterOpen(shot=name, t_mono_ns=open_ns))
        self._context.patience.sleep_until_ns(open_ns + settle_ns)
        try:
            log = with_row_times(self.display.play(progress, cancelled), self.display_info)
        except SyncError:
            self._take_spoilt(open_ns, folder, name, notify, hold)
            raise
        shared.played = (frames, log)
        self.display.black()
        self._context.patience.sleep_until_ns(int(log.end_ns.max()) + settle_ns)
        close_ns = self._close()
        shared.exposed_ns = (open_ns, close_ns)
        notify(ShutterClosed(shot=name, t_mono_ns=close_ns))
        photo = self._fetched(folder, name, hold)
        log = verify_times(log, photo.fetched)
        self._left = frames, int(log.end_ns.max())
        return RigExposure(open_ns, close_ns, log, photo.raw, settings, photo.held)

    def _prepare(self, frames: Frames, settings: CameraSettings, *, again: bool) -> int:
        """Load the frames, make both panels black and the camera ready; returns since when panels
        are black."""
        edge = self.display_info is not None and self.display_info.waits_for_edge
        loaded, black_ns = self._left if again and not edge else (None, None)
        self._left = None, None
        if loaded is not frames:
            self.display.load(frames)
        if black_ns is None:
            self.display.black()
            black_ns = self.clock.now_ns()
        begun_ns = self.clock.now_ns()
        self.readout.arm(settings)
        self._arming_ns = self.clock.now_ns() - begun_ns
        return black_ns

    def _timed(
        self, settings: CameraSettings, frames: Frames, moving: ShutterTiming | None
    ) -> CameraSettings:
        """The settings with the times of this exposure. Raises ConfigError for frames that the
        display cannot show, DeviceLost for a camera that hangs."""
        self.look_at_finder()
        info = self.display_info
        if info is None or not info.row_times:
            check_row_times(frames)
        if moving is not None:
            return with_open_time(settings, self.config, moving.open_s)
        return with_exposure_times(
            settings, self.config, frames, None if info is None else info.refresh_hz
        )

    def _moved(
        self, mover: MovingShutter, frames: Frames, folder: Path
    ) -> tuple[FrameLog, int, int]:
        """Play the loaded frames while the shutter moves; returns the log, and when the shutter was
        surely open, and surely closed."""
        shared = self._context.shared
        try:
            log = with_row_times(self.display.play(mover, mover.over), self.display_info)
        except Cancelled:
            if mover.failure is not None:
                raise mover.failure from None
            raise
        except SyncError:
            if mover.open_ns is not None:
                self._take_spoilt(mover.open_ns, folder, mover.shot, mover.notify)
            raise
        self.display.black()
        shared.played = (frames, log)
        open_ns, close_ns = shared.exposed_ns = mover.ended()
        return log, open_ns, close_ns

    def _take_spoilt(
        self, open_ns: int, folder: Path, name: str, notify: Emit, hold: bool = False
    ) -> None:
        """End an exposure that was given up, and fetch its file: left in the camera, it would be
        taken for the next one."""
        self.display.black()
        close_ns = self._close()
        self._context.shared.exposed_ns = (open_ns, close_ns)
        notify(ShutterClosed(shot=name, t_mono_ns=close_ns))
        self._fetched(folder, name, hold)

    def begin_photos(self) -> None:
        """Start a new job: `recheck_photos` concerns the photos from here on."""
        self._photos = set()

    def forget_photo(self, sha256: str) -> None:
        """Do not recheck that photo: it is not used any more."""
        self._photos.discard(sha256)

    def recheck_photos(self) -> None:
        """Check that the photos since `begin_photos` are unchanged since they were fetched, where
        others have access to their files. Raises ExposureError, DeviceLost."""
        photos = set(self._photos)
        if isinstance(self.readout, RecheckingReadout):
            self.readout.recheck(photos)

    def _fetched(self, folder: Path, name: str, hold: bool = False) -> _StoredPhoto:
        closed_ns = self.clock.now_ns()
        with disk_errors("camera"):
            photo = self.readout.fetch(folder, name, self.config.camera.fetch_timeout_s)
        camera, path = self.camera_info, folder / f"{name}.dng"
        named = ("unknown", "") if camera is None else (camera.model, camera.serial)
        raw, held = keep_photo(photo, path, *named, hold=hold)
        self._photos.add(raw.sha256)
        self._readouts_ns.append(self._arming_ns + self.clock.now_ns() - closed_ns)
        return _StoredPhoto(raw, held, photo)
