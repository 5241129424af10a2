"""A coded photo in several exposures with codes of their own: its parts.

Each part alone is a photo of the same wanted matrix from fewer codes. The photo is the sum of all
parts, which is what one exposure of all their codes would have been. Their differences show the
error of the codes, which nothing else on a real rig can show.

Other multiple exposures are here, too: equal exposures whose sum is less noisy, complement pairs
(the same codes twice, with the mask's codes and with their complement), and codes that replace
earlier ones which do not count.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError
from pdcd.probing.wanted import UniformPart
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.maker import RecipeMaker, match_own_cells
from pdcd.recipes.programs import CodedProgram
from pdcd.recipes.recipe import Recipe, RecipePhoto, Rule, Shot

FEWEST_PARTS = 4
"""Number of parts from which their spread is a better estimate than a model of the scene."""


def split_into_parts(recipe: Recipe, parts: int) -> Recipe:
    """Return the recipe with every shot of codes taken in `parts` exposures, part by part.

    Programs and shots get the number of their part, from 1, behind the name of the program; shots
    that are not split come first. One part leaves the recipe as it is. Raises RequestError when
    there are no codes to split.
    """
    if parts == 1:
        return recipe
    split = [s for s in recipe.shots if _splits(recipe, s)]
    if not split:
        raise RequestError(
            f"goal {recipe.target.goal.name} has no coded photo to split into {parts} parts",
            hint="leave out the parts: this photo has no code error",
        )
    programs = {}
    for name, program in recipe.programs.items():
        mine = any(shot.program == name for shot in split)
        numbers = range(1, parts + 1) if mine else [0]
        programs.update({_named(name, part): program for part in numbers})
    by_name = {shot.name: shot for shot in recipe.shots}
    numbered = [_part(shot, part, by_name) for part in range(1, parts + 1) for shot in split]
    names = {shot.name for shot in split}
    photos = []
    for photo in recipe.photos:
        terms = [
            (sign, _part(by_name[name], part, by_name).name if name in names else name)
            for part in range(1, parts + 1)
            for sign, name in photo.shots
            if name in names or part == 1
        ]
        photos.append(replace(photo, shots=tuple(terms)))
    whole = [shot for shot in recipe.shots if shot.name not in names]
    return replace(recipe, programs=programs, shots=(*whole, *numbered), photos=tuple(photos))


def check_parts(request: CaptureRequest) -> int:
    """Number of parts asked for, 1 where that is left open (`pdcd.planning.defaults` settles it
    earlier). Raises RequestError for a target error that so few parts cannot measure."""
    parts = request.parts if isinstance(request.parts, int) else 1
    if request.until_error is not None and parts < FEWEST_PARTS:
        raise RequestError(
            f"{parts} part{'s' * (parts > 1)} cannot tell when the error is low enough",
            hint=f"take at least {FEWEST_PARTS} parts: their spread measures the error",
        )
    return parts


def list_parts(recipe: Recipe) -> tuple[int, ...]:
    """Numbers of the parts of a recipe, ascending; none when no photo is split."""
    return tuple(sorted({shot.part for shot in recipe.shots if shot.part}))


def select_parts(recipe: Recipe, wanted: Container[int]) -> Recipe:
    """Return the recipe of the photos of some parts alone, with all that is not split."""
    shots = tuple(shot for shot in recipe.shots if not shot.part or shot.part in wanted)
    names = {shot.name for shot in shots}
    photos = tuple(
        replace(photo, shots=tuple(term for term in photo.shots if term[1] in names))
        for photo in recipe.photos
    )
    return replace(recipe, shots=shots, photos=photos)


def select_complete_parts(recipe: Recipe, names: Container[str]) -> Recipe:
    """Return the recipe of the parts of which every shot is among `names`.

    If no part is complete all parts are kept, as then there is no photo yet.
    """
    complete = [
        part
        for part in list_parts(recipe)
        if all(shot.name in names for shot in recipe.shots if shot.part == part)
    ]
    return select_parts(recipe, complete) if complete else recipe


def derive_part_seed(seed: int, parts: int, part: int) -> int:
    """Seed of one part's codes, different for all parts of all seeds; of a whole, `seed`."""
    return seed * parts + max(part - 1, 0)


