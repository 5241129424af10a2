"""What Tables 1 and 2 share: each row photographed beside its truth and by the paper's codes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    OUR_CODES,
    PAPERS_CODES,
    Drawn,
    Figure,
    Grid,
    Mode,
    Number,
    Panel,
    Photo,
    Row,
    Take,
    codes_printed,
)
from pdcd.figures.picture import white_of
from pdcd.virtual.scene.presets.canvas import WIDTH, Raster
from pdcd.virtual.scene.presets.still_life import (
    MIRROR_FOOT,
    MIRROR_HALF,
    MIRROR_LANDS,
    MIRROR_TOP,
    MIRROR_X,
    SQUEEZE,
)
from pdcd.words import FamilyName, GoalName

SCENE = "still-life"
PRINTED = 512
SMALL = (24, 32)
LEAST_SHARE = 0.05
"""Of the white photo's brightness: what is darker than that is brightened to it."""

HALF = 0.15
"""Half width of the spot that the scene's mirror throws, without its rim."""
TOP, FOOT = MIRROR_TOP + 0.02, MIRROR_FOOT - 0.02
"""Heights of the drawing between which the spot is counted: a little within those of the mirror."""


@dataclass(frozen=True)
class Asked:
    """A row of a table.

    words : what is written above. coins : the paper's codes for it, None where it needs none: its
    matrix is a sum of a few products. bound : of the error of our photo; full_bound : on the full
    page, where it is another. signed : the picture has both signs.
    """

    number: int
    words: str
    goal: GoalName
    bound: float
    coins: FamilyName | None = "bernoulli"
    signed: bool = False
    full_bound: float | None = None
    asked: Mapping[str, Any] = field(default_factory=dict)


def grid_of(mode: Mode) -> Grid:
    """Cells of the tables: the quick page has room for small pictures only."""
    return min(mode.grid, SMALL) if mode.quick else mode.grid


def table_of(
    number: str,
    title: str,
    rows: Callable[[Grid], tuple[Asked, ...]],
    *,
    see: str,
    paper: str,
    unlike: str,
) -> Figure:
    """A table as a figure. rows : its rows on a grid of cells; the words are as of `Figure`."""
    return Figure(
        number,
        title,
        see=see,
        paper=paper,
        unlike=unlike,
        takes=lambda mode: takes_of(rows(grid_of(mode)), mode),
        drawn=lambda mode, photos: drawn_of(rows(grid_of(mode)), photos),
    )


def takes_of(rows: tuple[Asked, ...], mode: Mode) -> dict[str, Take]:
    """All light, and a photo of every row; in the full page another by the paper's codes."""
    grid, coins = grid_of(mode), not mode.quick
    found = {"white": Take(SCENE, "white", grid=grid, said="all light")}
    codes = {"codes": codes_printed(PRINTED)}
    for row in rows:
        # What leaks is alike in both photos of a pair, and cancels; of few products it is little.
        leaks = {} if row.coins == "bernoulli" else {"black_level": "none"}
        asked = {**OUR_CODES, **codes, **leaks, **row.asked}
        found[f"row {row.number}"] = Take(
            SCENE,
            row.goal,
            asked,
            bound=mode.bound(row.bound, row.full_bound or row.bound),
            grid=grid,
            said="our codes",
        )
        if row.coins is not None and coins:
            asked = {**PAPERS_CODES, **codes, **leaks, "family": row.coins, **row.asked}
            found[f"row {row.number}, paper"] = Take(
                SCENE, row.goal, asked, grid=grid, said="the paper's codes"
            )
    return found


def drawn_of(rows: tuple[Asked, ...], photos: Mapping[str, Photo]) -> Drawn:
    """A row of pictures for each row of the table."""
    level = white_of(photos["white"].image)
    shown, numbers = [], []
    for row in rows:
        ours, papers = photos[f"row {row.number}"], photos.get(f"row {row.number}, paper")
        white = max(white_of(ours.truth), LEAST_SHARE * level)
        panels = [
            Panel(ours.image, "photo", white, signed=row.signed),
            Panel(ours.truth, "truth", white, signed=row.signed),
        ]
        if papers is not None:
            panels.append(Panel(papers.image, "the paper's codes", white, signed=row.signed))
            numbers.append(
                Number(
                    f"row {row.number}: error of the paper's codes over ours",
                    papers.error / ours.error,
                    least=1.0,
                )
            )
        title = f"Row {row.number}: {row.words}"
        shown.append(Row(tuple(panels), title, small=True))
    return Drawn(tuple(shown), numbers=tuple(numbers))


def spot(grid: Grid) -> NDArray[Any]:
    """Camera cells on which the mirror throws its light, (rows, cols), 0 or 1."""
    drawing = Raster(grid)
    inside = (np.abs(drawing.x - MIRROR_LANDS) < HALF) & (drawing.y > TOP) & (drawing.y < FOOT)
    return inside.astype(np.float64)


def mirror(grid: Grid) -> NDArray[Any]:
    """Projector cells that light the mirror, (rows, cols), 0 or 1."""
    drawing = Raster(grid)
    inside = np.abs(drawing.x - MIRROR_X) < MIRROR_HALF + 0.03
    inside &= (drawing.y > MIRROR_TOP - 0.04) & (drawing.y < MIRROR_FOOT + 0.04)
    return inside.astype(np.float64)


def by_the_mirror(grid: Grid) -> NDArray[Any]:
    """The projector cell whose light the mirror brings to each camera cell; -1 beside the spot."""
    rows, cols = grid
    seen = MIRROR_X - (Raster(grid).x - MIRROR_LANDS) / SQUEEZE
    column = np.floor((seen / WIDTH + 0.5) * cols)
    cell = np.arange(rows)[:, None] * cols + column
    return np.where(spot(grid) > 0.0, cell, -1.0)


def itself(grid: Grid) -> NDArray[Any]:
    """Every cell's own number, (rows, cols)."""
    rows, cols = grid
    return np.arange(rows * cols, dtype=np.float64).reshape(rows, cols)


def stripes(grid: Grid) -> NDArray[Any]:
    """An illumination of broad vertical stripes, (rows, cols), 0.15 or 1."""
    rows, cols = grid
    lit = (np.arange(cols) * 8 // cols) % 2 == 0
    return np.where(lit, 1.0, 0.15) * np.ones((rows, 1))
