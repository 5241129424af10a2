"""From a goal, and how it is photographed, to the recipe: the one way for plans and decoding."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace

import numpy as np

from pdcd.errors import RequestError
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.recipes.alternatives import FittedWeights, MaskedWeights, find_light_shares, make_checkers
from pdcd.recipes.composed import compose_matrix
from pdcd.recipes.each import RECIPES
from pdcd.recipes.goals import Target
from pdcd.recipes.isolation import ISOLATION_FAMILIES as ISOLATION
from pdcd.recipes.isolation import use_path_isolation
from pdcd.recipes.maker import RecipeMaker
from pdcd.recipes.parts import (
    make_pairs_recipe,
    rename_shots,
    repeat_shots,
    select_complete_parts,
    split_into_parts,
)
from pdcd.recipes.programs import (
    BlockProgram,
    FloodlitProgram,
)
from pdcd.recipes.recipe import (
    Combination,
    Extremes,
    Recipe,
    RecipePhoto,
    Rule,
    Shot,
    list_rule_photos,
)
from pdcd.recipes.transport import make_transport_recipe


def make_recipe(target: Target, how: CaptureScheme) -> Recipe:
    """The recipe for a target that `check_target` has passed.

    The same target and the same `how` always give the same recipe, so that a run is decoded as it
    was planned. Exact decompositions are taken where they need fewer pairs than there are codes.
    Black exposures measure what leaks and are subtracted (limitations L1-L3). Where a pilot leaves
    no codes, the coded photo is made of the pilot's.

    Raises RequestError when the goal cannot be photographed in this way.
    """
    return finish_recipe(make_draft_recipe(target, how), how)


def make_draft_recipe(target: Target, how: CaptureScheme) -> Recipe:
    """The same before family and repetitions are settled: its programs say what they need."""
    return split_into_parts(_whole(target, how), how.parts)


def finish_recipe(draft: Recipe, how: CaptureScheme) -> Recipe:
    """A draft with the family and the repetitions that were settled on."""
    if how.family in ISOLATION:
        draft = use_path_isolation(draft, how.family)
    recipe = repeat_shots(draft, how.repeat)
    return rename_shots(recipe) if how.late else recipe


def _whole(target: Target, how: CaptureScheme) -> Recipe:
    """The recipe in single exposures, each in one piece."""
    if target.goal.name == "transport":
        return make_transport_recipe(target, how)
    maker = RecipeMaker(target, how.black_level, grey=how.grey_masks)
    if how.method != "coded":
        if how.pilot:
            raise RequestError(f"method {how.method} takes no pilot", hint="leave it out")
        if how.method == "pairs":
            return make_pairs_recipe(maker, how.white, how.buckets)
        return _multi_image(maker, how.codes) if how.method == "multi-image" else _nayar(maker)
    pictures: dict[str, Rule]
    if target.goal.name == "relit":
        pictures = {"relit": compose_matrix(maker, how.coded // how.parts)}
    else:
        pictures = RECIPES[target.goal.name](maker, how.white, how.coded)
    recipe = Recipe(
        target,
        maker.programs,
        tuple(maker.shots),
        tuple(maker.photos),
        pictures,
        split=tuple(maker.split),
    )
    if how.pilot:
        recipe = _with_pilot(recipe, how)
    return recipe if how.coded else _pilot_alone(recipe)


def _with_pilot(recipe: Recipe, how: CaptureScheme) -> Recipe:
    """The same with photos of single codes through an open mask before the shots of all codes."""
    helped = {"coded", "far"}
    if not helped & recipe.programs.keys() or recipe.target.goal.name == "fraction":
        raise RequestError(
            f"goal {recipe.target.goal.name} takes no pilot",
            hint="a pilot helps indirect and direct light, and light by range",
        )
    if recipe.target.partner is not None:
        raise RequestError(
            "a pilot goes with neither a shift nor a warp",
            hint="leave it out: it looks for paths beside those of each cell with itself",
        )
    stack = tuple(Shot(f"pilot-{k + 1:04d}", "pilot", only=k) for k in range(how.pilot))
    first = next(i for i, shot in enumerate(recipe.shots) if shot.program in helped)
    return replace(
        recipe,
        programs={"pilot": FloodlitProgram(), **recipe.programs},
        shots=(*recipe.shots[:first], *stack, *recipe.shots[first:]),
        photos=tuple(replace(photo, paths=photo.name in helped) for photo in recipe.photos),
        stack=tuple(shot.name for shot in stack),
    )


def _pilot_alone(recipe: Recipe) -> Recipe:
    """The same with the pilot's photos, masked in software, instead of the coded shot."""
    if recipe.target.goal.name not in ("indirect", "direct"):
        raise RequestError(
            f"a pilot leaves no codes for the goal {recipe.target.goal.name}",
            hint="ask for more codes or a smaller pilot",
        )
    coded = recipe.coded
    if coded is None or len(coded.shots) > 1 or recipe.target.light is not None:
        raise RequestError(
            "a pilot of all codes takes neither black exposures nor an illumination",
            hint="leave them out, or ask for more codes",
        )
    return replace(
        recipe,
        programs={name: p for name, p in recipe.programs.items() if name != "coded"},
        shots=tuple(shot for shot in recipe.shots if shot.name != "coded"),
        sums={"coded": FittedWeights(direct=0.0, indirect=1.0)},
    )


