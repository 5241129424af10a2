"""What each sample of the camera sees: a mask site, and a projector site and a cell behind it.

Samples lie evenly in every quad. Neighbours mostly see the same, so they are kept as runs of equal
sights. Sights are found once for each way of driving the panels, and serve all photos.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import gcd
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.probing.borders import GOLDEN, PLASTIC
from pdcd.virtual.optics.raster import MapRaster
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sites import PanelSites

_Numbers = NDArray[np.int64]

_Kind = TypeVar("_Kind", np.int32, np.float64)

_ASIDE = 1e-9
"""Quads by which samples are moved. Samples that would lie on the border of two cells then fall to
the same side of it on both panels, whatever is rounded. No detail of a scene is as fine."""
CHUNK_SAMPLES = 1 << 16
"""Samples that are looked at together: few enough that their numbers stay in the processor's cache.
"""
_KEPT_BYTES = 1 << 27
"""Memory for the numbers of pixels, which are kept from photo to photo as nothing moves."""
_SCATTER = PLASTIC**2, PLASTIC
"""Steps that fill a plane evenly: powers, below 1, of the root of x^3 = x + 1."""
NO_SITE = -1
"""No site, or no cell: beside the panel, or beside the field."""


@dataclass(frozen=True)
class CellGrid:
    """The scene's cells at points of the field.

    smooth : whether values are interpolated between the centres of cells, so that a *place* is the
        four cells around a point; else a cell has one value all over, and a place is one cell.
    """

    grid: tuple[int, int]
    smooth: bool

    @property
    def places(self) -> int:
        """How many places there are."""
        rows, cols = self.grid
        return (rows + 1) * (cols + 1) if self.smooth else rows * cols

    @cached_property
    def corners(self) -> _Numbers:
        """Cells of each place, (places, 4) or (places, 1)."""
        rows, cols = self.grid
        if not self.smooth:
            return np.arange(rows * cols)[:, None]
        row, col = np.divmod(np.arange(self.places), cols + 1)
        down = [np.clip(row + i, 0, rows - 1) for i in (-1, 0)]
        across = [np.clip(col + i, 0, cols - 1) for i in (-1, 0)]
        return np.stack([r * cols + c for r in down for c in across], axis=1)

    def at(self, x: Floats, y: Floats) -> NDArray[np.int32]:
        """The place of points of the field; `NO_SITE` beside it, and for NaN."""
        rows, cols = self.grid
        with np.errstate(invalid="ignore"):
            inside = (x >= 0.0) & (x < 1.0) & (y >= 0.0) & (y < 1.0)
        whole = bool(inside.all())
        if not whole:
            x, y = (np.where(inside, v, 0.0) for v in (x, y))
        more = 0.5 if self.smooth else 0.0
        across = cols + 1 if self.smooth else cols
        found = (y * rows + more).astype(np.int32)
        found *= across
        found += (x * cols + more).astype(np.int32)
        if not whole:
            found[~inside] = NO_SITE
        return found

    def passes(self, seen: Floats) -> NDArray[np.bool_]:
        """Which points of the field (n, 2) a mask of these cells lets the camera see."""
        return np.ones(len(seen), dtype=np.bool_)

    def before(
        self, passed: NDArray[np.bool_], lit: tuple[Floats, Floats], lit_px: tuple[Floats, Floats]
    ) -> NDArray[np.int32]:
        """The cell of points, whose light is seen at points that `passed` (n,) says of. It is used
        in place of a site of the mask. lit, lit_px : x and y of the points, (n,) each, on the field
        and in pixels of the projector."""
        return np.maximum(self.at(*lit), 0)

    def shares(self, x: Floats, y: Floats) -> Floats:
        """How much each corner of the place of points (n,) counts there, (n, 4)."""
        rows, cols = self.grid
        down, across = (_fraction(v) for v in (y * rows + 0.5, x * cols + 0.5))
        up, left = 1.0 - down, 1.0 - across
        found = np.empty((x.size, 4))
        for corner, (one, other) in enumerate(
            ((up, left), (up, across), (down, left), (down, across))
        ):
            np.multiply(one, other, out=found[:, corner])
        return found


def _fraction(values: Floats) -> Floats:
    """The fractional parts of numbers, computed in place; 0 for NaN."""
    with np.errstate(invalid="ignore"):
        values -= np.floor(values)
    values[np.isnan(values)] = 0.0
    return values


@dataclass(frozen=True)
class SampleRuns:
    """Samples of one chunk, row by row: runs of equal sights. starts, sights : (runs,) int32"""

    starts: NDArray[np.int32]
    sights: NDArray[np.int32]

    def spread(self, count: int) -> NDArray[np.int32]:
        """The sight of each of the chunk's samples, (count,)."""
        return np.repeat(self.sights, np.diff(np.append(self.starts, count)))


