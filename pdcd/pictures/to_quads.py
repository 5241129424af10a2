"""From cells up to the quads of a camera: what is known of cells, as each quad saw it.

This is the one way up, as `pdcd.pictures.to_cells` is the one way down. Code that works on cells,
such as weights, corrections and errors of codes, needs no map of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.pictures.picture import Errors, Picture
from pdcd.pictures.weights import CellWeights
from pdcd.probing.fine import PieceWeights
from pdcd.probing.realised import Factors
from pdcd.recipes.alternatives import ALL_DARK, CodeMixture, FittedWeights, MaskedWeights
from pdcd.sensor.bands import OfRows, fill_in_bands, make_planar_image, run_in_bands
from pdcd.sensor.cells import CellMap

_BLIND = 1e-3
"""Light of a window, over the mean of all, below which the window counts as never open."""
_BRIGHTEST = 4.0
"""Most that a quad is taken to be brighter than its cell, for errors in proportion to light."""
LEAST_DIRECT = 1e-4
"""Share of the direct light below which none is taken out, as it is not visible."""
_MOST_DIRECT = 0.5
"""Share from which the photo holds too little indirect light to be corrected in this way."""


@dataclass(frozen=True, eq=False)
class QuadWeights:
    """What the quads of a photo are divided by, in seconds: () or (h, w) float64, all > 0.

    blind : (h, w), quads whose windows were never open for light that the photo is to keep; None
        where there are none. They are divided by the weight of their cell, or the common one.
    """

    quads_s: Floats
    blind: Bools | None


def find_quads_outside(cells: CellMap) -> Bools | None:
    """(h, w), quads that do not lie wholly within the field; None where all do."""
    return None if cells.known.all() else ~cells.known


def weigh_quads(weights: CellWeights, cells: CellMap) -> QuadWeights:
    """What to divide the quads of a photo by.

    A quad is divided by the weight of its cell, times the light of the windows that the quad saw
    over that of the cell. So windows that were open longer than others leave no trace in the
    picture. Quads at the border of the field, whose blur reaches beyond it, are divided by less.
    """
    own, shut = weights.cells_s, weights.shut
    fine = None if cells.map is None else weights.realised.fine
    blind = None if shut is None else cells.spread(shut)
    weight = own
    if own.ndim:
        weight = expand_to_quads(own, cells, fine)
    if fine is not None:
        light, sure = weights.window_light()
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
    return QuadWeights(weight, blind)


def _of_windows(light: Floats, fine: PieceWeights, cells: CellMap) -> tuple[Floats, Bools]:
    """Light of what each quad saw over that of its cell, (h, w), and where there is none."""
    # A camera with one quad a cell: what it sees is the mean over each cell.
    alike = CellMap.block(cells.grid, cells.grid)
    mean = alike.gather(light, fine.cuts)
    seen = cells.gather(light, fine.cuts)
    around = _bring_rows(mean.ravel(), cells, fine)
    least = _BLIND * float(mean.mean())
    closed, known = np.empty(cells.frame, np.bool_), cells.known

    def ratio(rows: slice) -> Floats:
        here, level = seen[rows], around(rows)
        lit = (here > least) & (level > least)
        closed[rows] = known[rows] & ~lit
        return np.divide(here, level, out=np.ones_like(here), where=lit)

    return fill_in_bands(cells.frame, np.float64, ratio), closed


def expand_to_quads(
    values: NDArray[Any], cells: CellMap, fine: PieceWeights | None
) -> NDArray[Any]:
    """Values of cells, (N, ...) -> of quads, (h, w, ...); bool values stay so.

    Where every window has a code of its own (`fine`) nothing changes at the edges of cells, so that
    values are interpolated smoothly; else they are weighted by the shares of cells in each quad.
    """
    if fine is not None and fine.smooth:
        return cells.smooth(values)
    return cells.spread(values)


def _bring_rows(values: Floats, cells: CellMap, fine: PieceWeights | None) -> OfRows:
    """The same for one value a cell, (N,), some rows of quads at a time."""
    if fine is not None and fine.smooth:
        return cells.smooth_rows(values)
    whole = cells.spread(values)
    return lambda rows: whole[rows]


def compute_direct_share(realised: Factors, weights: QuadWeights, cells: CellMap) -> Floats | None:
    """Share of the direct light that a photo of indirect light has, (h, w); None where it is too
    small to be worth a correction, or too large for one."""
    level = float(np.mean(weights.quads_s))
    largest = float(np.abs(realised.coaxial).max()) / level
    if not LEAST_DIRECT < largest < _MOST_DIRECT:
        return None
    fine = None if cells.map is None else realised.fine
    if fine is None:
        seen = expand_to_quads(realised.coaxial, cells, None)
    else:
        seen = cells.gather(fine.coaxial, fine.cuts)
    share = seen / weights.quads_s
    return share if float(np.abs(share).max()) < _MOST_DIRECT else None


def add_missing_light(
    picture: Picture, light: Floats, more: Floats, cells: CellMap, fine: PieceWeights | None
) -> Picture:
    """A picture with the light that its cells lack, (N, C), shared out among their quads in
    proportion to light. Sigma stays, as that light is a small part of the picture.

    light : (N, C), that of the picture on cells. fine : as of `expand_to_quads`.
    """
    whole = cells.known.all()
    lit = [_by_light(picture.image[..., c], light[:, c], cells) for c in range(light.shape[1])]
    missing = [_bring_rows(one, cells, fine) for one in more.T]

    def corrected(rows: slice) -> Floats:
        out = picture.image[rows].copy(order="K")
        for channel, (share, lacking) in enumerate(zip(lit, missing, strict=True)):
            out[..., channel] += share(rows) * lacking(rows)
        if not whole:
            np.copyto(out, 0.0, where=~cells.known[rows, :, None])
        return out

    return Picture(fill_in_bands(picture.image.shape, np.float64, corrected), picture.sigma)


def spread_errors(error: Errors, picture: Picture, light: Floats, cells: CellMap) -> Errors:
    """Errors of cells (rows, cols, C) -> of quads (h, w, C), in proportion to the quads' light.

    light : (rows, cols, C), that of the picture on cells.
    """
    channels = range(error.shape[2])
    shares = [_by_light(picture.image[..., c], light[..., c].ravel(), cells) for c in channels]
    errors = [cells.smooth_rows(error[..., c].ravel()) for c in channels]
    out = make_planar_image(picture.sigma.shape, picture.sigma.dtype)

    def band(rows: slice) -> None:
        for channel, (share, brought) in enumerate(zip(shares, errors, strict=True)):
            np.multiply(share(rows), brought(rows), out=out[rows, :, channel], casting="same_kind")

    run_in_bands(out.shape[0], band)
    return out


def _by_light(image: NDArray[np.floating], of_cells: Floats, cells: CellMap) -> OfRows:
    """Light of quads (h, w) over that of the cells (N,) around them, from 0 to `_BRIGHTEST`: the
    factor between cells and quads of an error in proportion to light. 1 where the cells are dark.

    It is computed for some rows of quads at a time.
    """
    around = cells.smooth_rows(of_cells)
    lit = bool(of_cells.min() > 0.0)

    def some(rows: slice) -> NDArray[np.floating]:
        here, level = image[rows], around(rows)
        share: NDArray[np.floating]
        if lit:
            share = here / level
        else:
            share = np.divide(here, level, out=np.ones(here.shape), where=level > 0.0)
        return np.clip(share, 0.0, _BRIGHTEST, out=share)

    return some


@dataclass(frozen=True, eq=False)
class MixedCodes:
    """Codes of single photos as seen by quads that see several cells. The light of these cells
    cannot be separated, so such a quad has a weight of its own, not the average of its cells'
    weights. `mixture` is None where there are no such quads."""

    cells: CellMap
    bits: Bools
    mixture: CodeMixture | None

    @classmethod
    def of(cls, bits: Bools, cells: CellMap) -> MixedCodes:
        """Made of the lit cells of each photo, (K, N)."""
        if cells.single.all():
            return cls(cells, bits, None)
        codes, squares, dark = (np.zeros(cells.frame) for _ in range(3))
        for code in bits:
            lit = cells.spread(code.astype(np.float64))
            codes += lit
            squares += lit * lit
            dark += lit < ALL_DARK
        return cls(cells, bits, CodeMixture(len(bits), codes, squares, dark))

    def weigh_quads(
        self, of_cells: Floats, photo: int, weigh: FittedWeights | MaskedWeights, equal: Floats
    ) -> Floats:
        """Weights of quads in a photo, (h, w), from those of cells, (N,), which `weigh` makes of
        the codes; `equal` are factors of the photos, (K,)."""
        of_quads = self.cells.spread(of_cells)
        if self.mixture is None:
            return of_quads
        lit = self.cells.spread(self.bits[photo].astype(np.float64))
        mixed = weigh.mixed(lit, self.mixture) * equal[photo]
        return np.where(self.cells.single, of_quads, mixed)
