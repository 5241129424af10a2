"""Masks of grey levels for light from beyond a radius.

A mask that is open or closed counts each path a whole number of times. One with grey levels counts
it by any number, so that what is missed near a lit cell is compensated by its neighbours in other
codes. The levels are those, 0 to 1, with the least error in light that is correlated between cells
(`pdcd.codes.alike`): non-negative least squares, for each camera cell by itself.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.codes.alike import CHUNK_ENTRIES, CellBlock, split_into_cell_blocks

MEAN_OPEN_LEVEL = 0.5
"""Mean level over the share of codes in which a cell may be open at all: as much room upwards as
downwards."""
_LEVEL_STEPS = 256
"""Levels are whole multiples of one part in this many."""
MOST_WORK = 2**29
"""Codes squared times cells up to which levels are chosen: ten seconds."""
_STEPS = 300
"""Steps of descent. Twice as many change errors by one or two per cent."""
_FINE = 2.0**18
"""Intermediate values are rounded to this part of a level, and `_SUMS` is the largest sum of a row
of the matrix, in whole numbers: all products and their sums are then below 2^53, and exact."""
_SUMS = 2.0**32
_POWERS, _WHOLE = 8, 2.0**12
"""Steps of the search for the largest eigenvalue, with vectors of whole numbers up to this."""


def can_make_grey_masks(count: int, cells: int) -> bool:
    """Whether levels are chosen for so many codes and cells."""
    return count**2 * cells <= MOST_WORK


def make_grey_masks(lit: Bools, seen: Bools, lattice: tuple[int, int], radius: int) -> Floats:
    """How far the mask is open, 0..1, so that far light is counted as evenly as possible.

    Parameters
    ----------
    lit : (K, L) bool
        Cells of the projector that are lit.
    seen : (K, L) bool
        Cells of the mask that may be open: no cell is lit within the radius of them.
    lattice : (rows, cols), L cells in all
    radius : cells along each axis, 1 or more

    Returns
    -------
    (K, L) float64, 0 where `seen` is not.
    """
    bits = lit.astype(np.float64)
    level = MEAN_OPEN_LEVEL * float(seen.mean())
    counted = level * float(bits.sum()) / bits.shape[1]
    found = np.empty(seen.shape)
    for group in _groups(split_into_cell_blocks(bits, lattice, radius), len(lit)):
        _level(found, group, seen, level, counted)
    return found


def _groups(found: Iterator[CellBlock], count: int) -> Iterator[list[CellBlock]]:
    """Blocks whose matrices fit into the caches of a processor together: at least one."""
    most = max(1, CHUNK_ENTRIES // count**2)
    while group := list(itertools.islice(found, most)):
        yield group


def _level(
    found: Floats, group: list[CellBlock], seen: Bools, level: float, counted: float
) -> None:
    """Choose the levels of some blocks so that each path from afar is counted so often; written
    into `found` (K, L)."""
    size = max(block.cells.size for block in group)
    shape = (len(group), len(seen), size)
    together = np.empty((*shape[:2], len(seen)))
    wanted, most = np.zeros(shape), np.zeros(shape)
    for n, block in enumerate(group):
        scale = _scale(block.together)
        together[n] = np.rint(block.together * scale)
        wanted[n, :, : block.cells.size] = np.rint(block.wanted * (counted * scale))
        most[n, :, : block.cells.size] = seen[:, block.cells]
    chosen = _least(together, wanted, most, level * most)
    for block, levels in zip(group, chosen, strict=True):
        found[:, block.cells] = levels[:, : block.cells.size]


def _least(together: Floats, wanted: Floats, most: Floats, first: Floats) -> Floats:
    """Levels (G, K, Y) between 0 and `most` with the least error, by descent from the first.

    Their error is ``(a L - c W) C (a L - c W)``. It is minimised by accelerated descent within the
    bounds (Beck and Teboulle 2009, FISTA).
    """
    steepest = _steepest(together)[:, None, None]
    now = _rounded(first, _FINE)
    ahead, pace = now, 1.0
    for _ in range(_STEPS):
        slope = together @ ahead - wanted
        after = _rounded(np.clip(ahead - slope / steepest, 0.0, most), _FINE)
        faster = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * pace**2))
        ahead = _rounded(after + (pace - 1.0) / faster * (after - now), _FINE)
        now, pace = after, faster
    return _rounded(now, _LEVEL_STEPS)


def _steepest(matrices: Floats) -> Floats:
    """An upper bound of the eigenvalues of matrices (G, K, K), (G,); steps of one over it are safe.

    For a matrix A without negative entries it is the largest of ``A v / v`` for any positive v
    (Collatz and Wielandt); the nearer v is to an eigenvector, the tighter. A v of all ones, which
    gives the largest sum of a row, is too high by a factor of 2 to 3.
    """
    vector = np.ones((*matrices.shape[:2], 1))
    for _ in range(_POWERS):
        image = matrices @ vector
        vector = 1.0 + np.rint(_WHOLE * (image / image.max(axis=1, keepdims=True)))
    return np.asarray((matrices @ vector / vector).max(axis=(1, 2)))


def _scale(matrix: Floats) -> float:
    """The power of two that brings the largest sum of a row just below `_SUMS`."""
    return float(_SUMS * 2.0 ** -np.frexp(matrix.sum(axis=1).max())[1])


def _rounded(values: Floats, parts: float) -> Floats:
    """To whole multiples of one part in so many."""
    return np.asarray(np.rint(values * parts) / parts)
