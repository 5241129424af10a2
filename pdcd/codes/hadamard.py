"""Hadamard codes: orthogonal on-off sequences, reused only by cells that are far apart."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.codes.colouring import choose_phases, colour_lattice
from pdcd.codes.orders import (
    count_spread_subspaces,
    find_nearest_orders,
    is_order,
    make_hadamard_columns,
    make_spread_codes,
)
from pdcd.errors import RequestError


def make_hadamard_codes(
    lattice: tuple[int, int],
    count: int,
    p: float,
    rng: np.random.Generator,
    links: Any = None,
) -> NDArray[np.bool_]:
    """Give each cell a column of a Hadamard matrix of order K, or its negative.

    The constant column is left out, so every cell is lit in exactly K/2 codes. Two cells with
    different columns meet in exactly K/4 codes, which is the wanted weight without any error. Two
    cells with the same column never meet when their signs agree and meet twice too often when
    they differ; `colour_lattice` keeps such cells apart and lets these errors cancel. With more
    codes than cells no column is used twice and the probing matrix is exact.

    For p = 1/4, 1/8 ... a cell gets the product of 2, 3 ... columns (`pdcd.codes.orders`), and is
    lit in exactly pK codes. Two cells with different products meet in exactly p^2 K; of cells with
    the same product those of one phase meet in pK, and others never.

    Returns
    -------
    (K, L) bool

    Raises
    ------
    RequestError
        p is no power of 1/2; for p = 1/2 no Hadamard matrix of order K >= 2 can be constructed
        here; for smaller p, K is no power of two from 1/p^2 on.
    """
    if p != 0.5:
        return _seldom(lattice, count, p, rng, links)
    check_order(count)
    return make_colouring_codes(count, *colour_lattice(lattice, count - 1, rng, links), rng)


def _seldom(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator, links: Any
) -> NDArray[np.bool_]:
    """Codes for p = 2^-t with t > 1: (K, L) bool."""
    mantissa, exponent = math.frexp(p)
    t = 1 - exponent
    if mantissa != 0.5 or t < 2:
        raise RequestError(
            f"hadamard codes light cells in 1/2, 1/4, 1/8 ... of the codes, not p = {p:g}",
            hint="take the family 'balanced' for other p",
        )
    if not can_make_hadamard_codes(count, p):
        least = 4**t
        below = 1 << (count.bit_length() - 1)
        near = [n for n in (below, 2 * below) if n >= least] or [least]
        raise RequestError(
            f"hadamard codes of p = {p:g} do not come in sets of K = {count}",
            hint=f"take {' or '.join(str(n) for n in near)} codes, or the family 'balanced'",
        )
    spaces = count_spread_subspaces(count.bit_length() - 1, t)
    colour, _ = colour_lattice(lattice, spaces, rng, links)
    phase = choose_phases(lattice, colour, 2**t, rng)
    return make_spread_codes(count, t, rng.permutation(spaces)[colour], phase)


def can_make_hadamard_codes(count: int, p: float) -> bool:
    """Whether there are `count` such codes that light cells in a share p of them."""
    if p == 0.5:
        return count >= 2 and is_order(count)
    mantissa, exponent = math.frexp(p)
    return mantissa == 0.5 and count >= 4 ** (1 - exponent) and count & (count - 1) == 0


def check_order(count: int) -> None:
    """Raise RequestError, naming the nearest numbers that work, if `count` codes cannot be made."""
    if count < 2 or not is_order(count):
        near = " or ".join(str(n) for n in find_nearest_orders(count))
        raise RequestError(
            f"hadamard codes do not come in sets of K = {count}", hint=f"take {near} codes"
        )


def make_colouring_codes(
    count: int, colour: NDArray[np.int64], sign: NDArray[np.int8], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return the codes (K, L) bool of a colouring: a shuffled Hadamard column for each colour."""
    # Shuffled, so that which cells lose their orthogonality when codes are lost does not follow
    # from the regular construction of the matrix.
    column = 1 + rng.permutation(count - 1)[: colour.max() + 1]
    entries = make_hadamard_columns(count, column)
    return entries[:, colour] * sign > 0


def make_prior_codes(
    lattice: tuple[int, int],
    count: int,
    links: Any,
    rng: np.random.Generator,
    *,
    apart: bool = False,
) -> NDArray[np.bool_]:
    """Give each cell a column of a Hadamard matrix that no cell strongly linked to it has.

    The error of a cell comes from the light of the cells that share its column, so a link counts by
    its squared strength, besides the distance that `make_hadamard_codes` goes by. Any prior will
    do: paths that a pilot found (`pdcd.codes.pilot.links`), a whole transport matrix, or a guess
    that falls off with distance.

    Parameters
    ----------
    lattice : (rows, cols)
        Cells of the patterns, L in all.
    count : int
        Number K of codes; a Hadamard order.
    links : sparse or dense (L, L), >= 0
        Strength of the light paths between cells, in any unit. Needs no symmetry, since a column
        shared harms both ways: the stronger way counts. The diagonal is ignored.
    rng : Generator
        Source of whatever the links leave open.
    apart : codes of one of several parts, in which other cells are to share columns
        (`pdcd.codes.colouring.colour_lattice`).

    Returns
    -------
    (K, L) bool
        Each cell lit in exactly K/2 codes, as `make_hadamard_codes` makes them; without links the
        same bits.

    Raises
    ------
    RequestError
        No Hadamard matrix of order K >= 2 can be constructed here, or the links do not fit the
        lattice, are negative or are not finite.
    """
    check_order(count)
    known = symmetrise_links(links, lattice[0] * lattice[1])
    return make_colouring_codes(
        count, *colour_lattice(lattice, count - 1, rng, known, apart=apart), rng
    )


def symmetrise_links(links: Any, cells: int) -> Any:
    """Return links as a symmetric CSR array (L, L) float64 without diagonal or zeros.

    Raises
    ------
    RequestError
        The links are not (L, L) with finite entries of at least 0.
    """
    matrix = scipy.sparse.csr_array(links, dtype=np.float64)
    if matrix.shape != (cells, cells):
        raise RequestError(
            f"links of shape {matrix.shape} do not fit a lattice of {cells} cells",
            hint=f"give a matrix of {cells} x {cells} strengths",
        )
    if not (np.isfinite(matrix.data).all() and (matrix.data >= 0.0).all()):
        raise RequestError(
            "links hold strengths that are negative or not finite", hint="clip them at 0"
        )
    both = matrix.maximum(matrix.T).tocoo()
    row, col = both.coords
    keep = (row != col) & (both.data > 0.0)
    return scipy.sparse.csr_array((both.data[keep], (row[keep], col[keep])), shape=both.shape)
