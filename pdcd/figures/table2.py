"""Table 2: all seven rows, each photographed beside its truth."""

from __future__ import annotations

import numpy as np

from pdcd.figures.figure import Grid
from pdcd.figures.tables import Asked, mirror, spot, table_of

RADIUS = 2
KERNEL = np.array([[0.0, -0.25, 0.0], [-0.25, 1.0, -0.25], [0.0, -0.25, 0.0]])
"""The cell itself less its four neighbours."""


def rows(grid: Grid) -> tuple[Asked, ...]:
    """The table's rows, in its words."""
    return (
        Asked(1, "direct, retro-reflection and back-scattering", "direct", 0.05),
        Asked(2, "all other indirect light", "indirect", 0.16),
        Asked(
            3, f"long-range indirect: from more than {RADIUS} cells away", "long-range", 0.55,
            asked={"radius": RADIUS},
        ),
        Asked(
            4, f"short-range indirect: from within {RADIUS} cells", "short-range", 0.50,
            asked={"radius": RADIUS},
        ),
        Asked(
            5, "transport masking: no light from the mirror to the wall beside it", "blocked",
            0.034, None, asked={"region_a": spot(grid), "region_b": mirror(grid)},
        ),
        # Misplaced panels let in direct light at the borders of cells: more where these are small.
        Asked(
            6, "local de-scattering: direct less what came from the cell to the left",
            "descattered", 0.10, "rademacher", signed=True, full_bound=0.21,
            asked={"shift": (0, -1)},
        ),
        Asked(
            7, "a filter: direct less a quarter of each neighbour", "filtered", 0.053,
            "rademacher", signed=True, asked={"kernel": KERNEL},
        ),
    )  # fmt: skip


FIGURE = table_of(
    "table-2",
    "Seven tasks by their probing matrices",
    rows,
    see="Row 5 takes the mirror's light off the wall and leaves all else as it is.",
    paper="a table of matrices; Figures 1 and 8 to 12 show some of them.",
    unlike="distances in rows 3 and 4 are the larger of both.",
)
