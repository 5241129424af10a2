"""Image sensors: a profile of numbers per body, and the noise model that goes with it.

One model serves four users: the mock camera draws photos from it (`expose_sensor`), decoding and
planning take the variance of a sample from it (`compute_variance_dn2`), and saturation is judged by
it (`SensorProfile.saturation_dn`). Signals are in DN (digital numbers) above the black level or in
photo-electrons (e-).

Model of one sample, with gain g in e- per DN::

    charge = min(Poisson(light + dark t) - dark t, full well)      e-
    DN     = round(black + (charge + Normal(0, read noise)) / g), clipped to [0, white]

The mean of the dark current is taken off, as Canon bodies do it in camera: their dark frames do not
brighten with time, only their noise grows. Not modelled: fixed-pattern noise, hot pixels, banding,
blooming, non-linearity below saturation, colour cross-talk.
"""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.bench.tables import CameraConfig
from pdcd.errors import ConfigError, ExposureError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import read_file

_PACKAGE = Path(__file__).resolve().parents[1]
PROFILE_FOLDERS = (_PACKAGE / "_config" / "sensors", _PACKAGE.parent / "config" / "sensors")
"""Where named profiles lie: inside an installed package, or beside it in the source tree."""

NOMINAL_RESPONSIVITY_E = (4.8e6, 8.6e6, 5.6e6)
"""Electrons per scene unit and second at f/1 (R, G, B) where `camera.responsivity_e` is not given:
a half-grey scene then fills the well of the "modern" sensor to about two thirds in a default
capture at f/8. It is true of the mock camera; for a real bench without a calibration it is only a
scale. A sensor without colours has no filters in front of it, and gets the sum (`weigh_colours`).
"""

_MAX_BYTES = 2**20
"""Longest profile that is read."""
_GAUSSIAN_FROM_E = 1000.0
"""Mean count from which photon noise is drawn as Gaussian: its skewness is then below 0.032."""
_FULL_WELL_SIGMAS = 4.0
_PREVIEW_BYTES = 64 << 20
_LARGEST_PHOTO_BYTES = 1 << 28
"""Longest photo of a sensor whose size is not known."""
_MAX_ISO = 65535  # what EXIF's PhotographicSensitivity holds


def responsivity_e(config: CameraConfig, colours: int = 3) -> NDArray[np.float64]:
    """What every camera driver reports as `CameraInfo.responsivity_e`: the configured or else the
    nominal numbers, (3,), or (1,) for a sensor without colours. Drivers that cannot know the number
    of colours leave it to the rig. A real camera cannot know its responsivity; the run then gets a
    warning."""
    light = np.array(config.responsivity_e or NOMINAL_RESPONSIVITY_E)
    return light.sum(keepdims=True) if colours == 1 else light


def weigh_colours(light: NDArray[np.float64], colours: int) -> NDArray[np.float64]:
    """Light of a scene, (..., 3) in scene units, as a sensor of `colours` colours sees it: (..., 3)
    or (..., 1).

    A sensor without colours sees the mean of red, green and blue, weighted by what the filter of
    each colour lets through (`NOMINAL_RESPONSIVITY_E`): white of one scene unit stays one.
    """
    if colours == 3:
        return light
    shares = np.array(NOMINAL_RESPONSIVITY_E)
    return np.asarray(light @ (shares / shares.sum()))[..., None]


class IsoRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One ISO setting: gain in e- per DN of the file, read noise (standard deviation) in e-."""

    iso: int
    gain_e_per_dn: float
    read_noise_e: float


class SensorProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the noise model must know of one body; every number is checked on construction.

    name, description, source
        For people: what it is and where the numbers come from.
    estimated
        True when the numbers are not measurements of this very body.
    bits, black_dn, white_dn
        Bits of a sample, its value without light, and its highest value.
    full_well_e
        Charge a pixel holds, e-.
    dark_e_per_s
        Dark current, e- per second and pixel.
    rows
        The ISO settings, ascending.
    frame_quads
        Width and height of its full-size photos in Bayer quads, as LibRaw shows them, or in samples
        of a sensor without colours; None where that is not known.
    mono
        True for a sensor without colours; left out for one behind a Bayer mosaic.
    base
        The profile (a name, or a path) that this measured one replaces; "" for one that was not
        measured. A mock body keeps to the numbers of `base`.

    Raises `ConfigError` naming every value that is wrong.
    """

    name: str
    description: str
    source: str
    estimated: bool
    bits: int
    black_dn: int
    white_dn: int
    full_well_e: float
    dark_e_per_s: float
    rows: tuple[IsoRow, ...]
    frame_quads: tuple[int, int] | None = None
    base: str = ""
    mono: bool | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        faults = [
            f"{name} = {value} is not a positive number"
            for name, value in self._numbers()
            if not (math.isfinite(value) and value > 0)
        ]
        if not 1 <= self.bits <= 16:
            faults.append(f"bits = {self.bits} is not in 1..16")
        elif not 0 <= self.black_dn < self.white_dn < 2**self.bits:
            faults.append(f"0 <= black_dn < white_dn < 2^{self.bits} does not hold")
        if self.frame_quads is not None and min(self.frame_quads) < 1:
            faults.append(f"frame_quads = {list(self.frame_quads)} is no picture")
        isos = self.isos
        if not isos or list(isos) != sorted(set(isos)) or not 1 <= isos[0] <= isos[-1] <= _MAX_ISO:
            faults.append(
                f"ISOs {list(isos)} are not one or more ascending values in 1..{_MAX_ISO}"
            )
        if faults:
            raise ConfigError(
                f"sensor profile {self.name!r}: {'; '.join(faults)}",
                hint="correct the profile's TOML file",
            )

    def _numbers(self) -> list[tuple[str, float]]:
        numbers = [("full_well_e", self.full_well_e), ("dark_e_per_s", self.dark_e_per_s)]
        for row in self.rows:
            numbers.append((f"gain_e_per_dn at ISO {row.iso}", row.gain_e_per_dn))
            numbers.append((f"read_noise_e at ISO {row.iso}", row.read_noise_e))
        return numbers

    @property
    def colours(self) -> int:
        """Colours of its photos: 3, or 1 for a sensor without colours."""
        return 1 if self.mono is True else 3

    @property
    def isos(self) -> tuple[int, ...]:
        """The ISO settings, ascending."""
        return tuple(row.iso for row in self.rows)

    @property
    def samples(self) -> int:
        """Samples of a full-size photo; 0 where that is not known."""
        width, height = self.frame_quads or (0, 0)
        return width * height * (1 if self.colours == 1 else 4)

    @property
    def largest_photo_bytes(self) -> int:
        """Longest possible RAW file of this sensor: two bytes for each sample, as much again for
        masked borders and a second plane, and room for previews."""
        if self.frame_quads is None:
            return _LARGEST_PHOTO_BYTES
        return 2 * (2 * self.samples) + _PREVIEW_BYTES

    def row(self, iso: int) -> IsoRow:
        """Numbers of one ISO setting. Raises `ConfigError` listing those there are."""
        for row in self.rows:
            if row.iso == iso:
                return row
        raise ConfigError(
            f"sensor profile {self.name!r} has no ISO {iso}",
            hint="choose one of " + ", ".join(map(str, self.isos)),
        )

    def saturation_dn(self, iso: int) -> float:
        """Signal, in DN above black, from which a sample counts as saturated.

        It is the lower of white level and full well. Read noise is added after the full well, so
        half of the full pixels read lower. Four standard deviations of it are therefore taken off
        the full well, which leaves one full pixel in 30 000 unmarked.
        """
        row = self.row(iso)
        full_dn = (self.full_well_e - _FULL_WELL_SIGMAS * row.read_noise_e) / row.gain_e_per_dn
        return min(float(self.white_dn - self.black_dn), full_dn)


def list_profiles() -> tuple[str, ...]:
    """Names of the profiles that come with pdcd."""
    return tuple(sorted({p.stem for folder in PROFILE_FOLDERS for p in folder.glob("*.toml")}))


