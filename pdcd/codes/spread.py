"""Hadamard columns for cells that are lit less than half of the time: partial spreads.

The columns of Sylvester's matrix of order K = 2^n are the characters ``(-1)^(a . k)`` of the codes
k, one for each a in F_2^n. The product of t of them, each as an on-off sequence, is lit in the
share p = 2^-t of all codes: those k in which t linear forms have given values. Two cells of which
the forms span subspaces that meet in 0 alone are lit together in exactly p^2 K codes, the wanted
number without any error. A set of such subspaces is called a partial spread.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def spread_size(n: int, t: int) -> int:
    """How many subspaces `partial_spread` makes."""
    size = 0
    while n >= 2 * t:
        size += 1 << (n - t)
        n -= t
    return size + (n >= t)


def partial_spread(n: int, t: int) -> NDArray[np.int64]:
    """Subspaces of dimension t of F_2^n, any two of which meet in 0 alone.

    Beutelspacher's construction (1975): in F_2^t x F_(2^m) with n = t + m, the graphs of
    ``x -> alpha x`` for all alpha of the field; they leave out 0 x F_(2^m), which is treated in the
    same way. It gives a whole spread, ``(2^n - 1) / (2^t - 1)`` subspaces, where t divides n.

    Returns
    -------
    (spread_size(n, t), t) int64
        A basis of each subspace; vectors as the bits of a number below 2^n.
    """
    parts = []
    while n >= 2 * t:
        m = n - t
        image = np.arange(1 << m)  # alpha times z^0
        basis = []
        for j in range(t):
            basis.append((1 << (m + j)) | image)
            image = image << 1
            image = np.where(image >> m & 1, image ^ _irreducible(m), image)
        parts.append(np.stack(basis, axis=1))
        n = m
    if n >= t:
        parts.append(1 << np.arange(t)[None, :])
    return np.concatenate(parts) if parts else np.zeros((0, t), dtype=np.int64)


def spread_codes(
    count: int, t: int, space: NDArray[np.int64], phase: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Codes of cells with given subspaces and phases.

    Parameters
    ----------
    count : K = 2^n
    t : log2(1 / p)
    space, phase : (L,) int64
        Number of the subspace of each cell, and which values its t forms must have: 0 .. 2^t - 1.

    Returns
    -------
    (K, L) bool
        Each cell lit in K / 2^t codes.
    """
    code = np.arange(count)
    basis = partial_spread(int(math.log2(count)), t)
    used, which = np.unique(space, return_inverse=True)
    seen = np.zeros((count, used.size), dtype=np.int16)
    for j in range(t):
        odd = np.bitwise_count(code[:, None] & basis[used, j]) & 1
        seen |= odd.astype(np.int16) << j
    lit = np.empty((count, space.size), dtype=np.bool_)
    for k in range(count):  # row by row, so that nothing larger than the codes is held
        np.equal(seen[k][which], phase, out=lit[k])
    return lit


def _irreducible(m: int) -> int:
    """The smallest irreducible polynomial of degree m over F_2, as the bits of its coefficients."""
    return next(p for p in range(1 << m, 2 << m) if _is_irreducible(p, m))


def _is_irreducible(p: int, m: int) -> bool:
    return all(_remainder(p, d) for d in range(2, 2 << (m // 2)))


def _remainder(p: int, divisor: int) -> int:
    size = divisor.bit_length()
    while p.bit_length() >= size:
        p ^= divisor << (p.bit_length() - size)
    return p
