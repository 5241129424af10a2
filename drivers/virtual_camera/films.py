"""What the virtual camera photographs: the mock bench, a chart of its own, or bytes from a test."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import SceneConfig
from pdcd.driver import DriverContext, load_profile
from pdcd.files.images import encode_jpeg
from pdcd.sensor.dng import encode_dng
from pdcd.virtual.scene.build import build_scene

from ..mock.bench import MockBench
from ..mock.camera import BenchSensor
from ..mock.shutter import Lag
from .shutter import CameraExposure

_BRIGHTEST_E_PER_S = 20_000.0

SENSOR_450D = (2848, 4272)
"""Rows and columns of the 450D's picture, in samples."""


class BenchFilm:
    """The scene of the mock bench, through the shutter lag of [trigger] and the sensor of [camera].

    A lens that reports no aperture is taken to be at `[camera] f_number`, or f/8 if that is auto.
    """

    def __init__(self, context: DriverContext) -> None:
        config = context.config
        self._bench = MockBench.of(context)
        context.shared.photographed = True
        self._sensor = BenchSensor(self._bench, config.camera)
        self._lag = Lag(self._bench.true.trigger, config.camera.seed)
        fixed = config.camera.f_number
        self._fixed_f_number = 8.0 if fixed == "auto" else float(fixed)

    @property
    def isos(self) -> tuple[int, ...]:
        """The ISOs of the bench's sensor profile."""
        return self._sensor.profile.isos

    def make_finder_jpeg(self) -> bytes:
        """The live view picture of the bench now, as JPEG."""
        return encode_jpeg(self._sensor.finder(self._fixed_f_number))

    def open(self, asked_ns: int) -> int:
        """Open the bench's shutter, late by its lag."""
        open_ns = asked_ns + self._lag.draw_ns()
        self._bench.open_shutter(open_ns)
        return open_ns

    def close(self, asked_ns: int) -> int:
        """Close it, late by its lag."""
        close_ns = asked_ns + self._lag.draw_ns()
        self._bench.close_shutter(close_ns)
        return close_ns

    def make_raw(self, exposure: CameraExposure) -> bytes:
        """The bench's DNG; the body names it .CR2, which readers of RAW files accept."""
        return self._sensor.dng(exposure.iso, exposure.f_number or self._fixed_f_number)


class PlainFilm:
    """A shutter without lag, and files from a function: for tests, and for scenes of one's own."""

    def __init__(self, make_raw: Callable[[CameraExposure], bytes]) -> None:
        self._make_raw = make_raw

    def open(self, asked_ns: int) -> int:
        """Open at once."""
        return asked_ns

    def close(self, asked_ns: int) -> int:
        """Close at once."""
        return asked_ns

    def make_raw(self, exposure: CameraExposure) -> bytes:
        """The file that the function makes of the exposure."""
        return self._make_raw(exposure)


def make_chart_film(shape: tuple[int, int] = SENSOR_450D, seed: int = 0) -> PlainFilm:
    """A grey staircase in an even frame, lit steadily, on the 450D's sensor (estimated profile).

    `shape` is rows and columns of the mosaic, both even. Sixteen steps of half a stop go from left
    to right; the brightest gathers 20000 electrons a second at f/8 and saturates after about 2 s.
    """
    rows, columns = shape
    steps = 2.0 ** (-0.5 * (15 - np.arange(columns) * 16 // columns))
    frame = np.ones(rows)
    frame[: rows // 16] = frame[rows - rows // 16 :] = 0.25
    return _lit_film(np.outer(frame, _BRIGHTEST_E_PER_S * steps), seed)


def make_chart_finder() -> Callable[[], bytes]:
    """A function that makes live view pictures of that chart: sixteen grey steps, left to right."""
    steps = np.repeat(np.arange(16, dtype=np.uint8) * 17, 30)
    jpeg = encode_jpeg(np.tile(steps, (320, 1)))
    return lambda: jpeg


def make_scene_film(kind: str, shape: tuple[int, int] = SENSOR_450D) -> PlainFilm:
    """A scene preset of the mock bench under steady white light, spread over the whole sensor.

    Raises ConfigError when there is no such preset. Brightness as in `make_chart_film`.
    """
    scene = build_scene(SceneConfig(kind=kind))
    seen = scene.white().reshape(*scene.grid, 3)
    rows = np.arange(shape[0]) // 2 * scene.grid[0] // (shape[0] // 2)
    columns = np.arange(shape[1]) // 2 * scene.grid[1] // (shape[1] // 2)
    colour = np.add.outer(np.arange(shape[0]) % 2, np.arange(shape[1]) % 2)  # RGGB: 0, 1, 1, 2
    light = seen[rows[:, None], columns[None, :], colour]
    return _lit_film(light * (_BRIGHTEST_E_PER_S / max(float(light.max()), 1e-12)), 0)


def _lit_film(electrons_per_s: NDArray[np.float64], seed: int) -> PlainFilm:
    """Film under light that gathers `electrons_per_s` in each sample, in a second at f/8.

    Noise is drawn before the first photo and shifted from one photo to the next: gphoto2 waits at
    most 3 s for a file after a bulb exposure, and on a busy machine the drawing alone takes 3 s.
    """
    profile = load_profile("450d")
    rng = np.random.default_rng([seed, 3])
    rate = electrons_per_s.astype(np.float32)
    unit = rng.standard_normal(rate.size, dtype=np.float32)

    def samples(exposure: CameraExposure, seconds: float, f_number: float) -> NDArray[np.uint16]:
        """Like `pdcd.sensor.profile.expose_sensor`, but with Gaussian shot noise."""
        row = profile.row(exposure.iso)
        light = rate * np.float32(seconds * 64.0 / f_number**2)
        steady = profile.dark_e_per_s * seconds + row.read_noise_e**2
        noise = np.sqrt(light + np.float32(steady))
        noise *= np.roll(unit, int(rng.integers(unit.size))).reshape(rate.shape)
        charge = np.minimum(light, np.float32(profile.full_well_e))
        charge += noise
        charge *= np.float32(1.0 / row.gain_e_per_dn)
        charge += np.float32(profile.black_dn + 0.5)  # the cast rounds down
        np.clip(charge, 0, profile.white_dn, out=charge)
        found: NDArray[np.uint16] = charge.astype(np.uint16)
        return found

    def make_raw(exposure: CameraExposure) -> bytes:
        seconds = (exposure.close_ns - exposure.open_ns) * 1e-9
        f_number = exposure.f_number or 8.0
        return encode_dng(
            samples(exposure, seconds, f_number),
            black=profile.black_dn,
            white=profile.white_dn,
            iso=exposure.iso,
            exposure_s=seconds,
            f_number=exposure.f_number,
            model="pdcd virtual camera",
            date=datetime.now(UTC),
        )

    return PlainFilm(make_raw)
