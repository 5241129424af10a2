"""Settings and photos of a Canon EOS body over USB."""

from __future__ import annotations

import logging
import weakref
from pathlib import Path
from typing import TypeVar

from pdcd.driver import (
    CameraConfig,
    CameraInfo,
    CameraSettings,
    Clock,
    ConfigError,
    DriverContext,
    ExposureError,
    PdcdError,
    RawFile,
    load_profile,
    responsivity_e,
)

from .codes import Property
from .eos import EosCamera
from .events import ObjectAdded
from .faults import DEVICE
from .files import store_photo, suffix_of, wait_for_photo
from .values import list_f_numbers, list_isos

logger = logging.getLogger(__name__)

_Number = TypeVar("_Number", int, float)

FILE_EXTRA_S = 30.0
"""A photo is waited for this long, plus twice the exposure: noise reduction doubles it."""
_LATE_S = 5.0
"""A photo that takes longer than both this and its exposure is reported with a warning."""
_WHOLE_S = 1.0
"""Extra time for a photo that was announced in time, to become whole."""
_STRAY_S = 15.0
"""How long the photo of an exposure that was given up is waited for before the next one."""


class PtpReadout:
    """Sets ISO, aperture and bulb, and fetches the photo, whatever operated the shutter.

    With a cable release the camera is armed in the same way, and its photo is waited for. The next
    `arm` deals with exposures whose photos were not fetched, so that no photo is taken for that of
    another exposure. Never run on a real body so far.
    """

    maturity = "experimental"

    def __init__(self, camera: EosCamera, clock: Clock, config: CameraConfig) -> None:
        self._camera = camera
        self._clock = clock
        self._config = config
        self._armed_ns: int | None = None
        self._session = self._found = 0
        weakref.finalize(self, camera.let_go, "readout")

    @classmethod
    def create(cls, context: DriverContext) -> PtpReadout:
        """The readout of this rig's camera."""
        return cls(EosCamera.of(context), context.clock, context.config.camera)

    def connect(self) -> CameraInfo:
        """Open the session and return what the camera reports about itself."""
        identity = self._camera.open("readout")
        choices = self._camera.choices
        # A virtual body has films of any size, whatever sensor it reports.
        virtual = self._camera.options.in_process
        return CameraInfo(
            model=identity["model"],
            serial=identity["serial"],
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config),
            isos=tuple(list_isos(choices.get(Property.ISO, ()))),
            f_numbers=tuple(list_f_numbers(choices.get(Property.APERTURE, ()))),
            frame_quads=None if virtual else load_profile(self._config.profile).frame_quads,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Apply the settings and check that the camera can expose.

        Raises ConfigError with what the camera offers, ExposureError with what to change on it. A
        lost camera is looked for first.
        """
        camera, armed_ns, self._armed_ns = self._camera, self._armed_ns, None
        with camera.in_time():
            if armed_ns is not None and not camera.releases:
                camera.bulb.owed = True  # a cable release does not report what it did
            camera.session.open()
            camera.poll()
            camera.check_ready()
            iso = _choose(settings.iso, list_isos(camera.choices.get(Property.ISO, ())), "ISO ")
            aperture = None
            if settings.f_number is not None:
                offered = list_f_numbers(camera.choices.get(Property.APERTURE, ()))
                aperture = _choose(settings.f_number, offered, "f/")
            self._clear()
            camera.set_value(Property.ISO, iso, f"ISO {settings.iso}")
            camera.set_bulb()
            if aperture is not None:
                camera.set_value(Property.APERTURE, aperture, f"f/{settings.f_number:g}")
            self._session, self._found = camera.session.renewed, camera.session.found
            self._armed_ns = self._clock.now_ns()

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        """Wait for the photo and store it as `folder/name` with the camera's own suffix.

        Waits for twice the time since `arm` and `FILE_EXTRA_S`, but not beyond `timeout_s`.
        Raises ExposureError when no photo comes, or one that is not whole.
        """
        camera, armed_ns, self._armed_ns = self._camera, self._armed_ns, None
        if armed_ns is None:
            raise ExposureError("the camera was not armed", device=DEVICE, hint="call arm first")
        if camera.bulb.since_ns is not None:
            raise ExposureError("the shutter is open", device=DEVICE, hint="close it first")
        camera.bulb.owed = True  # until it is here, or known not to come

        def too_slow() -> PdcdError:
            return ExposureError(
                f"the photo did not come whole within {timeout_s:g} s",
                device=DEVICE,
                hint="take it again; on a slow bus raise camera.fetch_timeout_s",
            )

        with camera.patience.within(timeout_s + _WHOLE_S, too_slow):
            return self._fetched(folder, name, armed_ns, timeout_s)

    def _fetched(self, folder: Path, name: str, armed_ns: int, timeout_s: float) -> RawFile:
        camera, begun_ns = self._camera, self._clock.now_ns()
        exposed_s = (begun_ns - armed_ns) * 1e-9
        wait_s = min(timeout_s, 2.0 * exposed_s + FILE_EXTRA_S)
        self._same_session()
        while (photo := wait_for_photo(camera, begun_ns + round(wait_s * 1e9))) is not None:
            raw = self._stored(photo, folder / f"{name}{suffix_of(photo)}")
            if raw is not None:
                camera.bulb.owed = False
                waited_s = (self._clock.now_ns() - begun_ns) * 1e-9
                if waited_s > max(exposed_s, _LATE_S):
                    logger.warning("photo came late, noise reduction? waited_s=%.1f", waited_s)
                return raw
            logger.warning("event without a photo, ignored handle=%#x", photo.handle)
        self._same_session()
        raise ExposureError(
            f"no photo came within {wait_s:.0f} s",
            device=DEVICE,
            hint="is the camera set to RAW, and long-exposure noise reduction off?",
        )

    def _stored(self, photo: ObjectAdded, path: Path) -> RawFile | None:
        """`store_photo`; a photo that cannot be fetched is thrown away, now or by the next
        `arm`."""
        camera = self._camera
        try:
            self._same_session()
            return store_photo(camera, photo, path, twice=camera.options.read_twice)
        except (OSError, PdcdError) as err:
            try:
                if not isinstance(err, OSError | ExposureError):
                    raise
                camera.discard(photo)
                camera.bulb.owed = False
            except PdcdError:  # who waited no longer waits
                camera.files.appendleft(photo)
            raise

    def disconnect(self) -> None:
        """Release the camera unless the shutter still uses it."""
        self._armed_ns = None
        self._camera.close("readout")

    def _same_session(self) -> None:
        """Check that the session is still the one of the settings and the exposure."""
        if self._camera.session.renewed != self._session:
            raise ExposureError(
                "the connection was lost since the camera was armed",
                device=DEVICE,
                hint="take it again",
            )

    def _clear(self) -> None:
        """Throw away photos of exposures that were given up, also one that is still to come.

        Raises ExposureError when that one does not come: it could be taken for the next. With a
        cable release it is not known whether there was an exposure, so waiting must be enough.
        """
        camera = self._camera
        until_ns = self._clock.now_ns() + round(_STRAY_S * 1e9) if camera.bulb.owed else 0
        while (photo := wait_for_photo(camera, until_ns)) is not None:
            logger.warning("photo of an earlier exposure thrown away name=%s", photo.name)
            if camera.discard(photo):
                camera.bulb.owed, until_ns = False, 0
        if camera.bulb.owed and camera.releases and camera.session.found == self._found:
            raise ExposureError(
                "the photo of an earlier exposure has not come and could be taken for the next",
                device=DEVICE,
                hint="wait a while, or switch the camera off and on",
            )
        camera.bulb.owed = False  # it went with the camera's memory, or never was


def _choose(wanted: _Number, offered: dict[_Number, int], sign: str) -> int:
    """The code of a value; ConfigError with the list when the camera does not offer it."""
    if wanted in offered:
        return offered[wanted]
    listed = ", ".join(f"{value:g}" for value in offered)
    raise ConfigError(
        f"{sign}{wanted:g} is not offered",
        device=DEVICE,
        hint=f"take one of {listed}" if listed else "it cannot be set from here: leave it out",
    )
