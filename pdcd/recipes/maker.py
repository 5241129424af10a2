"""What gathers the programs, shots and photos of one recipe."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pdcd.arrays import Floats
from pdcd.probing.wanted import GainPart, MatchPart, MatrixPart, NearPart, UniformPart, WantedMatrix
from pdcd.recipes.goals import Target
from pdcd.recipes.programs import (
    BlockProgram,
    GainProgram,
    IlluminatedProgram,
    LongRangeProgram,
    Program,
)
from pdcd.recipes.recipe import RecipePhoto, Shot
from pdcd.words import BlackLevel

# The other shots of each way to remove what black panels let through, as (sign, projector black,
# mask black): mask leak, ambient light and projector leak, and both (limitations L1 to L3).
_BLACKS: dict[str, tuple[tuple[float, bool, bool], ...]] = {
    "none": (),
    "mask": ((-1.0, False, True),),
    "ambient": ((-1.0, True, False),),
    "both": ((-1.0, False, True), (-1.0, True, False), (1.0, True, True)),
}


class RecipeMaker:
    """Collects the programs, shots and photos of one recipe."""

    def __init__(self, target: Target, black_level: BlackLevel, *, grey: bool = False) -> None:
        self.target = target
        self.grey = grey
        """Whether masks of far light may have grey levels."""
        self.blacks = _BLACKS[black_level]
        self.programs: dict[str, Program] = {}
        self.shots: list[Shot] = []
        self.photos: list[RecipePhoto] = []
        self.split: list[str] = []
        """How a matrix is taken apart, a line a part."""

    def say(self, part: str, share: float, how: str) -> None:
        """Note a part of a matrix, its share of all squared weights, and how it is photographed."""
        self.split.append(f"{100.0 * share:.3g} % {part}: {how}")

    def white(self) -> None:
        """A photo of everything: a floodlit shot, or the illumination through an open mask."""
        wanted = WantedMatrix(
            self.target.grid, ((1.0, UniformPart(self.target.cells)),), self.target.light
        )
        if self.target.light is None:
            self.photo("white", wanted, [(1.0, Shot("white", "", white=True))])
        else:
            self.exact("white", wanted, [np.ones(self.target.cells)], [self.target.light])

    def coded(
        self,
        name: str,
        program: Program,
        *parts: tuple[float, MatrixPart],
        light: Floats | None = None,
        gain: Floats | None = None,
        by_direct: bool = False,
        by_light: bool = False,
        rows: bool = False,
    ) -> None:
        """A photo of one coded shot, under `light` beside the goal's own, the mask's levels times
        `gain`, (N,) each; with `rows` each cell is divided by its own weight."""
        wanted = self.wanted(*parts, light=light, gain=gain)
        wanted = replace(wanted, by_direct=by_direct, by_light=by_light)
        self.programs[name] = _seen(program, light, gain)
        self.photo(
            name, wanted, [(1.0, Shot(name, name))], rows or isinstance(program, LongRangeProgram)
        )
        if isinstance(program, LongRangeProgram) and wanted.light is None and gain is None:
            self.photos[-1] = replace(self.photos[-1], beyond=program.radius)

    def far(
        self, name: str, radius: int, *, light: Floats | None = None, gain: Floats | None = None
    ) -> None:
        """A photo of light from beyond a radius; `light` and `gain` as of `coded`."""
        program = LongRangeProgram(radius, self.grey)
        everything = (1.0, UniformPart(self.target.cells))
        near = (-1.0, NearPart(self.target.grid, radius))
        self.coded(name, program, everything, near, light=light, gain=gain)

    def signed(
        self,
        name: str,
        half: Callable[[bool], Program],
        *parts: tuple[float, MatrixPart],
        light: Floats | None = None,
        gain: Floats | None = None,
        by_direct: bool = False,
    ) -> None:
        """A photo that is the difference of two shots; `light` and `gain` as of `coded`."""
        shots = []
        for sign, positive in ((1.0, True), (-1.0, False)):
            part = f"{name}-{'plus' if positive else 'minus'}"
            self.programs[part] = _seen(half(positive), light, gain)
            shots.append((sign, Shot(part, part)))
        wanted = replace(self.wanted(*parts, light=light, gain=gain), by_direct=by_direct)
        self.photo(name, wanted, shots)

    def exact(self, name: str, wanted: WantedMatrix, camera: list, projector: list) -> None:  # type: ignore[type-arg]
        """A photo of few exact, non-negative blocks."""
        self.programs[name] = BlockProgram(np.array(camera), np.array(projector))
        self.photo(name, wanted, [(1.0, Shot(name, name))])

    def wanted(
        self,
        *parts: tuple[float, MatrixPart],
        light: Floats | None = None,
        gain: Floats | None = None,
    ) -> WantedMatrix:
        """A wanted matrix under the goal's illumination, and under `light` and behind `gain`."""
        if gain is not None:
            parts = tuple((weight, GainPart(gain, part)) for weight, part in parts)
        return WantedMatrix(self.target.grid, parts, self.lit(light))

    def lit(self, light: Floats | None) -> Floats | None:
        """The goal's illumination times another; None is full light."""
        own = self.target.light
        if light is None or own is None:
            return own if light is None else light
        return light * own

    def kept(self, direct: float, indirect: float) -> WantedMatrix:
        """The wanted matrix of these shares of direct and of indirect light."""
        everything, same = UniformPart(self.target.cells), match_own_cells(self.target)
        return self.wanted((indirect, everything), (direct - indirect, same))

    def photo(
        self,
        name: str,
        wanted: WantedMatrix,
        shots: list[tuple[float, Shot]],
        row_weights: bool = False,
    ) -> None:
        """A photo of some shots, each with the black ones that measure its leaks."""
        terms = []
        for sign, shot in shots:
            self.shots.append(shot)
            terms.append((sign, shot.name))
            for black_sign, primal, dual in self.blacks:
                sides = [s for s, black in (("primal", primal), ("dual", dual)) if black]
                extra = replace(
                    shot,
                    name=f"{shot.name}-black-{'-'.join(sides)}",
                    primal_black=primal,
                    dual_black=dual,
                )
                self.shots.append(extra)
                terms.append((sign * black_sign, extra.name))
        self.photos.append(RecipePhoto(name, wanted, tuple(terms), row_weights))


def match_own_cells(target: Target) -> MatchPart:
    """Each camera cell with its own projector cell."""
    return MatchPart(np.arange(target.cells))


def _seen(program: Program, light: Floats | None, gain: Floats | None) -> Program:
    """A program under an illumination and behind a gain, where there are any."""
    if light is not None:
        program = IlluminatedProgram(program, light)
    return program if gain is None else GainProgram(program, gain)
