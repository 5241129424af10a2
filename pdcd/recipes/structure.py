"""What a wanted matrix is made of: even light, near bands, matched cells, and what is left.

A matrix of N x N weights that somebody hands over is often one of a few kinds: all light but that
from one cell each, all light from further than a radius, some taps of a filter, regions. Each of
these can be photographed far better than an arbitrary matrix. So the matrix is taken apart here;
how the parts are photographed is in `pdcd.recipes.composed`.

Nothing is lost: what no part explains is the rest. Parts and rest together are the matrix to
`EQUAL_WEIGHTS` of its largest weight, which is checked. A part is only found where its weights are
all equal: numbers that scatter stay in the rest.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pdcd.arrays import Floats, Indices
from pdcd.probing.wanted import NearPart, shift_cells
from pdcd.recipes.even import EQUAL_WEIGHTS, find_even_part

_Grid = tuple[int, int]

_BLOCK = 256
"""Rows that are processed together; bounds the memory in addition to the matrix and its rest."""
_SCATTER = 8.0
"""Deviations of noisy numbers from a part, over the usual one, that still count as noise."""
_MOST_RADIUS = 16
"""Largest radius of a near band, cells."""
_MOST_RINGS = 2
"""Most different weights of the rings of a band; more are taps of a filter."""
_TINY = 1e-3
"""Share of the tolerance for equality by which exact numbers are rounded."""
_WHOLE = 0.9
"""Share of the entries of a ring or of a shift that must have its weight."""
_MOST_TAPS = 255
"""Most matched cells of a row; with more of them codes do no better than for any matrix."""
_MOST_MATCHES = 16
"""Most matches that are not shifts."""
_SHIFTED = 0.25
"""Share of all cells that a shift must pair to be considered."""
_FEW = 1.0 / 16.0, 4
"""Least share of all cells, and least number of them, that have matched cells of one weight."""
_MOST_REST = 0.5
"""Most of the squared weights that may be left; with more, nothing was found."""
_ROUNDS = 20
"""Iterations towards the nearest product of two sides to a matrix. If that is most of the matrix,
each iteration at least halves the error."""


class _Least(NamedTuple):
    """Tolerances of weights: to count as equal, or as 0; and to be rounded."""

    off: float
    rounding: float


@dataclass(frozen=True, eq=False)
class Structure:
    """A matrix as ``gain_n (level + near + matches + rest)_nm light_m + even_nm``.

    gain, light : (N,), 0 to 1. level : the weight of all pairs of cells alike.
    near : weights and radii of bands; matches : weights and partners (N,), -1 for none; rest :
        (N, N), or None where nothing is left.
    camera, projector : sides of the even part, (r, N), where it is more than one level.
    """

    grid: _Grid
    gain: Floats
    light: Floats
    level: float = 0.0
    near: tuple[tuple[float, int], ...] = ()
    matches: tuple[tuple[float, Indices], ...] = ()
    rest: Floats | None = None
    camera: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    projector: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def found(self) -> bool:
        """Whether there is anything but a rest."""
        return bool(self.level or self.near or self.matches or len(self.camera))

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1 of the sum of all parts, (stop - start, N)."""
        cells = self.gain.size
        total = np.full((stop - start, cells), self.level)
        for weight, radius in self.near:
            total += weight * NearPart(self.grid, radius).rows(start, stop)
        for weight, partner in self.matches:
            there = np.flatnonzero(partner[start:stop] >= 0)
            total[there, partner[start:stop][there]] += weight
        if self.rest is not None:
            total += self.rest[start:stop]
        total *= self.gain[start:stop, None] * self.light
        if len(self.camera):
            total += self.camera[:, start:stop].T @ self.projector
        return total


