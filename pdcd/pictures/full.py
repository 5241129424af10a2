"""Which quads of a run's answer are full of light: the brightest of their cell, and not left out by
chance.

A dead or a stuck sample says nothing of the light that it misses: the mean of the others stands for
it. What is saturated has more light than any other, so that a mean without it is too dark by
nobody knows how much.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pdcd.arrays import Bools
from pdcd.pictures.exposed import RawShot
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from pdcd.sensor.dead import can_tell_samples, find_always_full_samples


def find_full_quads(
    recipe: Recipe, shots: Mapping[str, RawShot], cells: CellMap, dead: Bools | None
) -> Bools | None:
    """Quads that a shot of the answer has saturated by light, (h, w); None where there are none.

    shots : of the run, by name. dead : (h, w), quads that all of them have as saturated because
    they are dead; None where nobody could tell. Samples that are white whatever they see do not
    count where any shot tells (`pdcd.sensor.dead.find_always_full_samples`).
    """
    names = [name for name in recipe.answer_shots if name in shots]
    if not names:
        return None
    full: Bools = np.logical_or.reduce([shots[name].saturated for name in names])
    if dead is not None:
        full = full & ~dead
    if full.any() and can_tell_samples(cells):
        frames = ((shot.raw, shot.profile.saturation_dn(shot.iso)) for shot in shots.values())
        full = full & ~find_always_full_samples(full, frames)
    return full if full.any() else None
