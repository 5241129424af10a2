"""Panels, card, room and sensor by plain physics, for the calibration of light.

Written from the equations, refresh by refresh in small steps of time; it shares no code with what
it tests. Light of a point: ``integral of m(t) (rho p(t) + room) dt``, p and m being what the panels
let pass. Sensor: Poisson photons, read noise, banding, hot samples, full well, whole DN.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence

Floats = NDArray[np.float64]

REFRESH_S = 1.0 / 60.0
STEPS = 50
STEP_S = REFRESH_S / STEPS
WHITE = -2


@dataclass
class TruePanel:
    """Leak is black over white; times in s."""

    leak: float = 0.0
    rise_s: float = 0.002
    fall_s: float = 0.004

    def light(self, levels: Floats, dark_s: float) -> Floats:
        """What it lets pass, mean over each step of time, asked for `levels` (refreshes,) 0..1,
        with black before and after for `dark_s`."""
        dark = np.zeros(round(dark_s / REFRESH_S))
        step = np.arange(STEPS + 1) * STEP_S
        state, out = self.leak, []
        for aim in self.leak + (1.0 - self.leak) * np.concatenate([dark, levels, dark]):
            if abs(aim - state) < 1e-14:
                out.append(np.full(STEPS, aim))
                continue
            tau = max(self.rise_s if aim >= state else self.fall_s, 1e-9)
            left = np.exp(-step / tau)
            out.append(aim - (state - aim) * tau * np.diff(left) / STEP_S)
            state = aim + (state - aim) * left[-1]
        return np.concatenate(out)


@dataclass
class TrueSensor:
    """450D at ISO 100, as its profile has it."""

    gain: float = 2.96
    read_e: float = 16.8
    black: float = 1024.0
    white: int = 14605
    full_well_e: float = 1e9
    banding_e: float = 0.0
    black_error_dn: float = 0.0
    hot: float = 0.0
    prnu: float = 0.0

    def samples(self, electrons: Floats, rng: np.random.Generator, fixed: int = 0) -> Floats:
        """One photo of one plane in DN minus black, as the file's reader gives it: whole DN, and an
        error of the black level that is the same for all samples."""
        still = np.random.default_rng([fixed, 7])
        light = electrons
        if self.prnu:
            light = light * (1.0 + self.prnu * still.standard_normal(light.shape))
        hot = still.random(light.shape) < self.hot
        light = light + hot * 8000.0
        charge = light + np.sqrt(np.maximum(light, 0.0)) * rng.standard_normal(light.shape)
        low = light < 50.0
        charge[low] = rng.poisson(np.maximum(light[low], 0.0))
        charge = np.minimum(charge, self.full_well_e)
        charge += self.read_e * rng.standard_normal(light.shape)
        charge += self.banding_e * rng.standard_normal((light.shape[0], 1))
        counts = np.clip(np.rint(self.black + charge / self.gain), 0, self.white)
        return np.asarray(counts - self.black)


@dataclass
class LightBench:
    """A card that fills the picture.

    card, room : (h, w, 3) or scalars, light of a white projector on it and of the room, in scene
        units. electrons : of a scene unit in a second, after the aperture.
    """

    projector: TruePanel = field(default_factory=lambda: TruePanel(1.0 / 2000.0))
    mask: TruePanel = field(default_factory=lambda: TruePanel(1.0 / 500.0))
    sensor: TrueSensor = field(default_factory=TrueSensor)
    shape: tuple[int, int] = (96, 128)
    card: Floats | float = 0.9
    room: Floats | float = 0.0
    electrons: Floats | float = 22000.0
    settle_s: float = 0.1
    falloff: float = 0.3

    def vignetting(self) -> Floats:
        """(h, w, 1), 1 in the middle."""
        rows, cols = self.shape
        y, x = np.mgrid[:rows, :cols].astype(np.float64)
        y, x = (2 * y + 1) / rows - 1, (2 * x + 1) / cols - 1
        return np.asarray(1.0 - self.falloff * 0.5 * (x**2 + y**2))[..., None]

    def seconds(self, shown: PanelSequence, covered: bool = False) -> tuple[float, float]:
        """Integrals of m p and of m over an exposure of panels that are black or white."""
        p, m = (
            panel.light(np.array(index == WHITE, np.float64), self.settle_s)
            for panel, index in (
                (self.projector, shown.projector_index),
                (self.mask, shown.mask_index),
            )
        )
        return float(m @ p) * STEP_S * (not covered), float(m.sum()) * STEP_S

    def light(self, shown: PanelSequence, covered: bool = False, lamp: float = 1.0) -> Floats:
        """Expected electrons of the quads, (h, w, 3)."""
        lit_s, open_s = self.seconds(shown, covered)
        both = lamp * lit_s * np.asarray(self.card) + open_s * np.asarray(self.room)
        return np.broadcast_to(both * self.electrons * self.vignetting(), (*self.shape, 3)).copy()

    def photo(
        self, light: Floats, rng: np.random.Generator, black_error_dn: float | None = None
    ) -> QuadPhoto:
        """Quads of a photo in DN; both greens averaged."""
        sensor = self.sensor
        error = sensor.black_error_dn if black_error_dn is None else black_error_dn
        planes = [sensor.samples(light[..., c], rng) for c in (0, 1, 1, 2)]
        off = error * rng.standard_normal()
        top = sensor.white - sensor.black
        rgb = np.stack([planes[0], 0.5 * (planes[1] + planes[2]), planes[3]], axis=-1) - off
        variance = np.maximum(rgb, 0.0) / sensor.gain + (sensor.read_e / sensor.gain) ** 2 + 1 / 12
        variance[..., 1] *= 0.5
        return QuadPhoto(rgb, variance, np.max(planes, axis=0) >= top - 1)
