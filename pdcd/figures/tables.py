"""Tables 1 and 2: all seven rows of each, photographed, with their truth and the paper's codes.

Rows take signed or unsigned coins if the paper needs codes for them: a matrix that is a sum of a
few products needs none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.draw import white_of
from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigureTake,
    GridShape,
    PanelRow,
    PaperFigure,
    Photos,
    take_coded,
)
from pdcd.virtual.scene.presets.canvas import FRAME_WIDTH, FrameRaster
from pdcd.virtual.scene.presets.still_life import (
    MIRROR_FOOT,
    MIRROR_HALF,
    MIRROR_LANDS,
    MIRROR_TOP,
    MIRROR_X,
    SQUEEZE,
)
from pdcd.words import FamilyName, GoalName

_SCENE = "still-life"
_PRINTED = 512
_SMALL = (24, 32)
_LEAST_SHARE = 0.05
"""Share of the white photo's brightness; darker pictures are brightened to it."""

_HALF = 0.15
"""Half width of the spot that the scene's mirror throws, without its rim."""
_TOP, _FOOT = MIRROR_TOP + 0.02, MIRROR_FOOT - 0.02
"""Heights in the drawing between which the spot is counted: a little inside the mirror's."""
_RADIUS = 2
_KERNEL = np.array([[0.0, -0.25, 0.0], [-0.25, 1.0, -0.25], [0.0, -0.25, 0.0]])
"""The cell itself less a quarter of each of its four neighbours."""


@dataclass(frozen=True)
class TableRow:
    """A row of a table.

    words : its title. coins : the paper's codes for it, None if it needs none, as its matrix is a
    sum of a few products. bound : of the error of our photo; full_bound : the same on the full
    page, if it differs. signed : the picture has both signs.
    """

    words: str
    goal: GoalName
    bound: float
    coins: FamilyName | None = "bernoulli"
    signed: bool = False
    full_bound: float | None = None
    asked: Mapping[str, Any] = field(default_factory=dict)


def list_table_1_rows(grid: GridShape) -> tuple[TableRow, ...]:
    """The first table's rows, in its words.

    Quarter windows move codes by half a cell. Then neighbours mix, and a path by a mirror, which
    moves the other way when its end is moved, is met in only half of the places: rows 4 and 5
    differ much from those with whole windows. Rows 1 and 2 have sharp edges where the truth, which
    is computed for whole cells, is soft.
    """
    light, warp, cells = make_stripes(grid), map_mirror_paths(grid), grid[0] * grid[1]
    itself = np.arange(cells, dtype=np.float64).reshape(grid)
    return (
        TableRow(
            "conventional photo under a pattern, T i", "illuminated", 0.15, None,
            asked={"illumination": light},
        ),
        TableRow(
            "the same by a probing matrix, i_m in every row", "relit", 0.15, None,
            asked={"matrix": np.tile(light.ravel(), (cells, 1))},
        ),
        TableRow("the diagonal of T", "diagonal", 0.05, "rademacher"),
        TableRow(
            "an off-diagonal of T: light from the cell to the right", "off-diagonal", 0.90,
            "rademacher", asked={"shift": (0, 1)},
        ),
        TableRow(
            "one entry a row of T: the path by the mirror", "warped", 0.75, "rademacher",
            asked={"warp": warp},
        ),
        TableRow(
            "two entries a row: the path by the mirror, and half of the diagonal",
            "two-samples", 0.11, "rademacher",
            asked={"warp": warp, "warp_b": itself, "mix": (1.0, 0.5)},
        ),
        TableRow(
            "indirect light under a pattern, A o T under i", "indirect", 0.28,
            asked={"illumination": light},
        ),
    )  # fmt: skip


def list_table_2_rows(grid: GridShape) -> tuple[TableRow, ...]:
    """The second table's rows, in its words."""
    # The error of far light from one exposure is larger with coarse cells.
    return (
        TableRow("direct, retro-reflection and back-scattering", "direct", 0.05),
        TableRow("all other indirect light", "indirect", 0.16),
        TableRow(
            f"long-range indirect: from more than {_RADIUS} cells away", "long-range", 0.67,
            asked={"radius": _RADIUS}, full_bound=0.55,
        ),
        TableRow(
            f"short-range indirect: from within {_RADIUS} cells", "short-range", 0.53,
            asked={"radius": _RADIUS}, full_bound=0.50,
        ),
        TableRow(
            "transport masking: no light from the mirror to the wall beside it", "blocked",
            0.034, None, asked={"region_a": mark_mirror_spot(grid),
            "region_b": mark_mirror_cells(grid)},
        ),
        # Misplaced panels let in direct light at the borders of cells: more if cells are small.
        TableRow(
            "local de-scattering: direct less what came from the cell to the left",
            "descattered", 0.10, "rademacher", signed=True, full_bound=0.21,
            asked={"shift": (0, -1)},
        ),
        TableRow(
            "a filter: direct less a quarter of each neighbour", "filtered", 0.053,
            "rademacher", signed=True, asked={"kernel": _KERNEL},
        ),
    )  # fmt: skip


