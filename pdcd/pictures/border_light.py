"""Direct light that gets into a photo of indirect light along the borders of whole cells.

Where the pixels of both panels do not end together they draw the border of a cell in two places,
and between these the light of one cell goes through the mask of the other. Where these strips lie
is known from both panels' pixels (`pdcd.probing.borders.find_strips`), which quads see them from
the camera's map, and for how long they let light through from the realised probing matrix. How
bright they are the photos say: as direct light is between the quads around.

What they do not say is how direct light differs within a quad. That is an error in proportion to
how it differs from quad to quad. Where quads beside, which see no strip, tell a quad's share of
indirect light better than that, they have a say in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.pictures.picture import Picture
from pdcd.pictures.to_quads import Weights
from pdcd.probing.borders import Strips
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

ROUNDS = 4
"""Times that direct light is told from a photo without what got into it: of a share of a third, a
hundredth is left."""
MAP_QUADS = 0.02
"""Quads by which the camera's map may be off across a border."""
ROUGH = 0.8
"""What direct light differs within a quad, over what it differs between the quads around: 0.7 to
0.9 before five virtual scenes with detail finer than quads."""
EDGES_OFF = 0.05
"""Share of this light that is unsure everywhere: pixels have edges and gaps of their own."""
LEAST_SHARE = 1e-3
"""Share of direct light below which a quad counts as seeing no strip."""
AROUND = np.exp(-0.5 * np.hypot(*np.mgrid[-2:3, -2:3]) ** 2) - np.pad([[1.0]], 2)
"""How quads around one count where they tell of it."""
LEAST_LIT = 0.01
"""Of the mean light: a quad that is darker tells no share of it."""
LEAST_VARIANCE = 1e-12
"""Of the square of a share: what rounding leaves where quads tell the same."""
MOST_MOVED = 2.0
"""Standard deviations of what was taken out by which quads beside may change a quad at most."""


