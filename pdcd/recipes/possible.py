"""What can be made of a run of which not all shots are there."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace

from pdcd.recipes.parts import taken_parts
from pdcd.recipes.recipe import Combination, Extremes, Recipe, Rule


def possible(recipe: Recipe, names: Container[str]) -> Recipe:
    """Return the recipe of the photos and pictures that the shots among `names` suffice for.

    Of a photo in parts, complete ones do; of repeated shots, as many repetitions as all shots of
    the photo have. Its pictures may be none, and the first one need not be the answer.
    """
    recipe = taken_parts(recipe, names)
    origin = {shot.name: shot.copy_of or shot.name for shot in recipe.shots}
    stacked = all(name in names for name in recipe.stack)
    photos = []
    for photo in recipe.photos:
        summed = any(name in recipe.sums for _, name in photo.shots)
        terms = photo.shots if summed and stacked else _balanced(photo.shots, names, origin)
        if terms:
            photos.append(replace(photo, shots=terms))
    there = {photo.name for photo in photos}
    pictures = {
        name: rule for name, rule in recipe.pictures.items() if all(p in there for p in _of(rule))
    }
    return replace(
        recipe,
        shots=tuple(shot for shot in recipe.shots if shot.name in names),
        photos=tuple(photos),
        pictures=pictures,
    )


def _balanced(terms: Combination, names: Container[str], origin: dict[str, str]) -> Combination:
    """The terms whose shots are there, each shot repeated as often as any other of the photo;
    none when one of them is missing altogether."""
    repeats: dict[str, list[tuple[float, str]]] = {}
    for sign, name in terms:
        found = repeats.setdefault(origin.get(name, name), [])
        if name in names:
            found.append((sign, name))
    fewest = min(map(len, repeats.values()), default=0)
    return tuple(term for found in repeats.values() for term in found[:fewest])


def _of(rule: Rule) -> tuple[str, ...]:
    """Photos that a picture is made of."""
    return rule.photos if isinstance(rule, Extremes) else tuple(name for _, name in rule)
