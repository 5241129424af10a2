"""Codes of grey levels that are chosen together with the masks that they are seen through.

The mask is closed around each lit cell, and cells that are scattered close most of it. Here light
and masks are sought at once, so that they count far light evenly, and nothing from within the
radius. What comes out are short lines and rings, whose cells share what is closed around them: more
light passes, and it is counted more evenly. Only the light is kept, as the levels of the masks
follow from it (`pdcd.codes.greyed`).

Codes that light stretches of rows, stretches of columns and scattered cells.

Where there are enough codes, each stretch has one of its own. A mask of grey levels then counts
nearly all far light by stretches, exactly, as no other cell is lit with them. The scattered cells
make up for stretches that reach into the radius: these are few, and as there are stretches along
rows and along columns, cells at the end of one lie amid another.

The least value of a smooth function of very many numbers between 0 and 1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats, Singles
from pdcd.codes.alike import (
    CORRELATION_GAUSSIANS,
    STEEP,
    compute_light_falloff,
    make_gaussian_weights,
    sum_within_radius,
)
from pdcd.codes.greyed import LEVEL_STEPS

_MOST_WORK = 4.1e8
"""Cells squared times codes, of which all that goes with cells alone counts as 256: half a minute
on two cores."""
_STAGES = ((0.01, 400), (0.3, 300))
"""How much light from within the radius weighs, and in how many steps of descent. It is let in at
first, as codes get stuck where they start otherwise."""
JOINT_OWN_LIGHT = 0.5
"""Weight of light that each cell has for itself; among codes chosen by chance less is better."""
_BLOB_CELLS, _BLOB_SHARE = 2.0, 0.3
"""Before the descent each code lights this share of the cells, in blobs of about that size."""
_LEAST_LEVEL = 0.1
"""Light below this level is left out, as it closes the mask like any other."""
WOVEN_KEPT = 8
"""Sets of codes that are remembered."""
_known: dict[tuple[tuple[int, int], int, int, int], NDArray[np.uint16]] = {}


def can_make_joint_codes(count: int, cells: int) -> bool:
    """Whether so many codes of so many cells are chosen together."""
    return cells**2 * (count + 256) <= _MOST_WORK


def joint_codes_bytes(count: int, cells: int) -> int:
    """Bytes that `make_joint_codes` takes."""
    return 4 * (14 * cells**2 + 80 * count * cells)


def make_joint_codes(
    lattice: tuple[int, int], count: int, radius: int, seed: int, alive: Callable[[], None]
) -> Floats:
    """Levels of the projector, 0..1, (K, L), for light from beyond a radius of 1 or more.

    `alive` is called at every step of the descent. The last digits depend on how a machine adds in
    float32: codes of the same seed err alike on all machines, but are not the same.
    """
    key = (lattice, count, radius, seed)
    levels = _known.get(key)
    if levels is None:
        levels = _known[key] = _weave(lattice, count, radius, seed, alive)
        while len(_known) > WOVEN_KEPT:
            _known.pop(next(iter(_known)), None)
    return levels / LEVEL_STEPS


def _weave(
    lattice: tuple[int, int], count: int, radius: int, seed: int, alive: Callable[[], None]
) -> NDArray[np.uint16]:
    """The same in parts of a level."""
    measure = _Measure(lattice, radius)

    def errs(both: Singles, weight: float) -> tuple[float, Singles]:
        alive()
        return measure(both, weight)

    found = _start(lattice, count, np.random.Generator(np.random.PCG64(seed)))
    for weight, steps in _STAGES:
        found = follow_descent(partial(errs, weight=weight), found, steps)
    light = found[1]
    levels = np.rint(np.where(light < _LEAST_LEVEL, 0.0, light) * LEVEL_STEPS)
    return np.asarray(levels, dtype=np.uint16)


def _start(lattice: tuple[int, int], count: int, rng: np.random.Generator) -> Singles:
    """Masks and light, (2, K, L): blobs by chance, and masks half open elsewhere."""
    noise = rng.standard_normal((count, *lattice))
    smooth = np.stack([cv2.GaussianBlur(one, (0, 0), _BLOB_CELLS) for one in noise])
    smooth = smooth.reshape(count, -1)
    lit = smooth > np.quantile(smooth, 1.0 - _BLOB_SHARE, axis=1, keepdims=True)
    both = np.stack([np.where(lit, 0.02, 0.5), np.where(lit, 0.6, 0.02)])
    return np.asarray(both + rng.uniform(0.0, 0.1, both.shape), dtype=np.float32)


class _Measure:
    """How much light through masks m of codes l errs: its value and slope over both (2, K, L).

    The realised matrix over its mean weight far off, c, less the wanted one is ``d = l m / c - F``.
    Light that is alike over some cells, and falls off from each camera cell or does not, errs
    by ``d C d``. What a code lets in from within the radius is ``b``, over all codes and each
    camera cell, and ``(b / c)^2`` is added to it, times a weight.
    """

    def __init__(self, lattice: tuple[int, int], radius: int) -> None:
        rows, cols = lattice
        self.lattice, self.radius, self.cells = lattice, radius, rows * cols
        row, col = np.divmod(np.arange(self.cells), cols)
        down, right = (np.abs(np.subtract.outer(x, x)) for x in (row, col))
        far = np.maximum(down, right) > radius
        self.far, self.paths = _single(far), float(far.sum())
        falls = (np.ones(far.shape), *compute_light_falloff(np.hypot(down, right), radius))
        self.falls = [
            _single(fall * np.sqrt(share * self.cells / np.sum(fall**2)))
            for fall, share in zip(falls, (1.0, 1.0, STEEP), strict=True)
        ]
        self.alike = [
            (
                _single(share * make_gaussian_weights(rows, reach)),
                _single(make_gaussian_weights(cols, reach)),
            )
            for reach, share in CORRELATION_GAUSSIANS
        ]

    def __call__(self, both: Singles, weight: float) -> tuple[float, Singles]:
        mask, light = both
        realised = light.T @ mask  # projector cells x camera cells
        mean = _dot(realised, self.far) / self.paths
        wrong = realised * np.float32(1.0 / mean) - self.far
        slope = np.zeros_like(wrong)
        for fall in self.falls:
            slope += fall * self._spread(fall * wrong)
        near_light = sum_within_radius(light, self.lattice, self.radius)
        let_in = np.sum(mask * near_light, axis=0) / np.float32(mean)
        close = weight * _dot(let_in, let_in)
        value = _dot(slope, wrong) + close
        # What follows is half of each slope. The mean depends on the far entries, too.
        by_mean = (_dot(slope, realised) / mean + close) / (mean * self.paths)
        slope = slope * np.float32(1.0 / mean) - np.float32(by_mean) * self.far
        shut = np.float32(weight / mean) * let_in
        by_mask = light @ slope + near_light * shut
        by_light = mask @ slope.T + sum_within_radius(mask * shut, self.lattice, self.radius)
        return value / self.cells, np.stack([by_mask, by_light]) * np.float32(2.0 / self.cells)

    def _spread(self, light: Singles) -> Singles:
        """``C`` of light by projector cells and camera cells."""
        rows, cols = self.lattice
        spread = np.float32(JOINT_OWN_LIGHT) * light
        across = light.reshape(rows, cols * self.cells)
        for down, right in self.alike:
            both = right @ (down @ across).reshape(rows, cols, self.cells)
            spread += both.reshape(light.shape)
        return spread


def _single(values: Floats | NDArray[np.bool_]) -> Singles:
    return np.asarray(values, dtype=np.float32)


TIMES_LIT = 3
"""Each cell is lit along its row, along its column, and among scattered ones."""
_SHARE = 0.5
"""Share of the codes that light stretches. More leave too many scattered cells for the others, of
which then hardly any is seen; fewer make stretches long."""
_LEAST_STRETCHES = 2
"""Stretches in a row or column, at least. Whole rows and columns bring nothing."""
_MOST_SCATTERED = 6
"""Scattered cells in a code, at most: with more of them codes that light scattered cells alone err
less of smooth light."""


def count_stretches(lattice: tuple[int, int], count: int) -> int:
    """Stretches in each row and in each column, for so many codes; 0 where they bring nothing."""
    rows, cols = lattice
    parts = round(_SHARE * count / (rows + cols))
    left = count - parts * (rows + cols)
    return parts if parts >= _LEAST_STRETCHES and rows * cols <= _MOST_SCATTERED * left else 0


def make_stretched_codes(
    lattice: tuple[int, int], count: int, parts: int, rng: np.random.Generator
) -> Bools:
    """Codes (K, L) that light each cell three times; rows and columns are cut into so many
    stretches, all of the same length but for one cell. Codes come in any order."""
    cells = lattice[0] * lattice[1]
    numbers = np.arange(cells).reshape(lattice)
    codes = np.zeros((count, cells), dtype=np.bool_)
    order = rng.permutation(count)
    stretches = [
        stretch for line in (*numbers, *numbers.T) for stretch in np.array_split(line, parts)
    ]  # fmt: skip
    for code, stretch in zip(order, stretches, strict=False):
        codes[code, stretch] = True
    others = order[len(stretches) :]
    codes[others[np.arange(cells) % others.size], rng.permutation(cells)] = True
    return codes


Function = Callable[[Singles], tuple[float, Singles]]
"""Value and slope at a place."""

_STEPS_KEPT = 10
"""Steps from which the curvature is estimated."""
_FIRST = 0.1
"""How far the first step moves any number at most."""
_SHORTER, _TRIES = 0.35, 10
"""A step after which the value is not lower is shortened by this factor, so often at most."""
_LEAST_GAIN = 1e-7
"""Share of the value that a step must bring to be followed by another: what float32 tells apart."""
_TINY = 1e-30
"""No slope at all."""
_ENOUGH = 1e-4
"""Share of the fall that the slope promises which a step must bring (Armijo)."""


def follow_descent(function: Function, start: Singles, steps: int) -> Singles:
    """Where at most so many steps of descent from `start` lead; all numbers stay between 0 and 1.

    Steps go by the slope and by the curvature that the last steps met (limited-memory BFGS, Nocedal
    and Wright 2006, algorithm 7.4), of those numbers alone that are not held by their bounds. To
    reach the same value `scipy.optimize` takes three times as long for the codes that this is for,
    as it sorts all numbers by their bounds at each step and counts in float64.
    """
    place = start
    value, slope = function(place)
    met: list[tuple[Singles, Singles, float]] = []
    for _ in range(steps):
        held = ((place <= 0.0) & (slope > 0.0)) | ((place >= 1.0) & (slope < 0.0))
        way = _way(np.where(held, np.float32(0.0), slope), met)
        way[held] = 0.0
        step = _step(function, place, value, slope, way)
        if step is None and not met:
            break
        if step is None:
            # What was met before misleads here.
            met = []
            continue
        after, low, new_slope = step
        if value - low < _LEAST_GAIN * abs(value):
            return after
        value = low
        moved, bent = after - place, new_slope - slope
        curved = _dot(moved, bent)
        if curved > 0.0:
            met = [*met[1 - _STEPS_KEPT :], (moved, bent, 1.0 / curved)]
        place, slope = after, new_slope
    return place


def _way(slope: Singles, met: list[tuple[Singles, Singles, float]]) -> Singles:
    """Minus the slope times the inverse of the curvature that was met."""
    way = -slope
    if not met:
        way *= np.float32(_FIRST / max(float(np.abs(way).max()), _TINY))
        return way
    shares = []
    for moved, bent, scale in reversed(met):
        share = scale * _dot(moved, way)
        shares.append(share)
        way -= np.float32(share) * bent
    moved, bent, scale = met[-1]
    way *= np.float32(1.0 / (scale * _dot(bent, bent)))
    for (moved, bent, scale), share in zip(met, reversed(shares), strict=True):
        way += np.float32(share - scale * _dot(bent, way)) * moved
    return way


def _step(
    function: Function, place: Singles, value: float, slope: Singles, way: Singles
) -> tuple[Singles, float, Singles] | None:
    """The first place on the way, of ever nearer ones, where the value is low enough; its value and
    slope. None where the way leads up, or none of them is."""
    if _dot(way, slope) >= 0.0:
        return None
    length = 1.0
    for _ in range(_TRIES):
        after = np.clip(place + np.float32(length) * way, 0.0, 1.0)
        low, new_slope = function(after)
        if low <= value + _ENOUGH * _dot(slope, after - place):
            return after, low, new_slope
        length *= _SHORTER
    return None


def _dot(one: Singles, other: Singles) -> float:
    """Sum of the products of all numbers."""
    return float(np.vdot(one, other))
