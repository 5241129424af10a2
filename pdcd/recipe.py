"""Goal -> the shots to take, and the linear combination of them that is the answer.

A *photo* is a signed sum of shots (one shot, or the coded shot and those that measure what leaks
through black panels) with one wanted probing matrix, so one scale. The answer, and the pictures
shown beside it, are linear combinations of photos after each has been divided by its own realised
weight: subtracting photos of unequal weight would not give direct light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pdcd.goals import DIRECT, INDIRECT, WHITE, Goal
from pdcd.request import BlackLevel
from pdcd.schedule import Side

DualOfCodes = Literal["complement", "same"]
Combination = tuple[tuple[float, str], ...]
"""(coefficient, name) pairs."""

# The other shots of each way to remove what black panels let through, as (sign, primal, dual)
# where None keeps the side as it is: mask leak, ambient light and projector leak, and both.
_BLACKS: dict[str, tuple[tuple[float, Side | None, Side | None], ...]] = {
    "none": (),
    "mask": ((-1.0, None, "black"),),
    "ambient": ((-1.0, "black", None),),
    "both": ((-1.0, None, "black"), (-1.0, "black", None), (1.0, "black", "black")),
}


@dataclass(frozen=True)
class Shot:
    """One exposure: what each panel shows in its slots. `coded` shots run through the codes."""

    name: str
    primal: Side
    dual: Side
    coded: bool


@dataclass(frozen=True)
class Photo:
    """A signed sum of shots that is to have a wanted probing matrix, up to one scale."""

    name: str
    wanted: Goal
    shots: Combination


@dataclass(frozen=True)
class Recipe:
    """Shots, photos and pictures of one goal; `pictures` maps a name to photos, answer first."""

    goal: Goal
    dual: DualOfCodes | None
    shots: tuple[Shot, ...]
    photos: tuple[Photo, ...]
    pictures: dict[str, Combination]

    @property
    def answer(self) -> Combination:
        """The combination of photos that is the wanted image."""
        return self.pictures[self.goal.name]


def make_recipe(goal: Goal, *, black_level: BlackLevel = "none", white: bool = True) -> Recipe:
    """The recipe for a goal.

    Parameters
    ----------
    black_level : which leaks to measure with further shots and subtract (limitations L1-L3).
    white : take a white shot beside the coded one of the goal "indirect".
    """
    photos: list[Photo] = []
    shots: list[Shot] = []
    dual: DualOfCodes | None = None
    pictures: dict[str, Combination]
    if goal == WHITE:
        pictures = {"white": ((1.0, "white"),)}
    elif goal == INDIRECT and white:
        split: Combination = ((1.0, "white"), (-1.0, "coded"))
        pictures = {"indirect": ((1.0, "coded"),), "white": ((1.0, "white"),), "direct": split}
    elif goal == DIRECT:
        split = ((1.0, "white"), (-1.0, "coded"))
        pictures = {"direct": split, "white": ((1.0, "white"),), "indirect": ((1.0, "coded"),)}
    else:
        pictures = {goal.name: ((1.0, "coded"),)}
    used = {name for combination in pictures.values() for _, name in combination}
    if "white" in used:
        photos.append(_photo("white", WHITE, "white", black_level, shots))
    if "coded" in used:
        dual = "same" if goal.name == "fraction" else "complement"
        wanted = goal if dual == "same" else INDIRECT
        photos.append(_photo("coded", wanted, "codes", black_level, shots))
    return Recipe(goal, dual, tuple(shots), tuple(photos), pictures)


def _photo(
    name: str, wanted: Goal, side: Side, black_level: BlackLevel, shots: list[Shot]
) -> Photo:
    coded = side == "codes"
    terms = [(1.0, name)]
    shots.append(Shot(name, side, side, coded))
    for sign, primal, dual in _BLACKS[black_level]:
        parts = [part for part, value in (("primal", primal), ("dual", dual)) if value]
        extra = Shot(f"{name}-black-{'-'.join(parts)}", primal or side, dual or side, coded)
        shots.append(extra)
        terms.append((sign, extra.name))
    return Photo(name, wanted, tuple(terms))
