"""From tables of few numbers to the picture on the sensor: the weight of each number in a quad.

A picture is linear in the light of a frame's sights. The weight of a sight in a quad (its share of
the samples, the detail of the scene there, the unevenness of the projector) is the same in every
picture, so it is computed once, and kept where that does not take too much memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.virtual.optics.products import COLOUR_COUNT, SitePairs
from pdcd.virtual.optics.setting import OpticalSetting, Tap
from pdcd.virtual.optics.sights import NO_SITE, CameraSamples, CellGrid, Sights, sample_pixels
from pdcd.virtual.scene.texture import sample_texture

_Numbers = NDArray[np.int64]

_Scalar = TypeVar("_Scalar", bound=np.generic)

WEIGHT_CACHE_BYTES = 1 << 28
"""Memory for the weights of one way of driving the panels; weights beyond it are computed anew for
every picture."""


@dataclass(frozen=True)
class _Meetings:
    """The pairs that the sights of a frame are made of.

    direct : pairs of mask and projector sites; `of_sight` (K,) is the pair of each sight, or
        `NO_SITE`.
    indirect : pairs of mask sites and scene cells; `of_corner` (K, corners) is the pair of each
        corner of each sight, or `NO_SITE`.
    """

    direct: SitePairs
    of_sight: _Numbers
    indirect: SitePairs
    of_corner: _Numbers


def _meetings(sights: Sights, cells: CellGrid) -> _Meetings:
    """The distinct pairs of all sights."""
    seen = sights.place >= 0
    direct, of_sight = _pairs(sights.mask, sights.lit, seen & (sights.lit >= 0))
    corners = cells.corners[np.maximum(sights.place, 0)]
    count = corners.shape[1]
    indirect, of_corner = _pairs(np.repeat(sights.mask, count), corners.ravel(), seen.repeat(count))
    return _Meetings(direct, of_sight, indirect, of_corner.reshape(-1, count))


def _pairs(mask: _Numbers, other: _Numbers, used: NDArray[np.bool_]) -> tuple[SitePairs, _Numbers]:
    width = int(other.max(initial=0)) + 1
    keys, inverse = np.unique((mask * width + other)[used], return_inverse=True)
    of = np.full(mask.size, NO_SITE, dtype=np.int64)
    of[used] = inverse
    return SitePairs(*np.divmod(keys, width)), of


@dataclass(frozen=True)
class Detail:
    """Factors of the cells' light from place to place; None where there are none.

    textures : of the direct and of the indirect light, (H, W, 3) each.
    uneven : (height, width) light of each projector pixel over that of the brightest.
    """

    textures: tuple[Floats, Floats] | None
    uneven: Floats | None

    @property
    def split(self) -> bool:
        """Whether direct and indirect light differ in anything but the cells' light."""
        textures = self.textures
        return self.uneven is not None or bool(textures and textures[0] is not textures[1])


@dataclass(frozen=True)
class PictureTerms:
    """All that a picture is rendered from.

    direct : (pairs,) of `_Meetings.direct`, factors of the cells' direct reflection.
    reflected : (N, 3) that reflection; with a texture, divided by the texture's means.
    indirect : (pairs, 3) of `_Meetings.indirect`; with a texture, divided by its means.
    ambient : how long each mask site is open (S,), and the ambient light of the cells (N, 3).
    """

    direct: Floats
    reflected: Floats
    indirect: Floats
    ambient: tuple[Floats, Floats] | None = None


@dataclass(frozen=True)
class _Runs:
    """Runs of equal samples within a quad: the flat index of the first sample of each run (P,), and
    the first run of each quad (quads,)."""

    first: _Numbers
    quads: _Numbers

    @classmethod
    def of(cls, keys: NDArray[np.integer]) -> _Runs:
        """The runs in the samples of quads, (quads, samples)."""
        new = np.ones(keys.shape, dtype=np.bool_)
        new[:, 1:] = keys[:, 1:] != keys[:, :-1]
        counts = new.sum(axis=1)
        return cls(np.flatnonzero(new), np.cumsum(counts) - counts)

    def sums(self, left: Floats, right: Floats) -> Floats:
        """Sums over each run, (P, a, b), of left (n, a) times right (n, b) of the samples."""
        count, samples = self.first.size, np.arange(len(left), dtype=np.int32)
        ends = np.append(self.first, len(left)).astype(np.int32)
        found = np.empty((count, left.shape[1], right.shape[1]))
        for column in range(right.shape[1]):
            by_run = (np.ascontiguousarray(right[:, column]), samples, ends)
            found[..., column] = scipy.sparse.csr_array(by_run, shape=(count, samples.size)) @ left
        return found


