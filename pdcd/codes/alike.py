"""The correlation that light from afar is assumed to have, for choosing the codes that keep it.

Light is taken to be correlated between cells, and to fall off with distance or not. The error of a
camera cell in such light is a quadratic form of its mask (`CellBlock`). `pdcd.codes.far` and
`pdcd.codes.greyed` choose masks by it. All sums are exact in float64, so that the codes of a seed
do not depend on the order in which a machine adds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats

_Indices = NDArray[np.intp]

CORRELATION_GAUSSIANS = ((8.0, 0.375), (3.0, 0.375), (1.5, 0.25))
"""Correlation of the light of two cells: Gaussians of so many cells, and their shares."""
OWN_LIGHT = 0.25
"""Additional variance, for the light that each cell has for itself."""
_STEP = 2.0**-8
"""All these weights are whole multiples of it, so that sums of products are exact in float64 and
codes do not depend on the order in which a machine adds."""
_FALL_CELLS, _FALL_POWER, _FALL_STEP = 5.0, 4, 2.0**-6
"""Light falls off with distance not at all, exponentially over so many cells, or by this power; all
three count alike. The values are rounded to multiples of the step, for the same reason."""
CELL_BLOCK_SIDE = 3
"""Side, in camera cells, of the blocks within which distances are those from the middle."""
MOST_FALLING = 2**35
"""Blocks times codes squared times cells up to which light is assumed to fall off: five seconds."""
CHUNK_ENTRIES = 2**16
"""Codes times camera cells that are processed at once: what fits into a processor's caches."""


@dataclass(frozen=True)
class CellBlock:
    """Some camera cells that lie together, and the statistics of their light.

    cells : (Y,), their numbers. together : (K, K), ``L C L``; wanted : (K, Y), ``L C W``.
    """

    cells: _Indices
    together: Floats
    wanted: Floats


def split_into_cell_blocks(
    bits: Floats, lattice: tuple[int, int], radius: int
) -> Iterator[CellBlock]:
    """The blocks of a lattice. If light is not assumed to fall off, C is the same for all cells,
    and they are only split to be processed one after the other."""
    count, cells = bits.shape
    spread = _spread(bits, lattice)
    together, wanted = spread @ bits.T, sum_beyond_radius(spread, lattice, radius)
    rows, cols = (_parts(n) for n in lattice)
    if (1 + rows.max()) * (1 + cols.max()) * count**2 * cells > MOST_FALLING:
        for some in np.array_split(np.arange(cells), -(-cells * count // CHUNK_ENTRIES)):
            yield CellBlock(some, together, wanted[:, some])
        return
    numbers = np.arange(cells).reshape(lattice)
    images = bits.reshape(-1, *lattice)
    even = _alike(cells)
    for down, right in np.ndindex(1 + rows.max(), 1 + cols.max()):
        row, col = np.flatnonzero(rows == down), np.flatnonzero(cols == right)
        some = numbers[np.ix_(row, col)].ravel()
        own, far = together * even, wanted[:, some] * even
        falls = _falls(lattice, row.mean(), col.mean(), radius)
        for fall in falls:
            # Far away it is rounded to 0.
            lit = np.ix_(fall.any(axis=1), fall.any(axis=0))
            light = (images[:, lit[0], lit[1]] * fall[lit]).reshape(count, -1)
            spread = _spread(light, fall[lit].shape) * _alike(np.sum(fall**2))
            own += spread @ light.T
            near = _near(numbers[lit], some, lattice[1], radius)
            far += spread @ (~near * fall[lit].reshape(-1, 1))
        yield CellBlock(some, own, far)


def sum_beyond_radius(images: Floats, lattice: tuple[int, int], radius: int) -> Floats:
    """Sums of images (K, L) over all cells further than the radius from each cell, (K, L)."""
    rows, cols = (
        (np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= radius).astype(np.float64)
        for n in lattice
    )
    near = (rows @ images.reshape(-1, *lattice) @ cols).reshape(images.shape)
    sums: Floats = images.sum(axis=1, keepdims=True) - near
    return sums


def _near(these: _Indices, those: _Indices, width: int, radius: int) -> Bools:
    """Which of some cells are within the radius of which others, given their numbers."""
    (row, col), (other_row, other_col) = (
        np.divmod(these.reshape(-1, 1), width),
        np.divmod(those, width),
    )
    near: Bools = np.maximum(np.abs(row - other_row), np.abs(col - other_col)) <= radius
    return near


def _alike(square: float) -> float:
    """Factor that gives ways to fall off about equal weight, from the sum of their squares: a power
    of two, which leaves sums exact."""
    return float(2.0 ** -np.frexp(square)[1])


def _parts(size: int) -> _Indices:
    """Which block each of so many rows or columns is in, (size,)."""
    count = -(-size // CELL_BLOCK_SIDE)
    return (2 * np.arange(size) + 1) * count // (2 * size)


def _falls(lattice: tuple[int, int], row: float, col: float, radius: int) -> list[Floats]:
    """Light as a function of distance from a place, (rows, cols), at most 1, for both ways in which
    it may fall off."""
    rows, cols = lattice
    apart = np.hypot(np.arange(rows)[:, None] - row, np.arange(cols) - col)
    falls = (
        np.exp(-apart / _FALL_CELLS),
        ((radius + 1) / np.maximum(apart, radius + 1)) ** _FALL_POWER,
    )
    return [np.rint(fall / _FALL_STEP) * _FALL_STEP for fall in falls]


def _spread(light: Floats, lattice: tuple[int, int]) -> Floats:
    """``L C`` of light (K, L): the correlated part, and that which each cell has for itself."""
    images = light.reshape(-1, *lattice)
    rows, cols = lattice
    alike = sum(
        share * (_gaussian(rows, reach) @ images @ _gaussian(cols, reach))
        for reach, share in CORRELATION_GAUSSIANS
    )
    spread: Floats = np.asarray(alike).reshape(light.shape) + OWN_LIGHT * light
    return spread


def _gaussian(size: int, reach: float) -> Floats:
    """Gaussian of the distance of any two of so many cells, (size, size)."""
    apart = np.subtract.outer(np.arange(size), np.arange(size)) / reach
    return np.asarray(np.rint(np.exp(-(apart**2) / 2.0) / _STEP) * _STEP)
