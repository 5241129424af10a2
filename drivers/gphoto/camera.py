"""Shutter and readout of a camera that libgphoto2 knows.

Never run on a real camera. Not modelled: cameras without the setting ``bulb`` (most Nikons have
it; others need a trigger of their own), long-exposure noise reduction, which must be off in the
camera's menu.
"""

from __future__ import annotations

import hashlib
import logging
import sys
import weakref
from contextlib import suppress
from pathlib import Path, PurePath

import msgspec

from pdcd.driver import (
    RAW_SUFFIXES,
    CameraConfig,
    CameraInfo,
    CameraSettings,
    Clock,
    ConfigError,
    DecodeError,
    DeviceLost,
    DriverContext,
    ExposureError,
    PdcdError,
    RawFile,
    TriggerConfig,
    disk_errors,
    load_profile,
    read_tags,
    responsivity_e,
)

from ..guard import ShutterGuard
from .session import CameraFile, GphotoSession

logger = logging.getLogger(__name__)

GPHOTO_GUARDIAN: tuple[str, ...] = (sys.executable, "-P", "-m", f"{__package__}.guardian")
"""Command that ends an exposure if this process is killed; the camera's options and its line
follow."""
_ANSWER_S = 20.0
"""Longest time for an answer of the guardian; its start takes half a second."""
_TARGETS = {"ram": "Internal RAM", "card": "Memory card"}
_SLICE_S = 0.5
"""Longest single wait for an event."""
_LATE_S = 0.3
"""How long to wait for a second file of the same exposure."""
_WHOLE_S = 1.0
"""Extra time for a photo that was announced in time, to become whole."""
_DRAIN_S, _ARM_S = 5.0, 120.0
"""How long events are read, and the longest time until the camera is ready for a photo, on top of
the wait for a photo that is still to come."""
_STRAY_S = 15.0
"""How long after an exposure, or after its photo was given up, the photo may still come, on top of
the exposure's length, which noise reduction takes once more."""


class GphotoShutter:
    """Opens and closes by the camera's setting ``bulb``.

    The shutter is closed when the driver is disconnected, forgotten, or the interpreter ends; when
    the process is killed, another one does it (`drivers.gphoto.guardian`).
    """

    maturity = "experimental"

    def __init__(self, session: GphotoSession, config: TriggerConfig, clock: Clock) -> None:
        self._session = session
        self._clock = clock
        self._sure_ns = config.sure_ns
        self._begun_ns = 0
        options = msgspec.json.encode(session.options).decode()
        self._guard = ShutterGuard((*GPHOTO_GUARDIAN, options), answer_s=_ANSWER_S)
        weakref.finalize(self, _close_forgotten, session)

    @classmethod
    def create(cls, context: DriverContext) -> GphotoShutter:
        """The shutter of this rig's camera. Raises ConfigError."""
        return cls(GphotoSession.of(context), context.config.trigger, context.clock)

    def connect(self) -> dict[str, str]:
        """Open the camera; an exposure that a dead program left running is ended."""
        self._session.open("shutter")
        self._session.get("bulb")  # or say that there is none
        self._session.prefer("shutterspeed", "bulb")
        with suppress(PdcdError):  # most cameras refuse to end what has not begun
            self._session.set("bulb", 0)
        self._ended()
        self._guard.insist("disarm")
        return {"model": "gphoto2 bulb", "port": self._session.options.port or "usb"}

    def open(self) -> int:
        """Start the exposure; never asked twice, as the first may have worked.

        Raises DeviceLost; `close` must then be called, and ends it if it did start.
        """
        self._guard.arm(lambda: "arm")  # before it is open: a kill may come at any time
        self._session.shutter_open, self._begun_ns = True, self._clock.now_ns()
        self._session.set("bulb", 1)
        return self._settled_ns()

    def close(self) -> int:
        """End the exposure. A camera that was lost meanwhile is looked for: it may be exposing.

        Raises DeviceLost if the state of the shutter is unknown; ExposureError when it is closed
        but the connection was lost.
        """
        if not self._session.shutter_open:
            return self._clock.now_ns()
        try:
            self._session.set("bulb", 0)
        except DeviceLost as lost:
            self._end_anew(lost)
        self._ended()
        return self._settled_ns()

    def disconnect(self) -> None:
        """Close, then release the camera."""
        try:
            self.close()
        finally:
            # With a shutter to close the guardian may take long: it waits for the camera.
            self._guard.stop(wait=not self._session.shutter_open)
            self._session.shutter_open = False
            self._session.close("shutter")

    def _end_anew(self, lost: DeviceLost) -> None:
        """End the exposure of a camera that has to be opened again; raises in any case."""
        if self._session.is_open:
            raise lost  # it answers, but refuses
        try:
            self._session.open("shutter")
        except DeviceLost:
            raise lost from None
        try:
            self._session.set("bulb", 0)
        except DeviceLost:
            if not self._session.is_open:
                raise
            logger.warning("a camera that was lost holds no exposure any more")
        self._ended()
        raise ExposureError(
            "the connection was lost while the shutter was open",
            device="camera",
            hint="the exposure was ended; take it again",
        ) from lost

    def _ended(self) -> None:
        """Note that the shutter is closed, and until when the photo may come if it was open."""
        if self._session.shutter_open:
            now_ns = self._clock.now_ns()
            stray_ns = round(_STRAY_S * 1e9)
            self._session.photo_due_ns = now_ns + (now_ns - self._begun_ns) + stray_ns
        self._session.shutter_open = False
        self._guard.disarm()

    def _settled_ns(self) -> int:
        sure_ns = self._clock.now_ns() + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns


class GphotoReadout:
    """Sets ISO and aperture, and fetches the RAW file of an exposure, whatever released it."""

    maturity = "experimental"

    def __init__(self, session: GphotoSession, config: CameraConfig, clock: Clock) -> None:
        self._session = session
        self._config = config
        self._clock = clock
        self._isos: dict[int, str] = {}
        self._f_numbers: dict[float, str] = {}
        self._most_bytes = load_profile(config.profile).largest_photo_bytes
        self._armed_ns: int | None = None

    @classmethod
    def create(cls, context: DriverContext) -> GphotoReadout:
        """The readout of this rig's camera. Raises ConfigError."""
        return cls(GphotoSession.of(context), context.config.camera, context.clock)

    def connect(self) -> CameraInfo:
        """Open the camera and ask for its settings.

        Raises DeviceLost, and ConfigError for a camera whose ISO cannot be set.
        """
        session = self._session
        session.open("readout")
        self._isos = {int(c): c for c in session.choices("iso") if c.isdigit()}
        if not self._isos:
            raise ConfigError(
                "the camera offers no ISO",
                device="camera",
                hint="turn its dial to M; see gphoto2 --get-config iso",
            )
        self._f_numbers = {}
        for choice in session.choices("aperture"):
            with suppress(ValueError):  # "implicit auto" and the like
                self._f_numbers[float(choice.removeprefix("f/"))] = choice
        session.drain(_DRAIN_S)
        self._choose_target()
        return CameraInfo(
            model=self._say("cameramodel") or "gphoto2 camera",
            serial=self._say("serialnumber"),
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config),
            isos=tuple(sorted(self._isos)),
            f_numbers=tuple(sorted(self._f_numbers)),
            frame_quads=load_profile(self._config.profile).frame_quads,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Set bulb, RAW, ISO and aperture. Pictures of earlier exposures are thrown away; one that
        was given up is waited for, as it could be taken for the next. A lost camera is opened again
        first.

        Raises ConfigError with the list of what the camera offers, DeviceLost.
        """
        session, armed_ns, self._armed_ns = self._session, self._armed_ns, None
        if armed_ns is not None and not session.releases:
            self._give_up(armed_ns)  # a cable release does not report what it did
        due_s = ((session.photo_due_ns or 0) - self._clock.now_ns()) * 1e-9

        def too_slow() -> PdcdError:
            return DeviceLost(
                "did not get ready for a photo in time",
                device="camera",
                hint="switch it off and on; empty its card",
            )

        with session.patience.within(_ARM_S + max(0.0, due_s), too_slow):
            self._arm(settings)
        self._armed_ns = self._clock.now_ns()

    def _arm(self, settings: CameraSettings) -> None:
        session = self._session
        if not session.is_open:
            self.connect()  # it was lost since
        if settings.iso not in self._isos:
            raise ConfigError(
                f"ISO {settings.iso} is not offered",
                device="camera",
                hint=f"take one of {', '.join(map(str, sorted(self._isos)))}",
            )
        session.set("iso", self._isos[settings.iso])
        if settings.f_number is not None and self._f_numbers:
            nearest = min(self._f_numbers, key=lambda f: abs(f - (settings.f_number or 0.0)))
            if abs(nearest / settings.f_number - 1.0) > 0.01:
                raise ConfigError(
                    f"f/{settings.f_number:g} is not offered",
                    device="camera",
                    hint=f"take one of {', '.join(f'{f:g}' for f in sorted(self._f_numbers))}",
                )
            session.set("aperture", self._f_numbers[nearest])
        session.prefer("shutterspeed", "bulb")  # also for a shutter on a cable
        session.prefer("imageformat", "RAW")
        self._clear()

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        """Wait for the RAW file and store it; JPEGs beside it are thrown away.

        Raises ExposureError for none or more than one, DecodeError for a file with a piece missing,
        DeviceLost, NoSpaceError, or DiskError for any other refusal of the disk.
        """
        armed_ns, self._armed_ns = self._armed_ns, None
        if armed_ns is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        session, begun_ns = self._session, self._clock.now_ns()
        session.photo_due_ns = begun_ns  # until it is here

        def too_slow() -> PdcdError:
            return ExposureError(
                f"no RAW file came whole within {timeout_s:g} s",
                device="camera",
                hint="take it again; on a slow bus raise camera.fetch_timeout_s",
            )

        try:
            with session.patience.within(timeout_s + _WHOLE_S, too_slow):
                file, data = self._wait(timeout_s)
        finally:
            if session.photo_due_ns is not None:
                self._give_up(armed_ns, begun_ns)
        tags = read_tags(data)
        if not data or (tags is not None and tags.needs_bytes > len(data)):
            raise DecodeError(
                f"{file.name} came home with {len(data)} bytes, not whole",
                device="camera",
                hint="take the photo again; check the cable",
            )
        path = folder / f"{name}{PurePath(file.name).suffix.lower()}"
        with disk_errors(str(path)), path.open("xb") as copy:
            try:
                copy.write(data)
                copy.flush()
            except OSError:
                path.unlink()
                raise
        return RawFile(path, len(data), hashlib.sha256(data).hexdigest())

    def disconnect(self) -> None:
        """Release the camera."""
        self._armed_ns = None
        self._session.close("readout")

    def _choose_target(self) -> None:
        """Have pictures kept where the options say. Raises ConfigError where the camera cannot."""
        session, wanted = self._session, self._session.options.destination
        offered = session.choices("capturetarget")
        if offered and _TARGETS[wanted] not in offered:
            other = [f'destination = "{name}"' for name in _TARGETS if _TARGETS[name] in offered]
            raise ConfigError(
                f"the camera cannot keep its pictures in {_TARGETS[wanted]}, only in "
                f"{', '.join(offered)}",
                device="camera",
                hint=f"set {' or '.join(other) or 'its target'} in [camera.options]",
            )
        if offered:
            session.set("capturetarget", _TARGETS[wanted])

    def _give_up(self, armed_ns: int, closed_ns: int | None = None) -> None:
        """Stop waiting for the photo of an exposure, and note until when it may still come."""
        now_ns = self._clock.now_ns()
        exposed_ns = 0 if closed_ns is None else closed_ns - armed_ns
        self._session.photo_due_ns = now_ns + exposed_ns + round(_STRAY_S * 1e9)

    def _wait(self, timeout_s: float) -> tuple[CameraFile, bytes]:
        """The one RAW file of this exposure, downloaded."""
        until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        seen: set[CameraFile] = set()
        found: list[tuple[CameraFile, bytes]] = []
        while (left_s := (until_ns - self._clock.now_ns()) * 1e-9) > 0.0:
            file = self._session.next_file(min(left_s, _SLICE_S))
            if file is None or file in seen:  # an event was repeated
                continue
            seen.add(file)
            data = self._session.download(file, self._most_bytes)
            if _is_raw(file):
                self._session.photo_due_ns = None
                if not found:
                    until_ns = self._clock.now_ns() + round(_LATE_S * 1e9)
                found.append((file, data))
        if len(found) > 1:
            raise ExposureError(
                f"{len(found)} RAW files came for one exposure",
                device="camera",
                hint="set single shots; has somebody else released the shutter?",
            )
        if not found:
            other = ", ".join(sorted(file.name for file in seen))
            raise ExposureError(
                f"no RAW file came within {timeout_s:g} s" + (f", only {other}" if other else ""),
                device="camera",
                hint="is the camera set to RAW, the dial to M or B, noise reduction off?",
            )
        return found[0]

    def _clear(self) -> None:
        """Throw away pictures of earlier exposures, also one that is still to come.

        Raises ExposureError when that one does not come: it could be taken for the next. With a
        cable release it is not known whether there was an exposure, so waiting must be enough.
        """
        session, owed = self._session, self._session.photo_due_ns is not None
        for late in session.drain(_DRAIN_S):
            owed = not self._thrown_away(late) and owed
        while owed and (left_ns := (session.photo_due_ns or 0) - self._clock.now_ns()) > 0:
            late_one = session.next_file(min(left_ns * 1e-9, _SLICE_S))
            owed = late_one is None or not self._thrown_away(late_one)
        if owed and session.releases:
            raise ExposureError(
                "the photo of an earlier exposure has not come and could be taken for the next",
                device="camera",
                hint="wait a while, or switch the camera off and on and start pdcd anew",
            )
        if owed:
            logger.warning("the picture of an earlier exposure never came")
        session.photo_due_ns = None

    def _thrown_away(self, late: CameraFile) -> bool:
        """Throw one away; returns whether it was a RAW file."""
        logger.warning("picture of an earlier exposure thrown away name=%s", late.name)
        # Downloaded, as else its place in the buffer stays occupied.
        self._session.download(late, self._most_bytes)
        return _is_raw(late)

    def _say(self, name: str) -> str:
        """A setting; "" if the camera does not have it."""
        with suppress(ConfigError):
            return self._session.get(name)
        return ""


def _close_forgotten(session: GphotoSession) -> None:
    """End the exposure of a shutter object that was dropped; errors cannot be reported there."""
    if session.shutter_open and session.is_open:
        try:
            with session.patience.deaf():
                session.set("bulb", 0)
        except PdcdError as err:
            logger.critical("shutter may be open device=shutter error=%s", err)
        else:
            session.shutter_open = False


def _is_raw(file: CameraFile) -> bool:
    return PurePath(file.name).suffix.lower() in RAW_SUFFIXES
