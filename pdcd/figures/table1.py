"""Table 1: all seven rows, each photographed beside its truth."""

from __future__ import annotations

import numpy as np

from pdcd.figures.figure import Grid
from pdcd.figures.tables import Asked, by_the_mirror, itself, stripes, table_of


def rows(grid: Grid) -> tuple[Asked, ...]:
    """The table's rows, in its words."""
    light, warp, cells = stripes(grid), by_the_mirror(grid), grid[0] * grid[1]
    # Quarter windows move codes by half a cell. Neighbours then mix, and a path by a mirror, which
    # goes the other way when its end is moved, is met in half of the places: rows 4 and 5 are far
    # from what they are with whole windows. Rows 1 and 2 are cut where the truth, which knows light
    # for whole cells, is soft.
    return (
        Asked(
            1, "conventional photo under a pattern, T i", "illuminated", 0.15, None,
            asked={"illumination": light},
        ),
        Asked(
            2, "the same by a probing matrix, i_m in every row", "relit", 0.15, None,
            asked={"matrix": np.tile(light.ravel(), (cells, 1))},
        ),
        Asked(3, "the diagonal of T", "diagonal", 0.05, "rademacher"),
        Asked(
            4, "an off-diagonal of T: light from the cell to the right", "off-diagonal", 0.90,
            "rademacher", asked={"shift": (0, 1)},
        ),
        Asked(
            5, "one entry a row of T: the path by the mirror", "warped", 0.75, "rademacher",
            asked={"warp": warp},
        ),
        Asked(
            6, "two entries a row: the path by the mirror, and half of the diagonal",
            "two-samples", 0.11, "rademacher",
            asked={"warp": warp, "warp_b": itself(grid), "mix": (1.0, 0.5)},
        ),
        Asked(
            7, "indirect light under a pattern, A o T under i", "indirect", 0.28,
            asked={"illumination": light},
        ),
    )  # fmt: skip


FIGURE = table_of(
    "table-1",
    "What probing matrices can ask for",
    rows,
    see="Each photo looks like its truth; rows 1 and 2 are the same photo by two ways.",
    paper="a table of matrices; no photos of them are printed.",
    unlike=(
        "rows 4 and 5 want single paths from cell to cell, which quarter windows, made for panels "
        "that are not quite aligned, meet in a part of each cell only."
    ),
)
