"""What a matrix of weights is made of: few distinct rows, or few products of two sides.

Both are looked for without more work than it takes to see that there are none: a matrix over all
pairs of cells is large, and most have neither.

Products of two sides without negative weights are exact: light and masks can show them at once.

A matrix of rank r is ``camera.T @ projector`` in many ways: any invertible r x r matrix Q may go
between the sides. The aim is one that leaves both sides without negative entries (footnote 4 of the
paper, E11). Up to rank 2 there always is one, for a matrix without negative weights. Beyond, there
need not be, and to find one is hard in general. So a few ways are tried, and each is checked: the
sides that are returned are exact, or none are returned.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats

_RANK_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""
WHOLE_CELLS = 1024
"""Cells up to which all singular values are computed, in less than a second. Beyond, a sketch first
shows how many there are: the product with a few random vectors has the same rank."""
_MORE = 8
"""Random vectors beyond the largest rank that is looked for."""


def find_distinct_rows(matrix: Floats, most: int) -> tuple[Floats, NDArray[np.int64]] | None:
    """The different rows of a matrix (N, N), sorted, (D, N), and which of them each row is, (N,).

    None where there are more than `most`; this is found after as many rows.
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


def factor_matrix(matrix: Floats, most: int) -> tuple[Floats, Floats] | None:
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
    rank = int(np.sum(s > _RANK_TOLERANCE * s[0]))
    if rank > most:
        return None
    root = np.sqrt(s[:rank])
    return (u[:, :rank] * root).T, vt[:rank] * root[:, None]


def _sketch(matrix: Floats, most: int) -> Floats | None:
    """An orthonormal basis of the columns of a matrix, (N, D), or None when D is beyond `most`."""
    count = min(most + _MORE, len(matrix))
    rng = np.random.Generator(np.random.PCG64(0))  # any vectors will do, but always the same
    seen = matrix @ rng.standard_normal((len(matrix), count))
    # Any so many of these columns span as much as any others, so there is no need to choose them.
    size = np.abs(np.diag(np.linalg.qr(seen, mode="r")))
    rank = int(np.sum(size > 0.1 * _RANK_TOLERANCE * size.max()))
    return None if rank > most else np.linalg.qr(seen[:, :rank])[0]


_ROUNDING = 1e-9
"""Negative entries of a side, over its largest, that are rounding errors and are set to 0."""
_STEPS = 400
"""Steps of the search from one start."""
_MENDING = 500
"""Steps that remove negative entries from the result of the search."""
_STARTS = 3
"""Starts of the search."""
_MOST_CELLS = 384
"""Cells of each side that the search uses; the others are checked afterwards."""


def find_nonnegative_sides(camera: Floats, projector: Floats) -> tuple[Floats, Floats] | None:
    """Sides (r, N) each with the same product, without negative entries; None if none were found.

    Both given sides must have full rank.
    """
    for rows in _candidates(camera, projector):
        # New projector sides `rows`: they determine the mixture of the old ones.
        mix = np.linalg.lstsq(projector.T, rows.T, rcond=None)[0].T
        if np.linalg.cond(mix) > 1.0 / _ROUNDING:
            continue
        sides = np.linalg.solve(mix.T, camera), mix @ projector
        if all(_is_positive(side) for side in sides):
            return np.maximum(sides[0], 0.0), np.maximum(sides[1], 0.0)
    return None


def _candidates(camera: Floats, projector: Floats) -> Iterator[Floats]:
    """Projector sides (r, N) to try."""
    rank = len(camera)
    if rank == 1:
        yield projector * np.sign(projector[0, np.argmax(np.abs(projector[0]))])
        return
    # Rows of the matrix that all others lie between, or the same for its columns.
    yield _corners(camera, projector)
    onto = _corners(projector, camera)
    mix = np.linalg.lstsq(camera.T, onto.T, rcond=None)[0].T
    if np.linalg.cond(mix) < 1.0 / _ROUNDING:
        yield np.linalg.solve(mix.T, projector)
    for start in range(_STARTS):
        yield _searched(camera, projector, start)


def _corners(camera: Floats, projector: Floats) -> Floats:
    """The r rows of the matrix that are furthest from each other, among rows scaled to equal sums
    (successive projection; Araujo and others 2001)."""
    sums = camera.T @ projector.sum(axis=1)
    usable = np.flatnonzero(sums > _ROUNDING * np.abs(sums).max())
    points = (camera[:, usable] / sums[usable]).T  # coefficients of the rows in the old sides
    gram = projector @ projector.T
    root = np.linalg.cholesky(gram + np.eye(len(gram)) * np.trace(gram) * 1e-15)
    left = points @ root
    chosen = []
    for _ in range(len(camera)):
        best = int(np.argmax(np.einsum("nr,nr->n", left, left)))
        chosen.append(best)
        along = left[best] / np.linalg.norm(left[best])
        left = left - np.outer(left @ along, along)
    return np.asarray(points[chosen] @ projector)


def _searched(camera: Floats, projector: Floats, start: int) -> Floats:
    """Projector sides by hierarchical alternating least squares, from random ones (Cichocki and
    Phan 2009), on some of the cells."""
    rng = np.random.Generator(np.random.PCG64(start))
    cells = camera.shape[1]
    some = np.sort(rng.permutation(cells)[:_MOST_CELLS])
    matrix = np.maximum(camera[:, some].T @ projector[:, some], 0.0)
    rank = len(camera)
    left, right = rng.random((len(some), rank)), rng.random((rank, len(some)))
    for _ in range(_STEPS):
        for target, one, other in ((matrix, left, right), (matrix.T, right.T, left.T)):
            products, grams = target @ other.T, other @ other.T
            for d in range(rank):
                more = products[:, d] - one @ grams[:, d]
                one[:, d] = np.maximum(one[:, d] + more / max(grams[d, d], 1e-300), 0.0)
    mix = np.asarray(np.linalg.lstsq(projector[:, some].T, right.T, rcond=None)[0].T, np.float64)
    return np.asarray(_mended(mix, camera, projector) @ projector)


def _mended(mix: Floats, camera: Floats, projector: Floats) -> Floats:
    """A mixture (r, r) near another with less negative entries in both sides: their squares are
    minimised by gradient descent (L-BFGS-B)."""
    # A sixth of what a process for a job loads, and few jobs need it.
    import scipy.optimize

    rank = len(mix)

    def negative(flat: Floats) -> tuple[float, Floats]:
        mixing = flat.reshape(rank, rank)
        if not np.linalg.cond(mixing) < 1.0 / _ROUNDING:
            return np.inf, np.zeros_like(flat)
        lit = np.minimum(mixing @ projector, 0.0)
        inverse = np.linalg.inv(mixing).T
        seen = np.minimum(inverse @ camera, 0.0)
        slope = lit @ projector.T - inverse @ (camera @ seen.T) @ inverse
        return float(np.sum(lit**2) + np.sum(seen**2)), 2.0 * slope.ravel()

    found = scipy.optimize.minimize(
        negative, mix.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": _MENDING}
    )
    return np.asarray(found.x).reshape(rank, rank)


def _is_positive(side: Floats) -> bool:
    return bool(np.isfinite(side).all() and side.min() >= -_ROUNDING * side.max())
