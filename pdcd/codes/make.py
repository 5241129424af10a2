"""Codes as a value, and the one function that makes them by the name of a family."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.codes.hadamard import make_hadamard_codes
from pdcd.codes.independent import make_balanced_codes, make_bernoulli_codes, make_rademacher_codes
from pdcd.codes.singer import make_projective_plane_codes
from pdcd.errors import RequestError

_Family = Callable[[tuple[int, int], int, float, np.random.Generator], NDArray[np.bool_]]
"""(lattice, count K, p, rng) -> (K, L) bool: which cells the projector lights in each code."""

CODE_FAMILIES: dict[str, _Family] = {
    "bernoulli": make_bernoulli_codes,
    "rademacher": make_rademacher_codes,
    "balanced": make_balanced_codes,
    "hadamard": make_hadamard_codes,
    "singer": make_projective_plane_codes,
}


@dataclass(frozen=True, eq=False)
class Codes:
    """K primal/dual pairs over a lattice of L = rows x cols cells, row by row: (K, L) bool each,
    cells that the projector lights, and at which the mask is open.
    """

    primal: NDArray[np.bool_]
    dual: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.primal)


def make_codes(
    family: str,
    lattice: tuple[int, int],
    count: int,
    *,
    dual: Literal["complement", "same"],
    p: float = 0.5,
    seed: int = 0,
) -> Codes:
    """Make `count` primal/dual pairs.

    Parameters
    ----------
    family : str
        A key of `CODE_FAMILIES`.
    lattice : (rows, cols)
        Cells of the patterns.
    count : int
        Number K of independent pairs.
    dual : "complement" or "same"
        m = 1 - i keeps indirect light only (diagonal of the probing matrix exactly 0, elsewhere
        p(1-p) on average); m = i keeps direct light and the fraction p of indirect light (p on
        the diagonal, p^2 elsewhere). Paper, section 5.
    p : float
        Share of codes in which a cell is lit, 0 < p < 1; for `make_projective_plane_codes` codes
        the share of indirect light that m = i keeps, which is slightly more.
    seed : int
        Non-negative; one seed always gives the same codes.

    Raises
    ------
    RequestError
        An argument is out of range, or the family cannot serve this `count` and `p`.
    """
    _check(family, lattice, count, dual, p, seed)
    # The bit generator is named because default_rng may change it and old runs must replay.
    rng = np.random.Generator(np.random.PCG64(seed))
    primal = CODE_FAMILIES[family](lattice, count, p, rng)
    return Codes(primal, primal if dual == "same" else ~primal)


def _check(
    family: str, lattice: tuple[int, int], count: int, dual: str, p: float, seed: int
) -> None:
    """Raise RequestError for an argument that is out of range."""
    rows, cols = lattice
    if rows < 1 or cols < 1:
        raise RequestError(
            f"a lattice of {rows} x {cols} cells is empty", hint="give at least 1 row and 1 column"
        )
    if count < 1:
        raise RequestError(f"{count} codes were asked for", hint="take at least 1 code")
    if not 0.0 < p < 1.0:
        raise RequestError(
            f"p = {p} is not between 0 and 1", hint="take p = 0.5 for indirect light"
        )
    if seed < 0:
        raise RequestError(f"seed {seed} is negative", hint="take a seed of 0 or more")
    if dual not in ("complement", "same"):
        raise RequestError(f"unknown dual {dual!r}", hint="take 'complement' or 'same'")
    if family not in CODE_FAMILIES:
        raise RequestError(
            f"unknown code family {family!r}", hint=f"take one of {', '.join(CODE_FAMILIES)}"
        )
