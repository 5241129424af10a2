"""Hadamard codes: orthogonal on-off sequences, reused only by cells that are far apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.codes.colouring import colour_lattice
from pdcd.codes.orders import hadamard_columns, is_order, nearest_orders
from pdcd.errors import ConfigError


def hadamard(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Give each cell a column of a Hadamard matrix of order K, or its negative.

    The constant column is left out, so every cell is lit in exactly K/2 codes. Two cells with
    different columns meet in exactly K/4 codes, which is the wanted weight without any error. Two
    cells with the same column never meet when their signs agree and meet twice too often when
    they differ; `colour_lattice` keeps such cells apart and lets these errors cancel. With more
    codes than cells no column is used twice and the probing matrix is exact.

    Returns
    -------
    (K, L) bool

    Raises
    ------
    ConfigError
        p is not 1/2, or no Hadamard matrix of order K >= 2 can be constructed here.
    """
    if p != 0.5:
        raise ConfigError(
            f"hadamard codes light every cell half of the time, not p = {p:g}",
            hint="take the family 'balanced' for other p",
        )
    check_order(count)
    return coloured(count, *colour_lattice(lattice, count - 1, rng), rng)


def check_order(count: int) -> None:
    """Raise ConfigError, naming the nearest numbers that work, unless `count` codes can be made."""
    if count < 2 or not is_order(count):
        near = " or ".join(str(n) for n in nearest_orders(count))
        raise ConfigError(
            f"hadamard codes do not come in sets of K = {count}", hint=f"take {near} codes"
        )


def coloured(
    count: int, colour: NDArray[np.int64], sign: NDArray[np.int8], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return the codes (K, L) bool of a colouring: a shuffled Hadamard column for each colour."""
    # Shuffled, so that which cells lose their orthogonality when codes are lost does not follow
    # from the regular construction of the matrix.
    column = 1 + rng.permutation(count - 1)[: colour.max() + 1]
    entries = hadamard_columns(count, column)
    return entries[:, colour] * sign > 0
