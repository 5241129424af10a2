"""A camera of Acme's: it is told how long to expose, and hands over samples."""

from __future__ import annotations

from pathlib import Path

import acme
import msgspec

from pdcd.driver import (
    CameraInfo,
    CameraSettings,
    ConfigError,
    DeviceLost,
    DriverContext,
    ExposureError,
    PhotoError,
    PhotoFrame,
    Readout,
    TimedShutter,
    merge_camera_options,
    read_options,
    responsivity_e,
)

ISOS = (100, 200, 400, 800)
BLACK_DN, WHITE_DN = 64, 4095
CFA = "BGGR"  # None: a sensor without colours


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[camera.options], or [trigger.options]."""

    serial: str
    margin_s: float = 0.1  # by how much longer it exposes than planned: panels may be late
    unplanned_s: float = 1.0  # where nobody said how long


class AcmeCamera:
    """The one open camera of a rig; its shutter and its readout are two views of it."""

    def __init__(self, context: DriverContext) -> None:
        given, table = merge_camera_options(context.config, ("acme",))
        hint = "serial, margin_s and unplanned_s are the options of the driver acme"
        self.options = read_options(given, Options, table=table, device="camera", hint=hint)
        self.clock, self.patience = context.clock, context.patience
        self._sure_ns = context.config.trigger.sure_ns
        self._device: acme.Device | None = None
        self._users: set[str] = set()
        self._time_s = 0.0
        self._over_ns: int | None = None  # when the exposure that goes on is surely over
        self.planned_s: float | None = None
        self.lost = ""  # why the last exposure is no photo

    @classmethod
    def of(cls, context: DriverContext) -> AcmeCamera:
        """The camera of this rig, made by the first driver that asks."""
        return context.the(cls, lambda: cls(context))

    @property
    def device(self) -> acme.Device:
        """The open camera. Raises DeviceLost."""
        if self._device is None:
            raise DeviceLost("the camera is not open", device="camera", hint="connect it first")
        return self._device

    def open(self, user: str) -> None:
        """Be open for the shutter, or the readout. Raises DeviceLost."""
        if self._device is None:
            try:
                self._device = acme.open_camera(self.options.serial)
            except OSError as err:
                raise DeviceLost(
                    f"no camera {self.options.serial}", device="camera", hint="is it plugged in?"
                ) from err
        self._users.add(user)

    def close(self, user: str) -> None:
        """That one is done; the last one lets the camera go."""
        self._users.discard(user)
        if self._device is not None and not self._users:
            self._device.close()
            self._device = None

    def begin(self) -> int:
        """Start an exposure a little longer than planned; returns when it surely goes on."""
        planned_s, self.planned_s = self.planned_s, None
        self._time_s = planned_s or self.options.unplanned_s
        self._time_s += self.options.margin_s
        self.lost = ""
        self.device.start(self._time_s)
        sure_ns = self.clock.now_ns() + self._sure_ns
        self._over_ns = sure_ns + round(self._time_s * 1e9)
        self.clock.sleep_until_ns(sure_ns)
        return sure_ns

    def end(self) -> int:
        """Return once nothing is exposed any more. Safe where nothing is."""
        over_ns, self._over_ns = self._over_ns, None
        now_ns = self.clock.now_ns()
        if over_ns is None or self._device is None:
            return now_ns
        if now_ns > over_ns - self._sure_ns:
            self.lost = "the panels were done after the exposure had ended"
        if now_ns < over_ns - round(2e9 * self.options.margin_s) - self._sure_ns:
            self.lost = "the exposure was given up"
            self._device.stop()
            return self.clock.now_ns()
        self.patience.sleep_until_ns(over_ns)
        return self.clock.now_ns()

    def fetch(self, settings: CameraSettings, timeout_s: float) -> PhotoFrame:
        """The photo of the last exposure. Raises PhotoError for one to be taken again."""
        if self.lost:
            raise PhotoError(self.lost, device="camera", hint="raise camera.options.margin_s")

        def over() -> ExposureError:
            return ExposureError("no photo came", device="camera", hint="see its cable")

        with self.patience.within(timeout_s, over):
            while (samples := self.device.frame()) is None:
                self.patience.sleep(0.01)
        record = {"Temperature": f"{self.device.temperature():.1f}"}
        return PhotoFrame(
            samples, BLACK_DN, WHITE_DN, settings.iso, self._time_s, cfa=CFA, record=record
        )


class AcmeShutter:
    """Starts an exposure; the camera's own clock ends it, whatever becomes of this process."""

    maturity = "experimental"

    def __init__(self, camera: AcmeCamera) -> None:
        self._camera = camera

    @classmethod
    def create(cls, context: DriverContext) -> AcmeShutter:
        """The shutter of this rig's camera, which is not opened yet. Raises ConfigError."""
        return cls(AcmeCamera.of(context))

    def connect(self) -> dict[str, str]:
        """Open the camera; nothing is exposed on return."""
        self._camera.open("shutter")
        self._camera.end()
        return {"model": "Acme One", "serial": self._camera.options.serial}

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        """The next exposure is planned to be so long."""
        self._camera.planned_s = exposure_s

    def open(self) -> int:
        """Start the exposure."""
        return self._camera.begin()

    def close(self) -> int:
        """Wait for its end, or give up one that would go on for long."""
        return self._camera.end()

    def disconnect(self) -> None:
        """End what goes on, release the camera."""
        self._camera.end()
        self._camera.close("shutter")


class AcmeReadout:
    """Sets the gain, hands over samples."""

    maturity = "experimental"

    def __init__(self, camera: AcmeCamera, context: DriverContext) -> None:
        self._camera, self._config = camera, context.config.camera
        self._settings: CameraSettings | None = None

    @classmethod
    def create(cls, context: DriverContext) -> AcmeReadout:
        """The readout of this rig's camera, which is not opened yet. Raises ConfigError."""
        return cls(AcmeCamera.of(context), context)

    def connect(self) -> CameraInfo:
        """Open the camera and say what it is."""
        self._camera.open("readout")
        return CameraInfo(
            model="Acme One",
            serial=self._camera.options.serial,
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config),
            isos=ISOS,
            f_numbers=(),  # a lens that is set by hand
            cfa=CFA,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Set the gain, forget what was left behind."""
        if settings.iso not in ISOS:
            raise ConfigError(f"no ISO {settings.iso}", device="camera", hint=f"take one of {ISOS}")
        self._camera.end()
        self._camera.device.drop()
        self._camera.device.set("Gain", settings.iso / ISOS[0])
        self._camera.lost = ""
        self._settings = settings

    def fetch(self, folder: Path, name: str, timeout_s: float) -> PhotoFrame:
        """The photo in memory; the rig keeps it."""
        settings, self._settings = self._settings, None
        if settings is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        return self._camera.fetch(settings, timeout_s)

    def disconnect(self) -> None:
        """Release the camera."""
        self._settings = None
        self._camera.close("readout")


def _conforms(camera: AcmeCamera, context: DriverContext) -> tuple[TimedShutter, Readout]:
    """Let the type checker compare the classes with their Protocols."""
    return AcmeShutter(camera), AcmeReadout(camera, context)
