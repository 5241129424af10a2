"""Singer codes: direct light and exactly 1/(q+1) of the indirect, in q^2 + q + 1 codes.

The lines of a projective plane of order q are a 2-design: v = q^2 + q + 1 points and as many lines,
q + 1 points on a line, and any two lines meet in exactly one point. Codes are points and cells are
lines: a cell is lit in q + 1 codes, together with any cell of another line in exactly one. With
m = i the probing matrix is ``q I + 1 1^T``, direct light and 1/(q+1) of the rest without error, as
long as there are no more cells than lines.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from pdcd.codes.colouring import colour_lattice
from pdcd.errors import RequestError

LARGEST = 31
"""Largest order q of the planes made here; its codes come in sets of 993."""


def make_projective_plane_codes(
    lattice: tuple[int, int], count: int, p: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Give each cell a line of a projective plane; cells with the same line keep far apart.

    Parameters
    ----------
    p : float
        The share of indirect light that is kept, 1/(q+1) with q a power of a prime. Cells are lit
        in the somewhat smaller share ``(q + 1) / v`` of the codes.
    count : int
        A multiple of v. Each set of v codes gives the lines out anew, so that cells which share a
        line in one set do not in the next.

    Returns
    -------
    (K, L) bool
        Over a lattice of more cells than lines, two cells with the same line are seen q + 1 times
        in a set; light from beyond such distances counts ``(q + 1) / v`` on average.

    Raises
    ------
    RequestError
        There is no plane of that order here, or `count` is no multiple of v.
    """
    lines, q = count_plane_lines(p), round(1.0 / p) - 1
    if count % lines:
        near = [n for n in (count // lines * lines, -(-count // lines) * lines) if n]
        raise RequestError(
            f"singer codes of p = 1/{q + 1} do not come in sets of K = {count}",
            hint=f"take {' or '.join(str(n) for n in near)} codes",
        )
    on = np.zeros(lines, dtype=np.bool_)
    on[list(make_difference_set(q))] = True
    sets = []
    for _ in range(count // lines):
        colour, _ = colour_lattice(lattice, lines, rng)
        line = rng.permutation(lines)[colour]
        sets.append(on[(np.arange(lines)[:, None] - line) % lines])
    return np.concatenate(sets)


def count_plane_lines(p: float) -> int:
    """Codes in a set, v = q^2 + q + 1, for the share p = 1/(q+1) of indirect light.

    Raises
    ------
    RequestError
        There is no plane of that order here.
    """
    q = round(1.0 / p) - 1
    if abs(p * (q + 1) - 1.0) > 1e-9 or not 2 <= q <= LARGEST or _prime_of(q) is None:
        shares = ", ".join(f"1/{n + 1}" for n in range(2, LARGEST + 1) if _prime_of(n))
        raise RequestError(
            f"singer codes keep the share 1/(q+1) of indirect light, not p = {p:g}",
            hint=f"take the goal fraction with a p of {shares}",
        )
    return q * q + q + 1


@cache
def make_difference_set(q: int) -> tuple[int, ...]:
    """Singer's difference set (1938): q + 1 numbers below v = q^2 + q + 1.

    Every number 1 .. v - 1 is the difference of exactly one pair of them, modulo v. They are the
    discrete logarithms, modulo v, of the elements of a plane through 0 in the field of q^3 elements
    over that of q.

    Raises
    ------
    RequestError
        q is no power of a prime from 2 to `LARGEST`.
    """
    prime = _prime_of(q)
    if prime is None or q > LARGEST:
        raise RequestError(
            f"no projective plane of order {q} is made here",
            hint=f"take a power of a prime up to {LARGEST}",
        )
    degree = 3 * next(e for e in range(1, 6) if prime**e == q)
    powers = _powers(prime, degree)
    # Numbers with the digits of elements, so that the logarithm is a table.
    place = prime ** np.arange(degree)
    logarithm = np.zeros(prime**degree, dtype=np.int64)
    logarithm[powers @ place] = np.arange(len(powers))
    lines = q * q + q + 1
    ground = np.concatenate([np.zeros((1, degree), dtype=np.int64), powers[::lines]])
    plane = (powers[1] + ground) % prime
    return tuple(sorted({0, *(int(n) % lines for n in logarithm[plane @ place])}))


def _powers(prime: int, degree: int) -> NDArray[np.int64]:
    """All powers of a generator of the field of prime^degree elements, in digits: (., degree)."""
    order = prime**degree - 1
    for number in range(1, prime**degree):
        tail = [number // prime**k % prime for k in range(degree)]  # z^degree = tail
        # Lists: arrays of a few digits would take several times as long.
        one = [1] + [0] * (degree - 1)
        element, powers = one, [one]
        while len(powers) <= order:
            last, moved = element[-1], [0, *element[:-1]]
            element = [(a + last * t) % prime for a, t in zip(moved, tail, strict=True)]
            if element == one:
                break
            powers.append(element)
        if element == one and len(powers) == order:  # earlier, z generates less than the field
            return np.array(powers, dtype=np.int64)
    raise AssertionError(f"the field of {prime}^{degree} elements has a generator")


def _prime_of(q: int) -> int | None:
    """The prime of which q >= 2 is a power; None if there is none."""
    prime = next(d for d in range(2, q + 1) if q % d == 0)
    while q % prime == 0:
        q //= prime
    return prime if q == 1 else None
