"""Where families of codes begin and end: counts, shares, rows, and what they are made from."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.hadamard import (
    can_make_hadamard_codes,
    make_colouring_codes,
    make_hadamard_codes,
    symmetrise_links,
)
from pdcd.codes.independent import make_balanced_codes
from pdcd.codes.lines import make_comb_codes, make_matched_codes, make_row_codes
from pdcd.codes.orders import (
    count_spread_subspaces,
    make_hadamard_columns,
    make_partial_spread,
    make_spread_codes,
)
from pdcd.codes.singer import (
    LARGEST,
    count_plane_lines,
    make_difference_set,
    make_projective_plane_codes,
)
from pdcd.errors import RequestError


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def pcg() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(1))


@pytest.mark.parametrize("count", [1, 2])
def test_balanced_codes_light_each_cell_once_and_leave_it_dark_once(count: int) -> None:
    """Not all of the time, not never."""
    if count == 2:
        assert (make_balanced_codes((2, 2), 2, 0.5, rng()).sum(axis=0) == 1).all()
    for p in (0.1, 0.9):
        with pytest.raises(RequestError):
            make_balanced_codes((2, 2), count, p, rng())


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
        assert (make_hadamard_codes((2, 3), count, p, rng()).sum(axis=0) == p * count).all()
    else:
        with pytest.raises(RequestError):
            make_hadamard_codes((2, 3), count, p, rng())


def test_a_colouring_is_lit_by_its_columns_and_signs() -> None:
    colour, sign = np.array([0, 1, 0, 2]), np.array([1, 1, -1, 1], dtype=np.int8)
    found = make_colouring_codes(8, colour, sign, rng(3))
    column = 1 + rng(3).permutation(7)[:3]
    wanted = make_hadamard_columns(8, column)[:, colour] == sign
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(found[:, 0], ~found[:, 2])


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


def test_lines_keep_the_codes_of_their_seeds() -> None:
    made = (make_row_codes((5, 3), 12, pcg()), make_matched_codes((3, 20), 8, pcg()),
            make_comb_codes((3, 9), 8, 4, pcg()))  # fmt: skip
    assert [codes.shape for codes in made] == [(12, 15), (8, 63), (8, 27)]
    assert [digest(codes) for codes in made] == [
        "fcbb10322959310e", "69b9739477eb3482", "c763381356a4c9c1",
    ]  # fmt: skip


@pytest.mark.parametrize(("p", "lines"), [(1 / 3, 7), (1 / 32, 993), (0.25, 13), (0.2 + 1e-11, 21)])
def test_planes_have_so_many_lines(p: float, lines: int) -> None:
    assert count_plane_lines(p) == lines


@pytest.mark.parametrize("p", [0.2 + 1e-8, 0.2 - 1e-8, 0.5, 1 / 33, 1 / 7, 0.3, 0.9])
def test_shares_that_no_plane_has_are_refused(p: float) -> None:
    assert LARGEST == 31
    with pytest.raises(RequestError) as caught:
        count_plane_lines(p)
    shares = [3, 4, 5, 6, 8, 9, 10, 12, 14, 17, 18, 20, 24, 26, 28, 30, 32]
    assert str(caught.value.hint).endswith(", ".join(f"1/{n}" for n in shares))


@pytest.mark.parametrize("q", [2, 3, 4, 5, 7, 8, 9, 11])
def test_small_planes_have_each_difference_once(q: int) -> None:
    lines, found = q * q + q + 1, make_difference_set(q)
    assert len(found) == q + 1 and list(found) == sorted(found) and found[0] == 0
    differences = sorted((a - b) % lines for a in found for b in found if a != b)
    assert differences == list(range(1, lines))


@pytest.mark.parametrize(
    ("q", "wanted"),
    [
        (3, (0, 1, 3, 9)),
        (5, (0, 1, 3, 8, 12, 18)),
        (7, (0, 1, 3, 13, 32, 36, 43, 52)),
        (9, (0, 1, 6, 10, 23, 26, 34, 41, 53, 55)),
    ],
)
def test_planes_keep_their_lines(q: int, wanted: tuple[int, ...]) -> None:
    """Others would do as well, but codes of stored runs are made again by these."""
    assert make_difference_set(q) == wanted


def test_the_largest_plane() -> None:
    found = make_difference_set(LARGEST)
    assert len(found) == 32 and found[:4] == (0, 1, 3, 22) and found[-1] == 966


@pytest.mark.parametrize("q", [6, 32, 37])
def test_orders_that_are_no_powers_of_primes_or_too_large_have_none(q: int) -> None:
    with pytest.raises(RequestError, match=f"order {q}"):
        make_difference_set(q)


@pytest.mark.parametrize(
    ("count", "hint"),
    [(6, "take 7 codes"), (8, "take 7 or 14 codes"), (15, "take 14 or 21 codes")],
)
def test_singer_codes_come_in_whole_sets(count: int, hint: str) -> None:
    with pytest.raises(RequestError) as caught:
        make_projective_plane_codes((2, 2), count, 1 / 3, rng())
    assert caught.value.hint == hint
    sets = make_projective_plane_codes((2, 3), 14, 1 / 3, rng())
    assert sets.shape == (14, 6) and (sets.reshape(2, 7, 6).sum(axis=1) == 3).all()


@pytest.mark.parametrize(
    ("n", "t", "size"),
    [(4, 2, 5), (3, 2, 1), (2, 2, 1), (1, 2, 0), (5, 2, 9), (6, 2, 21), (6, 3, 9), (7, 3, 17)],
)
def test_sizes_of_spreads(n: int, t: int, size: int) -> None:
    """(2^n - 1) / (2^t - 1) where t divides n."""
    assert count_spread_subspaces(n, t) == size
    assert make_partial_spread(n, t).shape == (size, t)


def test_cells_of_a_spread_are_lit_where_their_forms_have_their_phase() -> None:
    space, phase = np.array([0, 3, 3, 1]), np.array([0, 2, 1, 3])
    found = make_spread_codes(16, 2, space, phase)
    basis = make_partial_spread(4, 2)
    for code, cell in np.ndindex(16, 4):
        forms = [bin(code & int(basis[space[cell], j])).count("1") % 2 for j in (0, 1)]
        assert found[code, cell] == (forms[0] + 2 * forms[1] == phase[cell])


def test_links_keep_their_strength_and_lose_zeros_and_themselves() -> None:
    links = scipy.sparse.csr_array(
        (np.array([0.0, 2.0, 5.0, 3.0]), (np.array([0, 0, 1, 2]), np.array([1, 2, 1, 0]))),
        shape=(3, 3),
    )
    found = symmetrise_links(links, 3)
    assert found.nnz == 2 and found.format == "csr" and found.dtype == np.float64
    assert found.toarray().tolist() == [[0, 0, 3], [0, 0, 0], [3, 0, 0]]
    assert symmetrise_links(np.zeros((2, 2)), 2).nnz == 0
    for shape in ((3, 2), (2, 3)):
        with pytest.raises(RequestError, match="do not fit"):
            symmetrise_links(np.zeros(shape), 3)


def test_more_rows_than_codes_share_them_so_many_rows_apart() -> None:
    bits = make_row_codes((11, 2), 4, rng(1)).reshape(4, 11, 2)
    assert (bits[:, :, 0] == bits[:, :, 1]).all()
    h = np.where(bits[:, :, 0], 1, -1)
    for one, other in np.ndindex(11, 11):
        same = (one - other) % 4 == 0
        assert abs(h[:, one] @ h[:, other]) == (4 if same else 0)
    # All columns, the constant one too, and signs of both kinds.
    assert sorted(np.abs(h[:, :4].sum(axis=0)).tolist()) == [0, 0, 0, 4]
    signs = [np.sign(h[0, row] * h[0, row % 4]) for row in range(11)]
    assert -1 in signs and 1 in signs


@pytest.mark.parametrize(("count", "turns"), [(4, 1), (7, 1), (8, 2)])
def test_a_comb_passes_each_cell_once_a_turn(count: int, turns: int) -> None:
    bits = make_comb_codes((3, 9), count, 4, rng(2)).reshape(count, 3, 9)
    for turn in range(turns):
        assert (bits[4 * turn : 4 * turn + 4].sum(axis=0) == 1).all()
    assert not bits[4 * turns :].any()
    # Cells a period apart are lit together, and only these.
    for row in range(3):
        meets = bits[:, row].T.astype(int) @ bits[:, row]
        at = np.arange(9)
        assert ((meets > 0) == ((at[:, None] - at) % 4 == 0)).all()
    phases = {tuple(bits[:4, row, :4].argmax(axis=0)) for row in range(3)}
    assert len(phases) > 1


def test_a_comb_of_fewer_codes_than_its_period_is_refused() -> None:
    with pytest.raises(RequestError, match="at least 4"):
        make_comb_codes((2, 2), 3, 4, rng())
