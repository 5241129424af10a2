"""The codes of a pilot: how many, and which."""

from __future__ import annotations

import numpy as np

from pdcd.arrays import Bools
from pdcd.codes.make import make_codes
from pdcd.codes.orders import is_order
from pdcd.codes.pilot.matching import MOST_MATCHING_CELLS
from pdcd.errors import RequestError

LEAST_PURSUED = 32
"""Pilot photos from which single paths are looked for. With fewer, chance matches outnumber true
ones."""


MATCHED = (8, 12, 16)
"""Pilot photos with which a smooth map is looked for instead."""


TILE = 4
"""Side of the squares of cells that get different codes, as far as these go."""


SCOUTS = 4
"""First photos of a pilot, after which it goes on or ends."""


def choose_pilot_count(count: int, parts: int) -> int:
    """Return how many of `count` codes to spend on a pilot that looks for a map; 0 if it cannot be
    had.

    At most two thirds of the codes, and leaving a Hadamard order for each part of the shot.
    """
    for share in reversed(MATCHED):
        each, rest = divmod(count - share, parts)
        if 3 * share <= 2 * count and not rest and is_order(each):
            return share
    return 0


def make_pilot_codes(lattice: tuple[int, int], count: int, seed: int) -> Bools:
    """Make the codes of a pilot, (count, L) bool.

    The scouts come first, as `hadamard` codes (`sharpness`); `count` may be their number alone. The
    other codes of a pilot that looks for a map are lit in half of the photos, give or take one:
    more different codes for next cells, and fewer cells that cannot be told from their partners,
    than if all were lit equally often.

    In longer pilots each cell is lit in exactly half of the codes. Two more sets of `hadamard`
    codes, a quarter each, tell by how much they disagree what codes alone would get wrong
    (`worth`). The others are `balanced`: independent cells, any few of which can be told apart, as
    the search for paths needs it.

    Raises
    ------
    RequestError
        No pilot has that many codes, the lattice is empty, or too fine to look for a map.
    """
    if count == SCOUTS or count in MATCHED:
        if count > SCOUTS and lattice[0] * lattice[1] > MOST_MATCHING_CELLS:
            raise RequestError(
                f"a pilot of {count} codes looks for a map of at most {MOST_MATCHING_CELLS} cells",
                hint=f"take a power of two from {LEAST_PURSUED}, or a coarser grid",
            )
        scouts = make_codes("hadamard", lattice, SCOUTS, dual="complement", seed=4 * seed).primal
        return np.concatenate([scouts, _varied(lattice, count - SCOUTS, seed)])
    quarter = count // 4
    if count % 4 or not is_order(quarter) or count < LEAST_PURSUED:
        raise RequestError(
            f"a pilot of {count} codes cannot be made",
            hint=f"take one of {MATCHED}, or a power of two from {LEAST_PURSUED}",
        )
    rest = count - 2 * quarter - SCOUTS
    kinds = (
        ("hadamard", SCOUTS),
        ("hadamard", quarter),
        ("hadamard", quarter),
        ("balanced", rest),
    )
    parts = [
        make_codes(family, lattice, part, dual="complement", seed=4 * seed + i).primal
        for i, (family, part) in enumerate(kinds)
    ]
    return np.concatenate(parts)


def _varied(lattice: tuple[int, int], count: int, seed: int) -> Bools:
    """Codes (count, L) by chance, lit in half of `count` or one more or less; none for 0.

    Cells of a tile have different ones as long as there are any.
    """
    rows, cols = lattice
    all_codes = np.arange(2**count)[:, None] >> np.arange(count) & 1
    own = np.flatnonzero(np.abs(all_codes.sum(axis=1) - count / 2) <= 1)
    rng = np.random.Generator(np.random.PCG64([seed, 3]))
    chosen = np.empty((-(-rows // TILE), -(-cols // TILE), TILE * TILE), dtype=np.intp)
    again = -(-chosen.shape[2] // own.size)
    for tile in np.ndindex(chosen.shape[:2]):
        drawn = np.concatenate([rng.permutation(own) for _ in range(again)])[: chosen.shape[2]]
        chosen[tile] = rng.permutation(drawn)
    down, right = chosen.shape[:2]
    image = chosen.reshape(down, right, TILE, TILE).swapaxes(1, 2).reshape(down * TILE, -1)
    codes: Bools = all_codes[image[:rows, :cols].ravel()].T.astype(np.bool_)
    return codes
