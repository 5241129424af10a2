"""Hadamard matrices, the colouring of the lattice, and the family made of both."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.colouring import colour_lattice
from pdcd.codes.hadamard import can_make_hadamard_codes, make_hadamard_codes
from pdcd.codes.make import make_codes
from pdcd.codes.orders import find_nearest_orders, is_order, make_hadamard_columns
from pdcd.errors import RequestError
from tests.unit.codes._oracles import probing

ORDERS = [n for n in range(1, 133) if is_order(n)]


def test_orders_missing_below_132_are_those_that_need_other_constructions() -> None:
    """52 and 100 need prime powers, 92 and 116 Williamson's method: the textbook gaps."""
    missing = [n for n in range(4, 133, 4) if n not in ORDERS]
    assert missing == [52, 92, 100, 116]
    assert [n for n in ORDERS if n % 4] == [1, 2]


@pytest.mark.parametrize("order", [*ORDERS[::3], 140, 256, 300])
def test_columns_are_orthogonal_signs_and_the_first_is_ones(order: int) -> None:
    matrix = make_hadamard_columns(order, np.arange(order)).astype(np.int64)
    assert np.array_equal(np.abs(matrix), np.ones((order, order)))
    assert np.array_equal(matrix.T @ matrix, order * np.eye(order))
    assert np.all(matrix[:, 0] == 1)


@pytest.mark.parametrize("order", [2, 12, 28, 40, 96, 128])
def test_chosen_columns_are_those_of_the_whole_matrix(order: int) -> None:
    index = np.random.default_rng(0).integers(0, order, 17)
    whole = make_hadamard_columns(order, np.arange(order))
    assert np.array_equal(make_hadamard_columns(order, index), whole[:, index])


@pytest.mark.parametrize("order", [-2, 0, 3, 10, 52])
def test_columns_of_an_order_that_is_none_are_refused(order: int) -> None:
    with pytest.raises(RequestError, match=f"order {order} .*take the order"):
        make_hadamard_columns(order, np.arange(1))


@pytest.mark.parametrize(
    ("order", "near"),
    [(1, (2,)), (2, (4,)), (3, (2, 4)), (10, (8, 12)), (52, (48, 56)), (100, (96, 104))],
)
def test_nearest_orders(order: int, near: tuple[int, ...]) -> None:
    assert find_nearest_orders(order) == near


@pytest.mark.parametrize("colours", [7, 127])
@pytest.mark.parametrize("lattice", [(24, 32), (17, 41)])
def test_cells_of_one_colour_keep_apart(lattice: tuple[int, int], colours: int) -> None:
    """Nearly as far as the best packing allows: 1.07 sqrt(colours) for hexagons."""
    colour, _ = colour_lattice(lattice, colours, np.random.default_rng(1))
    row, col = np.divmod(np.arange(colour.size), lattice[1])
    distance = np.hypot(row[:, None] - row, col[:, None] - col)
    same = (colour[:, None] == colour) & ~np.eye(colour.size, dtype=bool)
    assert distance[same].min() > 0.7 * np.sqrt(colours)


@pytest.mark.parametrize("colours", [1, 7, 127])
def test_signs_of_a_colour_balance_everywhere(colours: int) -> None:
    """The signs of each colour nearly cancel, over the lattice and over each half of it."""
    colour, sign = colour_lattice((24, 32), colours, np.random.default_rng(2))
    assert set(np.unique(sign)) == {-1, 1}
    total = np.bincount(colour, sign, colours)
    left = np.bincount(colour, sign * (np.arange(768) % 32 < 16), colours)
    size = np.bincount(colour, minlength=colours)
    assert np.abs(total).max() <= 4
    # Independent signs would give a mean square of size / 2 in a half.
    assert np.mean(left**2) < 0.5 * np.mean(size / 2)


def test_seeds_differ_in_which_cells_share_a_colour() -> None:
    """An unlucky match of scene and colouring must not come back with every seed."""
    first, other = (colour_lattice((24, 32), 31, np.random.default_rng(seed))[0] for seed in (0, 1))
    share_first = first[:, None] == first
    share_other = other[:, None] == other
    both = (share_first & share_other).sum() - 768
    assert both < 0.2 * (share_first.sum() - 768)


@pytest.mark.parametrize("lattice", [(1, 1), (1, 9), (3, 5), (11, 13)])
def test_more_codes_than_cells_make_the_probing_matrix_exact(lattice: tuple[int, int]) -> None:
    cells = lattice[0] * lattice[1]
    first = next(n for n in range(max(cells + 1, 4), 2 * cells + 4) if is_order(n))
    for count in (first, 2 * first, 4 * first):
        codes = make_codes("hadamard", lattice, count, dual="complement", seed=count)
        assert np.array_equal(4 * probing(codes), count * (1 - np.eye(cells)))


