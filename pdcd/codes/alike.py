"""How alike light from afar is taken to be, where the codes that keep it are chosen.

What a camera cell counts wrong of light that is alike over some cells, and falls off with the
distance or does not, is a quadratic form of its mask (`CellBlock`). `pdcd.codes.far` and
`pdcd.codes.greyed` choose masks by it. All sums are exact in float64, so that the codes of a seed
do not depend on the order in which a machine adds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats

_Indices = NDArray[np.intp]
_Real = TypeVar("_Real", NDArray[np.float64], NDArray[np.float32])

CORRELATION_GAUSSIANS = ((8.0, 0.375), (3.0, 0.375), (1.5, 0.25))
"""How alike the light of two cells is taken to be: Gaussians of so many cells, and their shares."""
OWN_LIGHT = 0.25
"""What is added for light that each cell has for itself."""
_STEP = 2.0**-8
"""All these weights are whole multiples of it, so that sums of products are exact in float64 and
codes do not depend on the order in which a machine adds."""
_FALL_CELLS, _FALL_POWER, _FALL_STEP = 5.0, 4, 2.0**-6
"""Light falls off with the distance not at all, exponentially over so many cells, or by this power;
all three count alike. Rounded to multiples of the step, for the same reason."""
CELL_BLOCK_SIDE, FINE_SIDE = 3, 2
"""Camera cells along a side of the blocks within which the distance is that from the middle."""
STEEP = 2.0
"""How often light that falls off by the power counts where codes are chosen together with masks:
it is what they err most of."""
MOST_FALLING = 2**35
"""Blocks times codes squared times cells up to which light is taken to fall off: five seconds."""
CHUNK_ENTRIES = 2**16
"""Codes times camera cells that are looked at at once: what stays in the caches of a processor."""


@dataclass(frozen=True)
class CellBlock:
    """Some camera cells that lie together, and what is known of their light.

    cells : (Y,), their numbers. together : (K, K), ``L C L``; wanted : (K, Y), ``L C W``.
    """

    cells: _Indices
    together: Floats
    wanted: Floats


def split_into_cell_blocks(
    bits: Floats, lattice: tuple[int, int], radius: int, *, fine: bool = False
) -> Iterator[CellBlock]:
    """The blocks of a lattice; `fine` for codes that were chosen together with masks. C is the same
    for all cells, and they are split only to be looked at one after the other, where light is not
    taken to fall off."""
    count, cells = bits.shape
    side, weights = (FINE_SIDE, (1.0, STEEP)) if fine else (CELL_BLOCK_SIDE, (1.0, 1.0))
    spread = _spread(bits, lattice)
    together, wanted = spread @ bits.T, sum_beyond_radius(spread, lattice, radius)
    rows, cols = (_parts(n, side) for n in lattice)
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
        for weight, fall in zip(weights, falls, strict=True):
            # Far enough off it is rounded to nothing.
            lit = np.ix_(fall.any(axis=1), fall.any(axis=0))
            light = (images[:, lit[0], lit[1]] * fall[lit]).reshape(count, -1)
            spread = _spread(light, fall[lit].shape) * (weight * _alike(np.sum(fall**2)))
            own += spread @ light.T
            near = _near(numbers[lit], some, lattice[1], radius)
            far += spread @ (~near * fall[lit].reshape(-1, 1))
        yield CellBlock(some, own, far)


def sum_beyond_radius(images: Floats, lattice: tuple[int, int], radius: int) -> Floats:
    """Sums of images (K, L) over all that is further than the radius from each cell, (K, L)."""
    sums: Floats = images.sum(axis=1, keepdims=True) - sum_within_radius(images, lattice, radius)
    return sums


def sum_within_radius(images: _Real, lattice: tuple[int, int], radius: int) -> _Real:
    """Sums of images (K, L) over all that is within the radius of each cell, (K, L)."""
    rows, cols = (
        (np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= radius).astype(images.dtype)
        for n in lattice
    )
    near = (rows @ images.reshape(-1, *lattice) @ cols).reshape(images.shape)
    return np.asarray(near, dtype=images.dtype)


def compute_light_falloff(apart: Floats, radius: int) -> tuple[Floats, Floats]:
    """Light over the distance in cells, at most 1, in both ways in which it may fall off."""
    return (
        np.exp(-apart / _FALL_CELLS),
        ((radius + 1) / np.maximum(apart, radius + 1)) ** _FALL_POWER,
    )


def _near(these: _Indices, those: _Indices, width: int, radius: int) -> Bools:
    """Which of some cells are within the radius of which others, by their numbers."""
    (row, col), (other_row, other_col) = (
        np.divmod(these.reshape(-1, 1), width),
        np.divmod(those, width),
    )
    near: Bools = np.maximum(np.abs(row - other_row), np.abs(col - other_col)) <= radius
    return near


def _alike(square: float) -> float:
    """What makes ways to fall off count about alike, by the sum of their squares: a power of two,
    which leaves sums exact."""
    return float(2.0 ** -np.frexp(square)[1])


def _parts(size: int, side: int) -> _Indices:
    """Which block of that side each of so many rows or columns is in, (size,)."""
    count = -(-size // side)
    return (2 * np.arange(size) + 1) * count // (2 * size)


def _falls(lattice: tuple[int, int], row: float, col: float, radius: int) -> list[Floats]:
    """Light over its distance from a place, (rows, cols), at most 1, in both ways in which it may
    fall off."""
    rows, cols = lattice
    apart = np.hypot(np.arange(rows)[:, None] - row, np.arange(cols) - col)
    return [
        np.rint(fall / _FALL_STEP) * _FALL_STEP for fall in compute_light_falloff(apart, radius)
    ]


def _spread(light: Floats, lattice: tuple[int, int]) -> Floats:
    """``L C`` of light (K, L): what is alike, and what each cell has for itself."""
    images = light.reshape(-1, *lattice)
    rows, cols = lattice
    alike = sum(
        share * (make_gaussian_weights(rows, reach) @ images @ make_gaussian_weights(cols, reach))
        for reach, share in CORRELATION_GAUSSIANS
    )
    spread: Floats = np.asarray(alike).reshape(light.shape) + OWN_LIGHT * light
    return spread


def make_gaussian_weights(size: int, reach: float) -> Floats:
    """Gaussian of the distance of any two of so many cells, (size, size)."""
    apart = np.subtract.outer(np.arange(size), np.arange(size)) / reach
    return np.asarray(np.rint(np.exp(-(apart**2) / 2.0) / _STEP) * _STEP)
