"""Hadamard codes for a scene of which something is known: linked cells never share a code."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.codes.colouring import colour_lattice
from pdcd.codes.hadamard import check_order, coloured
from pdcd.errors import RequestError


def prior_codes(
    lattice: tuple[int, int],
    count: int,
    links: Any,
    rng: np.random.Generator,
    *,
    apart: bool = False,
) -> NDArray[np.bool_]:
    """Give each cell a column of a Hadamard matrix that no cell strongly linked to it has.

    The error of a cell comes from the light of the cells that share its column, so a link counts by
    its squared strength, besides the distance that `hadamard` goes by. Any prior will do: paths
    that a pilot found (`pdcd.codes.pilot.links`), a whole transport matrix, or a guess that falls
    off with distance.

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
        Each cell lit in exactly K/2 codes, as `hadamard` makes them; without links the same bits.

    Raises
    ------
    RequestError
        No Hadamard matrix of order K >= 2 can be constructed here, or the links do not fit the
        lattice, are negative or are not finite.
    """
    check_order(count)
    known = symmetric(links, lattice[0] * lattice[1])
    return coloured(count, *colour_lattice(lattice, count - 1, rng, known, apart=apart), rng)


def symmetric(links: Any, cells: int) -> Any:
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
