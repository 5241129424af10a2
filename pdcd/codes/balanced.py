"""Balanced codes: every cell is lit in exactly pK of the K codes, in an order of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError

_MAX_COUNT = 65536
"""Largest number of codes that a hint proposes; requests allow no more."""


def balanced(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Independent random permutations of pK ones and (1-p)K zeros, one permutation a cell.

    Equal on-counts make the diagonal of the probing matrix exact and take the S^2 term out of the
    variance of `bernoulli`: at p = 1/2 with the complement as dual, Q / (K - 1) is left.

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
