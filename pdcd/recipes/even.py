"""The low-rank part of a matrix, also where some of its entries have nothing to do with it.

Light that is kept evenly (a uniform weight, an illumination, regions, few products of two sides) is
a matrix of low rank. Matched cells and near bands lie on top of it: they change few entries, but
those by much. So the part is sought that most entries agree with, and the others are not asked.

It is found in a sample of rows and columns and then carried over to all of them, which costs a few
passes over the matrix at most.
"""

from __future__ import annotations

import numpy as np

from pdcd.arrays import Floats

_SAMPLE = 192
"""Rows and columns of the sample."""
_MOST_RANK = 6
"""Largest rank that is sought; each more is one more product of two sides."""
_CELLS_A_RANK = 8
"""Cells that there must be for each rank: few cells are fitted by anything."""
_AGREE = 0.7
"""Share of the entries that must agree with a part."""
EQUAL_WEIGHTS = 1e-6
"""Weights that differ by less, over the largest one, are the same: numbers are given in single
precision, or with a few digits."""
_NOISE = 1e-2
"""Largest deviation, over the largest weight, of the entries that agree with a part, if the numbers
are noisy."""
_ROUNDS = 60
"""Steps of each fit at most; a few do where few entries disagree."""
_BEYOND = 2.0
"""Deviation, over that which the share `_AGREE` stays within, from which an entry is trusted
little."""
_SLOW = 0.9
"""Deviation over that of the step before from which a fit gets no better."""
_PATIENCE = 6
"""Such steps that end it."""
_LEAST = 1e-13
"""Weight of having no side at all, over that of the entries."""
_EXACT = 1e-12
"""Deviation over the largest weight at which a fit can get no better."""


def find_even_part(matrix: Floats) -> tuple[Floats, Floats] | None:
    """Sides of the even part of a matrix (N, N): camera and projector, (r, N) each.

    Their products add up to it, with r of at most `_MOST_RANK`; r is 0 where most entries are 0.
    None where no part is agreed with by the share `_AGREE` of all entries.

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
    # Each column of the matrix in that base, from the rows of the sample; then each row in what
    # these columns span.
    projector = _carried(matrix[rows], base, largest)
    onto, _ = np.linalg.qr(projector[:, columns].T)
    camera = _carried(matrix[:, columns].T, onto, largest)
    across = np.linalg.lstsq(projector[:, columns].T, onto, rcond=None)[0]
    return camera, across.T @ projector


def _basis(sample: Floats, largest: float) -> Floats | None:
    """An orthonormal base (some, r) of the columns of the sample's even part; None: there is none.

    The least rank with which it is exact; of noisy numbers, the least that will do.
    """
    noisy = None
    plain = np.linalg.svd(sample)[0]
    base, trust = np.zeros((len(sample), 0)), np.ones(sample.shape)
    for rank in range(1, min(_MOST_RANK, len(sample) // _CELLS_A_RANK) + 1):
        # One side more, of all that is left: fits that trust few entries must not hide it. Or all
        # sides anew.
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
    """A part of the rank of a base (some, r) to begin with: its base, how far each entry is
    trusted in its column, and by how much those that agree are off, at the worst row or column."""
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
    """Coefficients (r, n) of columns (some, n) in an orthonormal base, by the entries that agree.

    What disagrees is judged for each column on its own.
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
    """What most entries of each column are off by, but no less than a fit can reach."""
    return np.maximum(_agreed_along(size, 0), _EXACT * largest)


def _trusted(size: Floats, usual: Floats) -> Floats:
    """How far entries are trusted that are off by `size`, 0 to 1, where most are by `usual`.

    (Geman and McClure's weights: what is far off has no say.)
    """
    return np.asarray((1.0 + (size / (_BEYOND * usual)) ** 2) ** -2.0)


def _asked(seen: Floats, base: Floats, trust: Floats) -> Floats:
    """Least-squares coefficients (r, n) of columns (some, n) in a base, entries by their trust."""
    rank = base.shape[1]
    if not rank:
        return np.zeros((0, seen.shape[1]))
    products = (base[:, :, None] * base[:, None, :]).reshape(len(base), rank**2)
    grams = (trust.T @ products).reshape(seen.shape[1], rank, rank)
    told = (trust * seen).T @ base
    scale = np.trace(grams, axis1=1, axis2=2)[:, None, None]
    grams += _LEAST * np.maximum(scale, _LEAST) * np.eye(rank)  # what no entry tells stays 0
    return np.asarray(np.linalg.solve(grams, told[..., None])[..., 0].T)


def _agreed_along(size: Floats, axis: int) -> Floats:
    """The deviation within which `_AGREE` of each column (axis 0) or row (axis 1) stays."""
    place = int(_AGREE * (size.shape[axis] - 1))
    return np.asarray(np.partition(size, place, axis=axis).take(place, axis=axis))


def _agreed(size: Floats) -> float:
    """The same of all entries."""
    place = int(_AGREE * (size.size - 1))
    return float(np.partition(size, place, axis=None)[place])
