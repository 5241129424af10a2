"""What the panels did to the cells of a photo, and hence what these are divided by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.errors import DecodeError
from pdcd.probing.deviation import row_weights_s, weight_s
from pdcd.probing.fine import PieceWeights, sum_piece_weights
from pdcd.probing.realised import Factors, sum_signed_factors
from pdcd.probing.wanted import WANTED_BLOCK, WantedMatrix
from pdcd.recipes.recipe import Combination, RecipePhoto
from pdcd.words import NormaliseName

_LEAST_SHARE = 0.1
"""Share of the light that a cell is to get below which it counts as dark: black lets so much by."""
_MOST_LOOKED_AT = 2**26
"""Most wanted weights that are summed over columns; of larger matrices some rows are used."""


class RealisedShot(Protocol):
    """What the panels really did in a shot; no light is needed for it."""

    @property
    def realised(self) -> Factors:
        """The probing matrix that the panels gave it."""
        ...

    @property
    def missed(self) -> int:
        """Refreshes that came late or never, where that left codes with unequal light."""
        ...


@dataclass(frozen=True)
class RealisedMatrix:
    """What the panels did in a shot, without its light.

    crossed : the additional time in seconds, (N,), for which light would go through its own cell if
    the mask were late, and if it were early, by enough for codes to meet others of the projector's;
    None where this was not asked for, or where none can meet. slow : the time in seconds, (N,), for
    which light goes through its own cell because panels are slow or late, in shots of codes.
    """

    realised: Factors
    missed: int = 0
    crossed: tuple[Floats, Floats] | None = None
    slow: Floats | None = None


@dataclass(frozen=True, eq=False)
class CellWeights:
    """What the panels did to the cells of a photo, and what each is divided by.

    realised : the photo's probing matrix.
    cells_s : in seconds, all > 0: one number (), or that of each cell's row (N,).
    shut : (N,), cells that were never open for what they are to keep; None where there are none.
    shown : the fine sums of its shots, where these are known.
    """

    photo: RecipePhoto
    realised: Factors
    cells_s: Floats
    shut: Bools | None
    shown: tuple[PieceWeights | None, ...]

    def window_light(self) -> tuple[Floats | None, bool]:
        """Light of the photo that each piece of the cells let through, up to a factor, and whether
        a piece without any is blind, as light is wanted everywhere."""
        uniform = self.photo.wanted.uniform
        if uniform is not None and self.realised.fine is not None:
            light = self.realised.fine.kept(*uniform)
            if (light >= 0.0).all() and light.any():
                return light, True
        # The wanted weights differ from path to path, or have signs: all light is used instead.
        whole = sum_piece_weights((1.0, fine) for fine in self.shown)
        if whole is None or not whole.light.any():
            return None, False
        return whole.light, False


def weigh_cells(
    photo: RecipePhoto, shots: Mapping[str, RealisedShot], normalise: NormaliseName
) -> CellWeights:
    """What the cells of a photo are divided by.

    With `normalise` "row" each cell is divided by its own weight, with "scalar" all by the same.
    "auto" is "row" for photos whose codes ask for it and for those that missed refreshes: lost
    codes leave cells open unequally often, as the paper's random codes do.

    Raises DecodeError for a photo that has no light on the paths it is to keep.
    """
    realised = sum_realised_matrices(photo.shots, shots)
    own, shut = _row_weights(photo, realised, is_divided_by_row(photo, shots, normalise))
    shown = tuple(shots[name].realised.fine for _, name in photo.shots)
    return CellWeights(photo, realised, own, shut, shown)


def is_divided_by_row(
    photo: RecipePhoto, shots: Mapping[str, RealisedShot], normalise: NormaliseName
) -> bool:
    """Whether each cell of a photo is divided by its own weight; see `pdcd.pictures.combine`."""
    if normalise == "auto":
        return photo.row_weights or any(shots[name].missed for _, name in photo.shots)
    return normalise == "row"


def sum_realised_matrices(terms: Combination, shots: Mapping[str, RealisedShot]) -> Factors:
    """Realised probing matrix of a signed sum of shots."""
    return sum_signed_factors((sign, shots[name].realised) for sign, name in terms)


def find_shut_cells(realised: Factors, wanted: WantedMatrix) -> Bools | None:
    """Cells that the mask never opened for what they are to keep, (N,); None where there are none.

    Black that leaks does not count: less than `_LEAST_SHARE` of the light of others is none.
    """
    through = np.abs(realised.right).sum(axis=1) @ np.abs(realised.left)
    shut: Bools = through < _LEAST_SHARE * through.mean()
    if not shut.any():  # as with the codes of a family
        return None
    inner, norm = row_weights_s(realised, wanted)
    common = weight_s(realised, wanted)
    shut &= (norm > 0.0) & (inner < _LEAST_SHARE * common * norm)
    return shut if shut.any() else None


def find_unlit_cells(realised: Factors, wanted: WantedMatrix) -> tuple[Bools, float]:
    """Cells that the projector never lit although their light is wanted, (N,), and their share of
    the absolute wanted weights."""
    lit = np.abs(realised.left).sum(axis=1) @ np.abs(realised.right)
    unlit: Bools = lit < _LEAST_SHARE * lit.mean()
    if not unlit.any():
        return unlit, 0.0
    weights = _sum_columns(wanted)
    total = float(weights.sum())
    if not total > 0.0:
        return np.zeros_like(unlit), 0.0
    unlit &= lit * total < _LEAST_SHARE * weights * lit.sum()
    return unlit, float(weights[unlit].sum()) / total


def _sum_columns(wanted: WantedMatrix) -> Floats:
    """Sums of the absolute wanted weights over columns, (N,), up to a factor; with many cells, from
    some rows, evenly spread."""
    step = -(-(wanted.cells**2) // _MOST_LOOKED_AT)
    block = WANTED_BLOCK if step == 1 else 1
    total = np.zeros(wanted.cells)
    for start in range(0, wanted.cells, step * block):
        rows = wanted.rows(start, min(start + block, wanted.cells))
        total += np.abs(rows).sum(axis=0)
    return total


def _row_weights(
    photo: RecipePhoto, realised: Factors, by_row: bool
) -> tuple[Floats, Bools | None]:
    """Weights of cells, () or (N,), and which cells were never open for what they are to keep. The
    common weight includes a share of these, so where there are any each cell is divided by its own.
    """
    common = weight_s(realised, photo.wanted)
    if not common > 0.0:
        raise DecodeError(
            f"photo {photo.name} has no light on the paths it is to keep",
            hint="look at frames.csv: did the panels show the codes while the shutter was open",
        )
    shut = find_shut_cells(realised, photo.wanted)
    if not by_row and shut is None:
        return np.array(common), None
    inner, norm = row_weights_s(realised, photo.wanted)
    usable = (norm > 0.0) & (inner > 0.0)
    if shut is not None:
        usable &= ~shut
    own: Floats = np.where(usable, inner / np.where(norm > 0.0, norm, 1.0), common)
    return own, (norm > 0.0) & ~usable
