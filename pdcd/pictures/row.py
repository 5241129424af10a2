"""One row of a photo's probing matrix, wanted and realised: where a cell's light came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.errors import ConfigError
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import convert_record_errors
from pdcd.pictures.weights import RealisedShot, is_divided_by_row, sum_realised_matrices
from pdcd.pictures.written.picture_files import draw_caption, draw_value_table
from pdcd.probing.deviation import row_weights_s, weight_s
from pdcd.probing.realised import Factors
from pdcd.recipes.recipe import RecipePhoto
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.verify import read_whole_manifest
from pdcd.words import NormaliseName

_WIDTH_PX = 960
"""Least width of a picture of a row."""
_BETWEEN = (29, 95, 168)
"""Colour of the strip between wanted and realised."""


@dataclass(frozen=True, eq=False)
class MatrixRow:
    """Weight of the paths from every projector cell to one camera cell.

    wanted, realised : (rows, cols) float64
        The realised weights are divided by what the picture was divided by, so that both can be
        compared. The entry of the cell itself is the weight of direct light.
    """

    photo: str
    wanted: Floats
    realised: Floats

    def picture(self, cell: tuple[int, int]) -> NDArray[np.uint8]:
        """Both side by side, wanted left, one cell apart, with a strip below, (H, W, 3) uint8.

        Linear in the weight: white is the largest, black is 0, or as far below 0 where there are
        negative ones. cell : row and column of the camera cell.
        """
        both = np.concatenate([self.wanted, self.realised], axis=1)
        top = max(float(np.abs(both).max()), np.finfo(np.float64).tiny)
        low = -top if self.wanted.min() < 0.0 else 0.0
        rows, cols = self.wanted.shape
        shown = np.concatenate([self.wanted, np.zeros((rows, 1)), self.realised], axis=1)
        drawn = draw_value_table((shown - low) / (top - low), _WIDTH_PX)
        side = len(drawn) // rows
        drawn[:, side * cols : side * (cols + 1)] = _BETWEEN
        title = f"paths to cell {cell[0]} {cell[1]}, photo {self.photo}"
        marks = [(round(255 * s), f"{low + s * (top - low):.2g}") for s in (0.0, 0.25, 0.5, 1.0)]
        notes = ("left: weights as wanted", "right: as realised")
        return np.concatenate([drawn, draw_caption(drawn.shape[1], title, notes, marks)])


@dataclass(frozen=True, eq=False)
class WeighedMatrix:
    """A photo's realised matrix, and what its rows are divided by, in seconds: one number (), or
    that of each camera cell (N,)."""

    photo: RecipePhoto
    realised: Factors
    weight_s: Floats


def read_matrix_row(folder: Path, cell: tuple[int, int], photo: str | None = None) -> MatrixRow:
    """Row of a finished run's realised probing matrix.

    Parameters
    ----------
    folder : a run folder.
    cell : row and column of the camera cell.
    photo : which photo; None takes the main one of the recipe.

    Raises
    ------
    DecodeError
        `folder` is no finished run, or its manifest, codes or frame log have changed.
    ConfigError
        There is no such cell or photo.
    """
    record = read_whole_manifest(folder, (CODES, FRAMES)).run
    rows, cols = record.grid
    if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
        raise ConfigError(
            f"there is no cell {cell[0]} {cell[1]} in a grid of {rows} x {cols}",
            hint=f"rows count from 0 to {rows - 1}, columns from 0 to {cols - 1}",
        )
    with convert_record_errors(folder):
        recipe, shots = Darkroom(folder, record).matrices()
    photos = {p.name: p for p in recipe.photos}
    name = recipe.main if photo is None else photo
    if name not in photos:
        raise ConfigError(f"there is no photo {name}", hint=f"known: {', '.join(photos)}")
    found = weigh_matrix(photos[name], shots, record.normalise)
    n = cell[0] * cols + cell[1]
    realised = found.realised
    row = realised.left[:, n] @ realised.right
    row[n] = realised.coaxial[n]
    row = row / (found.weight_s[n] if found.weight_s.ndim else found.weight_s)
    wanted = photos[name].wanted.rows(n, n + 1)[0]
    return MatrixRow(name, wanted.reshape(rows, cols), row.reshape(rows, cols))


def weigh_matrix(
    photo: RecipePhoto, shots: Mapping[str, RealisedShot], normalise: NormaliseName
) -> WeighedMatrix:
    """What the panels really did in a photo, and what its picture was divided by."""
    realised = sum_realised_matrices(photo.shots, shots)
    weight = np.array(weight_s(realised, photo.wanted))
    if is_divided_by_row(photo, shots, normalise):
        inner, norm = row_weights_s(realised, photo.wanted)
        own = np.divide(inner, norm, out=np.zeros_like(inner), where=norm > 0.0)
        weight = np.where(inner > 0.0, own, weight)
    return WeighedMatrix(photo, realised, weight)
