"""How much work it is to decode a run, in refreshes to look at, for a `Watch` to expect.

Only shares of the total matter, and only roughly: they move a bar and foretell the time left. The
constants were measured on the scenes of the mock bench, 48 x 64 cells; one unit is about 0.15 ms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from pdcd.pictures.combine import Exposed
from pdcd.pictures.smooth import signs_of_life
from pdcd.probing.deviation import BLOCK
from pdcd.recipes.parts import FEWEST_PARTS, part_numbers
from pdcd.recipes.recipe import Photo, Recipe
from pdcd.runs.record import RunRecord, ShotRecord

BYTES = 2048
"""Of a RAW file, read in the time of a refresh."""
SMOOTHING = 4.0
"""Times that the light of a refresh is spread, and weighed, to smooth a photo."""


def reading(shot: ShotRecord) -> float:
    """Of one shot: its file and its refreshes."""
    return shot.refreshes + shot.size_bytes / BYTES


def comparing(photo: Photo) -> float:
    """Of the realised matrix of a photo with the wanted one, for sigma or for the report."""
    return float(photo.wanted.cells)


def signs_of_comparing(photos: Iterable[Photo]) -> int:
    """How often that gives a sign of life."""
    return sum(math.ceil(photo.wanted.cells / BLOCK) for photo in photos)


def smoothing(recipe: Recipe, record: RunRecord) -> float:
    """Of the smooth light in the coded photo, as far as its shots go; 0 where it is left as is."""
    names = {name for photo in recipe.photos if photo.name == "coded" for _, name in photo.shots}
    if not record.smooth:
        return 0.0
    return SMOOTHING * sum(shot.refreshes for shot in record.shots if shot.name in names)


def signs_of_smoothing(recipe: Recipe, shots: Mapping[str, Exposed]) -> int:
    """How often that gives a sign of life."""
    photo = next(p for p in recipe.photos if p.name == "coded")
    rows = sum(shots[name].realised.left.shape[0] for _, name in photo.shots)
    return signs_of_life(rows, photo.wanted.cells)


def decoding(
    recipe: Recipe, record: RunRecord, unread: Iterable[ShotRecord], *, report: bool
) -> float:
    """All of it: reading, pictures with sigma where every shot is there, and the report."""
    units = sum(map(reading, unread))
    taken = {shot.name for shot in record.shots}
    if not all(shot.name in taken for shot in recipe.shots):
        return units  # a run in the middle, which wants to learn
    compared = sum(map(comparing, recipe.photos))
    measured = len(part_numbers(recipe)) >= FEWEST_PARTS
    # Measured sigma takes the pictures of each part, too, instead of a comparison.
    units += smoothing(recipe, record) * (2.0 if measured else 1.0)
    return units + compared * ((not measured) + report)
