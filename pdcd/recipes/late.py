"""Codes that come after others which do not count: shots under names of their own.

Ambient light may hide mirrors from the first photos of a pilot, so that it ends and codes are
shown. Once a dark photo has told how much of that light there is, the pilot may go on after all.
Its codes are other ones; what was taken of the first stays in the run folder, and is no shot of the
recipe.
"""

from __future__ import annotations

from dataclasses import replace

from pdcd.recipes.recipe import Recipe

LATE = "-late"
"""What the names of such shots end in."""


def renamed(recipe: Recipe) -> Recipe:
    """The same recipe with its shots of codes under other names; white ones, and photos of single
    codes, keep theirs."""
    new = {
        shot.name: shot.name + LATE
        for shot in recipe.shots
        if not shot.white and shot.name not in recipe.stack
    }

    def name(old: str) -> str:
        return new.get(old, old)

    shots = tuple(
        replace(s, name=name(s.name), copy_of=name(s.copy_of), beside=name(s.beside))
        for s in recipe.shots
    )
    photos = tuple(
        replace(photo, shots=tuple((sign, name(shot)) for sign, shot in photo.shots))
        for photo in recipe.photos
    )
    return replace(recipe, shots=shots, photos=photos)
