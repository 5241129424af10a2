"""How much light is blurred on its way to the mask, measured at the edges of blocks.

The camera sees blocks on the mask through its own lens alone. Blocks on the projector reach it
through the projector's lens, the scene and the optics that focus the scene on the mask. If their
edges are wider, light is blurred in front of the mask, and leaves through cells beside its own. A
surface that scatters light widens edges, too, but leaves some of them sharp: light that is
reflected right where it falls is not spread.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.pictures.found_blocks import FoundPattern, PatternFinder, compute_patch_covariance

_ROUNDS = 24
"""Iterations in which a blur is estimated from the last estimate."""
_SETTLED = 0.02
"""Change of a squared blur that counts as none, over itself or a squared step of the raster."""
_SMOOTHED = 1.0
"""Points by which a photo is smoothed, so that its edges are never sharper than the pattern's: a
blur below zero cannot be estimated as well as one above."""
_SIGMAS = 3.0
"""Standard deviations by which an estimate of a squared blur may be off."""
_UNSURE = 0.015
"""Squared blur by which edges of two sharp panels may differ beside chance, in squared points of
the raster. Virtual scenes show half of both together (root of the sum of squares)."""
_LENS_UNSURE = 0.1
"""The same, relative to the squared blur of the camera's lens, which both panels share."""
_WIDER = (1.0, 2.0, 4.0)
"""Widths over a blur that are tried for scattered light."""
_WIDE = 0.8
"""Squared blur, in squared points, from which light with sharp edges is separated well from it."""
_SHARP, _SHARP_IF_NARROW = 0.22, 0.5
"""Share of a pattern's light with sharp edges from which the scene is what scatters the rest: a
wide blur leaves less than 0.16; beside a narrow blur that share is hardly measurable."""


class PatternBasis:
    """A pattern with any blur, as a photo shows it at the known points of the field."""

    def __init__(self, finder: PatternFinder, known: Bools, found: FoundPattern) -> None:
        raster = finder.raster
        points = raster.points()
        self.pitch = raster.pitch
        self._known, self._flattener = known, finder.make_flattener(known)
        self._inside = known & np.all((points >= 0.0) & (points < raster.size_px), axis=-1)
        # Distortion by a lens moves edges from place to place, and would count as blur.
        window = scipy.spatial.cKDTree(found.centres).query(points)[1]
        self._sharp = finder.shown(found.map(points) + found.left[window])
        self._patch = finder.number_patches(points[self._inside])

    def flatten_photo(self, seen: Floats) -> Floats:
        """A photo on the raster without its level, (n,)."""
        weight = np.maximum(self._weighted(np.ones(seen.shape)), 1e-3)
        return self._flatten(self._weighted(seen) / weight)

    def _weighted(self, seen: Floats) -> Floats:
        light = np.where(self._known, seen, 0.0)
        return np.asarray(scipy.ndimage.gaussian_filter(light, _SMOOTHED))

    def _flatten(self, light: Floats) -> Floats:
        return np.asarray(self._flattener.flatten(light)[self._inside])

    def pattern(self, squared_px: float) -> Floats:
        """The pattern with that squared blur, without its level, (n,)."""
        return self._flatten(self._blurred(squared_px))

    def design(self, squared_px: float) -> Floats:
        """The same, and its derivative by the squared blur, per square pixel and without a level:
        (n, 2)."""
        step, now = 0.25 * self.pitch**2, self._blurred(squared_px)
        more = self._blurred(squared_px + step) - now
        return np.stack([self._flatten(now), more[self._inside] / step], axis=1)

    def _blurred(self, squared_px: float) -> Floats:
        sigma = np.sqrt(squared_px) / self.pitch
        return np.asarray(
            scipy.ndimage.gaussian_filter(self._sharp, sigma) if sigma else self._sharp
        )

    def spread(self, design: Floats, left: Floats) -> float:
        """Standard deviation of a fit's second factor, estimated from patches of residuals."""
        return float(np.sqrt(compute_patch_covariance(design, left, self._patch)[1, 1]))


@dataclass(frozen=True, eq=False)
class BlockEdges:
    """Edges of a panel's blocks in a photo.

    basis : the pattern where it was found. light : of the photo, (n,). depth : amplitude that the
    pattern would have in it without a blur. squared_px : squared blur of the edges, that of
    smoothing and of quads included, and sigma_px2 its standard deviation, both in square
    projector pixels.
    """

    basis: PatternBasis
    light: Floats
    depth: float
    squared_px: float
    sigma_px2: float


def measure_block_edges(
    finder: PatternFinder, seen: Floats, known: Bools, found: FoundPattern
) -> BlockEdges:
    """Measures how wide the edges of a pattern are where it was found. The photo is fitted by least
    squares to the pattern and its derivative by the blur, starting from sharp edges."""
    basis = PatternBasis(finder, known, found)
    light, point = basis.flatten_photo(seen), basis.pitch**2
    squared, sigma = _SMOOTHED * point, 0.0
    for _ in range(_ROUNDS):
        before = max(squared, 0.0)
        design = basis.design(before)
        depth, change = np.linalg.lstsq(design, light, rcond=None)[0]
        if not depth > 0.0:
            return BlockEdges(basis, light, 0.0, 0.0, np.inf)
        squared = before + change / depth
        sigma = basis.spread(design, light - design @ (depth, change)) / depth
        if abs(squared - before) < _SETTLED * max(before, point) or squared < 0.0:
            break
    return BlockEdges(basis, light, float(depth), float(squared), float(sigma))


def measure_blur_before_mask(
    projector: BlockEdges, mask: BlockEdges, known_px: float = 0.0
) -> float:
    """Standard deviation, in projector pixels, of the blur of light in front of the mask; 0 where
    photos cannot separate it from the known one, or where the scene scatters.

    Caller: `pdcd.pictures.misplaced.find_panel_places`, for the error bars and the verdict.
    """
    point = projector.basis.pitch**2
    lens = max(mask.squared_px - _SMOOTHED * point, 0.0)
    found = projector.squared_px - mask.squared_px
    by_chance = _SIGMAS * np.hypot(projector.sigma_px2, mask.sigma_px2)
    unsure = np.hypot(by_chance, _UNSURE * point) + _LENS_UNSURE * lens
    if not found - known_px**2 > unsure:
        return 0.0
    sharp = _measure_sharp_share(projector, mask.squared_px, found)
    if sharp > (_SHARP if found > _WIDE * point else _SHARP_IF_NARROW):
        return 0.0
    return float(np.sqrt(found))


def _measure_sharp_share(edges: BlockEdges, sharp_px2: float, blur_px2: float) -> float:
    """Share of a pattern's light with edges as sharp as the mask's; the rest has wider ones."""
    wider = [sharp_px2 + (times**2) * blur_px2 for times in _WIDER]
    design = np.stack([edges.basis.pattern(px2) for px2 in (sharp_px2, *wider)], axis=1)
    parts = scipy.optimize.nnls(design, edges.light)[0]
    return float(parts[0] / parts.sum()) if parts.any() else 0.0
