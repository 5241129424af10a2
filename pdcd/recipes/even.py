"""The low-rank part of a matrix, even if some of its entries are not part of it.

Light that is kept evenly (a uniform weight, an illumination, regions, few products of two sides) is
a matrix of low rank. Matched cells and near bands lie on top of it: they change few entries, but
those by much. So the low-rank part is fitted to most entries, and the others are ignored.

It is found in a sample of rows and columns and then extended to all of them, which costs a few
passes over the matrix at most.
"""

from __future__ import annotations

import numpy as np

from pdcd.arrays import Floats

_SAMPLE = 192
"""Rows and columns of the sample."""
_MOST_RANK = 6
"""Largest rank that is tried; each is one more product of two sides."""
_CELLS_A_RANK = 8
"""Least number of cells for each rank: few cells can be fitted by anything."""
_AGREE = 0.7
"""Share of the entries that must agree with a part."""
EQUAL_WEIGHTS = 1e-6
"""Relative difference, over the largest weight, up to which weights are the same: numbers are given
in single precision, or with a few digits."""
_NOISE = 1e-2
"""Largest deviation, over the largest weight, of the entries that agree with a part, for noisy
numbers."""
_ROUNDS = 60
"""Most iterations of each fit; a few are enough where few entries disagree."""
_BEYOND = 2.0
"""Deviation, over the one within which the share `_AGREE` stays, from which an entry gets little
weight."""
_SLOW = 0.9
"""Ratio of successive deviations from which a fit no longer improves."""
_PATIENCE = 6
"""Number of such iterations after which the fit ends."""
_LEAST = 1e-13
"""Regularisation of the least squares, over the weight of the entries."""
_EXACT = 1e-12
"""Deviation over the largest weight at which a fit cannot improve."""


def find_even_part(matrix: Floats) -> tuple[Floats, Floats] | None:
    """Sides of the even part of a matrix (N, N): camera and projector, (r, N) each.

    Their products add up to it, with r of at most `_MOST_RANK`; r is 0 where most entries are 0.
    None if no part agrees with the share `_AGREE` of all entries.

    The same matrix always gives the same sides.
    """
    cells = len(matrix)
    largest = max(float(matrix.max()), -float(matrix.min()))
    some = min(_SAMPLE, cells)
    rng = np.random.Generator(np.random.PCG64(0))  # any rows and columns, but always the same
    rows, columns = (np.sort(rng.permutation(cells)[:some]) for _ in range(2))
    sample = matrix[np.ix_(rows, columns)]
    if _agreed(np.abs(sample)) <= EQUAL_WEIGHTS * largest:
        return np.zeros((0, cells)), np.zeros((0, cells))
    base = _basis(sample, largest)
    if base is None:
        return None
    # Each column of the matrix in that base, from the rows of the sample; then each row in the
    # space that these columns span.
    projector = _carried(matrix[rows], base, largest)
    onto, _ = np.linalg.qr(projector[:, columns].T)
    camera = _carried(matrix[:, columns].T, onto, largest)
    across = np.linalg.lstsq(projector[:, columns].T, onto, rcond=None)[0]
    return camera, across.T @ projector


def _basis(sample: Floats, largest: float) -> Floats | None:
    """An orthonormal base (some, r) of the columns of the sample's even part; None: there is none.

    It has the least rank with which the part is exact, or good enough for noisy numbers.
    """
    noisy = None
    plain = np.linalg.svd(sample)[0]
    base, trust = np.zeros((len(sample), 0)), np.ones(sample.shape)
    for rank in range(1, min(_MOST_RANK, len(sample) // _CELLS_A_RANK) + 1):
        # Start with one more side, of all that is left: fits that trust few entries must not hide
        # it. Or start with all sides anew.
        rest = sample - base @ _asked(sample, base, trust)
        more = np.linalg.svd(rest)[0][:, :1]
        starts = [np.concatenate([base, more], axis=1), plain[:, :rank]]
        fits = [_fit(sample, start, largest) for start in starts[rank == 1 :]]
        base, trust, off = min(fits, key=lambda fit: fit[2])
        if off <= EQUAL_WEIGHTS * largest:
            return base
        if noisy is None and off <= _NOISE * largest:
            noisy = base
    return noisy


def _fit(sample: Floats, base: Floats, largest: float) -> tuple[Floats, Floats, float]:
    """Fits a part, starting from a base (some, r): its base, the trust in each entry of a column,
    and the deviation of the entries that agree, in the worst row or column."""
    trust = np.ones(sample.shape)
    off, stuck = np.inf, 0
    for _ in range(_ROUNDS):
        found = _asked(sample, base, trust)
        onto, _ = np.linalg.qr(found.T)
        size = np.abs(sample - base @ found)
        trust_in_row = _trusted(size.T, _floor(size.T, largest))
        base, _ = np.linalg.qr(_asked(sample.T, onto, trust_in_row).T)
        size = np.abs(sample - base @ _asked(sample, base, trust))
        trust = _trusted(size, _floor(size, largest))
        # Each row and each column must agree, not only most of them.
        before, off = off, max(float(_agreed_along(size, axis).max()) for axis in (0, 1))
        stuck = stuck + 1 if off > _SLOW * before else 0
        if off <= _EXACT * largest or stuck == _PATIENCE:
            break
    return base, trust, off


def _carried(seen: Floats, base: Floats, largest: float) -> Floats:
    """Coefficients (r, n) of columns (some, n) in an orthonormal base, from the entries that agree.

    Which entries disagree is decided for each column by itself.
    """
    trust = np.ones(seen.shape)
    for _ in range(_ROUNDS):
        found = _asked(seen, base, trust)
        size = np.abs(seen - base @ found)
        off = _agreed_along(size, 0)
        trust = _trusted(size, _floor(size, largest))
        if off.max() <= _EXACT * largest:
            break
    return _asked(seen, base, trust)


def _floor(size: Floats, largest: float) -> Floats:
    """Deviation of most entries of each column, but no less than a fit can reach."""
    return np.maximum(_agreed_along(size, 0), _EXACT * largest)


def _trusted(size: Floats, usual: Floats) -> Floats:
    """Trust, 0 to 1, in entries that deviate by `size`, where most deviate by `usual`.

    (Geman and McClure's weights: outliers hardly count.)
    """
    return np.asarray((1.0 + (size / (_BEYOND * usual)) ** 2) ** -2.0)


def _asked(seen: Floats, base: Floats, trust: Floats) -> Floats:
    """Least-squares coefficients (r, n) of columns (some, n) in a base, weighted by `trust`."""
    rank = base.shape[1]
    if not rank:
        return np.zeros((0, seen.shape[1]))
    products = (base[:, :, None] * base[:, None, :]).reshape(len(base), rank**2)
    grams = (trust.T @ products).reshape(seen.shape[1], rank, rank)
    told = (trust * seen).T @ base
    scale = np.trace(grams, axis1=1, axis2=2)[:, None, None]
    grams += _LEAST * np.maximum(scale, _LEAST) * np.eye(rank)  # what no entry determines stays 0
    return np.asarray(np.linalg.solve(grams, told[..., None])[..., 0].T)


def _agreed_along(size: Floats, axis: int) -> Floats:
    """The deviation within which `_AGREE` of each column (axis 0) or row (axis 1) stays."""
    place = int(_AGREE * (size.shape[axis] - 1))
    return np.asarray(np.partition(size, place, axis=axis).take(place, axis=axis))


def _agreed(size: Floats) -> float:
    """The same of all entries."""
    place = int(_AGREE * (size.size - 1))
    return float(np.partition(size, place, axis=None)[place])
