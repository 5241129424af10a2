"""Every cell of every code by its own throw of a coin, as in the paper: Bernoulli, Rademacher."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError


def bernoulli(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Independent cells, lit with probability p (paper, section 5).

    With the complement as dual, p = 1/2 and the mean weight 1/4 divided out, one photo of K codes
    has the variance (S^2 + 2 Q) / K at a cell whose indirect paths sum to S and whose squares sum
    to Q. The S^2 comes from cells being open an unequal number of times; `balanced` removes it.

    Returns
    -------
    (K, L) bool
    """
    return rng.random((count, lattice[0] * lattice[1])) < p


def rademacher(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Independent signs +1 (lit) and -1 (dark), each with probability 1/2 (paper, section 3.2).

    A goal of signed codes shows each code and its negative, in two photos of which the difference
    is taken (eq. 10); the variance is then Q / K (eq. 7). In goals of unsigned codes the bits are
    those of fair coins, and the variance is that of `bernoulli` with p = 1/2.

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
