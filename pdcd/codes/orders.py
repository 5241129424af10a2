"""Hadamard matrices: which orders can be built, and any columns of them without the rest.

They are built from Sylvester's matrix of order 2, Paley's two constructions over prime fields
(1933) and Kronecker products of these. All have a first column of ones, so that every other column
sums to 0.

Hadamard columns for cells that are lit less than half of the time: partial spreads.

The columns of Sylvester's matrix of order K = 2^n are the characters ``(-1)^(a . k)`` of the codes
k, one for each a in F_2^n. The product of t of them, each as an on-off sequence, is lit in the
share p = 2^-t of all codes: those k in which t linear forms have given values. If the forms of two
cells span subspaces that meet in 0 alone, the cells are lit together in exactly p^2 K codes, the
wanted number without any error. A set of such subspaces is called a partial spread.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError

_ROWS = 64
"""Rows of a matrix whose entries are looked up together; bounds the memory."""


def is_order(order: int) -> bool:
    """Whether a Hadamard matrix of this order can be built here."""
    return _factors(order) is not None


def find_nearest_orders(order: int) -> tuple[int, ...]:
    """Nearest orders of at least 2 below and above `order`, itself one or not, for `order` >= 1."""
    below = next((n for n in range(order - 1, 1, -1) if is_order(n)), None)
    # A power of two lies in that range, and every power of two is an order.
    above = next(n for n in range(order + 1, 2 * order + 1) if is_order(n))
    return (above,) if below is None else (below, above)


def make_hadamard_columns(order: int, index: NDArray[np.int64]) -> NDArray[np.int8]:
    """Columns of a Hadamard matrix.

    Parameters
    ----------
    order : int
        An order for which `is_order` holds.
    index : (n,) int64
        Columns wanted, 0 .. order - 1; column 0 is all ones.

    Returns
    -------
    (order, n) int8
        Entries +1 and -1; two different columns have the scalar product 0.

    Raises
    ------
    RequestError
        `is_order` does not hold for `order`.
    """
    factors = _factors(order)
    if factors is None:
        near = " or ".join(str(n) for n in find_nearest_orders(max(order, 1)))
        raise RequestError(
            f"no Hadamard matrix of order {order} can be built", hint=f"take the order {near}"
        )
    columns = np.ones((1, index.size), dtype=np.int8)
    rest = index
    for factor in factors:
        rest, inner = np.divmod(rest, factor)
        outer = _primitive_columns(factor, inner)
        columns = (outer[:, None, :] * columns[None, :, :]).reshape(-1, index.size)
    return columns


@cache
def _factors(order: int) -> tuple[int, ...] | None:
    """Orders of primitive matrices whose Kronecker product has this order; None if there are none.

    Powers of two are built from Sylvester's matrix, even if others would do.
    """
    if order < 1:
        return None
    if order & (order - 1) == 0:
        return (2,) * (order.bit_length() - 1)
    if _is_paley_one(order) or _is_paley_two(order):
        return (order,)
    for first in range(2, order):
        if order % first == 0 and (first == 2 or _is_paley_one(first) or _is_paley_two(first)):
            others = _factors(order // first)
            if others is not None:
                return (first, *others)
    return None


def _is_prime(n: int) -> bool:
    return n >= 2 and all(n % d for d in range(2, int(n**0.5) + 1))


def _is_paley_one(order: int) -> bool:
    return order % 4 == 0 and _is_prime(order - 1)


def _is_paley_two(order: int) -> bool:
    return order % 4 == 0 and order // 2 % 4 == 2 and _is_prime(order // 2 - 1)


def _primitive_columns(order: int, index: NDArray[np.int64]) -> NDArray[np.int8]:
    if order == 2:
        return np.stack([np.ones_like(index), 1 - 2 * index]).astype(np.int8)
    return _paley_one(order, index) if _is_paley_one(order) else _paley_two(order, index)


def _residues(q: int) -> NDArray[np.int8]:
    """Quadratic character modulo the prime q: 0 at 0, +1 at squares, -1 elsewhere; (q,) int8."""
    character = np.full(q, -1, dtype=np.int8)
    character[np.arange(1, q, dtype=np.int64) ** 2 % q] = 1
    character[0] = 0
    return character


def _circulant(character: NDArray[np.int8], column: NDArray[np.int64]) -> NDArray[np.int8]:
    """``character[(row - column) % q]``, (q, columns) int8, for all q rows.

    In blocks of rows: indices take eight times as much memory as what they pick.
    """
    q = character.size
    found = np.empty((q, column.size), dtype=np.int8)
    for start in range(0, q, _ROWS):
        row = np.arange(start, min(start + _ROWS, q))[:, None]
        found[start : start + _ROWS] = character[(row - column) % q]
    return found


def _paley_one(order: int, index: NDArray[np.int64]) -> NDArray[np.int8]:
    """Columns of Paley's first matrix, I + S with S skew, rows below the first negated."""
    q = order - 1
    character = _residues(q)
    character[0] = 1  # the identity falls on the zeros of the character
    columns = np.ones((order, index.size), dtype=np.int8)
    inner = index > 0
    columns[1:, inner] = -_circulant(character, index[inner] - 1)
    return columns


def _paley_two(order: int, index: NDArray[np.int64]) -> NDArray[np.int8]:
    """Columns of Paley's second matrix, C x [[1, 1], [1, -1]] + I x [[1, -1], [-1, -1]].

    C is the symmetric conference matrix of order q + 1, and x the Kronecker product.
    """
    q = order // 2 - 1
    block, side = np.divmod(index, 2)
    conference = np.ones((q + 1, index.size), dtype=np.int8)
    conference[0, block == 0] = 0
    inner = block > 0
    conference[1:, inner] = _circulant(_residues(q), block[inner] - 1)
    identity = (np.arange(q + 1)[:, None] == block).astype(np.int8)
    flip = (1 - 2 * side).astype(np.int8)  # +1 for the left column of a block, -1 for the right
    upper = conference + identity * flip
    lower = conference * flip - identity
    columns = np.stack([upper, lower], axis=1).reshape(order, index.size)
    columns[1] *= -1  # the one row that does not begin with +1
    return columns


def count_spread_subspaces(n: int, t: int) -> int:
    """How many subspaces `make_partial_spread` makes."""
    size = 0
    while n >= 2 * t:
        size += 1 << (n - t)
        n -= t
    return size + (n >= t)


def make_partial_spread(n: int, t: int) -> NDArray[np.int64]:
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


def make_spread_codes(
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
    basis = make_partial_spread(int(math.log2(count)), t)
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
