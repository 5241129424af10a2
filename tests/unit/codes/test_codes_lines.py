"""Codes for off-axis benches: what cells of one row have to do with each other."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.codes.lines import make_matched_codes


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