def test_every_pair_of_cells_meets_in_none_a_quarter_or_half_of_the_codes() -> None:
    codes = make_codes("hadamard", (9, 14), 28, dual="complement", seed=6)
    meets = probing(codes)
    assert set(np.unique(meets)) == {0, 7, 14}
    off_diagonal = meets[~np.eye(126, dtype=bool)]
    assert np.mean(off_diagonal == 7) > 1 - 1.1 / 27  # cells of equal colour are 1 in 27 pairs


def test_two_codes_use_the_one_column_with_both_signs() -> None:
    codes = make_codes("hadamard", (4, 6), 2, dual="complement", seed=0)
    lit = codes.primal
    assert np.array_equal(lit[0], ~lit[1])
    assert abs(int(lit[0].sum()) - 12) <= 2


@pytest.mark.parametrize(
    ("count", "hint"),
    [(1, "take 2 codes"), (10, "take 8 or 12 codes"), (52, "take 48 or 56 codes")],
)
def test_counts_that_are_no_order_are_refused_with_the_nearest(count: int, hint: str) -> None:
    with pytest.raises(RequestError) as caught:
        make_codes("hadamard", (4, 4), count, dual="complement")
    assert f"K = {count}" in caught.value.message
    assert caught.value.hint == hint


@pytest.mark.parametrize(
    ("count", "p", "hint"),
    [
        (16, 0.3, "balanced"), (16, 0.75, "balanced"), (8, 0.25, "take 16 codes"),
        (24, 0.25, "take 16 or 32 codes"), (100, 0.0625, "take 256 codes"),
        (300, 0.0625, "take 256 or 512 codes"),
    ],
)  # fmt: skip
def test_shares_and_counts_without_columns_are_refused(count: int, p: float, hint: str) -> None:
    assert not can_make_hadamard_codes(count, p)
    with pytest.raises(RequestError) as caught:
        make_codes("hadamard", (4, 4), count, dual="same", p=p)
    assert hint in str(caught.value.hint)


@pytest.mark.parametrize(
    ("count", "p", "fits"),
    [
        (1, 0.5, False), (2, 0.5, True), (3, 0.5, False), (12, 0.5, True), (15, 0.25, False),
        (16, 0.25, True), (20, 0.25, False), (32, 0.25, True), (63, 0.125, False),
        (64, 0.125, True), (32, 0.125, False), (64, 0.3, False), (16, 0.75, False),
    ],
)  # fmt: skip
def test_hadamard_counts_that_fit_a_share(count: int, p: float, fits: bool) -> None:
    assert can_make_hadamard_codes(count, p) is fits
    if fits:
        assert (
            make_hadamard_codes((2, 3), count, p, np.random.default_rng(0)).sum(axis=0) == p * count
        ).all()
    else:
        with pytest.raises(RequestError):
            make_hadamard_codes((2, 3), count, p, np.random.default_rng(0))


def digest(bits: NDArray[np.bool_]) -> str:
    return hashlib.sha256(np.packbits(bits).tobytes()).hexdigest()[:16]


@pytest.mark.parametrize(
    ("order", "known"),
    [(12, "fcf7bcbe6c69b01a"), (28, "fbc67a0bb6bd43e5"), (36, "9483ccc67545bd15"),
     (24, "3b6bbf75b37e187f"), (40, "483a3e0a26b600bc")],
)  # fmt: skip
def test_matrices_stay_what_they_are(order: int, known: str) -> None:
    """Any order of columns would do; codes of stored runs are made again by this one."""
    assert digest(make_hadamard_columns(order, np.arange(order)) > 0) == known


@pytest.mark.parametrize(
    ("family", "lattice", "count", "p", "known"),
    [
        ("hadamard", (65, 65), 128, 0.5, "7dea658dbef260f3"),
        ("hadamard", (48, 64), 8, 0.5, "adcb43f53d1d7836"),
        ("hadamard", (33, 65), 64, 0.25, "cb9598b42a900c08"),
        ("singer", (40, 50), 21, 0.2, "0cf0421a36f77abe"),
    ],
)
def test_seeds_keep_their_codes(
    family: str, lattice: tuple[int, int], count: int, p: float, known: str
) -> None:
    """As they were when a cell looked at all others: up to 65 x 65 cells it still does."""
    codes = make_codes(family, lattice, count, dual="same", p=p, seed=1)
    assert digest(codes.primal) == known


def test_cells_of_one_colour_keep_apart_where_not_all_are_looked_at() -> None:
    lattice, colours = (6, 200), 31
    colour, sign = colour_lattice(lattice, colours, np.random.default_rng(3))
    row, col = np.divmod(np.arange(colour.size), lattice[1])
    distance = np.hypot(row[:, None] - row, col[:, None] - col)
    same = (colour[:, None] == colour) & ~np.eye(colour.size, dtype=bool)
    assert distance[same].min() > 0.65 * np.sqrt(colours)
    total = np.bincount(colour, sign, colours)
    assert np.abs(total).max() <= 8
    quarters = np.bincount(4 * colour + col // 50, sign, 4 * colours)
    size = np.bincount(4 * colour + col // 50, minlength=4 * colours)
    assert np.mean(quarters**2) < 0.5 * np.mean(size)
