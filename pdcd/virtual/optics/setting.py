"""Where everything on a mock bench is: its devices as they are believed to be, and as they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.placed import Panels, make_camera_map, panels_of
from pdcd.bench.tables import Config
from pdcd.bench.truth import BenchTruth
from pdcd.panels.map import Map

_FEW_SAMPLES = (2, 32)
"""Least and most points along an axis of a quad, where the truth does not set their number."""
_SLANTED_SAMPLES = 24
"""Least points along an axis where the two panels draw the borders of cells in different places:
slanted samples measure the strip between the borders to a 576th of a quad."""
_MOST_SLANTED, _FEWEST_SLANTED = 2**23, 12
"""Most slanted samples of a photo, and fewest along an axis of a quad. In larger photos a quad gets
fewer samples; below the fewest it gets an upright raster, where many samples see the same and
photos of codes are quick."""
_EDGE = 1e-9
"""Places no further than this beyond the field count as on its edge."""


def find_points_on_field(places: Floats) -> NDArray[np.bool_]:
    """Which points (..., 2) of a field lie on it; nan lies nowhere."""
    with np.errstate(invalid="ignore"):
        return np.asarray(((places >= -_EDGE) & (places <= 1.0 + _EDGE)).all(axis=-1))


@dataclass(frozen=True)
class Tap:
    """One of the points whose light a blur mixes: how far off on the field, and its share."""

    offset: tuple[float, float]
    share: float


@dataclass(frozen=True)
class OpticalSetting:
    """One bench. `frame` is rows and columns of the camera's quads. `apart`: whether the panels
    draw the borders of cells in two places."""

    believed: Config
    truth: BenchTruth
    frame: tuple[int, int]
    apart: bool = False

    @cached_property
    def true(self) -> Config:
        """The configuration that describes the bench as it is."""
        return self.truth.of(self.believed)

    @cached_property
    def drawn(self) -> Panels:
        """The panels where they are believed to lie, as they are drawn on. Raises ConfigError."""
        return panels_of(self.believed)

    @cached_property
    def panels(self) -> Panels:
        """The panels as they lie. Raises ConfigError."""
        return panels_of(self.true)

    @cached_property
    def camera(self) -> Map:
        """The camera as it looks. Raises ConfigError."""
        return make_camera_map(self.true, self.frame)

    def check(self) -> None:
        """Make all maps. Raises ConfigError for one that cannot be used."""
        for _ in (self.drawn, self.panels, self.camera):
            pass

    @property
    def projector_px(self) -> Floats:
        """(width, height) of the projector: field times this is a place in projector pixels."""
        return np.array(self.believed.projector.size_px, dtype=np.float64)

    @cached_property
    def samples(self) -> int:
        """Points along either axis of a quad at which the light is looked at."""
        said = self.truth.camera.samples
        if said is not None:
            return said
        centre = 0.5 * np.array(self.frame[::-1])
        ahead = centre + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        on_mask = self.on_mask(self.camera.to_field(ahead))
        far = float(np.nan_to_num(np.abs(on_mask[1:] - on_mask[0])).sum(axis=-1).max())
        least, most = _FEW_SAMPLES
        if self.slanted:
            least = min(self._fitting, _SLANTED_SAMPLES)
        return int(np.clip(np.ceil(far - 1e-6), least, most))

    @property
    def slanted(self) -> bool:
        """Whether no two samples of a quad lie in one row or column, so that they see strips much
        narrower than a sample. They do so where there may be such strips and the truth does not set
        the number of samples."""
        said = self.truth.camera.samples
        return self.apart and said is None and self._fitting >= _FEWEST_SLANTED

    @property
    def _fitting(self) -> int:
        """Most slanted samples along an axis of a quad that a photo has room for."""
        return int((_MOST_SLANTED / (self.frame[0] * self.frame[1])) ** 0.5)

    def on_projector(self, points: Floats) -> Floats:
        """Points of the field (..., 2) -> pixels of the projector."""
        return self.panels.projector.map.from_field(points)

    def on_mask(self, points: Floats) -> Floats:
        """Points of the field (..., 2) -> pixels of the mask, seen through its offset."""
        offset = np.array(self.true.mask.offset_px) / self.projector_px
        return self.panels.mask.map.from_field(points + offset)

    @cached_property
    def taps(self) -> tuple[Tap, ...]:
        """The blur from scene to mask: a Gaussian taken at a few points, its variance exact."""
        sigma_px, count = self.true.mask.blur_px, self.truth.scene.blur_taps
        if sigma_px == 0.0:
            return (Tap((0.0, 0.0), 1.0),)
        place, share = make_gaussian_taps(count)
        across, down = (sigma_px * place / size for size in self.projector_px)
        return tuple(
            Tap((float(across[i]), float(down[j])), float(share[i] * share[j]))
            for j in range(count)
            for i in range(count)
        )


def make_gaussian_taps(count: int) -> tuple[Floats, Floats]:
    """Evenly spaced points of a Gaussian of variance 1, (count,), and their shares, (count,).

    They reach 2.5 standard deviations before they are spread to make the variance exact.
    """
    place = np.linspace(-2.5, 2.5, count)
    share = np.exp(-0.5 * place**2)
    share /= share.sum()
    place = place / np.sqrt(np.sum(share * place**2))
    return place, share


def compute_falloff(share: float, size: tuple[int, int]) -> Floats | None:
    """Light of each pixel of a device (width, height), over that of its centre, (height, width).

    It falls by the square of the radius, by `share` in the corners; None: nothing is lost.
    """
    if share == 0.0:
        return None
    width, height = size
    x = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    y = (np.arange(height) + 0.5) * 2.0 / height - 1.0
    # Radius over that of a corner, on a device whose pixels are square.
    radius2 = ((x * width) ** 2 + ((y * height) ** 2)[:, None]) / (width**2 + height**2)
    return np.asarray(1.0 - share * radius2)
