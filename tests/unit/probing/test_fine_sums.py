"""Sums for parts of cells, number by number."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.lattice import Lattice
from pdcd.probing.fine import PieceSums, PieceWeights, sum_piece_weights

GRID = (2, 3)


def fine(seed: int, cut: float = 0.5) -> PieceWeights:
    light, own, coaxial = np.random.default_rng(seed).random((3, 2, 4))
    return PieceWeights(((0.0, cut, 1.0), (0.0, 1.0)), True, light, own, coaxial)


def test_sums_are_weighted_field_by_field_where_all_are_there_and_cut_alike() -> None:
    one, other = fine(1), fine(2)
    total = sum_piece_weights([(2.0, one), (-0.5, other)])
    assert total is not None and total.cuts == one.cuts and total.smooth
    for name in ("light", "own", "coaxial"):
        wanted = 2.0 * getattr(one, name) - 0.5 * getattr(other, name)
        np.testing.assert_allclose(getattr(total, name), wanted)
    for terms in (
        [],
        [(1.0, None), (1.0, one)],
        [(1.0, one), (1.0, None)],
        [(1.0, one), (1.0, fine(2, cut=0.25))],
    ):
        assert sum_piece_weights(terms) is None


@pytest.mark.parametrize("window", ["quarter", "side-3/4"])
def test_sums_of_each_piece_are_those_of_the_matrix(window: str) -> None:
    """Row by row of the factors: the mask's window at the piece, times the light of cells."""
    lattice = Lattice(GRID, window, (0.125, -0.25))
    rng = np.random.default_rng(4)
    masks = rng.random((3, lattice.dual_fields, lattice.lattice_cells + 1))
    masks[1, 0] = 0.0  # shut throughout
    masks[0, 1, 3] = 0.0  # shut at one cell
    right = rng.random((3, lattice.cells))
    sums = PieceSums(lattice)
    sums.add_rows(masks, right)
    sums.add_rows(masks[:1], right[:1])
    for part in lattice.overlaps:
        sums.add_coaxial(part, np.full(GRID, 2.0))
    found = sums.fine()
    down, right_pieces = lattice.pieces
    assert found.smooth
    assert found.cuts[0] == (*(p.low for p in down), 1.0)
    assert found.cuts[1] == (*(p.low for p in right_pieces), 1.0)
    for i, row in enumerate(down):
        for j, col in enumerate(right_pieces):
            field = lattice.dual_field(row.strip, col.strip)
            seen = lattice.stepped(masks[:, field], (row.step, col.step)).reshape(3, -1)
            seen = np.concatenate([seen, seen[:1]])
            light = np.concatenate([right, right[:1]])
            matrix = seen.T @ light
            at = (slice(i, None, len(down)), slice(j, None, len(right_pieces)))
            np.testing.assert_allclose(found.light[at].ravel(), matrix.sum(axis=1))
            np.testing.assert_allclose(found.own[at].ravel(), matrix.diagonal())
    # Parts of a piece add up to all of it.
    np.testing.assert_allclose(found.coaxial, np.full(found.coaxial.shape, 2.0))
    # Whole cells change at their edges.
    assert not PieceSums(Lattice(GRID, "whole", (0.25, 0.0))).fine().smooth
