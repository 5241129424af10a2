"""The shutter and the readout of a machine-vision camera."""

from __future__ import annotations

from pathlib import Path

from pdcd.driver import (
    CameraConfig,
    CameraInfo,
    CameraSettings,
    ConfigError,
    DriverContext,
    PhotoFrame,
    Readout,
    TimedShutter,
    responsivity_e,
)

from .camera import GenicamCamera
from .library import load_library
from .options import GENICAM_DRIVERS

# Loaded at once: without the library these drivers are unavailable, and `pdcd drivers` says why.
load_library()

_SHUTTER, _READOUT = "shutter", "readout"


class GenicamShutter:
    """Begins an exposure by command; the camera's own clock ends it.

    Goes with `GenicamReadout` alone, whose frames are in memory. No guardian is needed: a timed
    exposure ends whatever becomes of this process. Never run on a real camera so far.
    """

    maturity = "experimental"

    def __init__(self, camera: GenicamCamera) -> None:
        self._camera = camera

    @classmethod
    def create(cls, context: DriverContext) -> GenicamShutter:
        """The shutter of this rig's camera. Raises ConfigError if another driver reads it out, or
        if its exposures last as long as a line that another driver holds."""
        camera, readout = GenicamCamera.of(context), context.config.camera.driver
        if readout not in GENICAM_DRIVERS:
            raise ConfigError(
                f"the shutter is a machine-vision camera and the readout is {readout!r}",
                device=_SHUTTER,
                hint=f"set camera.driver = {context.config.trigger.driver!r}",
            )
        if camera.options.exposure == "width":
            raise ConfigError(
                "exposure = 'width' leaves the shutter to the driver of the line",
                device=_SHUTTER,
                hint="choose the driver of that line in [trigger], 'serial' for example",
            )
        return cls(camera)

    def connect(self) -> dict[str, str]:
        """Open the camera; nothing is exposed on return. Raises DeviceLost, ConfigError."""
        return self._camera.open(_SHUTTER).identity

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        """Set the camera's clock for the next exposure. Raises ConfigError if that is too long."""
        self._camera.expect(exposure_s)

    def open(self) -> int:
        """Start the exposure; returns the time by which it surely has begun."""
        return self._camera.begin()

    def close(self) -> int:
        """Return when it is surely over; one that would go on for long is abandoned."""
        return self._camera.end()

    def disconnect(self) -> None:
        """End the exposure, and release the camera unless the readout still uses it."""
        try:
            self._camera.end()
        finally:
            self._camera.close(_SHUTTER)


class GenicamReadout:
    """Sets gain and exposure, and hands over the samples of each frame.

    Never run on a real camera so far.
    """

    maturity = "experimental"

    def __init__(self, camera: GenicamCamera, config: CameraConfig) -> None:
        self._camera = camera
        self._config = config

    @classmethod
    def create(cls, context: DriverContext) -> GenicamReadout:
        """The readout of this rig's camera. Raises ConfigError if nothing would start exposures."""
        camera, config = GenicamCamera.of(context), context.config
        if camera.options.exposure != "width" and config.trigger.driver not in GENICAM_DRIVERS:
            raise ConfigError(
                f"exposures of a camera that times them are started by the camera's own driver, "
                f"not by {config.trigger.driver!r}",
                device=_READOUT,
                hint=f"set trigger.driver = {config.camera.driver!r}, or camera.options.exposure "
                "= 'width' for a line that holds it",
            )
        return cls(camera, config.camera)

    def connect(self) -> CameraInfo:
        """Open the camera and return what it reports about itself. Raises DeviceLost,
        ConfigError."""
        device = self._camera.open(_READOUT)
        identity, cfa = device.identity, device.pixel_format.cfa
        return CameraInfo(
            model=f"{identity.get('vendor', '')} {identity.get('model', 'camera')}".strip(),
            serial=identity.get("serial", ""),
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config, 1 if cfa is None else 3),
            isos=device.isos,
            f_numbers=(),
            frame_quads=device.frame_quads,
            cfa=cfa,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Set gain and exposure; the level of black is measured once for each gain.

        The aperture is set at the lens. Raises ConfigError for what the camera does not offer.
        """
        self._camera.arm(settings)

    def fetch(self, folder: Path, name: str, timeout_s: float) -> PhotoFrame:
        """The samples of the last exposure; the rig writes them to disk. Raises as
        `GenicamCamera.fetch` does."""
        return self._camera.fetch(timeout_s)

    def disconnect(self) -> None:
        """Release the camera unless the shutter still uses it."""
        self._camera.close(_READOUT)


def _conforms(shutter: GenicamShutter, readout: GenicamReadout) -> tuple[TimedShutter, Readout]:
    """Let the type checker compare the classes with their Protocols."""
    return shutter, readout
