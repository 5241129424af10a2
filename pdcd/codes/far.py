"""Codes for light from beyond a radius: which cells are lit together, where the mask is closed.

The mask must be closed within the radius of every lit cell. Whatever else is lit in the same code
is then missed there, and each path from afar is counted a few times only, some often and some
never. So cells are lit seldom, all equally often, in company that is dealt anew each time. And the
mask is closed at a few more cells, chosen so that what each camera cell misses is spread evenly
over the scene: light that changes slowly from cell to cell is then counted right, although its
single paths are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

SELDOM = 0.5
"""Share of the codes that would bring most light in which a cell is lit. Half of them bring two
thirds of the light, and leave room to choose what else is closed."""
LEAST_LIGHT = 0.25
"""Cells are lit one by one where that leaves this share of the light, or more."""
ALIKE = ((8.0, 0.375), (3.0, 0.375), (1.5, 0.25))
"""How alike the light of two cells is taken to be: Gaussians of so many cells, and their shares."""
ALONE = 0.25
"""What is added for light that each cell has for itself."""
STEP = 2.0**-8
"""All these weights are whole multiples of it, so that sums of products are exact in float64 and
codes do not depend on the order in which a machine adds."""
FALL_CELLS, FALL_POWER, FALL_STEP = 5.0, 4, 2.0**-6
"""Light falls off with the distance not at all, exponentially over so many cells, or by this power;
all three count alike. Rounded to multiples of the step, for the same reason."""
SIDE = 3
"""Camera cells along a side of the blocks within which the distance is that from the middle."""
MOST = 2**22
"""Codes times cells up to which more cells of the mask are closed."""
MOST_FALLING = 2**35
"""Blocks times codes squared times cells up to which light is taken to fall off: five seconds."""
CHUNK = 2**16
"""Codes times camera cells that are looked at at once: what stays in the caches of a processor."""
FEW = 0.75
"""Share of these that are still being changed below which the others are set aside."""


def times_lit(count: int, cells: int, best: float) -> int:
    """In how many of `count` codes each of so many cells is lit; `best` is the share of
    codes that brings most light (`pdcd.recipes.programs.Far`).

    With twice as many codes as cells, say, every cell can be lit alone, twice, and nothing
    errs; that is taken where it does not cost too much light.
    """
    alone = count // cells
    if alone / count >= LEAST_LIGHT * best * (1.0 - best) ** (1.0 / best - 1.0):
        return alone
    return max(1, round(SELDOM * best * count))


def far_codes(lattice: tuple[int, int], count: int, best: float, rng: np.random.Generator) -> Bools:
    """Codes (K, L) that light each cell equally often, and as many cells in each code as can be.

    The codes are split into as many shares as each cell is lit times (`times_lit`); all
    cells are dealt out over the codes of each share by chance.
    """
    cells = lattice[0] * lattice[1]
    times = times_lit(count, cells, best)
    codes = np.zeros((count, cells), dtype=np.bool_)
    for share in np.array_split(rng.permutation(count), times):
        codes[rng.permutation(share)[np.arange(cells) % share.size], rng.permutation(cells)] = True
    return codes


def evened(lit: Bools, seen: Bools, lattice: tuple[int, int], radius: int) -> Bools:
    """Where the mask is open, (K, L), so that far light is counted as evenly as can be had.

    Parameters
    ----------
    lit : (K, L) bool
        Cells of the projector that are lit.
    seen : (K, L) bool
        Cells of the mask that may be open: no cell is lit within the radius of them.
    lattice : (rows, cols), L cells in all
    radius : cells along each axis

    Returns
    -------
    (K, L) bool, open only where `seen` is. It is `seen` with more than `MOST` codes times cells,
    and for a radius of 0, where codes are lit half of the time and are even by themselves.
    """
    if radius == 0 or lit.size > MOST:
        return seen
    bits = lit.astype(np.float64)
    far = _beyond(bits, lattice, radius)
    cells = _beyond(np.ones((1, lit.shape[1])), lattice, radius)[0]
    open_ = seen.copy()
    group: list[_Block] = []
    for block in _blocks(bits, lattice, radius):
        # The matrices of small blocks take as much memory as those of large ones.
        if group and (len(group) + 1) * max(block.cells.size, SIDE**2) * len(lit) > CHUNK:
            _choose(open_, group, far, cells)
            group = []
        group.append(block)
    _choose(open_, group, far, cells)
    return open_


def evening_bytes(count: int, cells: int) -> int:
    """Bytes that `evened` takes for so many codes and cells beside what it is given."""
    if count * cells > MOST:
        return 0
    some = min(cells, max(1, CHUNK // count))
    blocks = 2 + some // SIDE**2
    return 62 * count * cells + 16 * blocks * count**2 + 104 * count * some + 24 * cells * SIDE**2


@dataclass(frozen=True)
class _Block:
    """Some camera cells that lie together, and what is known of their light.

    cells : (Y,), their numbers. together : (K, K), ``L C L``; wanted : (K, Y), ``L C W``.
    """

    cells: Indices
    together: Floats
    wanted: Floats


def _blocks(bits: Floats, lattice: tuple[int, int], radius: int) -> Iterator[_Block]:
    """The blocks of a lattice. C is the same for all cells, and they are split only to be looked
    at one after the other, where light is not taken to fall off."""
    count, cells = bits.shape
    spread = _spread(bits, lattice)
    together, wanted = spread @ bits.T, _beyond(spread, lattice, radius)
    rows, cols = (_parts(n) for n in lattice)
    if (1 + rows.max()) * (1 + cols.max()) * count**2 * cells > MOST_FALLING:
        for some in np.array_split(np.arange(cells), -(-cells * count // CHUNK)):
            yield _Block(some, together, wanted[:, some])
        return
    numbers = np.arange(cells).reshape(lattice)
    images = bits.reshape(-1, *lattice)
    even = _alike(cells)
    for down, right in np.ndindex(1 + rows.max(), 1 + cols.max()):
        row, col = np.flatnonzero(rows == down), np.flatnonzero(cols == right)
        some = numbers[np.ix_(row, col)].ravel()
        own, far = together * even, wanted[:, some] * even
        for fall in _falls(lattice, row.mean(), col.mean(), radius):
            # Far enough off it is rounded to nothing.
            lit = np.ix_(fall.any(axis=1), fall.any(axis=0))
            light = (images[:, lit[0], lit[1]] * fall[lit]).reshape(count, -1)
            spread = _spread(light, fall[lit].shape) * _alike(np.sum(fall**2))
            own += spread @ light.T
            near = _near(numbers[lit], some, lattice[1], radius)
            far += spread @ (~near * fall[lit].reshape(-1, 1))
        yield _Block(some, own, far)


def _near(these: Indices, those: Indices, width: int, radius: int) -> Bools:
    """Which of some cells are within the radius of which others, by their numbers."""
    (row, col), (other_row, other_col) = (
        np.divmod(these.reshape(-1, 1), width),
        np.divmod(those, width),
    )
    near: Bools = np.maximum(np.abs(row - other_row), np.abs(col - other_col)) <= radius
    return near


def _alike(square: float) -> float:
    """What makes ways to fall off count about alike, by the sum of their squares: a power of two,
    which leaves sums exact."""
    return float(2.0 ** -np.frexp(square)[1])


def _parts(size: int) -> Indices:
    """Which block each of so many rows or columns is in, (size,)."""
    count = -(-size // SIDE)
    return (2 * np.arange(size) + 1) * count // (2 * size)


def _falls(lattice: tuple[int, int], row: float, col: float, radius: int) -> list[Floats]:
    """Light over its distance from a place, (rows, cols), at most 1, in both ways in which it may
    fall off."""
    rows, cols = lattice
    apart = np.hypot(np.arange(rows)[:, None] - row, np.arange(cols) - col)
    falls = (
        np.exp(-apart / FALL_CELLS), ((radius + 1) / np.maximum(apart, radius + 1)) ** FALL_POWER,
    )  # fmt: skip
    return [np.rint(fall / FALL_STEP) * FALL_STEP for fall in falls]


def _spread(light: Floats, lattice: tuple[int, int]) -> Floats:
    """``L C`` of light (K, L): what is alike, and what each cell has for itself."""
    images = light.reshape(-1, *lattice)
    rows, cols = lattice
    alike = sum(
        share * (_gaussian(rows, reach) @ images @ _gaussian(cols, reach)) for reach, share in ALIKE
    )
    spread: Floats = np.asarray(alike).reshape(light.shape) + ALONE * light
    return spread


def _choose(open_: Bools, blocks: list[_Block], far: Floats, cells: Floats) -> None:
    """Choose the codes in which the cells of some blocks are open; written into `open_`."""
    some = np.concatenate([block.cells for block in blocks])
    of = np.repeat(np.arange(len(blocks)), [block.cells.size for block in blocks])
    together = np.stack([block.together for block in blocks])
    wanted = np.concatenate([block.wanted for block in blocks], axis=1)
    open_[:, some] = _chosen(together, of, wanted, far[:, some], cells[some], open_[:, some])


def _chosen(
    together: Floats, of: Indices, wanted: Floats, far: Floats, cells: Floats, seen: Bools
) -> Bools:
    """Codes in which some camera cells are open, (K, Y): one change at a time, the best first.

    Open in the codes a, a cell counts the lit cells ``a L``; their mean over all `cells` that are
    further than the radius, W, is its weight w. What it errs of light that is alike as C says is
    ``(a L / w - W) C (a L / w - W)``, of which ``W C W`` does not change.

    together : (G, K, K), ``L C L`` of groups of cells; of : (Y,), each cell's group; wanted, far :
    (K, Y), ``L C W`` and ``L W``
    """
    opened = seen.copy()
    a = seen.astype(np.float64)
    met_by = np.empty_like(a)  # ``L C L a``
    for number, one in enumerate(together):
        met_by[:, of == number] = one @ a[:, of == number]
    own = np.diagonal(together, axis1=1, axis2=2)[of].T
    # Of each camera cell: what the error divides by the weight twice, once, and the weight.
    total, met = (a * met_by).sum(axis=0) * cells, 2.0 * (a * wanted).sum(axis=0)
    weight = (a * far).sum(axis=0)
    # What these gain where a code is closed that is open, or opened that is closed.
    turn = 1.0 - 2.0 * a
    more_total = (2.0 * turn * met_by + own) * cells
    more_met, more_weight = 2.0 * turn * wanted, turn * far
    never = np.where(seen, 0.0, np.inf)
    which = np.arange(cells.size)
    left = weight > 0.0
    while left.any():
        if left.mean() < FEW:
            which, of, cells, total, met, weight = (
                x[left] for x in (which, of, cells, total, met, weight)
            )
            turn, more_total, more_met, more_weight, never = (
                x[:, left] for x in (turn, more_total, more_met, more_weight, never)
            )
        after = _error(total + more_total, met + more_met, weight + more_weight)
        after += never
        best = after.argmin(axis=0)
        left = after[best, np.arange(which.size)] < _error(total, met, weight)
        at = np.flatnonzero(left)
        code = best[at]
        opened[code, which[at]] ^= True
        gained = more_total[code, at]
        total[at] += gained
        met[at] += more_met[code, at]
        weight[at] += more_weight[code, at]
        change = np.zeros(which.size)
        change[at] = 2.0 * turn[code, at] * cells[at]
        more_total += turn * together[of, best].T * change
        more_total[code, at] = -gained
        for of_each in (more_met, more_weight, turn):
            of_each[code, at] *= -1.0
    return opened


def _error(total: Floats, met: Floats, weight: Floats) -> Floats:
    """``a L C L a / w^2 - 2 a L C W / w`` over the number of cells; infinite without any weight."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error: Floats = (total / weight - met) / weight
    error[~(weight > 0.0)] = np.inf
    return error


def _beyond(images: Floats, lattice: tuple[int, int], radius: int) -> Floats:
    """Sums of images (K, L) over all that is further than the radius from each cell, (K, L)."""
    rows, cols = (
        (np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= radius).astype(np.float64)
        for n in lattice
    )
    near = (rows @ images.reshape(-1, *lattice) @ cols).reshape(images.shape)
    sums: Floats = images.sum(axis=1, keepdims=True) - near
    return sums


def _gaussian(size: int, reach: float) -> Floats:
    """Gaussian of the distance of any two of so many cells, (size, size)."""
    apart = np.subtract.outer(np.arange(size), np.arange(size)) / reach
    return np.asarray(np.rint(np.exp(-(apart**2) / 2.0) / STEP) * STEP)
