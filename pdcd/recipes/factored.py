"""What a matrix of weights is made of: few distinct rows, or few products of two sides.

Both are looked for without more work than it takes to see that there are none: a matrix over all
pairs of cells is large, and most have neither.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RANK_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""
WHOLE_CELLS = 1024
"""Cells up to which all singular values are computed, in less than a second. Beyond, a sketch
tells first how many there are: the product with a few random vectors has the same rank."""
MORE = 8
"""Random vectors beyond the largest rank that is looked for."""


def distinct_rows(matrix: Floats, most: int) -> tuple[Floats, NDArray[np.int64]] | None:
    """The different rows of a matrix (N, N), sorted, (D, N), and which of them each row is, (N,).

    None where there are more than `most`; that is seen after as many rows.
    """
    number: dict[bytes, int] = {}
    first, which = [], np.empty(len(matrix), dtype=np.int64)
    for n, row in enumerate(matrix):
        key = hashlib.blake2b((row + 0.0).tobytes(), digest_size=32).digest()  # -0.0 is 0.0
        if key not in number:
            if len(number) == most:
                return None
            number[key] = len(number)
            first.append(n)
        which[n] = number[key]
    rows, order = np.unique(matrix[first], axis=0, return_inverse=True)
    return rows, order.ravel()[which]


def factors_of(matrix: Floats, most: int) -> tuple[Floats, Floats] | None:
    """Sides of a matrix (N, N) of a rank D of at most `most`: (D, N) each, camera and projector.

    The matrix is ``camera.T @ projector``; both sides have equal norms. None for a higher rank.
    """
    if len(matrix) <= WHOLE_CELLS:
        u, s, vt = np.linalg.svd(matrix)
    else:
        sketch = _sketch(matrix, most)
        if sketch is None:
            return None
        small, s, vt = np.linalg.svd(sketch.T @ matrix, full_matrices=False)
        u = sketch @ small
    rank = int(np.sum(s > RANK_TOLERANCE * s[0]))
    if rank > most:
        return None
    root = np.sqrt(s[:rank])
    return (u[:, :rank] * root).T, vt[:rank] * root[:, None]


def _sketch(matrix: Floats, most: int) -> Floats | None:
    """An orthonormal basis of the columns of a matrix, (N, D), or None when D is beyond `most`."""
    count = min(most + MORE, len(matrix))
    rng = np.random.Generator(np.random.PCG64(0))  # any vectors will do, but always the same
    seen = matrix @ rng.standard_normal((len(matrix), count))
    # Any so many of these columns span as much as any others, so there is no need to choose them.
    size = np.abs(np.diag(np.linalg.qr(seen, mode="r")))
    rank = int(np.sum(size > 0.1 * RANK_TOLERANCE * size.max()))
    return None if rank > most else np.linalg.qr(seen[:, :rank])[0]
