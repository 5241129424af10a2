"""Direct light that gets into a photo of indirect light along the borders of whole cells.

Where the pixels of both panels do not end together they draw the border of a cell in two places,
and between these the light of one cell goes through the mask of the other. Where these strips lie
is known from both panels' pixels (`pdcd.probing.borders.find_strips`), which quads see them from
the camera's map, and for how long they let light through from the realised probing matrix. How
bright they are is interpolated from the direct light of the quads around.

Interpolation does not show how direct light varies within a quad. That error is taken to be in
proportion to the variation from quad to quad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.exposed import AmbientLight
from pdcd.pictures.picture import Picture
from pdcd.pictures.to_quads import QuadWeights
from pdcd.probing.borders import BorderStrips
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

_ROUNDS = 4
"""Iterations that estimate direct light from a photo without the light that got into it: where a
third got in, a hundredth remains."""
_MAP_QUADS = 0.02
"""Quads by which the camera's map may be off across a border."""
_ROUGH = 0.8
"""Variation of direct light within a quad, over that between the quads around: 0.7 to 0.9 in five
virtual scenes with detail finer than quads."""
_EDGES_OFF = 0.05
"""Relative error of this light everywhere, as pixels have edges and gaps of their own."""
_SEEN_OFF = 0.03
"""The same for light that was photographed, edges included: by how long panels show it."""
_LEAST_SHARE = 1e-3
"""Share of direct light below which a quad counts as seeing no strip."""
_LEAST_DIRECT = 0.1
"""Share of its direct light that a quad must see to be used."""
_BESIDE, _INNER = np.ones((5, 5)), np.zeros((5, 5))
_BESIDE[1:-1, 1:-1], _INNER[1:-1, 1:-1] = 0.0, 1.0
_INNER[2, 2] = 0.0
"""Which parts of a cell are lit in either photo: those beside its borders, those next to these."""
_INDIRECT_OFF = 0.5
"""Relative error of the measured indirect light: more may come from nearer by."""


@dataclass(frozen=True)
class BorderMeasurement:
    """What a photo of the strips alone shows (`pdcd.planning.border_photo`).

    light : of all strips in a second, on quads, without the indirect light that got in. indirect :
    that indirect light, (h, w, C), from the photo in which only the pixels next to those beside
    borders were lit. reach : how far from borders pixels were lit and open, in cells (x, y). leak :
    share of the light of lit pixels that a closed mask lets through.
    """

    light: AmbientLight
    indirect: Floats
    reach: tuple[float, float]
    leak: float = 0.0

    def without_leak(self, direct: Floats, cells: CellMap) -> tuple[Floats, Floats]:
        """`light` and `indirect` without the direct light (h, w, C) that got through the closed
        mask."""
        down, right = (_rings(reach) for reach in self.reach[::-1])
        beside, inner = (
            self.leak * cells.gather(np.tile(lit, cells.grid), (down, right))[..., None] * direct
            for lit in (_BESIDE, _INNER)
        )
        return self.light.light - (beside - inner), self.indirect - inner


def _rings(reach: float) -> tuple[float, ...]:
    """Where a cell is cut into a ring beside its borders, a ring next to that, and the inside."""
    inner = min(2.0 * reach, 0.499)
    return 0.0, reach, inner, 1.0 - inner, 1.0 - reach, 1.0


