"""More drivers for the stranger's bench, by what a driver may do beyond the least.

A camera that hands over samples and writes no file, one without colours, a shutter that wants to
know how long it will be open, and the camera's finder. Another distribution brings them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import (
    CameraConfig,
    CameraInfo,
    CameraSettings,
    DriverContext,
    ExposureError,
    PhotoFrame,
    Preview,
    Readout,
    TimedShutter,
    responsivity_e,
)

from . import BLACK_DN, GAIN_E_PER_DN, WHITE_DN, Bench, Blades, Camera


class TimedBlades(Blades):
    """Remembers what it was told of each exposure."""

    told: tuple[tuple[float, float], ...] = ()

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        self.told = (*self.told, (exposure_s, longest_s))


class SampleCamera:
    """Its photos are arrays; its sensor begins with the green of a blue row."""

    maturity = "experimental"
    cfa: str | None = "GBRG"

    def __init__(self, bench: Bench, config: CameraConfig, info: CameraInfo) -> None:
        self._bench, self._config, self._info = bench, config, info
        self.armed: list[CameraSettings] = []
        self._photos = 0

    @classmethod
    def create(cls, context: DriverContext) -> SampleCamera:
        info = replace(Camera.create(context).connect(), cfa=cls.cfa)
        return cls(Bench.of(context), context.config.camera, info)

    def connect(self) -> CameraInfo:
        return self._info

    def arm(self, settings: CameraSettings) -> None:
        self.armed.append(settings)

    def fetch(self, folder: Path, name: str, timeout_s: float) -> PhotoFrame:
        bench = self._bench
        if bench.open_ns is None or bench.closed_ns is None:
            raise ExposureError("there is no photo", device="camera", hint="open and close")
        exposure_s = (bench.closed_ns - bench.open_ns) * 1e-9
        bench.open_ns = bench.closed_ns = None
        self._photos += 1
        return PhotoFrame(
            self._samples(),
            black=BLACK_DN,
            white=WHITE_DN,
            iso=self.armed[-1].iso,
            exposure_s=exposure_s,
            cfa=self.cfa,
            record={"PixelFormat": "BayerGB12", "FrameID": str(self._photos)},
        )

    def _samples(self) -> NDArray[np.uint16]:
        f_number = float(self._config.f_number)
        light_e = self._bench.light_s[..., None] * responsivity_e(self._config) / f_number**2
        if self.cfa is None:
            return self._read(light_e.sum(axis=-1))
        height, width = light_e.shape[:2]
        samples = np.empty((2 * height, 2 * width))
        for place, colour in enumerate("GBRG"):
            samples[place // 2 :: 2, place % 2 :: 2] = light_e[..., "RGB".index(colour)]
        return self._read(samples)

    @staticmethod
    def _read(light_e: NDArray[np.float64]) -> NDArray[np.uint16]:
        samples = np.rint(BLACK_DN + light_e / GAIN_E_PER_DN)
        return np.asarray(np.minimum(samples, WHITE_DN), dtype=np.uint16)

    def disconnect(self) -> None:
        """Nothing is held."""


class GreyCamera(SampleCamera):
    """One without colours."""

    cfa = None


class WhiteCamera(SampleCamera):
    """One whose mosaic has a place without a filter."""

    cfa = "RGBW"


class Finder:
    """Small grey pictures of the card."""

    maturity = "experimental"

    def __init__(self, bench: Bench) -> None:
        self._bench, self._on = bench, False

    @classmethod
    def create(cls, context: DriverContext) -> Finder:
        return cls(Bench.of(context))

    def connect(self) -> dict[str, str]:
        self._on = True
        return {"model": "Stranger One"}

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        if not self._on:
            raise ExposureError("the finder is off", device="camera", hint="connect first")
        return np.rint(self._bench.albedo * 255.0).astype(np.uint8)

    def disconnect(self) -> None:
        self._on = False


def _conforms(context: DriverContext) -> tuple[TimedShutter, Readout, Preview]:
    """Let a type checker compare the classes with their Protocols."""
    blades = TimedBlades(Bench.of(context), context.clock)
    return blades, SampleCamera.create(context), Finder.create(context)
