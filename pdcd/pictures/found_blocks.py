"""Where a panel's blocks are seen in a photo: from the photo's pixels to those of the pattern.

A photo, divided by one of all light, is sampled where the camera is believed to see the field, on a
raster of whole projector pixels. Each window of the raster looks for the pattern, first close to
where it is believed to be. Where that does not fit, the whole pattern is searched for anywhere,
also mirrored, turned, smaller and larger. The result is an affine map, and what each window
deviates from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import gcd

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.panels.blocks import BlockPattern
from pdcd.panels.map import Map
from pdcd.pictures.agreeing import (
    FEWEST,
    WINDOW_OVERLAP,
    find_coherent_windows,
    fit_bend,
    fit_most_windows,
)
from pdcd.pictures.raster import HERE, AffineMap, FieldRaster, Flattener

_REACHES_PX = (50.0, 16.0, 6.0, 4.0)
"""How far windows look for the pattern, round by round, in projector pixels."""
WINDOW_BLOCKS = 10
"""Side of a window in blocks."""
_WINDOWS = (9, 12)
"""Windows down and across the raster."""
_LEVEL = 4.0
"""Standard deviation, in blocks, of the local mean that is subtracted: spread light and shade."""
_SEEN = 0.75
"""Share of a window's points that must be known."""
_ALIKE = 0.35
"""Correlation from which a window has found its place."""
_BEND_PX = 16.0
"""How far beside the map windows look for a bent pattern, in projector pixels."""
_NEARLY_ALL = 0.95
"""Share of all windows from which those that agree suffice."""
_AGREE = 0.4
"""Share of the windows that find anything which must agree."""
_SCALES = tuple(1.07**step for step in range(-8, 5))
_TURNS_DEG = (-6.0, -3.0, 0.0, 3.0, 6.0)
_COARSE = 96
"""Points of the raster in the search for a pattern that lies anywhere, along the longer side."""
_SURE = 9.0
"""Its highest correlation over the standard deviation of all, from which it counts as found."""

_PATCH = 3
"""Side, in blocks, of the patches from which the error of a place is estimated: what a scene does
to the pattern in one of them is nearly independent of the next."""

_FINER = 3
"""Samples of the panel's pixels in a step of the pattern, along either axis."""
_NODES = 49
"""Nodes along either axis between which a distorted map is interpolated by splines."""

FLIPS: dict[str, tuple[float, float]] = {
    "none": (1.0, 1.0),
    "horizontal": (-1.0, 1.0),
    "vertical": (1.0, -1.0),
    "both": (-1.0, -1.0),
}


@dataclass(frozen=True, eq=False)
class FoundPattern:
    """A pattern that was found.

    map : where most of it is. centres : (n, 2), of the windows that agree with the map, or with
    those beside them. left : (n, 2), residual of the map at each of them. contrast : (n,), of the
    pattern in each of them: 1 where all the light of the photo varies with it. number : (n,), which
    windows of the raster they are.
    """

    map: AffineMap
    centres: Floats
    left: Floats
    contrast: Floats
    number: NDArray[np.int64]

    @property
    def places(self) -> Floats:
        """Where on the pattern the centres of the windows are, (n, 2)."""
        return np.asarray(self.map(self.centres) + self.left)

    def follow(self, points: Floats) -> Floats:
        """Where on the pattern points of the raster (..., 2) are, bends of the picture included."""
        return np.asarray(self.map(points) + fit_bend(self.centres, self.left)(points))