@dataclass(frozen=True)
class _Part:
    """The weights of sights in the quads of a chunk, sorted by quad.

    quad, sight : (P,) int32
    direct, indirect : (P, corners, 1 or 3)
    """

    quad: NDArray[np.int32]
    sight: NDArray[np.int32]
    direct: Floats
    indirect: Floats

    @property
    def nbytes(self) -> int:
        """Memory that keeping it takes."""
        both = self.indirect.nbytes + (self.direct is not self.indirect) * self.direct.nbytes
        return both + self.sight.nbytes + self.quad.nbytes

    @classmethod
    def merge(cls, parts: Sequence[_Part]) -> _Part:
        """The sum of parts, with each sight once in a quad: taps beside each other, and the rows of
        samples of a quad, see much the same sights."""
        quad = np.concatenate([part.quad for part in parts])
        sight = np.concatenate([part.sight for part in parts])
        order = np.lexsort((sight, quad))
        quad, sight = quad[order], sight[order]
        new = np.ones(quad.size, dtype=np.bool_)
        new[1:] = (quad[1:] != quad[:-1]) | (sight[1:] != sight[:-1])
        starts = np.flatnonzero(new)

        def add(weights: list[Floats]) -> Floats:
            return np.asarray(np.add.reduceat(np.concatenate(weights)[order], starts, axis=0))

        indirect = add([part.indirect for part in parts])
        same = all(part.direct is part.indirect for part in parts)
        direct = indirect if same else add([part.direct for part in parts])
        return cls(quad[starts], sight[starts], direct, indirect)

    def sum_light(self, weights: Floats, values: Floats) -> Floats:
        """Light of quads (quads, 3): values (K, corners, 3) times weights (P, corners, 1 or 3)."""
        seen = np.einsum("pkc,pkc->pc", weights, values[self.sight])
        return np.asarray(np.add.reduceat(seen, self._first, axis=0))

    @cached_property
    def _first(self) -> NDArray[np.intp]:
        """The first of the entries of each quad."""
        return np.flatnonzero(np.diff(self.quad, prepend=-1))


@dataclass(frozen=True)
class _Open:
    """How much ambient light of a cell (P,) comes through a mask site (P,): `share` (P, 1)."""

    runs: _Runs
    mask: _Numbers
    cell: NDArray[np.int32]
    share: Floats


@dataclass(frozen=True)
class _Chunk:
    part: _Part
    opened: _Open | None