def _multi_image(maker: RecipeMaker, codes: int) -> Recipe:
    """Single codes through an open mask, one RAW file each, masked in software."""
    target = maker.target
    direct, indirect = find_light_shares(target, "multi-image")
    if codes < 2:
        raise RequestError("the method multi-image needs at least 2 codes")
    if maker.blacks:
        raise RequestError(
            "the method multi-image takes no black exposures", hint="take the black level none"
        )
    stack = tuple(Shot(f"photo-{k + 1:04d}", "photos", only=k) for k in range(codes))
    kept: dict[str, tuple[float, float]] = {
        target.goal.name: (direct, indirect),
        "white": (1.0, 1.0),
        "direct": (1.0, 0.0),
        "indirect": (0.0, 1.0),
    }
    sums = {name: FittedWeights(direct=d, indirect=i) for name, (d, i) in kept.items()}
    return Recipe(
        target,
        {"photos": FloodlitProgram()},
        stack,
        tuple(
            RecipePhoto(name, maker.kept(d, i), ((1.0, name),))
            for name, (d, i) in {**kept, "masked": (0.0, 1.0)}.items()
        ),
        {name: ((1.0, name),) for name in (*kept, "masked")},
        stack=tuple(shot.name for shot in stack),
        sums={**sums, "masked": MaskedWeights()},
    )


def _nayar(maker: RecipeMaker) -> Recipe:
    """Checkers through an open mask; the answer is made of the largest and smallest photo."""
    target = maker.target
    direct, indirect = find_light_shares(target, "nayar")
    patterns = make_checkers(target.grid)
    names = tuple(f"checker-{k + 1}" for k in range(len(patterns)))
    maker.programs["checkers"] = BlockProgram(np.ones_like(patterns), patterns)
    everything = maker.kept(1.0, 1.0)
    for k, name in enumerate(names):
        shot = Shot(name, "checkers", only=k)
        maker.photo(name, everything.under(patterns[k]), [(1.0, shot)])
    pictures: dict[str, Rule] = {
        target.goal.name: Extremes(direct, 2.0 * indirect - direct, names),
        "white": tuple((2.0 / len(names), name) for name in names),
        "direct": Extremes(1.0, -1.0, names),
        "indirect": Extremes(0.0, 2.0, names),
    }
    return Recipe(
        target,
        maker.programs,
        tuple(maker.shots),
        tuple(maker.photos),
        pictures,
        stack=names,
        meant=maker.kept(direct, indirect),
    )


def narrow_to_shots(recipe: Recipe, names: Container[str]) -> Recipe:
    """Return the recipe of the photos and pictures that can be made of the shots among `names`.

    Complete parts suffice for a photo in parts. Of repeated shots, as many repetitions are used as
    all shots of the photo have. Black exposures are left out where one is missing. There may be no
    pictures at all, and the first one need not be the answer.
    """
    recipe = select_complete_parts(recipe, names)
    photos = []
    for photo in recipe.photos:
        terms = _terms(recipe, photo, names)
        if terms:
            photos.append(replace(photo, shots=terms))
    there = {photo.name for photo in photos}
    pictures = {
        name: rule
        for name, rule in recipe.pictures.items()
        if all(p in there for p in list_rule_photos(rule))
    }
    first = next(iter(recipe.pictures), "")
    return replace(
        recipe,
        shots=tuple(shot for shot in recipe.shots if shot.name in names),
        photos=tuple(photos),
        pictures=pictures,
        asked=recipe.asked or ("" if first in pictures else first),
    )


def _terms(recipe: Recipe, photo: RecipePhoto, names: Container[str]) -> Combination:
    """The shots of a photo that are there; none where it cannot be made."""
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
