"""A camera that integrates the bench's scene and writes a real DNG."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypedDict

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.truth import TrueSensor
from pdcd.driver import (
    CameraConfig,
    CameraInfo,
    CameraSettings,
    Clock,
    ConfigError,
    DriverContext,
    ExposureError,
    RawFile,
    load_profile,
    responsivity_e,
    write_dng,
)
from pdcd.sensor.dng import encode_dng
from pdcd.sensor.profile import IsoRow, SensorProfile, expose_sensor, weigh_colours

from .bench import MockBench, check_no_options

F_NUMBERS = tuple(round(2.0 ** (third / 6.0), 2) for third in range(49))
"""f/1 to f/256 in third stops: wider than any lens, so that any number of codes can be exposed."""

_STOP_NEAR = 0.03
"""A number this close to a third stop is the engraving of that stop."""

_STOP_OFF = 0.07
"""A number further than this from every stop (half a third) is not one of the lens."""

FINDER_S = 1.0 / 15.0
"""Time from one picture of a finder to the next."""
_FINDER_GAIN = 64.0
"""Largest gain by which a finder brightens a dark picture."""

_READOUT_S = 0.2
"""Time from the end of the exposure until the file is there."""


class _Tags(TypedDict):
    """What a file says of a photo, as `write_dng` takes it."""

    black: int
    white: int
    iso: int
    exposure_s: float
    f_number: float
    model: str
    date: datetime
    as_shot_neutral: tuple[float, float, float]
    cfa: str | None


_Photo = tuple[NDArray[np.uint16], _Tags]
"""Samples, and what the file says of them."""


class BenchSensor:
    """The sensor on the bench: all four samples of a Bayer quad see the light of the quad. If the
    profile has no colours, one sample takes the quad's place.

    It models the noise of `pdcd.sensor.profile` and, if the bench has a truth, the truth's factors
    on it and samples of unequal sensitivity. It does not model optical black borders or hot pixels.
    """

    def __init__(self, bench: MockBench, config: CameraConfig) -> None:
        # Read at once: an impossible bench is refused before any device moves.
        bench.shared.cells_meet = bench.optics is None
        self._bench = bench
        self._config = config
        # The body as it was typed, before any measurement; and the true body.
        self.profile = load_profile(bench.true.camera.profile)
        self._true = make_true_profile(self.profile, bench.truth.sensor)
        colours = self.profile.colours
        self.cfa = "RGGB" if colours == 3 else None
        self.responsivity_e = responsivity_e(bench.typed.camera, colours)
        self._true_responsivity_e = responsivity_e(bench.true.camera, colours)
        self._rng = np.random.default_rng([config.seed, 1])

    @property
    def frame_quads(self) -> tuple[int, int]:
        """Width and height of its photos in Bayer quads, or in samples without colours."""
        rows, cols = self._bench.frame
        return cols, rows

    def dng(self, iso: int, f_number: float) -> bytes:
        """The last exposure as the bytes of a DNG file, for a body that sends them.

        Raises as `photos` does.
        """
        ((samples, tags),) = self.photos(iso, f_number, 1)
        return encode_dng(samples, **tags)

    def photos(self, iso: int, f_number: float, buckets: int) -> list[_Photo]:
        """The last exposure, from each of a sensor's buckets, one or two.

        Raises ConfigError when the profile lacks the ISO, ExposureError when no exposure has been
        completed, or it was taken already.
        """
        planes = []
        for self._bench.second in (False, True)[:buckets]:
            planes.append(self._plane(iso, f_number))
        self._bench.second = False
        self._bench.photo_taken()
        return planes

    def finder(self, f_number: float) -> NDArray[np.uint8]:
        """The finder's picture of what the panels show now: exposed automatically, for at most the
        time of a picture, with the noise of that exposure."""
        from pdcd.sensor.finder_picture import choose_finder_gain, draw_finder_picture  # no photo

        rate = self._bench.held_light() * self._true_responsivity_e
        rate /= self._true_stop(f_number) ** 2
        full_e = self._true.full_well_e
        shown_s = min(FINDER_S, full_e * choose_finder_gain(rate))
        charge_e = rate * shown_s
        if self._config.noise == "full":
            read_e = self._true.rows[-1].read_noise_e
            charge_e += np.sqrt(charge_e + read_e**2) * self._rng.standard_normal(charge_e.shape)
        charge_e *= self._true_responsivity_e.max() / self._true_responsivity_e  # white is white
        gain = min(choose_finder_gain(charge_e), _FINDER_GAIN / full_e)
        return draw_finder_picture(charge_e * gain)

    def _plane(self, iso: int, f_number: float) -> _Photo:
        bench = self._bench
        light = weigh_colours(bench.quads(), self.profile.colours)
        open_ns, close_ns = bench.exposed_ns()
        exposure_s = (close_ns - open_ns) * 1e-9
        electrons = self._mosaic(light * self._true_responsivity_e / self._true_stop(f_number) ** 2)
        rng = self._rng if self._config.noise == "full" else None
        return expose_sensor(electrons, self._true, iso, exposure_s, rng), {
            "black": self.profile.black_dn,
            "white": self.profile.white_dn,
            "iso": iso,
            "exposure_s": bench.truth.camera.tagged_s or exposure_s,
            "f_number": f_number,
            "model": f"pdcd mock {self.profile.name}",
            "date": datetime.now(UTC),
            "as_shot_neutral": self._neutral(),
            "cfa": self.cfa,
        }

    def _true_stop(self, f_number: float) -> float:
        """The true stop of an engraved one: that of the truth; else, as lenses are made, the exact
        third stop (a power of the sixth root of two) next to it."""
        for stop in self._bench.true.camera.stops:
            if stop.f_number == f_number:
                return stop.true
        third = 2.0 ** (round(6.0 * np.log2(f_number)) / 6.0)
        return float(third) if abs(third / f_number - 1.0) <= _STOP_NEAR else f_number

    def _mosaic(self, quads: NDArray[np.float64]) -> NDArray[np.float64]:
        """(h, w, 3) of quads -> (H, W) RGGB mosaic; (h, w, 1) -> (h, w)."""
        if self.cfa is None:
            mosaic = np.array(quads[..., 0])
        else:
            mosaic = np.empty((2 * quads.shape[0], 2 * quads.shape[1]))
            mosaic[0::2, 0::2] = quads[..., 0]
            mosaic[0::2, 1::2] = mosaic[1::2, 0::2] = quads[..., 1]
            mosaic[1::2, 1::2] = quads[..., 2]
        if self._bench.truth.sensor.prnu:
            mosaic *= self._sensitivity(mosaic.shape)
        return mosaic

    def _sensitivity(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Sensitivity of each sample relative to the mean: the same in every photo."""
        rng = np.random.default_rng([self._config.seed, 4])
        sigma = np.float32(self._bench.truth.sensor.prnu)
        wobble = rng.standard_normal(shape, dtype=np.float32)
        return np.asarray(np.maximum(1.0 + sigma * wobble, 0.0), dtype=np.float32)

    def _neutral(self) -> tuple[float, float, float]:
        red, green, blue = np.broadcast_to(self.responsivity_e / self.responsivity_e.max(), 3)
        return float(red), float(green), float(blue)


