"""What a plan is foreseen to be worth: the words that rehearsals and guesses share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Protocol

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.planning.metering import TARGET, USABLE, pick_aperture
from pdcd.sensor.profile import SensorProfile, compute_variance_dn2

Alive = Callable[[], None]


@dataclass(frozen=True)
class RigSetting:
    """What of a rig bears on the error."""

    config: Config
    camera: CameraInfo
    profile: SensorProfile
    mask_lag_s: float | None = None
    """As the display measured it; None where it is not known."""

    @property
    def isos(self) -> tuple[int, ...]:
        """The ISOs that may be chosen: the configured one, else all."""
        iso = self.config.camera.iso
        return self.camera.isos if iso is None else (iso,)

    def f_number(self, peak_e: float, iso: int) -> float:
        """The configured aperture, or what metering makes of `peak_e` electrons at f/1."""
        if self.config.camera.f_number != "auto":
            return self.config.camera.f_number
        wanted = float(np.sqrt(peak_e / (TARGET * self.full_e(iso))))
        return pick_aperture(self.camera.f_numbers, wanted)

    def full_e(self, iso: int) -> float:
        """Electrons at which a sample counts as saturated."""
        return self.profile.saturation_dn(iso) * self.profile.row(iso).gain_e_per_dn

    def variance_dn2(self, signal_dn: Floats, iso: int, exposure_s: float) -> Floats:
        """Variance of single samples; a mock camera without noise still rounds."""
        if self.config.camera.noise == "none":
            return np.full(signal_dn.shape, 1.0 / 12.0)
        return compute_variance_dn2(signal_dn, self.profile, iso, exposure_s)


@dataclass(frozen=True)
class ErrorEstimate:
    """Relative RMS errors of one exposure of each shot, and how far chance moves them.

    code, sensor : over the RMS of the true picture.
    code_var, cross_var, sensor_var : variance of the mean squared error, in parts that stay, fall
        with 1/B and fall with 1/B^2 when B exposures are added up.
    headroom : light that would fill the sensor to where metering wants it, over what there is.
    """

    code: float
    sensor: float
    code_var: float
    cross_var: float
    sensor_var: float
    headroom: float

    @property
    def saturates(self) -> bool:
        """Whether the brightest sample is too bright to be trusted."""
        return self.headroom < TARGET / USABLE[1]

    def error(self, repeat: int = 1) -> float:
        """RMS error of `repeat` exposures."""
        return float(np.sqrt(self.code**2 + self.sensor**2 / repeat))

    def bound(self, confidence: float, repeat: int = 1) -> float:
        """RMS error that is not exceeded with this probability, by the normal distribution."""
        variance = self.code_var + self.cross_var / repeat + self.sensor_var / repeat**2
        above = NormalDist().inv_cdf(confidence) * np.sqrt(variance)
        return float(np.sqrt(self.error(repeat) ** 2 + above))


class PlanForecast(Protocol):
    """What is foreseen for one plan."""

    def judge(self, iso: int, passes: int) -> ErrorEstimate:
        """Errors at that ISO, with the codes shown `passes` times in each exposure."""
        ...
