"""From a goal to the shots to take, and the linear combination of them that is the answer.

A *photo* is a signed sum of shots with one wanted probing matrix, and hence one scale: a single
coded shot, a signed pair (eq. 10), or either with the shots that measure what leaks through black
panels. The answer, and the pictures shown beside it, are linear combinations of photos after each
has been divided by its own realised weight: subtracting photos of unequal weight would be wrong
(erratum X9).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdcd.arrays import Floats
from pdcd.errors import RequestError
from pdcd.probing.wanted import IlluminatedPart, MatrixPart, WantedMatrix
from pdcd.recipes.alternatives import FittedWeights, MaskedWeights
from pdcd.recipes.goals import Target
from pdcd.recipes.programs import Program

Combination = tuple[tuple[float, str], ...]
"""(coefficient, name) pairs."""


@dataclass(frozen=True)
class Extremes:
    """``largest * max + smallest * min`` over photos, pixel by pixel (Fig. 10 of the paper)."""

    largest: float
    smallest: float
    photos: tuple[str, ...]


Rule = Combination | Extremes
"""How a picture is made of photos."""


@dataclass(frozen=True)
class Shot:
    """One exposure: the program whose pairs it shows, and which panels stay black instead.

    `white` shots show full light through a fully open mask. `only` picks one pair of the program:
    a photo of a single code. `part` counts the exposures of a photo taken in several, from 1; 0 is
    a whole one. `copy_of` names the shot that this one repeats. `beside` names the shot whose
    second bucket this one is: there is no exposure of its own.
    """

    name: str
    program: str
    white: bool = False
    primal_black: bool = False
    dual_black: bool = False
    only: int | None = None
    part: int = 0
    copy_of: str = ""
    beside: str = ""

    @property
    def kind(self) -> str:
        """Program without the number of its part; shots of one kind gather the same light."""
        return self.program.removesuffix(f"-{self.part}")

    @property
    def of_leaks(self) -> bool:
        """Whether a panel stays black, so that all the light that is seen leaks through it."""
        return self.primal_black or self.dual_black

    @property
    def all_light(self) -> bool:
        """Whether it shows full light through a fully open mask, and no panel stays black."""
        return self.white and not self.of_leaks


@dataclass(frozen=True)
class RecipePhoto:
    """A signed sum of shots that is to have a wanted probing matrix, up to one scale.

    With `row_weights` each cell is divided by its own realised weight instead of the common one,
    for codes whose cells are open unequally often by design. `beyond` is the radius of a photo of
    light from further away, under full light, whose smooth light can be corrected; else 0. If
    `paths`, the photo is corrected for the paths that a pilot found.
    """

    name: str
    wanted: WantedMatrix
    shots: Combination
    row_weights: bool = False
    beyond: int = 0
    paths: bool = False


@dataclass(frozen=True)
class Recipe:
    """Shots, photos and pictures of one goal; `pictures` maps a name to photos, answer first.

    `stack` names the shots of single patterns through an open mask, one RAW file each, in order.
    `sums` are weighted sums of that stack, which photos may name like shots; each is a function
    from code bits (K, N) to the weight of each cell in each photo. `meant` is the wanted matrix
    where the answer is only an estimate of it.
    """

    target: Target
    programs: dict[str, Program]
    shots: tuple[Shot, ...]
    photos: tuple[RecipePhoto, ...]
    pictures: dict[str, Rule]
    stack: tuple[str, ...] = ()
    sums: dict[str, FittedWeights | MaskedWeights] = field(default_factory=dict)
    meant: WantedMatrix | None = None
    split: tuple[str, ...] = ()
    """How a wanted matrix is taken apart, in words, a line a part."""
    asked: str = ""
    """Name of the picture that was asked for, if it cannot be made of the shots that are there and
    another one replaces it."""

    @property
    def coded(self) -> RecipePhoto | None:
        """The photo of all indirect light at once, where there is one."""
        return next((photo for photo in self.photos if photo.name == "coded"), None)

    @property
    def answer_name(self) -> str:
        """Name of the picture that was asked for."""
        return next(iter(self.pictures))

    @property
    def answer(self) -> Rule:
        """How the wanted image is made of photos."""
        return self.pictures[self.answer_name]

    @property
    def answer_photos(self) -> tuple[RecipePhoto, ...]:
        """The photos that the answer is made of."""
        names = list_rule_photos(self.answer)
        return tuple(photo for photo in self.photos if photo.name in names)

    @property
    def answer_shots(self) -> tuple[str, ...]:
        """Names of the shots of these photos, single codes of sums included."""
        there, found = {shot.name for shot in self.shots}, dict[str, None]()
        for photo in self.answer_photos:
            for _, name in photo.shots:
                found |= dict.fromkeys([name] if name in there else self.stack)
        return tuple(found)

    @property
    def main(self) -> str:
        """The photo that represents the light and the codes of the answer."""
        rule = self.answer
        return rule.photos[-1] if isinstance(rule, Extremes) else rule[-1][1]

    @property
    def wanted(self) -> WantedMatrix:
        """The goal's own wanted matrix: that of the answer.

        Raises RequestError for answers that no single matrix gives.
        """
        if isinstance(self.answer, Extremes):
            raise RequestError(f"goal {self.target.goal.name} is no sum of photos")
        photos = {photo.name: photo.wanted for photo in self.photos}
        light = self.target.light
        alike = all(_same(photos[name].light, light) for _, name in self.answer)
        parts = [
            (coefficient * weight, part if alike else _under(part, photos[name].light))
            for coefficient, name in self.answer
            for weight, part in photos[name].parts
        ]
        return WantedMatrix(self.target.grid, tuple(parts), light if alike else None)


def list_rule_photos(rule: Rule) -> tuple[str, ...]:
    """Names of the photos that a picture is made of."""
    return rule.photos if isinstance(rule, Extremes) else tuple(name for _, name in rule)


def _same(light: Floats | None, other: Floats | None) -> bool:
    """Whether two illuminations are the same; None is full light."""
    if light is None or other is None:
        return light is other
    return np.array_equal(light, other)


def _under(part: MatrixPart, light: Floats | None) -> MatrixPart:
    """A part of a photo that has a light of its own."""
    return part if light is None else IlluminatedPart(part, light)
