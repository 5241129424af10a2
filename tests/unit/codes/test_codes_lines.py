"""Codes for off-axis benches: what cells of one row have to do with each other."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from pdcd.codes.lines import make_comb_codes, make_matched_codes, make_row_codes
from pdcd.errors import RequestError


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("lattice", [(6, 8), (24, 32), (3, 40)])
def test_24_cells_of_a_row_never_share_a_matched_code(lattice: tuple[int, int]) -> None:
    rows, cols = lattice
    codes = make_matched_codes(lattice, 64, rng()).astype(np.int64)
    bits = codes[:, : rows * cols].reshape(64, rows, cols)
    assert (codes.sum(axis=0) == 32).all()
    for row in range(rows):
        meets = bits[:, row].T @ bits[:, row]
        assert (meets[~np.eye(cols, dtype=bool)] == 16).all()
        # One more for each row, for masks of cells without a match.
        assert (bits[:, row].T @ codes[:, rows * cols + row] == 16).all()


@pytest.mark.parametrize(("lattice", "count"), [((4, 12), 8), ((1, 1), 8), ((5, 1), 4)])
def test_matched_codes_of_few_codes_share_where_they_must(
    lattice: tuple[int, int], count: int
) -> None:
    cols = lattice[1]
    codes = make_matched_codes(lattice, count, rng())[:, : lattice[0] * cols]
    bits = codes.reshape(count, *lattice).astype(np.int64)
    assert (bits.sum(axis=0) == count // 2).all()
    for row in range(lattice[0]):
        meets = bits[:, row].T @ bits[:, row]
        # Twelve cells have seven columns: at least ten of the pairs of neighbours differ.
        assert sum(meets[c, c + 1] == count // 4 for c in range(cols - 1)) >= cols - 2


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


def seeded() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(1))


def test_lines_keep_the_codes_of_their_seeds() -> None:
    made = (make_row_codes((5, 3), 12, seeded()), make_matched_codes((3, 20), 8, seeded()),
            make_comb_codes((3, 9), 8, 4, seeded()))  # fmt: skip
    assert [codes.shape for codes in made] == [(12, 15), (8, 63), (8, 27)]
    assert [hashlib.sha256(np.packbits(codes).tobytes()).hexdigest()[:16] for codes in made] == [
        "fcbb10322959310e", "69b9739477eb3482", "c763381356a4c9c1",
    ]  # fmt: skip
