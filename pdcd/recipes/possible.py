"""What can be made of a run of which not all shots are there."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace

from pdcd.recipes.parts import taken_parts
from pdcd.recipes.recipe import Combination, Extremes, Photo, Recipe, Rule


def possible(recipe: Recipe, names: Container[str]) -> Recipe:
    """Return the recipe of the photos and pictures that the shots among `names` suffice for.

    Of a photo in parts, complete ones do; of repeated shots, as many repetitions as all shots of
    the photo have; and black exposures are done without where one is missing. Its pictures may be
    none, and the first one need not be the answer.
    """
    recipe = taken_parts(recipe, names)
    photos = []
    for photo in recipe.photos:
        terms = _terms(recipe, photo, names)
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


def _terms(recipe: Recipe, photo: Photo, names: Container[str]) -> Combination:
    """What is there of a photo; none where it cannot be made."""
    if any(name in recipe.sums for _, name in photo.shots):
        return photo.shots if all(name in names for name in recipe.stack) else ()
    shots = {shot.name: shot for shot in recipe.shots}
    lit = tuple(
        (sign, name)
        for sign, name in photo.shots
        if not (shots[name].primal_black or shots[name].dual_black)
    )
    origin = {name: shot.copy_of or name for name, shot in shots.items()}
    return _balanced(photo.shots, names, origin) or _balanced(lit, names, origin)


def _balanced(terms: Combination, names: Container[str], origin: Mapping[str, str]) -> Combination:
    """The terms whose shots are there, each shot repeated as often as any other of the photo;
    none when one of them is missing altogether."""
    repeats: dict[str, list[tuple[float, str]]] = {}
    for sign, name in terms:
        found = repeats.setdefault(origin[name], [])
        if name in names:
            found.append((sign, name))
    fewest = min(map(len, repeats.values()), default=0)
    return tuple(term for found in repeats.values() for term in found[:fewest])


def _of(rule: Rule) -> tuple[str, ...]:
    """Photos that a picture is made of."""
    return rule.photos if isinstance(rule, Extremes) else tuple(name for _, name in rule)
