"""The shutter of a Canon EOS body, held open over USB."""

from __future__ import annotations

import weakref

from drivers.ptp.eos import SHUTTER, EosCamera
from drivers.ptp.guard import Guard
from pdcd.config import TriggerConfig
from pdcd.errors import ConfigError
from pdcd.interfaces import Clock, DriverContext


class PtpShutter:
    """Opens and closes by BulbStart and BulbEnd, or by RemoteReleaseOn and Off.

    Goes with `PtpReadout`, or with any other readout: the photo then stays on the card. The time
    by which the shutter is surely open is that of the camera's answer plus `trigger.lag_s` and four
    `trigger.jitter_s`, which are to be measured on the bench; over USB they are not published.

    The shutter is closed when the driver is disconnected, forgotten, or the interpreter ends; when
    the process is killed, another one does it (`drivers.ptp.guard`). Never run on a real body so
    far.
    """

    maturity = "experimental"

    def __init__(self, camera: EosCamera, clock: Clock, config: TriggerConfig) -> None:
        self._camera = camera
        self._clock = clock
        self._sure_ns = round((config.lag_s + 4.0 * config.jitter_s) * 1e9)
        # The virtual camera is in this process, and would go with it.
        self._guard = None if camera.options.usb == "virtual" else Guard(camera.options)
        weakref.finalize(self, camera.let_go, SHUTTER)

    @classmethod
    def create(cls, context: DriverContext) -> PtpShutter:
        """The shutter of this rig's camera."""
        camera = EosCamera.of(context)
        if camera.options.release == "external":
            raise ConfigError(
                'release = "external" leaves the shutter to another driver',
                device="shutter",
                hint="choose the driver of the cable release in [trigger]",
            )
        return cls(camera, context.clock, context.config.trigger)

    def connect(self) -> dict[str, str]:
        """Open the session; the shutter is closed on return.

        Raises DeviceLost, and ConfigError when this body cannot hold its shutter open over USB.
        """
        found = self._camera.open(SHUTTER)
        if self._guard is not None:
            self._guard.watch(found["serial"])
        return found

    def open(self) -> int:
        """Start the exposure; returns the time by which the shutter is surely open."""
        if self._guard is not None:
            self._guard.tell(may_be_open=True)  # before it is: a kill may come at any time
        try:
            self._camera.begin_exposure()
        finally:
            self._tell()
        return self._surely()

    def close(self) -> int:
        """End the exposure; returns the time by which the shutter is surely closed."""
        try:
            was_open = self._camera.end_exposure()
        finally:
            self._tell()
        return self._surely() if was_open else self._clock.now_ns()

    def disconnect(self) -> None:
        """Close, and let the camera go unless the readout still has it."""
        try:
            self._camera.close(SHUTTER)
        finally:
            self._tell()
            if self._guard is not None:
                self._guard.stop()

    def _tell(self) -> None:
        if self._guard is not None:
            self._guard.tell(may_be_open=self._camera.bulb.since_ns is not None)

    def _surely(self) -> int:
        sure_ns = self._clock.now_ns() + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns
