"""Balanced codes in which a cell and its partner are lit together as often as by chance.

The mask shows a camera cell the code of its partner, so the cell's own direct light counts as often
as both are lit at once: in ``p^2 K`` codes on average. Columns drawn for themselves scatter around
that, by more than all of it where codes are few, and direct light is mostly the strongest. Here
each column is drawn so that it has just that many codes in common with its partner's.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]
Bools = NDArray[np.bool_]


def chained(codes: Bools, partner: Indices, rng: np.random.Generator) -> Bools:
    """Balanced codes (K, L), of which each cell is lit with its partner as often as can be had.

    Parameters
    ----------
    codes : (K, L), every cell lit equally often, else by chance; those of cells where chains of
        partners end are kept.
    partner : (L,), -1 for none

    Returns
    -------
    (K, L) bool. Cells that are their own partners, or share them, are lit as often. Where ``p^2 K``
    is no whole number, some pairs meet once more than others.
    """
    count, on = len(codes), int(codes[:, 0].sum())
    chosen = codes.copy()
    whole, more = divmod(on * on, count)
    often: Indices = np.where(rng.random(codes.shape[1]) < more / count, whole + 1, whole)
    last = _closing(partner)
    for cells in _outwards(partner, last):
        drawn = _beside(chosen[:, partner[cells]], often[cells], on, rng)
        for at, cell in enumerate(cells):
            if first := last.get(int(cell)):
                both = chosen[:, [partner[cell], first - 1]]
                drawn[:, at] = _between(both, often[[cell, first - 1]], drawn[:, at], on, rng)
        chosen[:, cells] = drawn
    return chosen


def _closing(partner: Indices) -> dict[int, int]:
    """Of each ring of partners the cell that closes it, and the one it is begun with, plus 1."""
    seen = np.zeros(partner.size, dtype=np.intp)
    found = {}
    for start in range(partner.size):
        cell = start
        while cell >= 0 and not seen[cell]:
            seen[cell] = start + 1
            cell = int(partner[cell])
        if cell >= 0 and seen[cell] == start + 1:
            found[int(partner[cell])] = cell + 1
    return found


def _outwards(partner: Indices, last: dict[int, int]) -> Iterator[Indices]:
    """All cells but those where chains end and rings begin, after their partners."""
    done = partner < 0
    done[[first - 1 for first in last.values()]] = True
    left = np.flatnonzero(~done)
    while left.size:
        ready = done[partner[left]]
        yield left[ready]
        done[left[ready]] = True
        left = left[~ready]


def _beside(other: Bools, often: Indices, on: int, rng: np.random.Generator) -> Bools:
    """Columns (K, B) of so many ones that have so many (B,) in common with others (K, B)."""
    order = np.argsort(rng.random(other.shape) + 2.0 * ~other, axis=0)
    place = np.arange(len(other))[:, None]
    taken = (place < often) | ((place >= on) & (place < 2 * on - often))
    drawn = np.zeros_like(other)
    np.put_along_axis(drawn, order, taken, axis=0)
    return drawn


def _between(
    both: Bools, often: Indices, otherwise: Bools, on: int, rng: np.random.Generator
) -> Bools:
    """A column (K,) that has so many ones (2,) in common with either of two (K, 2); `otherwise`
    where there is none, or the two are one."""
    if np.array_equal(both[:, 0], both[:, 1]):
        return otherwise
    kind = both[:, 0] * 2 + both[:, 1]
    neither, second, first, common = np.bincount(kind, minlength=4)
    least = max(0, often[0] - first, often[1] - second, often.sum() - on)
    most = min(common, *often, neither - on + often.sum())
    if least > most:
        return otherwise
    shared = int(np.clip(round(often[0] * often[1] / on), least, most))
    numbers = (on - often.sum() + shared, often[1] - shared, often[0] - shared, shared)
    drawn = np.zeros(len(both), dtype=np.bool_)
    for which, number in enumerate(numbers):
        drawn[rng.permutation(np.flatnonzero(kind == which))[:number]] = True
    return drawn