def find_structure(matrix: Floats, grid: _Grid) -> Structure:
    """Take a matrix (N, N) apart. The same matrix always gives the same parts.

    It takes a few passes over the matrix, and memory for one more of its size.
    """
    ones = np.ones(len(matrix))
    whole = Structure(grid, ones, ones, rest=matrix)
    largest = max(float(matrix.max()), -float(matrix.min()))
    sides = find_even_part(matrix)
    if sides is None or not largest > 0.0:
        return whole
    found = _scaled(matrix, _levelled(grid, *sides), largest)
    rest = _without_even(matrix, found, largest)
    noise = _usual(rest)
    scale = EQUAL_WEIGHTS * max(abs(found.level), _largest(rest))
    least = _Least(
        max(scale, _SCATTER * noise), _SCATTER * noise if noise > scale else _TINY * scale
    )
    near = _near(rest, grid, least)
    for weight, radius in near:
        _subtract_near(rest, grid, weight, radius)
    matches = _matches(rest, grid, least)
    found = replace(found, near=near, matches=matches)
    most, left, off = _compared(found, rest, matrix)
    if most > EQUAL_WEIGHTS * largest:
        found = replace(found, rest=rest)
        if left > _MOST_REST:
            return whole
    return found if found.found and off <= 2.0 * EQUAL_WEIGHTS * largest else whole


def find_nearest_product(matrix: Floats, grid: _Grid) -> Structure:
    """For scattered weights: the nearest product of two sides, if that is most of the matrix, and
    the rest; else all is the rest.

    Signed codes are bad at what all cells have in common, as each code lights half of them.
    """
    ones = np.ones(len(matrix))
    whole = Structure(grid, ones, ones, rest=matrix)
    camera = matrix.sum(axis=1)
    for _ in range(_ROUNDS):
        projector = camera @ matrix
        camera = matrix @ projector
        size = float(np.linalg.norm(camera))
        if not size > 0.0:
            return whole
        camera /= size
    projector = camera @ matrix
    if float(projector @ projector) < (1.0 - _MOST_REST) * float(np.sum(matrix**2)):
        return whole
    rest = matrix - np.outer(camera, projector)
    return replace(whole, camera=camera[None], projector=projector[None], rest=rest)


def _levelled(grid: _Grid, camera: Floats, projector: Floats) -> Structure:
    """An even part (r, N) each as a level, with gain and light, if it is a product of two sides
    without a change of sign; else unchanged."""
    cells = camera.shape[1]
    ones = np.ones(cells)
    if len(camera) != 1:
        return Structure(grid, ones, ones, camera=camera, projector=projector)
    sides, level = [], 1.0
    for side in (camera[0], projector[0]):
        top = side[np.argmax(np.abs(side))]
        scaled = side / top
        level *= float(top)
        scaled[np.abs(scaled) < EQUAL_WEIGHTS] = 0.0
        if scaled.min() < 0.0:
            return Structure(grid, ones, ones, camera=camera, projector=projector)
        sides.append(scaled)
    return Structure(grid, sides[0], sides[1], level)


def _scaled(matrix: Floats, found: Structure, largest: float) -> Structure:
    """The same with gain, light and level rounded: sides that are even up to the noise of the
    numbers become 1. If gain or light hide weights of the matrix, the even part is left as it is.
    """
    if not found.level:
        return found
    ones = np.ones(len(matrix))
    some = slice(0, min(_BLOCK, len(matrix)))
    off = np.abs(matrix[some] - found.rows(some.start, some.stop))
    noise = _usual(off)
    if noise < EQUAL_WEIGHTS * largest:
        noise = 0.0
    sides = [found.gain, found.light]
    level = found.level
    for number, side in enumerate(sides):
        usual = float(np.median(side))
        spread = np.abs(side - usual)
        if spread.max() <= max(EQUAL_WEIGHTS, _SCATTER * noise / abs(level)) * usual:
            sides[number] = ones
            level *= usual
    level = _rounded(level, noise or _TINY * EQUAL_WEIGHTS * largest)
    gain, light = sides
    hidden = np.abs(matrix[gain == 0.0]).max(initial=0.0)
    hidden = max(hidden, np.abs(matrix[:, light == 0.0]).max(initial=0.0))
    if hidden > EQUAL_WEIGHTS * largest:
        camera, projector = level * gain[None], light[None].copy()
        return Structure(found.grid, ones, ones, camera=camera, projector=projector)
    return replace(found, gain=gain, light=light, level=level)


