"""What each quad of a photo is to be divided by, cell by cell and window by window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.probing.deviation import row_weights_s, weight_s
from pdcd.probing.fine import Fine, summed
from pdcd.probing.realised import Factors, signed_sum
from pdcd.recipes.recipe import Combination, Photo
from pdcd.sensor.bands import OfRows, banded
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

BLIND = 1e-3
"""Share of the mean light of all windows below which one counts as never open."""


class Shown(Protocol):
    """What the panels really did in a shot; no light is needed to know it."""

    @property
    def realised(self) -> Factors:
        """The probing matrix that they gave it."""
        ...

    @property
    def missed(self) -> int:
        """Refreshes that came late or never, where that left codes with unequal light."""
        ...


@dataclass(frozen=True, eq=False)
class Weights:
    """What the quads of a photo are divided by, in seconds: () or (h, w) float64, all > 0.

    blind : (h, w), quads whose windows were never open for light that the photo is to keep; None
        where there are none. They are divided by the weight of their cell, or the common one.
    """

    quads_s: Floats
    blind: Bools | None


def divided_by_row(photo: Photo, shots: Mapping[str, Shown], normalise: NormaliseName) -> bool:
    """Whether each cell of a photo is divided by its own weight; see `pdcd.pictures.combine`."""
    if normalise == "auto":
        return photo.row_weights or any(shots[name].missed for _, name in photo.shots)
    return normalise == "row"


def realised_photo(terms: Combination, shots: Mapping[str, Shown]) -> Factors:
    """Realised probing matrix of a signed sum of shots."""
    return signed_sum((sign, shots[name].realised) for sign, name in terms)


def cell_weights_s(photo: Photo, realised: Factors, *, by_row: bool) -> Floats:
    """What to divide the cells of a photo by: one number (), or that of each cell's row (N,)."""
    return _of_cells(photo, realised, by_row)[0]


def quad_weights_s(
    photo: Photo, realised: Factors, shots: Mapping[str, Shown], cells: CellMap, *, by_row: bool
) -> Weights:
    """What to divide the quads of a photo by.

    That of its cell, times the light of the windows that the quad saw over that of its cell. So
    windows that were open longer than others leave no trace in the picture. Quads at the border of
    the field, whose blur reaches beyond it, are divided by less.
    """
    own, shut = _of_cells(photo, realised, by_row)
    fine = None if cells.map is None else realised.fine
    blind = None if shut is None else cells.spread(shut)
    weight = own
    if own.ndim:
        weight = brought(own, cells, fine)
    if fine is not None:
        light, sure = _window_light(photo, fine, shots)
        if light is not None:
            ratio, closed = _of_windows(light, fine, cells)
            weight = weight * ratio
            if sure:
                blind = closed if blind is None else blind | closed
    if cells.inside is not None:
        weight = weight * np.where(cells.known, cells.inside, 1.0)
    if blind is not None and not blind.any():
        blind = None
    if weight.ndim and not (weight > 0.0).all():  # outside the field
        weight = np.where(weight > 0.0, weight, float(own.flat[0]))
    return Weights(weight, blind)


def brought(cells_values: Floats, cells: CellMap, fine: Fine | None) -> Floats:
    """What is known of cells, (N, ...) -> of quads, (h, w, ...).

    Where every window has a code of its own nothing changes at the edges of cells, so that what is
    only known cell by cell is brought over smoothly; else by the shares of cells.
    """
    if fine is not None and fine.smooth:
        return cells.smooth(cells_values)
    return cells.spread(cells_values)


def brought_rows(cells_values: Floats, cells: CellMap, fine: Fine | None) -> OfRows:
    """The same of one value a cell, (N,), some rows of quads at a time."""
    if fine is not None and fine.smooth:
        return cells.smooth_rows(cells_values)
    whole = cells.spread(cells_values)
    return lambda rows: whole[rows]


def _of_cells(photo: Photo, realised: Factors, by_row: bool) -> tuple[Floats, Bools | None]:
    """Weights of cells, () or (N,), and which cells were never open for what they are to keep."""
    common = weight_s(realised, photo.wanted)
    if not common > 0.0:
        raise DecodeError(
            f"photo {photo.name} has no light on the paths it is to keep",
            hint="look at frames.csv: did the panels show the codes while the shutter was open",
        )
    if not by_row:
        return np.array(common), None
    inner, norm = row_weights_s(realised, photo.wanted)
    usable = (norm > 0.0) & (inner > 0.0)
    own: Floats = np.where(usable, inner / np.where(norm > 0.0, norm, 1.0), common)
    return own, (norm > 0.0) & ~usable


def _window_light(
    photo: Photo, fine: Fine, shots: Mapping[str, Shown]
) -> tuple[Floats | None, bool]:
    """Light of the photo that each piece of the cells let through, up to a factor, and whether
    light is wanted everywhere, so that a piece without any is blind."""
    uniform = photo.wanted.uniform
    if uniform is not None:
        light = fine.kept(*uniform)
        if (light >= 0.0).all() and light.any():
            return light, True
    # What is wanted differs from path to path, or has signs: all light speaks for it.
    whole = summed((1.0, shots[name].realised.fine) for _, name in photo.shots)
    if whole is None or not whole.light.any():
        return None, False
    return whole.light, False


def _of_windows(light: Floats, fine: Fine, cells: CellMap) -> tuple[Floats, Bools]:
    """Light of what each quad saw over that of its cell, (h, w), and where that is none."""
    # A camera with one quad a cell: what it sees is the mean over each cell.
    alike = CellMap.block(cells.grid, cells.grid)
    mean = alike.gather(light, fine.cuts)
    seen = cells.gather(light, fine.cuts)
    around = brought_rows(mean.ravel(), cells, fine)
    least = BLIND * float(mean.mean())
    closed, known = np.empty(cells.frame, np.bool_), cells.known

    def ratio(rows: slice) -> Floats:
        here, level = seen[rows], around(rows)
        lit = (here > least) & (level > least)
        closed[rows] = known[rows] & ~lit
        return np.divide(here, level, out=np.ones_like(here), where=lit)

    return banded(cells.frame, np.float64, ratio), closed