def make_true_profile(profile: SensorProfile, true: TrueSensor) -> SensorProfile:
    """The profile of the sensor as it is, by the factors of a truth."""
    rows = tuple(
        IsoRow(row.iso, row.gain_e_per_dn / true.gain, row.read_noise_e * true.read_noise)
        for row in profile.rows
    )
    return msgspec.structs.replace(
        profile,
        full_well_e=profile.full_well_e * true.full_well,
        dark_e_per_s=profile.dark_e_per_s * true.dark,
        rows=rows,
    )


class MockReadout:
    """A camera without a connection: it writes its files directly."""

    maturity = "stable"

    def __init__(self, bench: MockBench, clock: Clock, config: CameraConfig) -> None:
        self._clock = clock
        self._config = config
        self._sensor = BenchSensor(bench, config)
        self._settings: CameraSettings | None = None

    @classmethod
    def create(cls, context: DriverContext) -> MockReadout:
        """The camera of this rig's bench. Raises ConfigError if it is given options."""
        check_no_options(context.config.camera.options, "camera.options", "camera")
        bench = MockBench.of(context)
        context.shared.photographed = True
        return cls(bench, context.clock, context.config.camera)

    def connect(self) -> CameraInfo:
        """Report the sensor profile's ISOs and a lens with every aperture."""
        return CameraInfo(
            model=f"mock {self._sensor.profile.name}",
            serial="virtual",
            profile=self._config.profile,
            responsivity_e=self._sensor.responsivity_e,
            isos=self._sensor.profile.isos,
            f_numbers=self._f_numbers,
            frame_quads=self._sensor.frame_quads,
            readout_s=0.0,
            cfa=self._sensor.cfa,
        )

    @property
    def _f_numbers(self) -> tuple[float, ...]:
        fixed = self._config.f_number
        return F_NUMBERS if fixed == "auto" else (float(fixed),)

    def arm(self, settings: CameraSettings) -> None:
        """Take over the settings. Raises ConfigError if the profile lacks the ISO, or the lens the
        stop."""
        self._sensor.profile.row(settings.iso)
        if settings.f_number is None:
            raise ConfigError(
                "the mock lens has no ring to leave alone", device="camera", hint="set f_number"
            )
        if all(abs(stop / settings.f_number - 1.0) > _STOP_OFF for stop in self._f_numbers):
            raise ConfigError(
                f"the mock lens has no f/{settings.f_number:g}",
                device="camera",
                hint="take " + " to ".join(f"f/{f:g}" for f in sorted({*self._f_numbers[::48]})),
            )
        self._settings = settings

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        """Integrate the last exposure and write it as `folder/name.dng`."""
        settings = self._settings
        if settings is None or settings.f_number is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        planes = self._sensor.photos(settings.iso, settings.f_number, self._config.buckets)
        self._clock.sleep_until_ns(self._clock.now_ns() + round(_READOUT_S * 1e9))
        first, *others = (
            write_dng(folder / f"{name}{'-second' * number}.dng", samples, **tags)
            for number, (samples, tags) in enumerate(planes)
        )
        return replace(first, second=others[0]) if others else first

    def disconnect(self) -> None:
        """Forget the settings."""
        self._settings = None