@dataclass(frozen=True, eq=False)
class BorderLight:
    """The strips of a photo as a camera sees them.

    strips, lit_s : the strips, and for how long each piece of the field is lit through the mask of
    another cell (`pdcd.probing.borders.Strips.lit_s`). weight_s : () or (h, w), of the quads.
    """

    strips: tuple[Strips, ...]
    lit_s: tuple[Floats, ...]
    weight_s: Floats
    cells: CellMap

    @classmethod
    def of(cls, realised: Factors, weights: Weights, cells: CellMap) -> BorderLight | None:
        """That of a photo; None where both panels draw all borders alike, or nobody looked."""
        if not realised.apart:
            return None
        lit = tuple(s.lit_s(realised.left, realised.right, cells.grid) for s in realised.apart)
        return cls(realised.apart, lit, weights.quads_s, cells)

    def share(self) -> Floats:
        """Share of the direct light that gets into each quad, (h, w)."""
        parts = zip(self.strips, self.lit_s, strict=True)
        seen = sum((self.cells.gather(lit, s.cuts) for s, lit in parts), np.zeros(self.cells.frame))
        return np.asarray(seen / self.weight_s)

    def light(self, direct: NDArray[np.floating]) -> Floats:
        """Light that gets into each quad, (h, w, C), where direct light is that, (h, w, C)."""
        found = np.zeros(direct.shape)
        for strips, lit in zip(self.strips, self.lit_s, strict=True):
            x, y = self.cells.filled.from_field(strips.centres(self.cells.grid)).T
            places = np.nan_to_num(np.stack([y, x]) - 0.5)
            for channel in range(direct.shape[2]):
                there = scipy.ndimage.map_coordinates(
                    direct[..., channel], places, order=1, mode="nearest"
                )
                table = np.zeros(lit.size)
                table[strips.pieces] = there
                found[..., channel] += self.cells.gather(
                    lit * table.reshape(lit.shape), strips.cuts
                )
        return np.asarray(found / self.weight_s.reshape(*self.weight_s.shape, 1))

    def take_out(self, photo: Picture, white: Picture) -> Picture:
        """A photo of indirect light, and its error bar by the sensor, without this light. Where
        nothing is known of the white photo the other stays as it is."""
        known = np.isfinite(white.sigma)
        both, light = white.image - photo.image, np.zeros(photo.image.shape)
        for _ in range(ROUNDS):
            light = self.light(both + light)
        image = photo.image - np.where(known, light, 0.0)
        share = self.share()
        noise = share[..., None] * np.where(known, white.sigma, 0.0)
        sigma = np.hypot(photo.sigma, noise).astype(photo.sigma.dtype)
        off, free = self._off(white.image - image, share), self._free(share)
        for channel in range(image.shape[2]):
            told = _told(image[..., channel], white.image[..., channel], free)
            r = off[..., channel]
            trust = told.share_of(r**2) * known[..., channel]
            most = MOST_MOVED * r
            image[..., channel] += np.clip(trust * (told.image - image[..., channel]), -most, most)
        return Picture(image, sigma)

    def error(self, photo: Picture, white: Picture) -> Floats:
        """Standard deviation of a photo without this light, (h, w, C), by what was taken out: by
        what the camera's map may be off, and what direct light may differ within a quad.

        photo : what `take_out` made.
        """
        share = self.share()
        off, free = self._off(white.image - photo.image, share), self._free(share)
        for channel in range(off.shape[2]):
            told = _told(photo.image[..., channel], white.image[..., channel], free)
            off[..., channel] *= np.sqrt(1.0 - told.share_of(off[..., channel] ** 2))
        return off

    def _free(self, share: Floats) -> Bools:
        """Quads that see no strip, and the field alone."""
        return (np.abs(share) < LEAST_SHARE) & self.cells.known

    def _off(self, direct: NDArray[np.floating], share: Floats) -> Floats:
        """Standard deviation of what was taken out by itself, (h, w, C)."""
        moved = np.zeros(self.cells.frame)
        for strips, lit in zip(self.strips, self.lit_s, strict=True):
            one, other = (np.roll(lit, by, axis=1 - strips.axis) for by in (1, -1))
            slope = 0.5 * self.cells.gather(one - other, strips.cuts)
            width = strips.step * float(np.sqrt(1.0 / self.cells.quad_cells))
            moved += (slope * (MAP_QUADS / width)) ** 2
        moved = np.sqrt(moved) / self.weight_s
        off = np.empty(direct.shape)
        for channel in range(direct.shape[2]):
            here = direct[..., channel]
            mean = scipy.ndimage.uniform_filter(here, 3, mode="nearest")
            square = scipy.ndimage.uniform_filter(here * here, 3, mode="nearest") - mean * mean
            rough = ROUGH * np.sqrt(np.maximum(square, 0.0))
            edges = np.hypot(share * rough, EDGES_OFF * share * here)
            off[..., channel] = np.hypot(edges, moved * here)
        return off


@dataclass(frozen=True, eq=False)
class _Told:
    """What quads beside tell of each quad, (h, w), and with which variance; infinite where none
    does."""

    image: Floats
    variance: Floats

    def share_of(self, variance: Floats) -> Floats:
        """How much it counts beside a value of that variance, (h, w)."""
        both = variance + self.variance
        return np.divide(variance, both, out=np.zeros_like(both), where=np.isfinite(both))


def _told(image: NDArray[np.floating], white: NDArray[np.floating], free: Bools) -> _Told:
    """One colour of a photo as the `free` quads around tell it: by the share of all light that is
    indirect there."""
    lit = np.maximum(white, LEAST_LIT * float(np.abs(white).mean()) + np.finfo(np.float64).tiny)
    counts = free.astype(np.float64)
    there, indirect, squares = (
        scipy.ndimage.convolve(counts * each, AROUND, mode="constant")
        for each in (lit, image, image * image / lit)
    )
    sure = there > 0.0
    share, square = (
        np.divide(each, there, out=np.zeros_like(there), where=sure) for each in (indirect, squares)
    )
    # By as much as they differ among themselves, be it by an edge that runs between them: of n of
    # them, the next one differs from their mean by (n + 1) / (n - 1) of their own variance.
    twice = scipy.ndimage.convolve((counts * lit) ** 2, AROUND**2, mode="constant")
    many = np.divide(there * there, twice, out=np.zeros_like(there), where=sure)
    sure = sure & ~free & (many > 1.0 + 1e-9)
    wide = np.divide(many + 1.0, many - 1.0, out=np.zeros_like(there), where=sure)
    spread = np.maximum(square - share * share, LEAST_VARIANCE * square)
    return _Told(share * lit, np.where(sure, wide * spread * lit * lit, np.inf))
