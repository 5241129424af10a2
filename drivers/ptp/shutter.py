"""The shutter of a Canon EOS body, held open over USB."""

from __future__ import annotations

import sys
import weakref

import msgspec

from pdcd.driver import Clock, ConfigError, DriverContext, TriggerConfig

from ..guard import ShutterGuard
from .eos import SHUTTER, EosCamera

PTP_GUARDIAN: tuple[str, ...] = (sys.executable, "-P", "-m", f"{__package__}.guardian")
"""Command that closes the shutter if this process is killed; its socket and the camera's options
follow."""
_ANSWER_S = 20.0
"""Longest time for an answer of the guardian; its start takes half a second."""


class PtpShutter:
    """Opens and closes by BulbStart and BulbEnd, or by RemoteReleaseOn and Off.

    It goes with `PtpReadout`, or with any other readout: the photo then stays on the card. The
    shutter is surely open `trigger.lag_s` plus four `trigger.jitter_s` after the camera's answer.
    These must be measured on the bench; for USB they are not published.

    The shutter is closed when the driver is disconnected, forgotten, or the interpreter ends; when
    the process is killed, another one does it (`drivers.ptp.guardian`). Never run on a real body so
    far.
    """

    maturity = "experimental"

    def __init__(self, camera: EosCamera, clock: Clock, config: TriggerConfig) -> None:
        self._camera = camera
        self._clock = clock
        self._sure_ns = config.sure_ns
        self._guard: ShutterGuard | None = None
        self._longest_s: float | None = None
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
        # A virtual camera is in this process, and would end with it.
        if not self._camera.options.in_process:
            self._be_guarded(found["serial"])
        return found

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        """Have the thread that keeps the camera awake end the next exposure by then."""
        self._longest_s = longest_s

    def open(self) -> int:
        """Start the exposure; returns the time by which the shutter is surely open."""
        if self._guard is not None:
            self._guard.arm(lambda: "arm")  # before it is open: a kill may come at any time
        try:
            longest_s, self._longest_s = self._longest_s, None
            self._camera.begin_exposure(longest_s)
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
        """Close, and release the camera unless the readout still uses it."""
        try:
            self._camera.close(SHUTTER)
        finally:
            self._tell()
            if self._guard is not None:
                # With a shutter to close the guardian may take long.
                self._guard.stop(wait=not self._may_be_open)

    @property
    def _may_be_open(self) -> bool:
        return self._camera.bulb.since_ns is not None

    def _be_guarded(self, serial: str) -> None:
        """Make sure that a guardian answers, for the camera with this serial number."""
        if self._guard is not None:
            self._guard.stop()
        options = msgspec.structs.replace(self._camera.options, serial=serial)
        text = msgspec.json.encode(options).decode()
        self._guard = ShutterGuard(
            (*PTP_GUARDIAN, text),
            answer_s=_ANSWER_S,
            unguarded=self._camera.cut_short,
        )
        self._guard.insist("disarm")

    def _tell(self) -> None:
        """Disarm the guardian when the shutter is surely closed."""
        if self._guard is not None and not self._may_be_open:
            self._guard.disarm()

    def _surely(self) -> int:
        sure_ns = self._clock.now_ns() + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns
