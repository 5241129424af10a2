"""The points of the field at which photos of blocks are analysed, and affine maps of such points.

A raster has whole steps of projector pixels. It reaches a little beyond the field, as a camera may
look beside where it is believed to. `pdcd.pictures.found_blocks` looks for patterns on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.panels.map import Map

_MARGIN = 0.12
"""Share of the field's sides by which the raster reaches beyond them: a camera that looks beside
where it is believed to still sees the field there."""
_MOST = 520
"""Points of the raster along the longer side."""


@dataclass(frozen=True, eq=False)
class AffineMap:
    """``x @ linear.T + shift``, from points of the raster to points of the pattern, both in
    projector pixels of the field."""

    linear: Floats
    shift: Floats

    def __call__(self, points: Floats) -> Floats:
        """Points (..., 2)."""
        return np.asarray(points @ self.linear.T + self.shift)

    def inverse(self) -> AffineMap:
        """From the pattern to the raster."""
        back = np.linalg.inv(self.linear)
        return AffineMap(np.asarray(back, np.float64), np.asarray(-back @ self.shift, np.float64))

    def after(self, first: AffineMap) -> AffineMap:
        """The composition: this map applied to what `first` makes of a point."""
        return AffineMap(self.linear @ first.linear, self.linear @ first.shift + self.shift)


HERE = AffineMap(np.eye(2), np.zeros(2))


@dataclass(frozen=True, eq=False)
class FieldRaster:
    """Points of the field at which photos are looked at; pitch and places in projector pixels."""

    size_px: tuple[int, int]
    pitch: float
    shape: tuple[int, int]
    begin: Floats

    @classmethod
    def of(cls, size_px: tuple[int, int], quad_px: float) -> FieldRaster:
        """For a projector of (width, height) and quads of that side."""
        pitch = max(quad_px, max(size_px) / _MOST)
        reach = np.ceil(_MARGIN * np.array(size_px) / pitch)
        cols, rows = (np.round(np.array(size_px) / pitch) + 2 * reach).astype(int)
        return cls(size_px, pitch, (int(rows), int(cols)), -reach * pitch)

    def points(self) -> Floats:
        """(rows, cols, 2)."""
        rows, cols = self.shape
        at = np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), axis=-1)
        return np.asarray(at * self.pitch + self.begin)

    def sample(self, image: Floats, known: Bools, camera: Map) -> tuple[Floats, Bools]:
        """What a photo (h, w) shows at the points, and where that is known."""
        height, width = image.shape
        filled = np.where(known, image, np.median(image[known]) if known.any() else 0.0)
        places = camera.from_field(self.points() / self.size_px)
        side = max(1, round(self.pitch * width / self._quads_px(camera)))
        at = np.moveaxis(places[..., ::-1], -1, 0) - 0.5
        with np.errstate(invalid="ignore"):
            inside = np.all((places > 0.5) & (places < (width - 0.5, height - 0.5)), axis=-1)
        at = np.where(inside, at, 0.0)
        smooth = scipy.ndimage.uniform_filter(filled, side, mode="nearest") if side > 1 else filled
        if side % 2 == 0:
            at = at + 0.5  # an even filter is centred half a quad before its middle
        seen = scipy.ndimage.map_coordinates(smooth, at, order=3 if side < 3 else 1, mode="nearest")
        sure = scipy.ndimage.map_coordinates(known.astype(np.float64), at, order=1, mode="nearest")
        return seen, inside & (sure > 0.99)

    def _quads_px(self, camera: Map) -> float:
        """Projector pixels that the photo's width spans, about."""
        middle = 0.5 * np.array(camera.size_px, dtype=np.float64)
        slope = camera.jacobian(middle) * np.array(self.size_px)[:, None]
        return float(np.sqrt(abs(np.linalg.det(slope)))) * camera.size_px[0]


class Flattener:
    """Subtracts the level from pictures on a raster: spread light, and shade. known : where they
    are known. sigma : in points, standard deviation of the local mean that is the level."""

    def __init__(self, known: Bools, sigma: float) -> None:
        self.known, self._sigma = known, sigma
        self.weight: Floats = np.maximum(self.blur(known.astype(np.float64)), 1e-3)

    def blur(self, values: Floats) -> Floats:
        """The sum around each point, as the mean weighs it."""
        return np.asarray(scipy.ndimage.gaussian_filter(values, self._sigma, mode="constant"))

    def flatten(self, light: Floats) -> Floats:
        """A picture less its mean around each point; 0 where nothing is known."""
        light = np.where(self.known, light, 0.0)
        return np.where(self.known, light - self.blur(light) / self.weight, 0.0)
