"""A slice of the transport matrix itself: light of single projector cells at single camera cells.

The cells of one projector row are lit by the rows of an S-matrix, all others stay black, and each
pattern is a RAW file of its own. Every column of the slice then follows from all photos, with the
noise of a photo of half the row instead of a single cell (Fig. 5 of the paper used codes, too).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Bools, Indices
from pdcd.codes.orders import is_order, make_hadamard_columns
from pdcd.errors import RequestError
from pdcd.probing.wanted import OuterPart, WantedMatrix
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.programs import BlockProgram
from pdcd.recipes.recipe import Recipe, RecipePhoto, Shot

_PROGRAM = "lights"
_SPARE = 4
MOST_PHOTOS = 1024
"""Most photos of one slice; each is a RAW file."""


@dataclass(frozen=True, eq=False)
class Slice:
    """Which entries of T are photographed: projector cells `lit` (J,), camera cells `seen` (C,)."""

    lit: Indices
    seen: Indices

    @classmethod
    def of(cls, goal: Goal, grid: tuple[int, int]) -> Slice:
        """The slice of a goal that `check_slice` has passed; without rows, all of T."""
        cells = np.arange(grid[0] * grid[1]).reshape(grid)
        if goal.rows is None:
            return cls(cells.ravel(), cells.ravel())
        return cls(cells[goal.rows[0]], cells[goal.rows[1]])


def check_slice(goal: Goal, grid: tuple[int, int], repeat: int = 1) -> None:
    """Refuse rows that do not exist, and slices of too many photos, each taken `repeat` times.
    Raises RequestError."""
    for row in goal.rows or ():
        if not 0 <= row < grid[0]:
            raise RequestError(
                f"there is no row {row} on a grid of {grid[0]} x {grid[1]} cells",
                hint=f"rows count from 0 to {grid[0] - 1}",
            )
    if goal.masked and goal.rows is None:
        raise RequestError("all of T leaves no row to mask", hint="name rows, or leave out masked")
    count = Slice.of(goal, grid).lit.size
    photos = repeat * count_slice_photos(count)
    if photos > MOST_PHOTOS:
        raise RequestError(
            f"{count} projector cells take {photos} photos; the limit is {MOST_PHOTOS}",
            hint="name a row of cells, take a coarser grid, or repeat them less often",
        )


def count_slice_photos(cells: int) -> int:
    """Photos for so many projector cells: one less than the least Hadamard order that has a column
    for each of them, one that is all ones, and `_SPARE` unused ones.

    The unused columns measure what all photos have in common: with s of them the variance of an
    entry is 1 + 1 / s times that of a slice without such light.
    """
    order = cells + 1 + _SPARE
    while not is_order(order):
        order += 1
    return order - 1


def make_s_matrix(cells: int) -> Bools:
    """Which cells are lit in which photo, (K, cells): the first columns of the S-matrix of order K,
    each lit in (K + 1) / 2 photos (Harwit and Sloane 1979)."""
    columns = make_hadamard_columns(count_slice_photos(cells) + 1, np.arange(1, cells + 1))
    return np.asarray((columns * columns[0])[1:] < 0)


def make_transport_recipe(target: Target, how: CaptureScheme) -> Recipe:
    """The recipe of a slice: a photo for each pattern; as a picture, the scene under all its light.

    Raises RequestError as `check_slice`, and for ways of photographing that a slice does not
    support.
    """
    if how.method != "coded" or how.pilot or how.parts > 1:
        raise RequestError(
            "a slice of T is taken in photos of single patterns",
            hint="leave out method, pilot and parts; repeat takes each photo more than once",
        )
    check_slice(target.goal, target.grid, how.repeat)
    part = Slice.of(target.goal, target.grid)
    lights = np.zeros((count_slice_photos(part.lit.size), target.cells))
    lights[:, part.lit] = make_s_matrix(part.lit.size)
    seen, lit = np.zeros(target.cells), np.zeros(target.cells)
    seen[part.seen if target.goal.masked else slice(None)] = 1.0
    lit[part.lit] = 1.0
    names = tuple(f"light-{k + 1:04d}" for k in range(len(lights)))
    return Recipe(
        target,
        {_PROGRAM: BlockProgram(np.tile(seen, (len(lights), 1)), lights)},
        tuple(Shot(name, _PROGRAM, only=k) for k, name in enumerate(names)),
        (
            RecipePhoto(
                "lit",
                WantedMatrix(target.grid, ((1.0, OuterPart(seen, lit)),)),
                tuple((1.0, name) for name in names),
            ),
        ),
        {"lit": ((1.0, "lit"),)},
        stack=names,
    )
