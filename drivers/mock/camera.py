"""A Bayer camera that integrates the bench's scene and writes a real DNG."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.mock.bench import Bench
from drivers.mock.dng import dng_bytes
from drivers.mock.options import refuse_options
from pdcd.bench.devices import CameraInfo, CameraSettings, Clock, DriverContext, RawFile
from pdcd.bench.tables import CameraConfig
from pdcd.errors import ConfigError, ExposureError
from pdcd.sensor.profile import expose, load_profile, responsivity_e

F_NUMBERS = tuple(round(2.0 ** (third / 6.0), 2) for third in range(49))
"""f/1 to f/256 in third stops: wider than any lens, so that any number of codes can be exposed."""

READOUT_S = 0.2
"""Time from the end of the exposure until the file is there."""


class BenchSensor:
    """The sensor on the bench: one Bayer quad, or a block of them, per scene cell.

    Each quad sees the mean over its cell; light finer than a cell is not resolved. Models the
    noise of `pdcd.sensor.profile`; not models optical black borders, hot pixels or lens shading.
    """

    def __init__(self, bench: Bench, config: CameraConfig) -> None:
        self._bench = bench
        self._config = config
        self.profile = load_profile(config.profile)
        self.responsivity_e = responsivity_e(config)
        self._rng = np.random.default_rng([config.seed, 1])

    @property
    def frame_quads(self) -> tuple[int, int]:
        """Width and height of its photos in Bayer quads."""
        rows, cols = self._bench.scene.grid
        return cols * self._config.quads_per_cell, rows * self._config.quads_per_cell

    def dng(self, iso: int, f_number: float) -> bytes:
        """The last exposure as a DNG file; ConfigError when the profile lacks the ISO.

        Raises ExposureError when no exposure has been completed, or it was taken already.
        """
        bench = self._bench
        light = bench.photo()
        open_ns, close_ns = bench.exposed_ns()
        exposure_s = (close_ns - open_ns) * 1e-9
        electrons = self._mosaic(light * self.responsivity_e / f_number**2)
        rng = self._rng if self._config.noise == "full" else None
        data = dng_bytes(
            expose(electrons, self.profile, iso, exposure_s, rng),
            black=self.profile.black_dn,
            white=self.profile.white_dn,
            iso=iso,
            exposure_s=exposure_s,
            f_number=f_number,
            model=f"pdcd mock {self.profile.name}",
            date=datetime.now(UTC),
            as_shot_neutral=self._neutral(),
        )
        bench.photo_taken()
        return data

    def _mosaic(self, cells: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 3) per cell -> (H, W) RGGB mosaic."""
        rows, cols = self._bench.scene.grid
        per_cell = self._config.quads_per_cell
        quads = cells.reshape(rows, cols, 3).repeat(per_cell, axis=0).repeat(per_cell, axis=1)
        mosaic = np.empty((2 * quads.shape[0], 2 * quads.shape[1]))
        mosaic[0::2, 0::2] = quads[..., 0]
        mosaic[0::2, 1::2] = mosaic[1::2, 0::2] = quads[..., 1]
        mosaic[1::2, 1::2] = quads[..., 2]
        return mosaic

    def _neutral(self) -> tuple[float, float, float]:
        red, green, blue = self.responsivity_e / self.responsivity_e.max()
        return float(red), float(green), float(blue)


class MockReadout:
    """A camera without a connection: its files are simply there."""

    maturity = "stable"

    def __init__(self, bench: Bench, clock: Clock, config: CameraConfig) -> None:
        self._clock = clock
        self._config = config
        self._sensor = BenchSensor(bench, config)
        self._settings: CameraSettings | None = None

    @classmethod
    def create(cls, context: DriverContext) -> MockReadout:
        """The camera of this rig's bench. Raises ConfigError where it is given options."""
        refuse_options(context.config.camera.options, "camera.options", "camera")
        bench = Bench.of(context)
        context.shared.photographed = True
        return cls(bench, context.clock, context.config.camera)

    def connect(self) -> CameraInfo:
        """Report the sensor profile's ISOs and a lens with every aperture."""
        fixed = self._config.f_number
        return CameraInfo(
            model=f"mock {self._sensor.profile.name}",
            serial="virtual",
            profile=self._config.profile,
            responsivity_e=self._sensor.responsivity_e,
            isos=self._sensor.profile.isos,
            f_numbers=F_NUMBERS if fixed == "auto" else (float(fixed),),
            frame_quads=self._sensor.frame_quads,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Take over the settings; ConfigError when the profile lacks the ISO."""
        self._sensor.profile.row(settings.iso)
        if settings.f_number is None:
            raise ConfigError(
                "the mock lens has no ring to leave alone", device="camera", hint="set f_number"
            )
        self._settings = settings

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        """Integrate the last exposure and write it as `folder/name.dng`."""
        settings = self._settings
        if settings is None or settings.f_number is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        data = self._sensor.dng(settings.iso, settings.f_number)
        self._clock.sleep_until_ns(self._clock.now_ns() + round(READOUT_S * 1e9))
        path = folder / f"{name}.dng"
        path.write_bytes(data)
        return RawFile(path, len(data), hashlib.sha256(data).hexdigest())

    def disconnect(self) -> None:
        """Forget the settings."""
        self._settings = None