def _without_even(matrix: Floats, found: Structure, largest: float) -> Floats:
    """The matrix less its even part, over gain and light, (N, N)."""
    rest = np.empty_like(matrix)
    for start in range(0, len(matrix), _BLOCK):
        here = slice(start, min(start + _BLOCK, len(matrix)))
        off = matrix[here] - found.rows(here.start, here.stop)
        off[np.abs(off) <= EQUAL_WEIGHTS * largest] = 0.0
        weight = found.gain[here, None] * found.light
        rest[here] = np.divide(off, weight, out=np.zeros_like(off), where=weight > 0.0)
    return rest


def _near(rest: Floats, grid: _Grid, least: _Least) -> tuple[tuple[float, int], ...]:
    """Bands around the diagonal: (weight, radius) each. Every ring of cells around a cell has one
    weight; the cell itself may have another."""
    rings: list[float] = []
    for radius in range(1, min(_MOST_RADIUS, max(grid) - 1) + 1):
        weight = _ring(rest, grid, radius, least)
        if weight is None:
            break
        rings.append(weight)
    steps = [
        (here - (rings[k + 1] if k + 1 < len(rings) else 0.0), k + 1)
        for k, here in enumerate(rings)
    ]
    bands = tuple((weight, radius) for weight, radius in steps if abs(weight) > least.off)
    return bands if len(bands) <= _MOST_RINGS else ()


def _ring(rest: Floats, grid: _Grid, radius: int, least: _Least) -> float | None:
    """The one weight, other than 0, of all paths to cells `radius` cells off, else None."""
    weight = None
    span = range(-radius, radius + 1)
    for down in span:
        for right in span:
            if max(abs(down), abs(right)) != radius:
                continue
            partner = shift_cells(grid, (down, right))
            there = np.flatnonzero(partner >= 0)
            if not there.size:
                continue
            seen = rest[there, partner[there]]
            if weight is None:
                weight = float(np.median(seen))
            if np.mean(np.abs(seen - weight) <= least.off) < _WHOLE or abs(weight) <= least.off:
                return None
    return None if weight is None else _rounded(weight, least.rounding)


def _subtract_near(rest: Floats, grid: _Grid, weight: float, radius: int) -> None:
    for start in range(0, len(rest), _BLOCK):
        stop = min(start + _BLOCK, len(rest))
        rest[start:stop] -= weight * NearPart(grid, radius).rows(start, stop)


def _matches(rest: Floats, grid: _Grid, least: _Least) -> tuple[tuple[float, Indices], ...]:
    """Matched cells of equal weight, which are subtracted from the rest: first whole shifts, then
    any cells."""
    count = int(np.count_nonzero(np.abs(rest) > least.off))
    if not count or count > _MOST_TAPS * len(rest):
        return ()
    row, column = np.nonzero(np.abs(rest) > least.off)
    found = [*_shifts(rest, grid, row, column, least)]
    kept = np.abs(rest[row, column]) > least.off
    found += _anywhere(rest, row[kept], column[kept], least)
    found = _joined(found, least)
    _meeting(rest, found, least)
    return tuple(found)


def _shifts(
    rest: Floats, grid: _Grid, row: Indices, column: Indices, least: _Least
) -> list[tuple[float, Indices]]:
    """Matches by a shift that most cells have; they are subtracted from the rest."""
    down = column // grid[1] - row // grid[1]
    right = column % grid[1] - row % grid[1]
    number = (down + grid[0]) * (2 * grid[1]) + right + grid[1]
    which, counts = np.unique(number, return_counts=True)
    found = []
    for one in which[counts >= _SHIFTED * len(rest)].tolist():
        shift = one // (2 * grid[1]) - grid[0], one % (2 * grid[1]) - grid[1]
        partner = shift_cells(grid, shift)
        there = np.flatnonzero(partner >= 0)
        seen = rest[there, partner[there]]
        weight = float(np.median(seen[np.abs(seen) > least.off]))
        same = np.abs(seen - weight) <= least.off
        if np.count_nonzero(same) < 0.5 * there.size:
            continue
        weight = _rounded(weight, least.rounding)
        partner[there[~same]] = -1
        rest[there[same], partner[there[same]]] -= weight
        found.append((weight, partner))
    return found


