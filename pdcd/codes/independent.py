"""Codes whose cells are chosen independently of where they lie: with a coin for every bit as in the
paper (Bernoulli, Rademacher), balanced, and balanced with chosen partners.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools
from pdcd.errors import RequestError


def make_bernoulli_codes(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Independent cells, lit with probability p (paper, section 5).

    With the complement as dual, p = 1/2 and the mean weight 1/4 divided out, one photo of K codes
    has the variance (S^2 + 2 Q) / K at a cell whose indirect paths sum to S and whose squares sum
    to Q. The S^2 comes from cells being open an unequal number of times; `make_balanced_codes`
    removes it.

    Returns
    -------
    (K, L) bool
    """
    return rng.random((count, lattice[0] * lattice[1])) < p


def make_rademacher_codes(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Independent signs +1 (lit) and -1 (dark), each with probability 1/2 (paper, section 3.2).

    A goal of signed codes shows each code and its negative, in two photos of which the difference
    is taken (eq. 10); the variance is then Q / K (eq. 7). In goals of unsigned codes the bits are
    those of fair coins, and the variance is that of `make_bernoulli_codes` with p = 1/2.

    Returns
    -------
    (K, L) bool
        True for +1.

    Raises
    ------
    RequestError
        p is not 1/2.
    """
    if p != 0.5:
        raise RequestError(
            f"rademacher codes are +1 and -1 equally often, not lit with p = {p:g}",
            hint="take the family 'bernoulli' for other p",
        )
    signs = rng.integers(0, 2, size=(count, lattice[0] * lattice[1]), dtype=np.uint8)
    return signs.view(np.bool_)


_MAX_COUNT = 65536
"""Largest number of codes that a hint proposes; requests allow no more."""


def make_balanced_codes(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Independent random permutations of pK ones and (1-p)K zeros, one permutation a cell.

    Equal on-counts make the diagonal of the probing matrix exact and take the S^2 term out of the
    variance of `make_bernoulli_codes`: at p = 1/2 with the complement as dual, Q / (K - 1) is left.

    Returns
    -------
    (K, L) bool

    Raises
    ------
    RequestError
        p * K is not a whole number between 1 and K - 1.
    """
    if not _fits(p, count):
        raise RequestError(
            f"balanced codes cannot light a cell in p*K = {p:g} * {count} = {p * count:g} codes",
            hint=_advice(p, count),
        )
    ordered = np.zeros((count, lattice[0] * lattice[1]), dtype=np.bool_)
    ordered[: round(p * count)] = True
    return rng.permuted(ordered, axis=0)


def _fits(p: float, count: int) -> bool:
    """Whether p * count is whole to rounding, with at least one code on and one off."""
    on = round(p * count)
    return abs(p * count - on) <= 1e-9 * count and 1 <= on < count


def _advice(p: float, count: int) -> str:
    """Hint that names the nearest numbers of codes that work, below and above `count`."""
    below = next((k for k in range(count - 1, 1, -1) if _fits(p, k)), None)
    above = next((k for k in range(count + 1, _MAX_COUNT + 1) if _fits(p, k)), None)
    near = [str(k) for k in (below, above) if k is not None]
    if not near:
        return "no number of codes fits this p; take a simple fraction such as 0.0625"
    return f"take {' or '.join(near)} codes"


_Indices = NDArray[np.intp]


def make_partner_codes(codes: Bools, partner: _Indices, rng: np.random.Generator) -> Bools:
    """Balanced codes (K, L) in which each cell is lit with its partner as often as it should be.

    Parameters
    ----------
    codes : (K, L), every cell lit equally often, apart from that at random; those of cells where
        chains of partners end are kept.
    partner : (L,), -1 for none

    Returns
    -------
    (K, L) bool. Cells that are their own partners, or share them, are lit as often. If ``p^2 K`` is
    not a whole number, some pairs meet once more than others.
    """
    count, on = len(codes), int(codes[:, 0].sum())
    chosen = codes.copy()
    whole, more = divmod(on * on, count)
    often: _Indices = np.where(rng.random(codes.shape[1]) < more / count, whole + 1, whole)
    last = _closing(partner)
    for cells in _outwards(partner, last):
        drawn = _beside(chosen[:, partner[cells]], often[cells], on, rng)
        for at, cell in enumerate(cells):
            if first := last.get(int(cell)):
                both = chosen[:, [partner[cell], first - 1]]
                drawn[:, at] = _between(both, often[[cell, first - 1]], drawn[:, at], on, rng)
        chosen[:, cells] = drawn
    return chosen


def _closing(partner: _Indices) -> dict[int, int]:
    """For each ring of partners, the cell that closes it -> the one that begins it, plus 1."""
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


def _outwards(partner: _Indices, last: dict[int, int]) -> Iterator[_Indices]:
    """All cells except those where chains end and rings begin, each after its partner."""
    done = partner < 0
    done[[first - 1 for first in last.values()]] = True
    left = np.flatnonzero(~done)
    while left.size:
        ready = done[partner[left]]
        yield left[ready]
        done[left[ready]] = True
        left = left[~ready]


def _beside(other: Bools, often: _Indices, on: int, rng: np.random.Generator) -> Bools:
    """Columns (K, B) of `on` ones each, of which `often` (B,) are in common with others (K, B)."""
    order = np.argsort(rng.random(other.shape) + 2.0 * ~other, axis=0)
    place = np.arange(len(other))[:, None]
    taken = (place < often) | ((place >= on) & (place < 2 * on - often))
    drawn = np.zeros_like(other)
    np.put_along_axis(drawn, order, taken, axis=0)
    return drawn


def _between(
    both: Bools, often: _Indices, otherwise: Bools, on: int, rng: np.random.Generator
) -> Bools:
    """A column (K,) that has `often` (2,) ones in common with each of two (K, 2); `otherwise` if
    there is none, or the two are equal."""
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