class Renderer:
    """Renders pictures of one geometry, driven in one way.

    ambient : whether there is ambient light.
    """

    def __init__(
        self,
        setting: OpticalSetting,
        looks: CameraSamples,
        cells: CellGrid,
        sights: Sights,
        detail: Detail,
        *,
        ambient: bool,
    ) -> None:
        self._setting, self._looks, self._cells = setting, looks, cells
        self._sights, self._detail, self._ambient = sights, detail, ambient
        self._met = _meetings(sights, cells)
        self._kept: dict[int, _Chunk] = {}
        self._room = WEIGHT_CACHE_BYTES

    @property
    def met(self) -> _Meetings:
        """The pairs that pictures are made of."""
        return self._met

    def render(self, picture: PictureTerms) -> Floats:
        """Mean light of each quad, (rows, cols, 3)."""
        rows, cols = self._setting.frame
        image = np.empty((rows, cols, COLOUR_COUNT))
        direct, indirect = self._values(picture)
        both = direct + indirect
        for number, span in enumerate(self._looks.chunks()):
            chunk = self._chunk(number, span)
            part = chunk.part
            if self._detail.split:
                light = part.sum_light(part.direct, direct)
                light += part.sum_light(part.indirect, indirect)
            else:
                # Where only the cells' light differs, one gather brings both.
                light = part.sum_light(part.indirect, both)
            if chunk.opened is not None and picture.ambient is not None:
                opened, (open_s, ambient) = chunk.opened, picture.ambient
                there = np.append(ambient, np.zeros((1, COLOUR_COUNT)), axis=0)[opened.cell]
                seen = opened.share * open_s[opened.mask][:, None] * there
                light += np.add.reduceat(seen, opened.runs.quads, axis=0)
            image[span[0] : span[1]] = light.reshape(-1, cols, COLOUR_COUNT)
        return image

    def _values(self, picture: PictureTerms) -> tuple[Floats, Floats]:
        """Direct and indirect light of each sight's corners, (K, corners, 3) each."""
        lit = np.append(picture.direct, 0.0)[self._met.of_sight]
        corners = self._cells.corners[np.maximum(self._sights.place, 0)]
        direct = lit[:, None, None] * picture.reflected[corners]
        none = np.zeros((1, COLOUR_COUNT))
        return direct, np.append(picture.indirect, none, axis=0)[self._met.of_corner]

    def _chunk(self, number: int, span: tuple[int, int]) -> _Chunk:
        """The weights of some rows of quads."""
        if number in self._kept:
            return self._kept[number]
        count = (span[1] - span[0]) * self._setting.frame[1] * self._setting.samples**2
        x = y = np.zeros(0)
        if self._detail.textures is not None or self._ambient:
            x, y = (self._by_quad(v).ravel() for v in self._looks.on_field(span))
        sights = [self._by_quad(runs.spread(count)) for runs in self._sights.runs[number]]
        parts = [
            self._part(span, which, sight, tap, x, y)
            for which, (tap, sight) in enumerate(zip(self._setting.taps, sights, strict=True))
        ]
        part = _Part.merge(parts)
        chunk = _Chunk(part, self._open(sights[0], x, y) if self._ambient else None)
        if part.nbytes <= self._room:
            self._room -= part.nbytes
            self._kept[number] = chunk
        return chunk

    def _part(
        self,
        span: tuple[int, int],
        which: int,
        sight: NDArray[np.int32],
        tap: Tap,
        x: Floats,
        y: Floats,
    ) -> _Part:
        """The weights of a tap's sights (quads, samples); samples lie at x, y of the field."""
        runs = _Runs.of(sight)
        share = tap.share / self._setting.samples**2
        textures, uneven = self._detail.textures, self._detail.uneven
        points = np.array([x + tap.offset[0], y + tap.offset[1]]).T
        plain = np.ones((sight.size, 1))
        corners = plain if textures is None else self._cells.shares(*points.T)

        def weights(texture: Floats | None, light: Floats | None) -> Floats:
            left = corners * share if light is None else corners * (light * share)[:, None]
            return runs.sums(left, plain if texture is None else sample_texture(texture, points))

        indirect = weights(textures and textures[1], None)
        direct = indirect
        if self._detail.split:
            lit = None
            if uneven is not None:
                place = (self._by_quad(v).ravel() for v in self._looks.on_projector(span, which))
                lit = sample_pixels(uneven, *place, missing=0.0)
            direct = weights(textures and textures[0], lit)
        quad = (runs.first // self._setting.samples**2).astype(np.int32)
        return _Part(quad, sight.ravel()[runs.first], direct, indirect)

    def _open(self, sight: NDArray[np.int32], x: Floats, y: Floats) -> _Open:
        plain = CellGrid(self._cells.grid, smooth=False)
        cell, mask = plain.at(x, y), self._sights.mask[sight.ravel()]
        runs = _Runs.of((mask * (plain.places + 1) + cell).reshape(sight.shape))
        share = np.full((sight.size, 1), 1.0 / self._setting.samples)
        open_share = runs.sums(share, share)[:, 0]
        return _Open(runs, mask[runs.first], cell[runs.first], open_share)

    def _by_quad(self, samples: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """Samples of rows of quads, row by row (n,), sorted by quad, (quads, samples)."""
        cols, per_quad = self._setting.frame[1], self._setting.samples
        rows = samples.reshape(-1, per_quad, cols, per_quad)
        return rows.transpose(0, 2, 1, 3).reshape(-1, per_quad**2)