def _anywhere(
    rest: Floats, row: Indices, column: Indices, least: _Least
) -> list[tuple[float, Indices]]:
    """Matches of equal weight with any cells; they are subtracted from the rest."""
    found: list[tuple[float, Indices]] = []
    while row.size and len(found) < _MOST_MATCHES:
        seen = rest[row, column]
        weight = _most_common(seen, least)
        same = np.flatnonzero(np.abs(seen - weight) <= least.off)
        rows, first = np.unique(row[same], return_index=True)
        if rows.size < max(_FEW[0] * len(rest), _FEW[1]):
            break
        weight = _rounded(weight, least.rounding)
        partner = np.full(len(rest), -1)
        partner[rows] = column[same[first]]
        rest[rows, partner[rows]] -= weight
        found.append((weight, partner))
        kept = np.ones(row.size, dtype=np.bool_)
        kept[same[first]] = False
        row, column = row[kept], column[kept]
    return found


def _joined(found: list[tuple[float, Indices]], least: _Least) -> list[tuple[float, Indices]]:
    """The same, with matches of equal weight joined if no cell has both."""
    joined: list[tuple[float, Indices]] = []
    for weight, partner in found:
        for number, (other, before) in enumerate(joined):
            if abs(weight - other) <= least.off and not np.any((before >= 0) & (partner >= 0)):
                joined[number] = other, np.where(before >= 0, before, partner)
                break
        else:
            joined.append((weight, partner))
    return joined


def _meeting(rest: Floats, found: list[tuple[float, Indices]], least: _Least) -> None:
    """Give cells their partner if it is the same in two matches: the entry is then the sum of both
    weights."""
    left = np.abs(rest) > least.off
    if len(found) < 2 or np.count_nonzero(left) > len(rest):
        return
    for row, column in np.argwhere(left).tolist():
        for (one, partner), (two, other) in itertools.combinations(found, 2):
            free = partner[row] < 0 and other[row] < 0
            if free and abs(rest[row, column] - one - two) <= 2.0 * least.off:
                partner[row] = other[row] = column
                rest[row, column] -= one + two
                break


def _most_common(values: Floats, least: _Least) -> float:
    """The middle of the range of `least` that holds the most values."""
    ordered = np.sort(values)
    last = np.searchsorted(ordered, ordered + least.off, side="right")
    first = int(np.argmax(last - np.arange(ordered.size)))
    return float(np.median(ordered[first : last[first]]))


def _rounded(weight: float, off: float) -> float:
    """The weight with as few digits as it has within `off`: 1 for 0.9999999998."""
    for digits in range(7):
        if abs(round(weight, digits) - weight) <= 0.25 * off:
            return float(round(weight, digits))
    return weight


def _usual(rest: Floats) -> float:
    """The usual size of entries, from some rows."""
    size = np.abs(rest[:: max(1, len(rest) // _BLOCK)])
    return float(np.median(size))


def _largest(rest: Floats) -> float:
    return max(float(rest.max()), -float(rest.min()))


def _compared(parts: Structure, rest: Floats, matrix: Floats) -> tuple[float, float, float]:
    """Compares a matrix with its parts: the largest weight of the rest in it, the share of its
    squared weights in the rest, and the largest deviation of parts and rest together."""
    most = squares = off = 0.0
    for start in range(0, len(matrix), _BLOCK):
        here = slice(start, min(start + _BLOCK, len(matrix)))
        left = rest[here] * (parts.gain[here, None] * parts.light)
        most = max(most, float(np.abs(left).max()))
        squares += float(np.sum(left**2))
        told = parts.rows(here.start, here.stop) + left
        off = max(off, float(np.abs(told - matrix[here]).max()))
    return most, squares / float(np.einsum("nm,nm->", matrix, matrix)), off
