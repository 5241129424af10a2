"""Parts of wanted matrices at single entries, at borders, and what they are made of."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.probing.convolved import KernelPart, SameRowPart
from pdcd.probing.wanted import (
    FullPart,
    GainPart,
    IlluminatedPart,
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
    shift_cells,
)

Floats = NDArray[np.float64]
GRID = (4, 5)
CELLS = 20
RNG = np.random.default_rng(1)
CAMERA, PROJECTOR, LIGHT = RNG.random((3, CELLS))
PARTNER = RNG.integers(-1, CELLS, CELLS)
PARTNER[[0, 5, 9]] = -1, 5, 0
MATRIX = RNG.standard_normal((CELLS, CELLS))
ROW, COL = np.divmod(np.arange(CELLS), GRID[1])


def _near(radius: int) -> Floats:
    apart = np.maximum(np.abs(ROW[:, None] - ROW), np.abs(COL[:, None] - COL))
    return np.asarray(apart <= radius, dtype=np.float64)


def _match() -> Floats:
    return np.asarray(PARTNER[:, None] == np.arange(CELLS), dtype=np.float64)


TAPS = RNG.standard_normal((5, 3))


def _kernel() -> Floats:
    out = np.zeros((CELLS, CELLS))
    for n, m in np.ndindex(CELLS, CELLS):
        down, right = ROW[n] - ROW[m] + 2, COL[n] - COL[m] + 1
        if 0 <= down < 5 and 0 <= right < 3:
            out[n, m] = TAPS[down, right]
    return out


PARTS: dict[str, tuple[MatrixPart, Floats]] = {
    "uniform": (UniformPart(CELLS), np.ones((CELLS, CELLS))),
    "outer": (OuterPart(CAMERA, PROJECTOR), np.outer(CAMERA, PROJECTOR)),
    "match": (MatchPart(PARTNER), _match()),
    "near0": (NearPart(GRID, 0), _near(0)),
    "near1": (NearPart(GRID, 1), _near(1)),
    "near3": (NearPart(GRID, 3), _near(3)),
    "row": (SameRowPart(GRID), (ROW[:, None] == ROW).astype(np.float64)),
    "gained": (GainPart(CAMERA, NearPart(GRID, 1)), CAMERA[:, None] * _near(1)),
    "lit": (IlluminatedPart(NearPart(GRID, 2), LIGHT), _near(2) * LIGHT),
    "full": (FullPart(MATRIX), MATRIX),
    "kernel": (KernelPart(GRID, TAPS), _kernel()),
}


@pytest.mark.parametrize("name", PARTS)
def test_rows_and_entries_are_those_of_the_matrix(name: str) -> None:
    part, dense = PARTS[name]
    np.testing.assert_allclose(part.rows(0, CELLS), dense, atol=1e-14)
    np.testing.assert_allclose(part.rows(3, 11), dense[3:11], atol=1e-14)
    column = np.random.default_rng(2).integers(-1, CELLS, CELLS)
    column[[0, 1, 2]] = -1, 1, 0
    if name == "lit":  # is asked of cells that there are
        column = np.maximum(column, 0)
    found = np.where(column >= 0, dense[np.arange(CELLS), column], 0.0)
    np.testing.assert_allclose(part.entries(column), found, atol=1e-14)
    np.testing.assert_allclose(part.entries(np.arange(CELLS)), dense.diagonal(), atol=1e-14)


@pytest.mark.parametrize("name", PARTS)
def test_sums_leave_out_the_diagonal(name: str) -> None:
    part, dense = PARTS[name]
    off = dense - np.diag(dense.diagonal())
    images = np.random.default_rng(3).standard_normal((3, CELLS))
    np.testing.assert_allclose(part.others(images), images @ off.T, atol=1e-12)
    weights = np.random.default_rng(4).random(CELLS)
    for other, whole in PARTS.values():
        both = off * whole
        np.testing.assert_allclose(part.overlap(other, weights), both @ weights, atol=1e-12)


@pytest.mark.parametrize("light", [None, LIGHT])
def test_a_sum_of_parts_is_the_sum_of_their_matrices(light: Floats | None) -> None:
    terms = tuple((0.5 + k, PARTS[name][0]) for k, name in enumerate(("near1", "match", "outer")))
    wanted = WantedMatrix(GRID, terms, light)
    dense = 0.5 * _near(1) + 1.5 * _match() + 2.5 * np.outer(CAMERA, PROJECTOR)
    dense = dense if light is None else dense * light
    np.testing.assert_allclose(wanted.dense(), dense, atol=1e-14)
    np.testing.assert_allclose(wanted.rows(4, 6), dense[4:6], atol=1e-14)
    np.testing.assert_allclose(wanted.entries((np.arange(CELLS) + 3) % CELLS),
                               dense[np.arange(CELLS), (np.arange(CELLS) + 3) % CELLS])  # fmt: skip
    row, column = np.divmod(RNG.permutation(CELLS * CELLS)[:90], CELLS)
    np.testing.assert_allclose(wanted.pairs(row, column), dense[row, column], atol=1e-14)
    assert wanted.pairs(row[:0], column[:0]).shape == (0,)
    assert wanted.cells == CELLS and wanted.uniform is None
    camera, projector = wanted.products()
    assert camera.shape == projector.shape == (1, CELLS)
    np.testing.assert_allclose(camera.T @ projector + wanted.banded().dense(), dense, atol=1e-14)
    nothing = WantedMatrix(GRID, terms[:2], light).products()
    assert [side.shape for side in nothing] == [(0, CELLS)] * 2


@pytest.mark.parametrize(
    ("parts", "light", "uniform"),
    [
        (((2.0, UniformPart(CELLS)),), None, (2.0, 2.0)),
        (((2.0, UniformPart(CELLS)), (-0.5, MatchPart(np.arange(CELLS)))), None, (1.5, 2.0)),
        (
            ((3.0, MatchPart(np.arange(CELLS))), (4.0, MatchPart(np.arange(CELLS)))),
            None,
            (7.0, 0.0),
        ),
        (((2.0, UniformPart(CELLS)),), LIGHT, None),
        (((2.0, UniformPart(CELLS)), (1.0, MatchPart(shift_cells(GRID, (0, 1))))), None, None),
        (((2.0, OuterPart(CAMERA, PROJECTOR)),), None, None),
        (((2.0, NearPart(GRID, 9)),), None, None),
    ],
)
def test_only_two_weights_make_a_matrix_uniform(
    parts: tuple[tuple[float, MatrixPart], ...],
    light: Floats | None,
    uniform: tuple[float, float] | None,
) -> None:
    assert WantedMatrix(GRID, parts, light).uniform == uniform


def test_matched_cells_are_those_of_the_one_match_with_others() -> None:
    own, beside = MatchPart(np.arange(CELLS)), MatchPart(shift_cells(GRID, (0, 1)))

    def matched(*parts: MatrixPart) -> object:
        return WantedMatrix(GRID, tuple((1.0, part) for part in parts)).matched

    assert matched(UniformPart(CELLS), beside) is beside.partner
    assert matched(GainPart(CAMERA, beside), UniformPart(CELLS)) is beside.partner
    assert matched(own) is None and matched(UniformPart(CELLS)) is None
    assert matched(own, beside) is None and matched(beside, beside) is None
    assert matched(GainPart(CAMERA, NearPart(GRID, 1)), beside) is beside.partner


def test_partners_of_a_shift_lie_down_and_right() -> None:
    assert shift_cells((2, 3), (0, 0)).tolist() == [0, 1, 2, 3, 4, 5]
    assert shift_cells((2, 3), (1, 1)).tolist() == [4, 5, -1, -1, -1, -1]
    assert shift_cells((2, 3), (-1, 0)).tolist() == [-1, -1, -1, 0, 1, 2]
    assert shift_cells((2, 3), (0, -1)).tolist() == [-1, 0, 1, -1, 3, 4]
    assert shift_cells((2, 3), (0, 2)).tolist() == [2, -1, -1, 5, -1, -1]


@pytest.mark.parametrize("name", PARTS)
def test_products_say_so(name: str) -> None:
    part, dense = PARTS[name]
    sides = part.product()
    assert (sides is None) == (name not in ("uniform", "outer"))
    if sides is not None:
        np.testing.assert_allclose(np.outer(*sides), dense)
        for more, whole in (
            (GainPart(LIGHT, part), LIGHT[:, None] * dense),
            (IlluminatedPart(part, LIGHT), dense * LIGHT),
        ):
            again = more.product()
            assert again is not None
            np.testing.assert_allclose(np.outer(*again), whole)
