"""Taking a photo in several equal exposures: each may fill the sensor, so their sum is less noisy.

The codes' error is that of one exposure, as all show the same codes.
"""

from __future__ import annotations

from dataclasses import replace

from pdcd.recipes.recipe import Extremes, Recipe, Shot


def repeated(recipe: Recipe, count: int) -> Recipe:
    """The same recipe with every shot that the answer rests on taken `count` times.

    A photo is then the sum of all its exposures. Shots of single codes (a pilot) and photos that
    are only shown beside the answer stay single.
    """
    if count == 1:
        return recipe
    rule = recipe.answer
    names = rule.photos if isinstance(rule, Extremes) else tuple(name for _, name in rule)
    copied = {shot for p in recipe.photos if p.name in names for _, shot in p.shots}
    shots: list[Shot] = []
    for shot in recipe.shots:
        shots.append(shot)
        if shot.name in copied:
            shots += [replace(shot, name=c, copy_of=shot.name) for c in _copies(shot.name, count)]
    photos = tuple(
        replace(
            photo,
            shots=tuple(
                (sign, name)
                for sign, first in photo.shots
                for name in (first, *(_copies(first, count) if first in copied else ()))
            ),
        )
        for photo in recipe.photos
    )
    return replace(recipe, shots=tuple(shots), photos=photos)


def _copies(name: str, count: int) -> list[str]:
    return [f"{name}-{n}" for n in range(2, count + 1)]