@dataclass(frozen=True, eq=False)
class BorderLight:
    """The strips of a photo as a camera sees them.

    strips, lit_s : the strips, and for how long each piece of the field is lit through the mask of
    another cell (`pdcd.probing.borders.BorderStrips.lit_s`). weight_s : of the quads, () or (h, w).
    """

    strips: tuple[BorderStrips, ...]
    lit_s: tuple[Floats, ...]
    weight_s: Floats
    cells: CellMap

    @classmethod
    def of(cls, realised: Factors, weights: QuadWeights, cells: CellMap) -> BorderLight:
        """The strips of a photo, of which there are some."""
        lit = tuple(s.lit_s(realised.left, realised.right, cells.grid) for s in realised.apart)
        return cls(realised.apart, lit, weights.quads_s, cells)

    def share(self) -> Floats:
        """Share of the direct light that gets into each quad, (h, w)."""
        parts = zip(self.strips, self.lit_s, strict=True)
        seen = sum((self.cells.gather(lit, s.cuts) for s, lit in parts), np.zeros(self.cells.frame))
        return np.asarray(seen / self.weight_s)

    def weigh_direct(self, of_quads: QuadWeights) -> QuadWeights:
        """What to divide the quads of a photo of direct light by, which lacks this light along the
        borders. A quad that sees little else is blind."""
        seen = 1.0 - compute_strip_shares(self.strips, self.cells) + self.share()
        dark = seen < _LEAST_DIRECT
        blind = dark if of_quads.blind is None else of_quads.blind | dark
        weight = of_quads.quads_s * np.where(dark, 1.0, seen)
        return QuadWeights(weight, blind if blind.any() else None)

    def light(self, direct: NDArray[np.floating]) -> Floats:
        """Light that gets into each quad, (h, w, C), given the direct light (h, w, C)."""
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

    def take_out(
        self, photo: Picture, white: Picture, seen: BorderMeasurement | None = None
    ) -> Picture:
        """A photo of indirect light, and its error bar by the sensor, without this light: as it was
        `seen` in a photo of its own, or else as bright as the direct light around. In the latter
        case nothing is taken out where the white photo is unknown."""
        share = self.share()
        if seen is not None:
            gain, light, _ = self._seen(photo, white, share, seen)
            image = photo.image - gain * light
            noise = gain * np.sqrt(seen.light.variance)
            return Picture(image, np.hypot(photo.sigma, noise).astype(photo.sigma.dtype))
        known = np.isfinite(white.sigma)
        both, light = white.image - photo.image, np.zeros(photo.image.shape)
        for _ in range(_ROUNDS):
            light = self.light(both + light)
        image = photo.image - np.where(known, light, 0.0)
        noise = share[..., None] * np.where(known, white.sigma, 0.0)
        return Picture(image, np.hypot(photo.sigma, noise).astype(photo.sigma.dtype))

    def error(
        self, photo: Picture, white: Picture, seen: BorderMeasurement | None = None
    ) -> Floats:
        """Standard deviation, (h, w, C), of the light that was taken out of a photo. If the light
        was `seen`, it comes from the time for which panels showed it, and from indirect light that
        got into that photo; else from the camera's map, and from the variation of direct light
        within a quad.

        photo : what `take_out` made.
        """
        share = self.share()
        if seen is None:
            return self._off(white.image - photo.image, share)
        gain, light, indirect = self._seen(photo, white, share, seen)
        return np.asarray(gain * np.hypot(_SEEN_OFF * light, _INDIRECT_OFF * indirect))

    def _seen(
        self, photo: Picture, white: Picture, share: Floats, seen: BorderMeasurement
    ) -> tuple[Floats, Floats, Floats]:
        """The gain of each quad, (h, w, 1), and the measured light along borders and indirect
        light, without the direct light that a closed mask lets through."""
        direct = np.where(np.isfinite(white.sigma), white.image - photo.image, 0.0)
        return self._gain(share)[..., None], *seen.without_leak(direct, self.cells)

    def _gain(self, share: Floats) -> Floats:
        """Light in each quad of the photo over that of a photo of strips in a second, (h, w): the
        time for which the strips there were open; where there are none, the mean time."""
        area = compute_strip_shares(self.strips, self.cells)
        usual = float((share * self.weight_s).sum() / area.sum()) / self.weight_s
        gain = np.divide(share, area, out=np.zeros_like(area), where=area > _LEAST_SHARE)
        return np.where(area > _LEAST_SHARE, gain, usual)

    def _off(self, direct: NDArray[np.floating], share: Floats) -> Floats:
        """Standard deviation of light that was interpolated and taken out, (h, w, C)."""
        moved = np.zeros(self.cells.frame)
        for strips, lit in zip(self.strips, self.lit_s, strict=True):
            one, other = (np.roll(lit, by, axis=1 - strips.axis) for by in (1, -1))
            slope = 0.5 * self.cells.gather(one - other, strips.cuts)
            width = strips.step * float(np.sqrt(1.0 / self.cells.quad_cells))
            moved += (slope * (_MAP_QUADS / width)) ** 2
        moved = np.sqrt(moved) / self.weight_s
        off = np.empty(direct.shape)
        for channel in range(direct.shape[2]):
            here = direct[..., channel]
            mean = scipy.ndimage.uniform_filter(here, 3, mode="nearest")
            square = scipy.ndimage.uniform_filter(here * here, 3, mode="nearest") - mean * mean
            rough = _ROUGH * np.sqrt(np.maximum(square, 0.0))
            edges = np.hypot(share * rough, _EDGES_OFF * share * here)
            off[..., channel] = np.hypot(edges, moved * here)
        return off


def compute_strip_shares(strips: tuple[BorderStrips, ...], cells: CellMap) -> Floats:
    """Share of each quad's area that strips take, (h, w)."""
    area = np.zeros(cells.frame)
    for each in strips:
        area += cells.gather(each.area(cells.grid), each.cuts)
    return area
