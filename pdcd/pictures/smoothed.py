"""The correction for smooth light, worked out on cells and brought to the quads of a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.combine import Picture, cell_weights_s, divided_by_row, realised_photo
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.learn import Learned, known_light
from pdcd.pictures.shares import Bools
from pdcd.pictures.smooth import Coded, colour_correction, shares_of_parts
from pdcd.pictures.weights import brought_rows
from pdcd.probing.realised import Factors
from pdcd.recipes.recipe import Photo
from pdcd.sensor.bands import OfRows, banded
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

Floats = NDArray[np.float64]

MOST = 4.0
"""Most that a quad is taken to be brighter than its cell, where an error is shared out by light."""


@dataclass(frozen=True, eq=False)
class Told:
    """What the parts of a photo tell of its smooth light: the light of cells, (N, C), without the
    paths that are known, and the shares of each kind, (P,)
    (`pdcd.pictures.smooth.shares_of_parts`).

    Parts are corrected by the light of all of them, as their own errs by much more.
    """

    light: Floats
    shares: Floats


def smoothed(
    photo: Photo,
    shots: Mapping[str, Exposed],
    picture: Picture,
    learned: Learned | None,
    cells: CellMap,
    *,
    normalise: NormaliseName = "auto",
    alive: Callable[[], None] = lambda: None,
    told: Told | None = None,
) -> Picture:
    """A picture of indirect or of far light corrected for its smooth light
    (`pdcd.pictures.smooth`).

    What is missing of a cell is shared out among its quads as they have light. Sigma stays: the
    correction is a small part of the picture. `normalise` is what the picture was made with
    (`pdcd.pictures.combine`). `alive` as of `smooth_correction`. `told` is what the parts of the
    photo, or of that of which it is a part, tell; else the picture tells by itself, where any quad
    sees it.
    """
    realised, weight, image, rest = _of_cells(photo, shots, picture, learned, cells, normalise)
    light, shares = (rest, None) if told is None else (told.light, told.shares)
    seen = seen_of(cells)
    more = colour_correction(
        realised.left, realised.right, weight, light, cells.grid, alive, photo.beyond, shares, seen
    )
    whole = cells.known.all()
    lit = [by_light(picture.image[..., c], image[:, c], cells) for c in range(image.shape[1])]
    missing = [brought_rows(one, cells, realised.fine) for one in more.T]

    def corrected(rows: slice) -> Floats:
        out = picture.image[rows].copy(order="K")
        for channel, (share, lacking) in enumerate(zip(lit, missing, strict=True)):
            out[..., channel] += share(rows) * lacking(rows)
        if not whole:
            np.copyto(out, 0.0, where=~cells.known[rows, :, None])
        return out

    return Picture(banded(picture.image.shape, np.float64, corrected), picture.sigma)


def told_of(
    photo: Photo,
    parts: Sequence[Photo],
    shots: Mapping[str, Exposed],
    pictures: Sequence[Picture],
    learned: Learned | None,
    cells: CellMap,
    *,
    seen: Bools | None = None,
    normalise: NormaliseName = "auto",
    alive: Callable[[], None] = lambda: None,
) -> Told | None:
    """What the parts of a photo tell of its smooth light; None of a dark one.

    pictures : of the photo and of each of its parts, in that order. seen : cells (N,) that any quad
    of the camera sees, None for all. Others as of `smoothed`.
    """
    coded, light = [], []
    for one, picture in zip((photo, *parts), pictures, strict=True):
        realised, weight, _, rest = _of_cells(one, shots, picture, learned, cells, normalise)
        coded.append(Coded(realised.left, realised.right, weight, rest.mean(axis=1)))
        light.append(rest)
    shares = shares_of_parts(coded[0], coded[1:], cells.grid, photo.beyond, alive, seen)
    return None if shares is None else Told(light[0], shares)


def seen_of(cells: CellMap) -> Bools | None:
    """Cells that any quad sees, (N,); None for all."""
    seen = cells.seen()
    return None if seen.all() else seen


def _of_cells(
    photo: Photo,
    shots: Mapping[str, Exposed],
    picture: Picture,
    learned: Learned | None,
    cells: CellMap,
    normalise: NormaliseName,
) -> tuple[Factors, Floats, Floats, Floats]:
    """Realised matrix and weights of a photo, its light (N, C), and that without the paths that
    are known."""
    realised = realised_photo(photo.shots, shots)
    weight = cell_weights_s(photo, realised, by_row=divided_by_row(photo, shots, normalise))
    image = cells.mean(picture.image)
    seen = seen_of(cells)
    if seen is not None:  # as bright as the others, for want of anything better
        image[~seen] = image[seen].mean(axis=0) if seen.any() else 0.0
    known = 0.0 if learned is None else known_light(learned, photo.wanted)
    return realised, weight, image, image - known


def by_light(image: NDArray[np.floating], of_cells: Floats, cells: CellMap) -> OfRows:
    """Light of quads (h, w) over that of the cells (N,) around them, from 0 to `MOST`: how an error
    that is in proportion to light lies on the quads of a cell. 1 where the cells are dark.

    It is told for some rows of quads at a time.
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
        return np.clip(share, 0.0, MOST, out=share)

    return some
