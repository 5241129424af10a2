"""Colours and signs of cells against a search that looks at every other cell, one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.colouring import choose_phases, colour_lattice

Floats = NDArray[np.float64]


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def apart(lattice: tuple[int, int]) -> tuple[Floats, NDArray[np.int64]]:
    """Distances of all pairs of cells, none of a cell to itself, and how many rows or columns they
    are apart, whichever are more."""
    row, col = np.divmod(np.arange(lattice[0] * lattice[1]), lattice[1])
    down, right = np.abs(row[:, None] - row), np.abs(col[:, None] - col)
    found = np.hypot(down, right)
    np.fill_diagonal(found, np.inf)
    return found, np.maximum(down, right)


def in_order(
    lattice: tuple[int, int], random: np.random.Generator
) -> tuple[NDArray[np.int64], tuple[float, float]]:
    """Cells as a straight front of random direction passes them."""
    row, col = np.divmod(np.arange(lattice[0] * lattice[1]), lattice[1])
    down, right = random.random(2) - 0.5
    return np.argsort(down * row + right * col, kind="stable"), (down, right)


def coloured(
    lattice: tuple[int, int], colours: int, seed: int, links: Any = None, *, loose: bool = False
) -> tuple[list[int], list[int]]:
    """The same by a look from each cell at all that have a colour already."""
    random, cells = rng(seed), lattice[0] * lattice[1]
    distance, off = apart(lattice)
    reach = max(64, int(np.ceil(4.0 * np.sqrt(colours))))
    crowds = np.where(off <= reach, distance**-4.0, 0.0)
    pulls = np.where(off <= reach, 1.0 / distance, 0.0)
    order, _ = in_order(lattice, random)
    weight = np.zeros(cells)
    if links is not None:
        strength = links / np.sqrt((links**2).sum() / (60.0 * cells))
        crowds, pulls = crowds + strength**2, pulls + strength
        weight = (links**2).sum(axis=1)
        if loose:
            weight = weight * 2.0 ** random.uniform(-1.0, 1.0, cells)
    order = np.array(sorted(order.tolist(), key=lambda cell: -weight[cell]))
    sign = random.choice(np.array([-1, 1], dtype=np.int8), cells)
    colour = np.full(cells, -1)
    for number, cell in enumerate(order.tolist()):
        if number < colours:
            colour[cell] = number
            continue
        crowd = [crowds[cell][colour == one].sum() for one in range(colours)]
        colour[cell] = best = int(np.argmin(np.round(crowd, 12)))
        same = (colour == best) & (np.arange(cells) != cell)
        around = float(np.sum(pulls[cell][same] * sign[same]))
        if abs(around) > 1e-12:
            sign[cell] = -1 if around > 0.0 else 1
    return colour.tolist(), sign.tolist()


@pytest.mark.parametrize(
    ("lattice", "colours"), [((7, 9), 5), ((1, 12), 3), ((6, 4), 24), ((3, 5), 40), ((9, 2), 1)]
)
def test_each_cell_takes_the_colour_that_crowds_it_least(
    lattice: tuple[int, int], colours: int
) -> None:
    for seed in range(3):
        colour, sign = colour_lattice(lattice, colours, rng(seed))
        assert (colour.tolist(), sign.tolist()) == coloured(lattice, colours, seed)
        assert colour.dtype == np.int64 and sign.dtype == np.int8


def test_a_cell_looks_around_so_far_and_no_further() -> None:
    """On long lattices: 64 cells, or four times the root of the number of colours."""
    for lattice, colours in (((1, 400), 2), ((2, 250), 300), ((260, 1), 3)):
        colour, sign = colour_lattice(lattice, colours, rng(5))
        assert (colour.tolist(), sign.tolist()) == coloured(lattice, colours, 5)


@pytest.mark.parametrize("loose", [False, True])
@pytest.mark.parametrize("density", [0.04, 0.6])
def test_links_crowd_by_their_squares_and_go_before_distance(density: float, loose: bool) -> None:
    lattice, cells = (6, 7), 42
    for seed in range(3):
        half = scipy.sparse.random_array((cells, cells), density=density, rng=rng(seed + 50))
        links = np.triu(half.toarray(), 1)
        links = links + links.T
        found = colour_lattice(lattice, 5, rng(seed), scipy.sparse.csr_array(links), apart=loose)
        wanted = coloured(lattice, 5, seed, links, loose=loose)
        assert (found[0].tolist(), found[1].tolist()) == wanted


@pytest.mark.parametrize("phases", [2, 4])
def test_cells_of_a_colour_take_the_phase_that_is_farthest_off(phases: int) -> None:
    """Among cells of their colour that the front has passed, by sum(1/d); the nearest next phase
    of those that are as good, counted on from the one that chance gave."""
    lattice = (8, 9)
    colour, _ = colour_lattice(lattice, 6, rng(1))
    found = choose_phases(lattice, colour, phases, rng(2))
    random = rng(2)
    phase = random.integers(phases, size=72)
    order, _ = in_order(lattice, random)
    distance, _ = apart(lattice)
    done = np.zeros(72, dtype=np.bool_)
    for cell in order.tolist():
        like = done & (colour == colour[cell])
        around = [np.sum(1.0 / distance[cell][like & (phase == one)]) for one in range(phases)]
        mine = int(phase[cell])
        phase[cell] = min(
            range(phases), key=lambda one: (round(around[one], 12), (one - mine) % phases)
        )
        done[cell] = True
    assert found.tolist() == phase.tolist()
