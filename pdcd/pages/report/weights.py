"""Probing matrices of a page: as factors, from which the page makes the row of any cell.

The realised matrix is ``left.T @ right`` with `coaxial` on its diagonal (`pdcd.probing.realised`),
the wanted one is a sum of parts (`pdcd.probing.wanted`). A page has both in these forms, rounded,
and the error of rounding in a row, measured at some cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.pages.report.packing import block_size_bytes, pack_factors, pack_integers, pack_singles
from pdcd.pictures.row import WeighedMatrix, weigh_matrix
from pdcd.pictures.weights import RealisedShot
from pdcd.probing.convolved import KernelPart, SameRowPart
from pdcd.probing.wanted import (
    GainPart,
    IlluminatedPart,
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
)
from pdcd.recipes.recipe import Recipe, RecipePhoto
from pdcd.words import NormaliseName

MOST_WEIGHT_BYTES = 3_000_000
"""Room for the matrices of all photos of a page."""
MOST_WEIGHTS = 12_000_000
"""Most entries of both factors of a photo that are packed at all; it bounds the time."""
_MOST_PHOTOS = 6
_LOOKS = 24
"""Cells at which the rounding of rows is measured."""


def pack_matrices(
    recipe: Recipe, shots: Mapping[str, RealisedShot], normalise: NormaliseName
) -> list[dict[str, Any]]:
    """The page's data on the matrices of the first `_MOST_PHOTOS` photos, the answer's first.

    A photo for which there is no room has `missing` instead: why, in words.
    """
    found: list[dict[str, Any]] = []
    room = MOST_WEIGHT_BYTES
    for photo in _ordered(recipe)[:_MOST_PHOTOS]:
        told = _told(weigh_matrix(photo, shots, normalise), room)
        room -= told.pop("bytes", 0)
        found.append(told)
    return found


def _ordered(recipe: Recipe) -> list[RecipePhoto]:
    """The main photo, the others of the answer, the rest."""
    return sorted(recipe.photos, key=lambda photo: photo.name != recipe.main)


def _told(one: WeighedMatrix, room: int) -> dict[str, Any]:
    name, realised = one.photo.name, one.realised
    if realised.left.size + realised.right.size > MOST_WEIGHTS:
        return {"name": name, "missing": "its factors are too many for a page; see pdcd row"}
    left, left_back = pack_factors(realised.left)
    right, right_back = pack_factors(realised.right)
    length = block_size_bytes(left) + block_size_bytes(right)
    if length > room:
        return {"name": name, "missing": "its factors are too long for a page; see pdcd row"}
    light = one.photo.wanted.light
    parts = list(_parts(one.photo.wanted))
    return {
        "name": name,
        "bytes": length,
        "left": left,
        "right": right,
        "coaxial": pack_singles(realised.coaxial),
        "weight": pack_singles(np.atleast_1d(one.weight_s)),
        # A matrix with parts that the page cannot draw is left out; the rest of it would be wrong.
        "wanted": None if any(part is None for part in parts) else parts,
        "light": None if light is None else pack_singles(light),
        "off": _off(one, left_back, right_back),
    }


def _off(one: WeighedMatrix, left: NDArray[np.float32], right: NDArray[np.float32]) -> float:
    """Largest rounding error of a weight, in the rows of some cells spread over the grid."""
    cells = one.realised.coaxial.size
    some = np.unique(np.linspace(0, cells - 1, min(_LOOKS, cells)).astype(np.int64))
    exact = one.realised.left[:, some].T @ one.realised.right
    rounded = left[:, some].T @ right
    weight = one.weight_s[some, None] if one.weight_s.ndim else one.weight_s
    return float(np.abs((rounded - exact) / weight).max())


def _parts(wanted: WantedMatrix) -> Iterator[dict[str, Any] | None]:
    for weight, part in wanted.parts:
        told = _part(part)
        yield None if told is None else {"weight": weight, **told}


def _part(part: MatrixPart) -> dict[str, Any] | None:
    """A part in the page's form; None for a matrix of numbers without structure."""
    if type(part) not in _KINDS:
        return None
    kind, fields = _KINDS[type(part)]
    told = {name: write(getattr(part, name)) for name, write in fields.items()}
    return None if any(value is None for value in told.values()) else {"kind": kind, **told}


_KINDS: Mapping[type, tuple[str, Mapping[str, Callable[[Any], Any]]]] = {
    SameRowPart: ("same row", {}),
    KernelPart: ("kernel", {"taps": pack_singles}),
    UniformPart: ("uniform", {}),
    OuterPart: ("outer", {"camera": pack_singles, "projector": pack_singles}),
    MatchPart: ("match", {"partner": pack_integers}),
    NearPart: ("near", {"radius": int}),
    GainPart: ("gained", {"camera": pack_singles, "part": _part}),
    IlluminatedPart: ("lit", {"projector": pack_singles, "part": _part}),
}
"""Parts that the page's script knows: their names there, and how to encode each field."""
