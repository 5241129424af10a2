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
from pdcd.sensor.dng import CFAS, keep_photo
from pdcd.sensor.profile import load_profile
from pdcd.virtual.scene.scene import Scene

if TYPE_CHECKING:
    from pdcd.capture.moving import MovingShutter

logger = logging.getLogger(__name__)

_LAST_PHOTOS = 9
"""Photos by whose median it is known what a photo costs."""

_Progress = Callable[[int, int, int], None]


class _StoredPhoto(NamedTuple):
    """A photo's file, what is in it and others where these are in memory alone, and what the
    camera's driver handed over."""

    raw: RawFile
    held: Mapping[str, bytes]
    fetched: RawFile | PhotoFrame


class Rig:
    """Display, shutter and readout of a configuration, on one clock."""

    def __init__(self, config: Config, broken_off: Callable[[], bool] = lambda: False) -> None:
        """`broken_off()`: whether nothing is to be waited for any more, asked in any thread.

        Raises ConfigError for a place on the field that a device cannot have, before any driver
        is made; DriverUnavailable for a driver that is not there."""
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
        """Since when, on the clock that does not step, devices are being made safe; for any
        thread."""
        self._left: tuple[Frames | None, int | None] = None, None
        """Of the last exposure: its frames, and since when panels are black."""
        self.look_at_finder: Callable[[], object] = lambda: None
        """Raises DeviceLost while the camera hangs in a live view that was left behind."""

    @property
    def camera(self) -> CameraInfo | None:
        """What is known of an open camera, what its photos were seen to cost included."""
        info = self.camera_info
        if info is None or not self._readouts_ns:
            return info
        return replace(info, readout_s=1e-9 * median(self._readouts_ns))

    @property
    def scene(self) -> Scene | None:
        """The scene that photos are of, where a driver knows it (the mock camera does); None for a
        real camera, whatever it stands before."""
        return self._virtual_scene if self._context.shared.photographed else None

    @property
    def _virtual_scene(self) -> Scene | None:
        """The scene of a mock bench any part of which is in use."""
        scene = self._context.shared.scene
        return scene if isinstance(scene, Scene) else None

    @property
    def display_warnings(self) -> tuple[str, ...]:
        """What the display says of its panels that the user must know."""
        return () if self.display_info is None else self.display_info.warnings

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""
        scene = self._virtual_scene
        return self.config.code_grid(None if scene is None else scene.grid)

    @property
    def cells_meet(self) -> bool:
        """Whether no panel can lie elsewhere: on a mock bench of cells."""
        return self._context.shared.cells_meet

    @property
    def mock(self) -> bool:
        """Whether the photos come from a virtual scene."""
        return self.scene is not None

    @property
    def mixed(self) -> str | None:
        """What to know of a rig with a real camera and virtual devices; None for any other."""
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
        """What the camera is; one that is not open is opened for the question only."""
        if self.camera_info is not None:
            return self.camera_info
        try:
            return self._as_measured(self.readout.connect())
        finally:
            self.readout.disconnect()

    def _as_measured(self, camera: CameraInfo) -> CameraInfo:
        """What a driver says of its camera, with what the configuration knows of it: that was
        measured, or typed by somebody, and a driver may only guess.

        Raises ConfigError for a sensor whose photos cannot be read, or whose answer to light has
        another number of colours."""
        if load_profile(self.config.camera.profile).colours == 1:
            camera = replace(camera, cfa=None)
        if camera.cfa not in (None, *CFAS):
            raise ConfigError(
                f"{camera.model} has a sensor with a mosaic {camera.cfa}, which cannot be read",
                device="camera",
                hint=f"use a camera without colours, or with a Bayer mosaic: {', '.join(CFAS)}",
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
        """Cover the projector's lens, or uncover it, for the exposures to come: of a mock bench. Of
        any other somebody has to do it."""
        self._context.shared.covered = covered

    def mask_lag_s(self, *, look: bool = True) -> float | None:
        """Lag of the mask; see `pdcd.capture.mask_lag`. A display that is not open is opened for
        the question only. look : whether a plan depends on it; black refreshes are not shown for a
        word in its reasons.
        """
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
        """Make safe, then release all devices; goes on past a device that fails."""
        self.make_safe()
        for device in (self.readout, self.shutter, self.display):
            release_device(type(device).__name__, device.disconnect, self._context.patience)

    def make_safe(self) -> bool:
        """Both panels black and the shutter closed; whether they are. See `pdcd.capture.safety`."""
        with self._deaf():
            return make_safe(self.display, self.shutter, self._context.patience)

    def make_safe_beside(self, within_s: float) -> bool:
        """The same from another thread, while the rig's own may hang in a driver."""
        return make_safe_beside(self.display, self.shutter, self._context.patience, within_s)

    def _close(self) -> int:
        """Close the shutter, cancelled or not."""
        with self._deaf():
            return self.shutter.close()

    @contextmanager
    def _deaf(self) -> Iterator[None]:
        """Devices are made safe, which hears no cancel; `deaf_since_s` tells."""
        self.deaf_since_s = time.monotonic()
        try:
            with self._context.patience.deaf():
                yield
        finally:
            self.deaf_since_s = None

    def refusal(self, frames: Frames) -> str | None:
        """Why the display takes no such frames, in words; None where it does. Asked of frames of
        pixels, which a driver that draws cells need not know; a device that is lost is raised."""
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
        `again` : nothing was done with the rig since the last, so what is loaded and dark stays so.

        The shutter opens and closes on panels that have settled to black, so its lag and jitter do
        not matter, nor what the panels showed before. When the display gives up (SyncError), the
        file of the spoilt exposure is fetched before that is raised.

        With `moving` the shutter opens and closes while the frames are shown: such a photo tells
        when it did, and is good for nothing else. Raises ExposureError when the frames ended first,
        and ConfigError for rows with times of their own that the display does not know.
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
        """Load the frames, both panels black, the camera ready; since when panels are black."""
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
        """Play the loaded frames while the shutter moves; log, and when it was surely open, and
        surely closed."""
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
        """End an exposure that was given up, and take its file: left in the camera, it would pass
        for the next one."""
        self.display.black()
        close_ns = self._close()
        self._context.shared.exposed_ns = (open_ns, close_ns)
        notify(ShutterClosed(shot=name, t_mono_ns=close_ns))
        self._fetched(folder, name, hold)

    def begin_photos(self) -> None:
        """The photos from here on are those of one job."""
        self._photos = set()

    def forget_photo(self, sha256: str) -> None:
        """Nothing is made of that photo any more."""
        self._photos.discard(sha256)

    def recheck_photos(self) -> None:
        """See that the photos since `begin_photos` still are what they were fetched as, where their
        files lie in others' hands. Raises ExposureError, DeviceLost."""
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
