"""Which quads of a run's answer are saturated by light.

A dead or a stuck sample is unrelated to the light that it misses: the mean of the others stands for
it. A saturated quad has more light than the others of its cell, so that a mean without it is too
dark by an unknown amount.
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
    """Quads that light has saturated in a shot of the answer, (h, w); None where there are none.

    shots : of the run, by name. dead : (h, w), quads that all of them have as saturated because
    they are dead; None where this could not be found out. Samples that are white whatever they see
    do not count where any shot shows them (`pdcd.sensor.dead.find_always_full_samples`).
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
