"""Codes for off-axis benches, whose direct light stays on epipolar lines: rows of cells."""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.arrays import Bools
from pdcd.codes.hadamard import check_order, make_prior_codes
from pdcd.codes.orders import make_hadamard_columns
from pdcd.errors import RequestError


def make_matched_codes(lattice: tuple[int, int], count: int, rng: np.random.Generator) -> Bools:
    """Hadamard codes in which no two cells of a row share one, where K allows it.

    A camera cell sees light from some place in its row, which depends on the depth. So the light
    that is kept of a depth must not depend on chance: all columns of a row are kept apart first,
    near cells of other rows next. Raises RequestError where there is no Hadamard matrix of order K.

    Returns
    -------
    (K, L + rows) bool
        After the codes of the cells, one more for each row, which none of its cells has.
    """
    rows, cols = lattice[0], lattice[1] + 1
    near = np.abs(np.subtract.outer(np.arange(cols), np.arange(cols)))
    line = scipy.sparse.csr_array(((near > 0) & (near < count - 1)).astype(np.float64))
    links = scipy.sparse.kron(scipy.sparse.eye_array(rows), line, format="csr")
    codes = make_prior_codes((rows, cols), count, links, rng).reshape(count, rows, cols)
    return np.concatenate([codes[:, :, :-1].reshape(count, -1), codes[:, :, -1]], axis=1)


def make_comb_codes(
    lattice: tuple[int, int], count: int, period: int, rng: np.random.Generator
) -> Bools:
    """Codes (K, L) that light one cell of each row, or some that are `period` apart: a comb.

    In `period` codes a comb passes all cells once; then the phases of rows are drawn anew. Two
    cells of one row that are nearer than the period are never lit together. So a mask that is
    closed while any of W neighbours is lit keeps exactly all light from the rest of the row, and
    all but the share W / period, on average, of light from other rows. Unused codes are dark.

    Raises RequestError for fewer codes than the period.
    """
    if count < period:
        raise RequestError(
            f"{count} codes do not light all cells of a row in turn",
            hint=f"take at least {period} codes, or {period} for each part",
        )
    rows, cols = lattice
    codes = np.zeros((count, rows, cols), dtype=np.bool_)
    column = np.arange(cols)
    for start in range(0, count - period + 1, period):
        turn = (column + rng.integers(period, size=rows)[:, None]) % period
        codes[start + turn, np.arange(rows)[:, None], column] = True
    return codes.reshape(count, -1)


def make_row_codes(lattice: tuple[int, int], count: int, rng: np.random.Generator) -> Bools:
    """Codes (K, L) that are the same all along each row: a column of a Hadamard matrix for each.

    The constant column may be used, too: shown together with their complements all K may. With at
    least as many codes as rows no column is used twice; else rows that share one are K apart, with
    random signs. Raises RequestError where there is no Hadamard matrix of order K.
    """
    check_order(count)
    rows, cols = lattice
    column = rng.permutation(count)[np.arange(rows) % count]
    sign = rng.choice(np.array([-1, 1], dtype=np.int8), rows)
    bits = make_hadamard_columns(count, column) * sign > 0
    return np.repeat(bits, cols, axis=1)