def _grid_of(mode: FigureMode) -> GridShape:
    """Rows and columns of cells of the tables; fewer on the quick page."""
    return min(mode.grid, _SMALL) if mode.quick else mode.grid


_Rows = Callable[[GridShape], tuple[TableRow, ...]]


def _take_rows(rows: _Rows, mode: FigureMode) -> dict[str, FigureTake]:
    """All light, and a photo of every row; on the full page another with the paper's codes."""
    grid = _grid_of(mode)
    found = {"white": FigureTake(_SCENE, "white", grid=grid, said="all light")}
    for number, row in enumerate(rows(_grid_of(mode)), 1):
        # Leaks are alike in both photos of a pair and cancel; with few products they are small.
        leaks = {} if row.coins == "bernoulli" else {"black_level": "none"}
        bound = mode.bound(row.bound, row.full_bound or row.bound)
        what = _SCENE, row.goal, _PRINTED
        found[f"row {number}"] = take_coded(
            "ours", *what, {**leaks, **row.asked}, grid=grid, bound=bound
        )
        if row.coins is not None and not mode.quick:
            asked = {**leaks, "family": row.coins, **row.asked}
            found[f"row {number}, paper"] = take_coded("paper", *what, asked, grid=grid)
    return found


def _show_rows(rows: _Rows, mode: FigureMode, photos: Photos) -> Iterator[PanelRow | BoundedNumber]:
    """A row of pictures for each row of the table."""
    level = white_of(photos["white"].image)
    for number, row in enumerate(rows(_grid_of(mode)), 1):
        ours, papers = photos[f"row {number}"], photos.get(f"row {number}, paper")
        images = {"photo": ours.image, "truth": ours.truth}
        if papers is not None:
            images["the paper's codes"] = papers.image
            what = f"row {number}: error of the paper's codes over ours"
            yield BoundedNumber(what, papers.error / ours.error, least=1.0)
        white = max(white_of(ours.truth), _LEAST_SHARE * level)
        panels = [FigurePanel(image, w, white, signed=row.signed) for w, image in images.items()]
        yield PanelRow(tuple(panels), f"Row {number}: {row.words}", small=True)


def mark_mirror_spot(grid: GridShape) -> NDArray[Any]:
    """Camera cells on which the mirror throws its light, (rows, cols), 0 or 1."""
    drawing = FrameRaster(grid)
    inside = (np.abs(drawing.x - MIRROR_LANDS) < _HALF) & (drawing.y > _TOP) & (drawing.y < _FOOT)
    return inside.astype(np.float64)


def mark_mirror_cells(grid: GridShape) -> NDArray[Any]:
    """Projector cells that light the mirror, (rows, cols), 0 or 1."""
    drawing = FrameRaster(grid)
    inside = np.abs(drawing.x - MIRROR_X) < MIRROR_HALF + 0.03
    inside &= (drawing.y > MIRROR_TOP - 0.04) & (drawing.y < MIRROR_FOOT + 0.04)
    return inside.astype(np.float64)


def map_mirror_paths(grid: GridShape) -> NDArray[Any]:
    """The projector cell whose light the mirror throws on each camera cell; -1 beside the spot."""
    rows, cols = grid
    seen = MIRROR_X - (FrameRaster(grid).x - MIRROR_LANDS) / SQUEEZE
    column = np.floor((seen / FRAME_WIDTH + 0.5) * cols)
    cell = np.arange(rows)[:, None] * cols + column
    return np.where(mark_mirror_spot(grid) > 0.0, cell, -1.0)


def make_stripes(grid: GridShape) -> NDArray[Any]:
    """An illumination of broad vertical stripes, (rows, cols), 0.15 or 1."""
    rows, cols = grid
    lit = (np.arange(cols) * 8 // cols) % 2 == 0
    return np.where(lit, 1.0, 0.15) * np.ones((rows, 1))


TABLE_1 = PaperFigure(
    "table-1",
    "What probing matrices can ask for",
    takes=partial(_take_rows, list_table_1_rows),
    shown=partial(_show_rows, list_table_1_rows),
    see="Each photo looks like its truth; rows 1 and 2 are the same photo by two ways.",
    paper="a table of matrices; no photos of them are printed.",
    unlike=(
        "rows 4 and 5 want single paths from cell to cell, which quarter windows, made for panels "
        "that are not quite aligned, meet in a part of each cell only."
    ),
)
TABLE_2 = PaperFigure(
    "table-2",
    "Seven tasks by their probing matrices",
    takes=partial(_take_rows, list_table_2_rows),
    shown=partial(_show_rows, list_table_2_rows),
    see="Row 5 takes the mirror's light off the wall and leaves all else as it is.",
    paper="a table of matrices; Figures 1 and 8 to 12 show some of them.",
    unlike="distances in rows 3 and 4 are the larger of both.",
)
