"""Cells that a cell's edges see in a mirror, where its middle sees their neighbour."""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.codes.pilot.links import BESIDE, widen_links

GRID = (3, 4)


def test_links_reach_the_cells_beside_partners_and_never_the_cell_itself() -> None:
    links = scipy.sparse.lil_array((12, 12))
    links[0, 5] = 0.8  # row 1, column 1: four cells beside it
    links[7, 3] = 0.4  # the corner beside cell 7: one cell but itself
    links[9, 5] = 0.2
    found = widen_links(scipy.sparse.csr_array(links), GRID).toarray()
    wanted = np.zeros((12, 12))
    wanted[0, [1, 4, 6, 9]] = 0.8 * BESIDE
    wanted[0, 5] = 0.8
    wanted[7, 2] = 0.4 * BESIDE
    wanted[7, 3] = 0.4
    wanted[9, [1, 4, 6]] = 0.2 * BESIDE
    wanted[9, 5] = 0.2
    np.testing.assert_allclose(found, wanted)