@dataclass
class Sights:
    """All sights of a frame, (K,) int64 each, and which samples have which sight.

    mask : site of the mask.
    lit : site of the projector, or `NO_SITE`.
    place : place of `CellGrid`, or `NO_SITE`.
    runs : for each chunk of rows of quads, the runs of each tap.
    """

    mask: _Numbers
    lit: _Numbers
    place: _Numbers
    runs: list[list[SampleRuns]] = field(repr=False)


@dataclass(frozen=True, eq=False)
class LightOrigins:
    """Where on the field the light at points comes from, on an off-axis bench.

    grid : (rows, cols). displacement : (N, 2) cells down and right; NaN where there is no light.
    """

    grid: tuple[int, int]
    displacement: Floats

    def of(self, points: Floats) -> Floats:
        """The places that light points of the field (n, 2); NaN for points that are not lit."""
        rows, cols = self.grid
        cell = CellGrid(self.grid, smooth=False).at(points[:, 0], points[:, 1])
        moved = self.displacement[np.maximum(cell, 0)][:, ::-1] / np.array([cols, rows])
        return np.where((cell >= 0)[:, None], points + moved, np.nan)


class CameraSamples:
    """The camera's samples on the field and on both panels, chunk by chunk. With `away`, their
    places on the projector are where the light comes from."""

    def __init__(self, setting: OpticalSetting, away: LightOrigins | None = None) -> None:
        self._setting, self._away = setting, away
        rows, cols = setting.frame
        per_quad = setting.samples
        x = (np.arange(cols * per_quad) + 0.5) / per_quad + _ASIDE
        y = (np.arange(rows * per_quad) + 0.5) / per_quad + _ASIDE
        to_field, size = setting.camera.to_field, setting.projector_px
        # In projector pixels: the unit of the raster's largest error.
        self._field = MapRaster(lambda points: to_field(points) * size, x, y)
        self._mask = MapRaster(lambda points: setting.on_mask(to_field(points)), x, y)
        self._lit = [MapRaster(partial(_behind, setting, tap.offset), x, y) for tap in setting.taps]
        self._step = max(1, CHUNK_SAMPLES // (cols * per_quad**2))
        self._kept: dict[tuple[tuple[int, int], int | None], NDArray[np.int32]] = {}
        self._room_bytes = _KEPT_BYTES

    def chunks(self) -> Iterator[tuple[int, int]]:
        """First and past-the-last row of quads of each chunk."""
        rows = self._setting.frame[0]
        for start in range(0, rows, self._step):
            yield start, min(start + self._step, rows)

    def on_field(self, chunk: tuple[int, int]) -> tuple[Floats, Floats]:
        """x and y of a chunk's samples on the field, (n,) each."""
        across, down = self._flat(self._field, chunk)
        width, height = self._setting.projector_px
        return across / width, down / height

    def on_mask(self, chunk: tuple[int, int]) -> tuple[Floats, Floats]:
        """The same on the mask, in its pixels."""
        return self._flat(self._mask, chunk)

    def on_projector(self, chunk: tuple[int, int], tap: int) -> tuple[Floats, Floats]:
        """The same on the projector, for the point that a tap samples."""
        if self._away is None:
            return self._flat(self._lit[tap], chunk)
        # Displacements jump from cell to cell, so an interpolated raster would be wrong.
        points = np.stack(self.on_field(chunk), axis=-1) + self._setting.taps[tap].offset
        across, down = self._setting.on_projector(self._away.of(points)).T
        return across, down

    def mask_pixels(self, chunk: tuple[int, int]) -> NDArray[np.int32]:
        """Number of the mask's pixel that each of a chunk's samples lies in, (n,); `NO_SITE` beside
        the mask. The numbers are kept from photo to photo: do not change them."""
        width, height = self._setting.true.mask.size_px
        return self._keep(
            (chunk, None), lambda: _number_pixels((height, width), *self.on_mask(chunk))
        )

    def lit_pixels(self, chunk: tuple[int, int], tap: int) -> NDArray[np.int32]:
        """The same for the projector's pixels that a tap samples."""
        width, height = self._setting.true.projector.size_px
        return self._keep(
            (chunk, tap), lambda: _number_pixels((height, width), *self.on_projector(chunk, tap))
        )

    def _keep(
        self, key: tuple[tuple[int, int], int | None], find: Callable[[], NDArray[np.int32]]
    ) -> NDArray[np.int32]:
        """What is kept under a key; else it is found now, and kept while there is room."""
        kept = self._kept.get(key)
        if kept is None:
            kept = find()
            if self._room_bytes >= kept.nbytes:
                self._room_bytes -= kept.nbytes
                self._kept[key] = kept
        return kept

    def _flat(self, raster: MapRaster, chunk: tuple[int, int]) -> tuple[Floats, Floats]:
        first, end = (row * self._setting.samples for row in chunk)
        across, down = raster.rows(first, end)
        return across.ravel(), down.ravel()


class ScatteredSamples(CameraSamples):
    """The same samples, each moved by up to half a step, spread as evenly as possible.

    Samples on a raster may fall into step with the panels' pixels: if the camera looks straight on,
    they see, say, every fourth pixel twice, all over the picture. Stripes of single pixels then
    look bent, although a real camera, whose quads are areas, sees them straight.
    """

    def __init__(self, setting: OpticalSetting, away: LightOrigins | None = None) -> None:
        super().__init__(setting, away)
        self._last: tuple[tuple[int, int], tuple[Floats, Floats]] | None = None

    def _flat(self, raster: MapRaster, chunk: tuple[int, int]) -> tuple[Floats, Floats]:
        per_quad = self._setting.samples
        if per_quad == 1:
            return super()._flat(raster, chunk)
        if self._last is None or self._last[0] != chunk:  # each chunk is asked for several rasters
            self._last = chunk, self._aside(chunk)
        across, down = raster.rows(chunk[0] * per_quad, chunk[1] * per_quad, self._last[1])
        return across.ravel(), down.ravel()

    def _aside(self, chunk: tuple[int, int]) -> tuple[Floats, Floats]:
        """How far a chunk's samples are moved to the right and down, in steps, -1/2 to 1/2."""
        per_quad, cols = self._setting.samples, self._setting.frame[1]
        row = np.arange(chunk[0] * per_quad, chunk[1] * per_quad, dtype=np.float64)[:, None]
        column = np.arange(cols * per_quad, dtype=np.float64)
        one, other = _SCATTER
        right, down = row * one + column * other, row * other + column * one
        return _fraction(right) - 0.5, _fraction(down) - 0.5


class SlantedSamples(ScatteredSamples):
    """The same samples, each row of a quad moved to the right by part of a step, and each column
    down. Along either axis no two samples of a quad lie at the same place and all together lie
    evenly, so that a narrow strip is seen along its whole length."""

    def _aside(self, chunk: tuple[int, int]) -> tuple[Floats, Floats]:
        per_quad, cols = self._setting.samples, self._setting.frame[1]
        # Neighbouring rows are moved by parts that differ as much as possible.
        turn = next(n for n in range(round(GOLDEN * per_quad), 0, -1) if gcd(n, per_quad) == 1)
        steps = (np.arange(per_quad) * turn % per_quad + 0.5) / per_quad - 0.5
        shape = (chunk[1] - chunk[0]) * per_quad, cols * per_quad
        right = np.tile(steps, chunk[1] - chunk[0])[:, None]
        return np.broadcast_to(right, shape), np.broadcast_to(np.tile(steps, cols), shape)


def _behind(setting: OpticalSetting, offset: tuple[float, float], points: Floats) -> Floats:
    """Where the camera's points (..., 2), moved by `offset` on the field, lie on the projector."""
    return setting.on_projector(setting.camera.to_field(points) + offset)


def find_sights(
    looks: CameraSamples,
    setting: OpticalSetting,
    cells: CellGrid,
    lit: PanelSites,
    mask: PanelSites | CellGrid | None,
) -> Sights:
    """All sights of a frame, through the mask; without a mask for None. With a grid in its place,
    the mask's site is the cell that a sample lies in, as for a perfect mask of whole cells."""
    keys: list[list[tuple[NDArray[np.int32], _Numbers, NDArray[np.intp]]]] = []
    places, sites = cells.places + 1, len(lit) + 1
    for chunk in looks.chunks():
        x, y = looks.on_field(chunk)
        before = np.zeros(x.size, dtype=np.int32)
        if isinstance(mask, PanelSites):
            before = sample_pixels(mask.image, *looks.on_mask(chunk), missing=0)
        elif mask is not None:
            passed = mask.passes(np.stack((x, y), axis=-1))
        of_taps = []
        for number, tap in enumerate(setting.taps):
            lit_px = looks.on_projector(chunk, number)
            behind = sample_pixels(lit.image, *lit_px, missing=NO_SITE)
            there = x + tap.offset[0], y + tap.offset[1]
            at = cells.at(*there)
            if isinstance(mask, CellGrid):
                before = mask.before(passed, there, lit_px)
            starts = find_changes(before, behind, at)
            key = before[starts] * np.int64(sites) + behind[starts] + 1
            key = key * places + at[starts] + 1
            of_taps.append((starts, *np.unique(key, return_inverse=True)))
        keys.append(of_taps)
    found: _Numbers = np.unique(np.concatenate([own for taps in keys for _, own, _ in taps]))
    runs = [
        [
            SampleRuns(starts, np.searchsorted(found, own).astype(np.int32)[inverse])
            for starts, own, inverse in taps
        ]
        for taps in keys
    ]
    rest, place = np.divmod(found, np.int64(places))
    before, behind = np.divmod(rest, np.int64(sites))
    return Sights(before.astype(np.int64), behind.astype(np.int64) - 1, place - 1, runs)


def find_changes(first: NDArray[np.int32], *others: NDArray[np.int32]) -> NDArray[np.int32]:
    """Where any of the arrays (n,) differs from its entry before; index 0 always counts."""
    new = np.ones(first.size, dtype=np.bool_)
    np.not_equal(first[1:], first[:-1], out=new[1:])
    for other in others:
        new[1:] |= other[1:] != other[:-1]
    return np.flatnonzero(new).astype(np.int32)


def sample_pixels(image: NDArray[_Kind], x: Floats, y: Floats, *, missing: float) -> NDArray[_Kind]:
    """Values of the pixels that points (n,) lie in; `missing` beside the device, and for NaN."""
    return pick_pixel_values(image, _number_pixels(image.shape, x, y), missing=missing)


def _number_pixels(shape: tuple[int, ...], x: Floats, y: Floats) -> NDArray[np.int32]:
    """Numbers of the pixels, row by row, that points (n,) lie in; `NO_SITE` beside them, and for
    NaN."""
    height, width = shape
    with np.errstate(invalid="ignore"):
        inside = (x >= 0.0) & (x < width) & (y >= 0.0) & (y < height)
    whole = bool(inside.all())
    if not whole:
        x, y = (np.where(inside, v, 0.0) for v in (x, y))
    place = y.astype(np.int32)
    place *= width
    place += x.astype(np.int32)
    if not whole:
        place[~inside] = NO_SITE
    return place


def pick_pixel_values(
    image: NDArray[_Kind], place: NDArray[np.int32], *, missing: float
) -> NDArray[_Kind]:
    """Values of pixels by their numbers, `missing` where there is none."""
    found = np.asarray(image.take(place, mode="clip"))  # the quickest mode
    nowhere = place < 0
    if nowhere.any():
        found[nowhere] = missing
    return found