def load_profile(name_or_path: str | Path) -> SensorProfile:
    """Read a sensor profile.

    Parameters
    ----------
    name_or_path
        Name of a profile that comes with pdcd (``"mark2"``), or the path of a TOML file: anything
        that ends in ``.toml``.

    Raises
    ------
    ConfigError
        There is no such profile (the hint lists those there are), the file is not TOML, a field is
        missing, unknown or of the wrong type, or a number makes no sense.
    """
    path = _profile_path(name_or_path)
    try:
        return msgspec.toml.decode(read_file(path, _MAX_BYTES), type=SensorProfile)
    except UnsoundFileError as err:
        raise ConfigError(f"cannot read sensor profile {path}: {err.why}") from err
    except (msgspec.MsgspecError, UnicodeDecodeError) as err:
        raise ConfigError(
            f"sensor profile {path}: {err}", hint="compare with config/sensors/modern.toml"
        ) from err


def _profile_path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix == ".toml":
        return path
    if str(name_or_path) not in list_profiles():
        raise ConfigError(
            f"unknown sensor profile {str(name_or_path)!r}",
            hint="give the path of a .toml file, or one of: " + ", ".join(list_profiles()),
        )
    named = (folder / f"{name_or_path}.toml" for folder in PROFILE_FOLDERS)
    return next(path for path in named if path.is_file())


def expose_sensor(
    electrons: NDArray[np.float64],
    profile: SensorProfile,
    iso: int,
    exposure_s: float,
    rng: np.random.Generator | None,
) -> NDArray[np.uint16]:
    """One RAW photo of the model in the module's docstring.

    Parameters
    ----------
    electrons : (H, W) float64
        Expected photo-electrons of each sample of the mosaic over the whole exposure.
    profile, iso, exposure_s
        The sensor, its setting, and how long dark current gathers.
    rng
        Source of all noise; None is the ideal sensor: only full well, gain, rounding and clipping.

    Returns
    -------
    (H, W) uint16
        Samples in DN, black level included.

    Raises
    ------
    ConfigError
        The profile has no such ISO.
    ExposureError
        A count is negative, infinite or NaN: the light was computed wrongly.
    """
    row = profile.row(iso)
    # Sums of products may be a rounding error below zero where no light falls.
    if not np.all(np.isfinite(electrons)) or np.any(electrons < -1e-3):
        raise ExposureError("expected electron counts must be finite and not negative")
    light = np.maximum(electrons, 0.0)
    if rng is None:
        charge = light
    else:
        dark = profile.dark_e_per_s * exposure_s
        charge = _poisson(light + dark, rng) - dark
    charge = np.minimum(charge, profile.full_well_e)
    if rng is not None:
        charge = charge + row.read_noise_e * rng.standard_normal(charge.shape)
    samples = np.rint(profile.black_dn + charge / row.gain_e_per_dn)
    return np.clip(samples, 0, profile.white_dn).astype(np.uint16)


def _poisson(mean: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Poisson counts of the given means; Gaussian ones, four times faster, for high means."""
    counts = mean + np.sqrt(mean) * rng.standard_normal(mean.shape)
    low = mean < _GAUSSIAN_FROM_E
    counts[low] = rng.poisson(mean[low])
    return counts


def compute_variance_dn2(
    signal_dn: ArrayLike, profile: SensorProfile, iso: int, exposure_s: float
) -> NDArray[np.float64]:
    """Variance of samples, in DN squared, from their signal.

    Photon noise + dark-current shot noise + read noise + rounding (1/12, of a uniform error).

    Parameters
    ----------
    signal_dn : array
        Signal above black in DN: the expected one, or the measured one as the best guess. Negative
        signals (noise around a dark sample) count as 0.
    profile, iso, exposure_s
        As for `expose_sensor`.

    Raises `ConfigError` when the profile has no such ISO. Clipping is not accounted for.

    Source: the paper's appendix, except for its thermal term (rate times time, squared), which is
    replaced by the variance of a Poisson count, rate times time.
    """
    row = profile.row(iso)
    photons_e2 = np.maximum(np.asarray(signal_dn, dtype=np.float64), 0.0) * row.gain_e_per_dn
    fixed_e2 = profile.dark_e_per_s * exposure_s + row.read_noise_e**2
    variance: NDArray[np.float64] = (photons_e2 + fixed_e2) / row.gain_e_per_dn**2 + 1.0 / 12.0
    return variance