class PatternFinder:
    """Looks on a raster for the blocks that a panel draws, given the map of the panel."""

    def __init__(self, blocks: BlockPattern, raster: FieldRaster, panel: Map) -> None:
        self._blocks, self.raster, self._panel = blocks, raster, panel
        width, height = raster.size_px
        self._block_px = float(np.sqrt(width * height / (blocks.cols * blocks.rows)))
        self._level_px = _LEVEL * self._block_px
        self._step = min(raster.pitch / 2.0, self._block_px / 6.0)
        self._steps = [
            _beside(round(raster.size_px[axis] / self._step), panel.size_px[axis])
            for axis in (0, 1)
        ]

    @cached_property
    def _image(self) -> Floats:
        """The pattern at steps of `_step` as the panel's pixels show it, as sharp as the raster: -1
        and 1, and 0 beside the panel."""
        x, y = (
            (np.arange(_FINER * self._steps[axis]) + 0.5) / (_FINER * self._steps[axis])
            for axis in (0, 1)
        )
        picture = 2.0 * self._blocks.drawn(self._panel) - 1.0
        pixel = np.floor(_pixels(self._panel, x, y)).astype(np.int64)
        on = np.all((pixel >= 0) & (pixel < self._panel.size_px), axis=-1)
        pixel = np.where(on[..., None], pixel, 0)
        fine = np.where(on, picture[pixel[..., 1], pixel[..., 0]], 0.0)
        image = _blocks_of(fine, _FINER)
        blurred: Floats = scipy.ndimage.gaussian_filter(
            image, 0.5 * self.raster.pitch / self._step, mode="constant"
        )
        return blurred

    def shown(self, places: Floats) -> Floats:
        """The pattern at places in projector pixels (..., 2)."""
        image = self._image
        width, height = self.raster.size_px
        rows, cols = image.shape
        at = places * (cols / width, rows / height) - 0.5
        found: Floats = scipy.ndimage.map_coordinates(
            image, np.moveaxis(at[..., ::-1], -1, 0), order=1, mode="constant"
        )
        return found

    def find(self, seen: Floats, known: Bools, believed: AffineMap = HERE) -> FoundPattern | None:
        """Where the pattern is in a picture on the raster; None where it is not found."""
        flat = _flat(seen, self.make_flattener(known))
        found = self._refined(flat, seen, known, believed)
        if found is None:
            for start in self._anywhere(flat, known):
                found = self._refined(flat, seen, known, start, _REACHES_PX[0] * 0.7)
                if found is not None:
                    break
        return found

    def _refined(
        self, flat: Floats, seen: Floats, known: Bools, start: AffineMap, reach_px: float = 0.0
    ) -> FoundPattern | None:
        """Windows search in ever smaller ranges around their last place; None if they disagree."""
        now, found = start, None
        for reach in (reach_px or _REACHES_PX[0], *_REACHES_PX[1:]):
            windows = list(self._windows(flat, known, now, reach))
            if len(windows) < FEWEST:
                return None
            number, centre, off, alike = (np.array(part) for part in zip(*windows, strict=True))
            good = alike > _ALIKE
            better, agree = fit_most_windows(centre[good], now(centre[good]) + off[good], reach)
            if better is None or agree.sum() < max(FEWEST, _AGREE * good.sum()):
                return None
            kept = np.flatnonzero(good)[agree]
            left = now(centre[kept]) + off[kept] - better(centre[kept])
            contrast = self._contrast(seen, known, better, number[kept], left)
            found = FoundPattern(better, centre[kept], left, contrast, number[kept])
            now = better
        return found if found is None else self._with_bends(flat, seen, known, found)

    def _with_bends(
        self, flat: Floats, seen: Floats, known: Bools, found: FoundPattern
    ) -> FoundPattern:
        """The same with windows that lie beside the map together with those beside them, as where a
        lens bends the pattern. Nothing is looked for where nearly all windows agree."""
        if len(found.number) > _NEARLY_ALL * len(self._corners[0]):
            return found
        now = found.map
        windows = [one for one in self._windows(flat, known, now, _BEND_PX) if one[3] > _ALIKE]
        if not windows:
            return found
        number, centre, off, _ = (np.array(part) for part in zip(*windows, strict=True))
        kept = find_coherent_windows(centre, off, self._spacing_px)
        if kept.sum() <= len(found.number):
            return found
        contrast = self._contrast(seen, known, now, number[kept], off[kept])
        return FoundPattern(now, centre[kept], off[kept], contrast, number[kept])

    @cached_property
    def _corners(self) -> tuple[NDArray[np.int64], int]:
        """Upper left corners of the windows, (n, 2) rows and columns, and their side, in points."""
        rows, cols = self.raster.shape
        side = min(round(WINDOW_BLOCKS * self._block_px / self.raster.pitch), min(rows, cols) // 3)
        down, across = (
            np.linspace(0, length - side, count).round().astype(np.int64)
            for length, count in zip((rows, cols), _WINDOWS, strict=True)
        )
        return np.stack(np.meshgrid(down, across, indexing="ij"), axis=-1).reshape(-1, 2), side

    @property
    def _spacing_px(self) -> float:
        """From a window to the next, in projector pixels: the longer way."""
        _, side = self._corners
        steps = np.array(_WINDOWS) - 1
        return float(np.max((np.array(self.raster.shape) - side) / steps)) * self.raster.pitch

    def _cut(self, number: int) -> tuple[slice, slice]:
        corners, side = self._corners
        down, across = corners[number]
        return slice(down, down + side), slice(across, across + side)

    def _windows(
        self, flat: Floats, known: Bools, now: AffineMap, reach_px: float
    ) -> Iterator[tuple[int, Floats, Floats, float]]:
        """Number and centre of each window that shows something, the offset of the pattern from
        where `now` has it, in projector pixels of the pattern, and the correlation there."""
        raster = self.raster
        corners, side = self._corners
        reach = int(np.ceil(reach_px / raster.pitch))
        for number, (down, across) in enumerate(corners.tolist()):
            cut = self._cut(number)
            if known[cut].mean() < _SEEN or not flat[cut].any():
                continue
            span = np.arange(-reach, side + reach) + 0.5
            at = np.stack(np.meshgrid(across + span, down + span), axis=-1)
            pattern = self.shown(now(at * raster.pitch + raster.begin))
            off, alike = _best(flat[cut], known[cut], pattern, reach)
            centre = (np.array([across, down]) + 0.5 * side) * raster.pitch + raster.begin
            yield number, centre, now.linear @ (off * raster.pitch), alike

    def _contrast(
        self,
        seen: Floats,
        known: Bools,
        now: AffineMap,
        numbers: NDArray[np.int64],
        left: Floats,
    ) -> Floats:
        """Contrast of the pattern in windows of a picture that was not flattened, (n,)."""
        points, found = self.raster.points(), []
        for number, beside in zip(numbers.tolist(), left, strict=True):
            cut = self._cut(number)
            good = known[cut]
            pattern = self.shown(now(points[cut]) + beside)[good]
            light = seen[cut][good]
            base = np.stack([np.ones(light.size), pattern], axis=1)
            level, depth = np.linalg.lstsq(base, light, rcond=None)[0]
            found.append(depth / level if level > 0.0 else 0.0)
        return np.array(found)

    def variance(self, seen: Floats, known: Bools, found: FoundPattern, places: Floats) -> Floats:
        """Variance of where the pattern was found, (n,) square pixels, right and down together, at
        `places` of the field (n, 2). It is estimated from how much each patch of the picture would
        change the map."""
        raster, points = self.raster, self.raster.points()
        inside = known & np.all((points >= 0.0) & (points < raster.size_px), axis=-1)
        flattener, at = self.make_flattener(known), found.follow(points)

        def flat(right: float, down: float) -> Floats:
            pattern = self.shown(at + np.array([right, down]))
            return np.asarray(_flat(pattern, flattener)[inside])

        half = 0.5 * raster.pitch
        light, pattern = _flat(seen, flattener)[inside], flat(0.0, 0.0)
        depth = float(light @ pattern / max(float(pattern @ pattern), 1e-12))
        slopes = [
            depth * (flat(*(half * step)) - flat(*(-half * step))) / (2.0 * half)
            for step in np.eye(2)
        ]
        base, wanted = (_affine_base(each, raster.size_px) for each in (points[inside], places))
        design = np.concatenate([slope[:, None] * base for slope in slopes], axis=1)
        patch = self.number_patches(points[inside])
        count = int(patch.max(initial=0)) + 1
        spread = compute_patch_covariance(design, light - depth * pattern, patch)
        spread = spread * count / max(count - 6, 1)
        across, along = spread[:3, :3], spread[3:, 3:]
        return np.asarray(np.einsum("ni,ij,nj->n", wanted, across + along, wanted))

    def number_patches(self, points: Floats) -> NDArray[np.int64]:
        """Which patch each of the points (n, 2) lies in, (n,)."""
        block = np.floor(points / (_PATCH * self._block_px)).astype(np.int64)
        return np.asarray(np.unique(block @ (1, 4096), return_inverse=True)[1].ravel())

    def make_flattener(self, known: Bools) -> Flattener:
        """A flattener of pictures on the raster that are known there."""
        return Flattener(known, self._level_px / self.raster.pitch)

    def left_at(
        self, seen: Floats, known: Bools, found: FoundPattern, there: AffineMap
    ) -> tuple[float, float]:
        """Contrast of the pattern at another place, fitted together with that at the place where it
        was found: the mean over windows, and its standard deviation.

        The pattern of a panel that lies elsewhere leaves nothing where it was believed to be. That
        of a panel in place, which a mirror shows once more, does.
        """
        points, parts = self.raster.points(), []
        for number in range(len(self._corners[0])):
            cut = self._cut(number)
            good = known[cut]
            if good.mean() < _SEEN:
                continue
            at = points[cut][good]
            light = seen[cut][good]
            base = np.stack([np.ones(len(at)), self.shown(found.map(at)), self.shown(there(at))], 1)
            level, _, part = np.linalg.lstsq(base, light, rcond=None)[0]
            if level > 0.0:
                parts.append(part / level)
        if len(parts) < FEWEST:
            return 0.0, np.inf
        return float(np.mean(parts)), float(np.std(parts) / np.sqrt(len(parts) / WINDOW_OVERLAP))

    def _coarse(self, pitch: float) -> _Coarse:
        blurred = scipy.ndimage.gaussian_filter(
            self._image, 0.4 * pitch / self._step, mode="constant"
        )
        every = max(1, int(0.3 * pitch / self._step))
        step = self.raster.size_px[0] / self._steps[0]
        return _Coarse(blurred[::every, ::every], every * step, 0.5 * step)

    def _anywhere(self, flat: Floats, known: Bools) -> list[AffineMap]:
        """Where the whole pattern may be, the likeliest first."""
        raster = self.raster
        step = max(1, max(raster.shape) // _COARSE)
        rows, cols = (length // step for length in raster.shape)
        coarse = _blocks_of(np.where(known, flat, 0.0), step)
        points = _blocks_of(raster.points(), step)
        size = scipy.fft.next_fast_len(2 * max(rows, cols), real=True)
        spectrum = scipy.fft.rfft2(coarse, (size, size))
        middle = 0.5 * np.array(raster.size_px)
        found: list[tuple[float, AffineMap]] = []
        smooth = self._coarse(step * raster.pitch)
        for flip in FLIPS.values():
            for turn in np.radians(_TURNS_DEG):
                turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
                for scale in _SCALES:
                    linear = np.diag(flip) @ turned / scale
                    start = AffineMap(linear, middle - linear @ middle)
                    pattern = smooth.shown(start(points))
                    product = spectrum * np.conj(scipy.fft.rfft2(pattern, (size, size)))
                    fit = scipy.fft.irfft2(product, (size, size))
                    at = np.unravel_index(int(fit.argmax()), fit.shape)
                    sure = float(fit[at] / fit.std())
                    down, across = (k - size if k > size // 2 else k for k in map(int, at))
                    moved = np.array([across, down], dtype=np.float64) * step * raster.pitch
                    found.append((sure, AffineMap(linear, start.shift - linear @ moved)))
        found.sort(key=lambda one: -one[0])
        return [start for sure, start in found[:3] if sure > _SURE]


@dataclass(frozen=True, eq=False)
class _Coarse:
    """A pattern at the steps of a coarse raster: `step` projector pixels from value to value, the
    first at `begin`."""

    image: Floats
    step: float
    begin: float

    def shown(self, places: Floats) -> Floats:
        """The pattern at places in projector pixels (..., 2)."""
        at = (np.moveaxis(places[..., ::-1], -1, 0) - self.begin) / self.step
        found: Floats = scipy.ndimage.map_coordinates(self.image, at, order=1, mode="constant")
        return found


def _affine_base(at: Floats, size_px: tuple[int, int]) -> Floats:
    """Base functions of an affine map at places (n, 2): (n, 3)."""
    return np.concatenate([np.ones((len(at), 1)), at / size_px - 0.5], axis=1)


def _beside(count: int, pixels: int) -> int:
    """`count` steps or a few more, so that they do not coincide with the pixels: else all edges
    would be found shifted to the same side."""
    while gcd(_FINER * count, pixels) > _FINER:
        count += 1
    return count


def _pixels(panel: Map, x: Floats, y: Floats) -> Floats:
    """Places in pixels of a panel at the field's points (x, y), (y, x, 2). A distorted map is
    smooth, and is interpolated by splines."""
    if not (panel.residual or any(panel.radial) or any(panel.tangential)):
        return panel.from_field(np.stack(np.meshgrid(x, y), axis=-1))
    nodes = [np.linspace(0.0, 1.0, _NODES)] * 2
    at = panel.from_field(np.stack(np.meshgrid(*nodes), axis=-1))
    at = np.where(np.isfinite(at), at, -1e6)
    return np.stack(
        [scipy.interpolate.RectBivariateSpline(*nodes, at[..., axis])(y, x) for axis in (0, 1)],
        axis=-1,
    )


def _blocks_of(values: Floats, side: int) -> Floats:
    """Means over squares of points."""
    rows, cols = values.shape[0] // side, values.shape[1] // side
    cut = values[: rows * side, : cols * side]
    return np.asarray(cut.reshape(rows, side, cols, side, *values.shape[2:]).mean(axis=(1, 3)))


def compute_patch_covariance(design: Floats, left: Floats, patch: NDArray[np.int64]) -> Floats:
    """Covariance (f, f) of the factors of a least squares fit, estimated from how much each patch
    of residuals would change them.

    design : (n, f). left : (n,), residuals of the fit. patch : (n,), which patch each point is in.
    """
    pull = np.zeros((patch.max(initial=0) + 1, design.shape[1]))
    np.add.at(pull, patch, design * left[:, None])
    back = np.linalg.pinv(design.T @ design)
    return np.asarray(back @ (pull.T @ pull) @ back)


def _flat(seen: Floats, flattener: Flattener) -> Floats:
    """A picture with the same level and contrast everywhere, 0 where nothing is known."""
    flat = flattener.flatten(seen)
    spread = np.sqrt(flattener.blur(flat**2) / flattener.weight)
    floor = 1e-3 * float(np.abs(np.where(flattener.known, seen, 0.0)).max(initial=0.0)) + 1e-12
    return np.asarray(np.clip(flat / np.maximum(spread, floor), -3.0, 3.0))


def _best(part: Floats, known: Bools, pattern: Floats, reach: int) -> tuple[Floats, float]:
    """Offset (right, down) of a window (s, s) within a piece of the pattern that has `reach` more
    points on each side; and the correlation there."""
    light = np.where(known, part - part[known].mean(), 0.0)
    size = scipy.fft.next_fast_len(pattern.shape[0], real=True)
    shape, steps = (size, size), 2 * reach + 1
    window = np.conj(scipy.fft.rfft2(light, shape))
    inside = np.conj(scipy.fft.rfft2(known.astype(np.float64), shape))

    def over(values: Floats, kernel: NDArray[np.complex128]) -> Floats:
        spectrum = scipy.fft.rfft2(values, shape)
        return np.asarray(scipy.fft.irfft2(spectrum * kernel, shape)[:steps, :steps])

    count = float(known.sum())
    inner, mean, square = over(pattern, window), over(pattern, inside), over(pattern**2, inside)
    power = np.maximum(square - mean**2 / count, 0.05 * count)
    fit = inner / np.sqrt(power * max(float((light**2).sum()), 1e-12))
    down, across = (int(k) for k in np.unravel_index(int(fit.argmax()), fit.shape))
    off = np.array([across + _top(fit[down], across), down + _top(fit[:, across], down)])
    return off - reach, float(fit[down, across])


def _top(line: Floats, at: int) -> float:
    """Where a parabola through three values has its top, relative to the middle one."""
    if not 0 < at < line.size - 1:
        return 0.0
    before, here, after = line[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    return float(0.5 * (before - after) / bend) if bend < 0.0 else 0.0
