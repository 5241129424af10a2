"""Bernoulli codes: every cell of every code is lit by its own throw of a coin, as in the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
