"""Codes of stretches and scattered cells: each cell thrice, and far light counted more evenly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes import far
from pdcd.codes.far import make_long_range_codes, make_long_range_masks
from pdcd.codes.woven import count_stretches, make_stretched_codes
from pdcd.probing.wanted import NearPart
from pdcd.virtual.scene.presets import PRESETS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

GRID = (12, 16)
N = GRID[0] * GRID[1]
BEST = 1.0 / 26.0


def bends(code: Bools) -> bool:
    """Whether the lit cells of a code are no unbroken stretch of one row or column."""
    row, col = np.nonzero(code.reshape(GRID))
    along, across = (col, row) if np.ptp(row) == 0 else (row, col)
    return bool(np.ptp(across) > 0 or np.ptp(along) + 1 != along.size)


def test_each_cell_is_lit_along_its_row_along_its_column_and_among_others() -> None:
    codes = make_stretched_codes(GRID, 128, 2, np.random.default_rng(3))
    assert codes.shape == (128, N) and np.array_equal(codes.sum(axis=0), np.full(N, 3))
    scattered = np.array([bends(code) for code in codes])
    assert (~scattered).sum() == 2 * sum(GRID)
    sizes = codes[~scattered].sum(axis=1)
    assert np.array_equal(np.sort(sizes), np.sort([8] * 24 + [6] * 32))
    assert np.array_equal(codes[scattered].sum(axis=0), np.ones(N, dtype=int))
    assert np.ptp(codes[scattered].sum(axis=1)) <= 1
    # By chance: in which order, and who is scattered with whom.
    other = make_stretched_codes(GRID, 128, 2, np.random.default_rng(4))
    assert not np.array_equal(other, codes)
    assert not np.array_equal(np.array([bends(code) for code in other]), scattered)


@pytest.mark.parametrize(
    ("lattice", "count", "parts"),
    [
        ((24, 32), 512, 5), ((24, 32), 256, 2), ((24, 32), 128, 0), ((12, 16), 128, 2),
        ((12, 16), 96, 2), ((12, 16), 64, 0), ((48, 64), 400, 0), ((30, 40), 500, 4),
        ((1, 5), 4, 0),
    ],
)  # fmt: skip
def test_there_are_stretches_where_codes_are_many(
    lattice: tuple[int, int], count: int, parts: int
) -> None:
    """And where few cells are left to be scattered over each of the others."""
    assert count_stretches(lattice, count) == parts


def test_grey_masks_alone_have_them() -> None:
    def unbroken(count: int, *, grey: bool) -> int:
        codes = make_long_range_codes(GRID, count, BEST, np.random.default_rng(1), grey=grey)
        return sum(not bends(code) for code in codes)

    assert unbroken(128, grey=True) == 2 * sum(GRID)
    assert unbroken(128, grey=False) == unbroken(64, grey=True) == 0
    # Each cell alone, as there are so many codes.
    assert (
        make_long_range_codes(GRID, 500, BEST, np.random.default_rng(1), grey=True)
        .sum(axis=1)
        .max()
        == 1
    )
    # Of a small radius cells would be lit more often, which is more light.
    often = make_long_range_codes(GRID, 190, 0.4, np.random.default_rng(1), grey=True)
    assert set(often.sum(axis=0)) == {far.choose_times_lit(190, N, 0.4, grey=True)} != {3}


@pytest.mark.parametrize(
    ("name", "share"), [("open-book", 0.7), ("wax-disk", 0.9), ("milky-bottle", 0.8)]
)
def test_smooth_light_errs_less_than_by_scattered_cells(
    name: str, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photos of far light, by dense sums, each cell over its own weight; means of three seeds."""
    radius, transport = 2, PRESETS[name](GRID, {}).dense()
    near = NearPart(GRID, radius).rows(0, N)
    truth = np.einsum("nm,cnm->nc", 1.0 - near, transport)

    def error() -> float:
        errors = []
        for seed in range(3):
            lit = make_long_range_codes(GRID, 128, BEST, np.random.default_rng(seed), grey=True)
            seen: Bools = lit.astype(float) @ near == 0.0
            mask = np.asarray(make_long_range_masks(lit, seen, GRID, radius, grey=True), np.float64)
            counted = mask.T @ lit
            assert not (counted * near).any()
            weight = (counted * (1.0 - near)).sum(axis=1) / (1.0 - near).sum(axis=1)
            image = np.einsum("nm,cnm->nc", counted, transport) / weight[:, None]
            errors.append(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)))
        return float(np.mean(errors))

    with_stretches = error()
    monkeypatch.setattr(far, "count_stretches", lambda lattice, count: 0)
    assert with_stretches < share * error()
