"""One open camera of libgphoto2, which shutter and readout share.

Every call ends by libgphoto2's own time-outs: 20 s on USB, 2.5 s over PTP/IP, longer while a Canon
is busy with a picture. Some calls hold Python's global lock for that long (seen with the summary,
which is never asked for here), so a program with other threads that must run in time should use the
driver ``ptp``. Between calls, and while a picture comes, a cancel is checked for
(`pdcd.driver.Patience`); a call that takes its whole time-out on USB is as long as the watchdog of
pdcd.service waits. Only one thread is in libgphoto2 at a time.
"""

from __future__ import annotations

import fcntl
import logging
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Literal, NamedTuple

import gphoto2 as gp
import msgspec

from pdcd.driver import (
    Clock,
    ConfigError,
    DeviceLost,
    DriverContext,
    ExposureError,
    Patience,
    PdcdError,
    read_options,
)

logger = logging.getLogger(__name__)

_HINTS = {
    gp.GP_ERROR_IO_USB_CLAIM: "another program holds it: gio mount -s gphoto2, or close it",
    gp.GP_ERROR_MODEL_NOT_FOUND: "is it on, and plugged in? gphoto2 --auto-detect lists cameras",
    gp.GP_ERROR_UNKNOWN_PORT: "see gphoto2 --list-ports",
    gp.GP_ERROR_BAD_PARAMETERS: "see gphoto2 --list-config",
    gp.GP_ERROR_CAMERA_BUSY: "wait until it has written its pictures",
}
_OFF_ON = "check cable and battery; switch the camera off and on"
_QUIET_MS = 50
_BUSY_S, _AGAIN_S = 5.0, 0.2
"""How long a busy camera is asked again, and the pause between; it reports that it did nothing."""
_LOST = frozenset(
    {
        gp.GP_ERROR_IO,
        gp.GP_ERROR_IO_READ,
        gp.GP_ERROR_IO_WRITE,
        gp.GP_ERROR_IO_UPDATE,
        gp.GP_ERROR_IO_USB_CLEAR_HALT,
        gp.GP_ERROR_IO_USB_FIND,
    }
)
"""After these errors an open camera does not answer any more, even if the device is back. A
time-out is not among them."""


class GphotoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[camera.options] of this driver; [trigger.options] if only the trigger uses it."""

    port: str = ""
    """Port as libgphoto2 names it (``usb:001,004``, ``ptpip:192.168.1.2``); "" takes the only USB
    camera."""
    model: str = ""
    """Model as libgphoto2 names it; "" asks the camera. PTP/IP needs ``PTP/IP Camera``."""
    destination: Literal["ram", "card"] = "ram"
    """Where the camera keeps a picture until it is fetched."""


class CameraFile(NamedTuple):
    """Where a picture lies in the camera."""

    folder: str
    name: str


class GphotoSession:
    """Opened by the first of its users, closed by the last."""

    def __init__(
        self,
        options: GphotoOptions,
        clock: Clock,
        patience: Patience | None = None,
    ) -> None:
        self.options = options
        self.patience = patience or Patience(clock)
        self.shutter_open = False
        """Whether an exposure was begun by `bulb` and not surely ended."""
        self.photo_due_ns: int | None = None
        """Until when the photo of an exposure that was not fetched may still come; None if all were
        fetched."""
        self._clock = clock
        self._lock = threading.RLock()
        self._users: set[str] = set()
        self._camera: Any = None
        self._place = ""

    @classmethod
    def of(cls, context: DriverContext) -> GphotoSession:
        """The session of this rig. Raises ConfigError for wrong options."""
        return context.the(cls, lambda: cls(_options(context), context.clock, context.patience))

    def open(self, user: str) -> None:
        """Find and open the camera. Raises DeviceLost."""
        self._users.add(user)
        if self._camera is not None:
            return
        camera = gp.Camera()
        with self.errors("open the camera"):
            if self.options.port:
                ports = gp.PortInfoList()
                ports.load()
                camera.set_port_info(ports[ports.lookup_path(self.options.port)])
            if self.options.model:
                models = gp.CameraAbilitiesList()
                models.load()
                camera.set_abilities(models[models.lookup_model(self.options.model)])
            with _standard_input_kept():
                camera.init()
            place = str(camera.get_port_info().get_path())
        if self._place not in ("", place):
            self.photo_due_ns = None  # it was switched off and on, and its memory is empty
        self._camera, self._place = camera, place

    @property
    def releases(self) -> bool:
        """Whether the shutter is operated from here, not by a cable release."""
        return "shutter" in self._users

    @property
    def is_open(self) -> bool:
        """Whether the camera is open."""
        return self._camera is not None

    def close(self, user: str) -> None:
        """Release the camera if it has no other user. Idempotent; never fails."""
        self._users.discard(user)
        if not self._users:
            self._let_go()

    def _let_go(self) -> None:
        if self._camera is not None:
            camera, self._camera = self._camera, None
            try:
                with _standard_input_kept():
                    camera.exit()
            except gp.GPhoto2Error as err:  # it is gone, which is what was wanted
                logger.warning("camera not closed in order error=%s", err)

    def get(self, name: str) -> str:
        """A setting as text. Raises ConfigError when the camera has none of that name."""
        return str(self._widget(name).get_value())

    def choices(self, name: str) -> list[str]:
        """Allowed values of a setting; empty when the camera lacks it or names no choices."""
        with suppress(ConfigError):
            widget = self._widget(name)
            if widget.get_type() in (gp.GP_WIDGET_RADIO, gp.GP_WIDGET_MENU):
                return [str(widget.get_choice(i)) for i in range(widget.count_choices())]
        return []

    def set(self, name: str, value: str | int) -> None:
        """Change a setting; a busy camera is asked again for some seconds.

        Raises ConfigError, with the list, for one that is not offered.
        """
        choices = self.choices(name) if isinstance(value, str) else []
        if choices and value not in choices:
            raise ConfigError(
                f"{name} {value} is not offered",
                device="camera",
                hint=f"take one of {', '.join(choices)}",
            )
        until_ns = self._clock.now_ns() + round(_BUSY_S * 1e9)
        while True:
            try:
                widget = self._widget(name)
                with self.errors(f"set {name} to {value}"):
                    widget.set_value(value)
                    self._opened().set_single_config(name, widget)
                return
            except DeviceLost as lost:
                if not _is_busy(lost) or self._clock.now_ns() >= until_ns:
                    raise
            self.patience.sleep(_AGAIN_S)

    def prefer(self, name: str, value: str) -> None:
        """Change a setting if the camera has it and offers that value; some have a dial for it."""
        for choice in self.choices(name):
            if choice.lower() == value.lower():
                self.set(name, choice)

    def next_file(self, wait_s: float) -> CameraFile | None:
        """The next picture that the camera announces; None if there is none within the time."""
        with self.errors("ask for events"):
            kind, data = self._opened().wait_for_event(max(1, round(wait_s * 1e3)))
        if kind == gp.GP_EVENT_FILE_ADDED:
            return CameraFile(str(data.folder), str(data.name))
        return None

    def drain(self, limit_s: float) -> list[CameraFile]:
        """Pictures in waiting events; reads events until there are none."""
        files: list[CameraFile] = []
        until_ns = self._clock.now_ns() + round(limit_s * 1e9)
        while self._clock.now_ns() < until_ns:
            with self.errors("ask for events"):
                kind, data = self._opened().wait_for_event(_QUIET_MS)
            if kind == gp.GP_EVENT_FILE_ADDED:
                files.append(CameraFile(str(data.folder), str(data.name)))
            elif kind == gp.GP_EVENT_TIMEOUT:
                break
        return files

    def download(self, file: CameraFile, most_bytes: int) -> bytes:
        """All bytes of a picture, which is then removed from the camera's buffer.

        Raises ExposureError for one with more than `most_bytes`.
        """
        with self.errors(f"download {file.name}"):
            size_bytes = self._size_bytes(file)
            if size_bytes > most_bytes:
                raise ExposureError(
                    f"the camera says that {file.name} has {size_bytes} bytes, and a photo of its "
                    f"sensor has {most_bytes} at most",
                    device="camera",
                    hint="take it again; is camera.profile that of this body?",
                )
            found, context = gp.CameraFile(), gp.Context()
            asked = context.set_cancel_func(self._is_over, None)  # not asked again once dropped
            self._opened().file_get(file.folder, file.name, gp.GP_FILE_TYPE_NORMAL, found, context)
            del asked
            return bytes(memoryview(found.get_data_and_size()))

    def see(self) -> bytes:
        """A picture of the camera's finder, as it sends it."""
        with self.errors("see through its finder"):
            return bytes(memoryview(self._opened().capture_preview().get_data_and_size()))

    def _size_bytes(self, file: CameraFile) -> int:
        """The size that the camera gives for a picture; 0 if it gives none."""
        try:
            told = self._opened().file_get_info(file.folder, file.name).file
        except gp.GPhoto2Error as err:
            if err.code in _LOST:
                raise
            return 0
        return int(told.size) if told.fields & gp.GP_FILE_INFO_SIZE else 0

    def _is_over(self, _context: object, _data: object) -> int:
        """Called by libgphoto2 while a picture comes: whether it is no longer wanted."""
        try:
            self.patience.look()
        except PdcdError:
            return int(gp.GP_CONTEXT_FEEDBACK_CANCEL)
        return int(gp.GP_CONTEXT_FEEDBACK_OK)

    @contextmanager
    def errors(self, doing: str) -> Iterator[None]:
        """Turn libgphoto2's errors into DeviceLost with a hint. A lost camera is released, so that
        `open` can find it again. Before each call, a cancel is checked for."""
        self.patience.look()
        self.patience.acquire(self._lock)
        try:
            yield
        except gp.GPhoto2Error as err:
            if err.code in _LOST:
                self._let_go()
            if err.code == gp.GP_ERROR_CANCEL:
                self.patience.look()
            raise DeviceLost(
                f"cannot {doing}: {err.string} ({err.code})",
                device="camera",
                hint=_HINTS.get(err.code, _OFF_ON),
            ) from err
        finally:
            self._lock.release()

    def _opened(self) -> Any:
        if self._camera is None:
            raise DeviceLost("the camera is not open", device="camera", hint="connect first")
        return self._camera

    def _widget(self, name: str) -> Any:
        camera = self._opened()
        with self.errors(f"read {name}"):
            try:
                return camera.get_single_config(name)
            except gp.GPhoto2Error as err:
                if err.code not in (gp.GP_ERROR_BAD_PARAMETERS, gp.GP_ERROR_NOT_SUPPORTED):
                    raise
                raise ConfigError(
                    f"the camera has no setting {name}",
                    device="camera",
                    hint="see gphoto2 --list-config; use another driver for what it lacks",
                ) from err


def _is_busy(lost: DeviceLost) -> bool:
    cause = lost.__cause__
    return isinstance(cause, gp.GPhoto2Error) and cause.code == gp.GP_ERROR_CAMERA_BUSY


@contextmanager
def _standard_input_kept() -> Iterator[None]:
    """Put file descriptor 0 back afterwards, unless another thread has a file there by now.

    libgphoto2 2.5.34 closes it when it leaves a PTP/IP camera (seen; it takes an unset field for a
    descriptor), and later closes the next file that the daemon opens under that number.
    """
    try:
        kept = os.dup(0)
    except OSError:  # closed before: nothing to keep
        yield
        return
    try:
        yield
    finally:
        if again := fcntl.fcntl(kept, fcntl.F_DUPFD, 0):  # the lowest that is free
            os.close(again)
        os.close(kept)


def _options(context: DriverContext) -> GphotoOptions:
    context.require_real_time("camera", "camera")
    config = context.config
    by_camera = config.camera.driver == "gphoto2"
    options = read_options(
        config.camera.options if by_camera else config.trigger.options,
        GphotoOptions,
        table="camera.options" if by_camera else "trigger.options",
        device="camera",
        hint="docs/cameras.md lists the options of the driver gphoto2",
    )
    return options