def randomise_signs(bits: NDArray[np.bool_], seed: int) -> NDArray[np.bool_]:
    """Return codes (K, L), lit half of the time, with those of each cell inverted by a coin.

    Hadamard codes give cells that share a column opposite signs where they are neighbours. The
    error that this leaves is small but the same in all parts, so that their spread would not show
    it. With coins the errors of parts differ in sign, and their mean is smaller than each.
    """
    coins = np.random.Generator(np.random.PCG64([seed, 1])).random(bits.shape[1]) < 0.5
    return bits ^ coins


def count_part_codes(codes: int, parts: int) -> int:
    """Codes of each part. Raises RequestError when they cannot be shared out evenly."""
    if codes % parts:
        raise RequestError(
            f"{codes} codes cannot be shared out to {parts} parts",
            hint=f"take {max(1, codes // parts) * parts} codes",
        )
    return codes // parts


def _splits(recipe: Recipe, shot: Shot) -> bool:
    """Whether a shot shows all codes of a program, or measures what leaks while it does."""
    return not shot.white and shot.only is None and recipe.programs[shot.program].coded


def _named(program: str, part: int) -> str:
    return f"{program}-{part}" if part else program


def _part(shot: Shot, part: int, by_name: Mapping[str, Shot]) -> Shot:
    """One part of a shot; the names of shots begin with that of their program."""
    program = _named(shot.program, part)
    name = program + shot.name[len(shot.program) :]
    beside = _part(by_name[shot.beside], part, by_name).name if shot.beside else ""
    return replace(shot, name=name, program=program, part=part, beside=beside)


def repeat_shots(recipe: Recipe, count: int) -> Recipe:
    """The same recipe with every shot that the answer is made of taken `count` times.

    A photo is then the sum of all its exposures. Shots of single codes (a pilot) and photos that
    are only shown beside the answer stay single.
    """
    if count == 1:
        return recipe
    copied = {shot for photo in recipe.answer_photos for _, shot in photo.shots}
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


FLOODLIT = "floodlit"
"""The photo and picture of a white shot, in addition to the white picture of a pair."""
_KNOWN = ("indirect", "direct")
"""Goals that a pair of exposures answers."""


def make_pairs_recipe(maker: RecipeMaker, white: bool, buckets: int = 1) -> Recipe:
    """Two exposures for direct, indirect and all light; and with `white` a floodlit shot to compare
    their sum with.

    A sensor of two buckets takes both at once. Raises RequestError for other goals.
    """
    target = maker.target
    if target.goal.name not in _KNOWN or target.light is not None:
        raise RequestError(
            f"method pairs does the goals {' and '.join(_KNOWN)}, under full light",
            hint="take the method coded",
        )
    everything, same = UniformPart(target.cells), match_own_cells(target)
    if white:
        maker.photo(
            FLOODLIT, maker.wanted((1.0, everything)), [(1.0, Shot("white", "", white=True))]
        )
    maker.coded("coded", CodedProgram(None, True), (1.0, everything), (-1.0, same))
    maker.coded("same", CodedProgram(None, False), (0.5, everything), (0.5, same))
    if buckets == 2:
        of = len("same")
        maker.shots = [
            replace(shot, beside=f"coded{shot.name[of:]}") if shot.program == "same" else shot
            for shot in maker.shots
        ]
    apart, together = maker.photos[-2], maker.photos.pop()
    less = tuple((-sign, name) for sign, name in apart.shots)
    maker.photos += [
        RecipePhoto("white", maker.wanted((1.0, everything)), (*together.shots, *apart.shots)),
        RecipePhoto("direct", maker.wanted((1.0, same)), (*together.shots, *less)),
    ]
    pictures: dict[str, Rule] = {
        "indirect": ((1.0, "coded"),),
        "white": ((1.0, "white"),),
        "direct": ((1.0, "direct"),),
    }
    first = target.goal.name
    pictures = {first: pictures[first], **pictures}
    if white:
        pictures[FLOODLIT] = ((1.0, FLOODLIT),)
    return Recipe(target, maker.programs, tuple(maker.shots), tuple(maker.photos), pictures)


LATE = "-late"
"""Suffix of the names of such shots."""


def rename_shots(recipe: Recipe) -> Recipe:
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
