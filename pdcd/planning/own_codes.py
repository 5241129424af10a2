"""Codes that came with a request: read, checked against the rig, and shown instead of those that a
family would have made.

All else goes its usual way: a program says which goal the pairs are for, and the photo is divided
by what they realise, whatever that is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.errors import RequestError
from pdcd.files.arrays import ZIP_MAGIC, read_npz
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from pdcd.panels.lattice import Lattice
from pdcd.planning.plan import find_code_lattice
from pdcd.planning.predict import guess_scene_light
from pdcd.probing.deviation import compute_row_deviations, weight_s
from pdcd.probing.realised import Factors
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import Given
from pdcd.recipes.programs import (
    GainProgram,
    IlluminatedProgram,
    LevelPairs,
    Levels,
    Program,
)
from pdcd.recipes.recipe import Recipe
from pdcd.words import GoalName

OWN_CODES = "codes_from"
"""The field of a request."""
_SIDES = ("primal", "dual")
_GOALS: tuple[GoalName, ...] = ("indirect", "direct", "fraction", "split", "long-range")
"""Goals whose photos each show pairs of codes as they are. Other goals make masks of sums of codes,
show codes and their negatives, or need none."""
_MOST_COMPARED = 2**34
"""Most codes squared times cells for which the error of codes is computed: some seconds."""


def read_own_codes(data: bytes, limits: ArrayLimits) -> dict[str, Floats]:
    """Reads the arrays in the bytes of an .npz file; the result has their names among a request's.

    `limits` are those of both arrays together. Raises UnsoundFileError.
    """
    if not data.startswith(ZIP_MAGIC):
        raise UnsoundFileError("it is not an .npz file", "write it with numpy.savez")
    each = ArrayLimits(limits.elements // len(_SIDES), limits.alive)
    try:
        found = read_npz(data, dict.fromkeys(_SIDES, each))
    except UnsoundFileError as err:
        if "shape" not in err.message:
            raise
        raise UnsoundFileError(err.message, "give one to some thousand codes") from err
    for name, array in found.items():
        if array.ndim not in (2, 3):
            raise UnsoundFileError(
                f"`{name}` has {array.ndim} dimensions",
                "give codes x rows x columns, or codes x cells",
            )
        wrong = (array < 0.0) | (array > 1.0)
        if wrong.any():
            first = ", ".join(map(str, np.argwhere(wrong)[0]))
            raise UnsoundFileError(
                f"`{name}` has {np.count_nonzero(wrong)} values below 0 or above 1, the first at "
                f"({first})",
                "scale it to the range from 0 (black) to 1 (lit, or open)",
            )
        if not array.any():
            raise UnsoundFileError(f"`{name}` is black throughout", "light some cells in it")
    primal, dual = found.values()
    if primal.shape != dual.shape:
        shapes = " and ".join(" x ".join(map(str, array.shape)) for array in (primal, dual))
        raise UnsoundFileError(
            f"`primal` and `dual` have the shapes {shapes}", "give both the same shape"
        )
    return {f"{OWN_CODES}.{name}": array for name, array in found.items()}


def count_own_codes(request: CaptureRequest, given: Given) -> CaptureRequest:
    """The request with the number of its own codes; unchanged where it has none.

    Raises RequestError where something else that was asked for excludes them.
    """
    if request.codes_from is None:
        return request
    if f"{OWN_CODES}.{_SIDES[0]}" not in given:
        raise RequestError(
            f"{OWN_CODES} was named, but not read", hint="hand the file over beside the request"
        )
    count = len(given[f"{OWN_CODES}.{_SIDES[0]}"])
    if request.goal not in _GOALS:
        raise RequestError(
            f"goal {request.goal} cannot be taken with {OWN_CODES}",
            hint=f"take the goal {', '.join(_GOALS[:-1])} or {_GOALS[-1]}, or leave it out",
        )
    spare = [
        name
        for name, idle in (
            ("family", None), ("equal_brightness", False), ("method", "coded"), ("prior", None),
        )
        if getattr(request, name) != idle
    ]  # fmt: skip
    spare += ["pilot"] * (request.pilot not in (None, 0))
    spare += ["codes"] * (request.codes not in (None, count))
    if spare:
        raise RequestError(
            f"{spare[0]} does not go with {OWN_CODES}, whose {count} pairs are shown as they are",
            hint=f"leave out {spare[0]}",
        )
    if isinstance(request.parts, int) and count % request.parts:
        fit = next(n for n in range(request.parts, 0, -1) if not count % n)
        raise RequestError(
            f"the {count} pairs of {OWN_CODES} cannot be shared out to {request.parts} parts",
            hint=f"take {fit} part{'s' * (fit > 1)}",
        )
    if request.parts == "auto":
        raise RequestError(
            f"parts cannot be left to the program with {OWN_CODES}", hint="give their number"
        )
    return msgspec.structs.replace(request, codes=count)


@dataclass(frozen=True, eq=False)
class OwnCodes:
    """K pairs of codes, (K, L) bool each, or levels where they have any.

    lattice_shape : rows and columns of their cells.
    """

    primal: Levels
    dual: Levels
    lattice_shape: tuple[int, int]

    def in_place_of(self, program: Program, part: int, parts: int) -> Program:
        """A program that shows these codes, or those of one of so many parts, under the same
        illumination and gain as another program."""
        if isinstance(program, IlluminatedProgram | GainProgram):
            return replace(program, program=self.in_place_of(program.program, part, parts))
        count = len(self.primal) // parts
        some = slice(max(part - 1, 0) * count, max(part, 1) * count)
        return _GivenProgram(replace(self, primal=self.primal[some], dual=self.dual[some]))

    def over(self, lattice: Lattice) -> LevelPairs:
        """Their levels over the cells of a lattice, (K, L) each. Codes over the grid alone are
        continued over its far edges."""
        if self.lattice_shape == lattice.shape:
            return self.primal, self.dual
        nearest = lattice.continued[0]
        return self.primal[:, nearest], self.dual[:, nearest]

    def explain(self, recipe: Recipe, lattice: Lattice) -> Iterator[str]:
        """What they are, their error in the goal's coded photo, and what becomes of them in parts
        and windows, a line each.

        lattice : of codes in the rig's window. Raises RequestError where they keep none of the
        light that the photo is scaled by.
        """
        yield self._describe_error(recipe)
        if self.lattice_shape != lattice.shape and lattice.fields > 1:
            yield (
                f"codes: window {lattice.window} moves them by half a cell; over the far edges of "
                "the grid its last cells are continued"
            )
        parts = max(shot.part for shot in recipe.shots)
        if parts:
            yield (
                f"parts: {parts} exposures of {len(self.primal) // parts} codes each, in their "
                "order; their spread measures the error if those of their codes are independent"
            )
        else:
            yield "parts: one exposure; the error of the codes is not in the error bars"

    def _describe_error(self, recipe: Recipe) -> str:
        """What they are, and their error. Raises RequestError."""
        lit, opened = (100.0 * float(side.mean()) for side in (self.primal, self.dual))
        told = (
            f"codes: {len(self.primal)} pairs as given; the projector lights {lit:.3g} % of the "
            f"cells, the mask opens {opened:.3g} %"
        )
        programs = recipe.programs
        coded = {s.name for s in recipe.shots if not s.white and programs[s.program].coded}
        wanted = next(photo for photo in recipe.photos if photo.shots[0][1] in coded)
        rows, columns = recipe.target.grid
        left, right = (
            np.asarray(side, np.float64)
            .reshape(-1, *self.lattice_shape)[:, :rows, :columns]
            .reshape(len(side), -1)
            for side in (self.dual, self.primal)
        )
        factors = Factors(left, right, np.sum(left * right, axis=0), left.sum(axis=0))
        weight = weight_s(factors, wanted.wanted)
        if not weight > 0.0:
            raise RequestError(
                f"{OWN_CODES}: its pairs keep no light that goal {recipe.target.goal.name} wants",
                hint="open the mask where the projector is to be seen",
            )
        kind = wanted.wanted.uniform
        if kind is None or len(self.primal) ** 2 * left.shape[1] > _MOST_COMPARED:
            return told
        mean, variance, own = compute_row_deviations(factors, wanted.wanted, weight)
        light = guess_scene_light()
        direct, indirect = (float(np.mean(side**2)) for side in (light.direct, light.indirect))
        error = np.mean(mean**2) * indirect + np.mean(variance) * light.squares
        error += np.mean(own**2) * direct
        signal = np.mean((kind[0] * light.direct + kind[1] * light.indirect) ** 2)
        return (
            f"{told}; their error is {100.0 * float(np.sqrt(error / signal)):.2g} % of the coded "
            f"photo ({light.name})"
        )


@dataclass(frozen=True, eq=False)
class _GivenProgram:
    """Pairs as they were given."""

    codes: OwnCodes
    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """K pairs; `bits` is not used."""
        return self.codes.over(lattice)


def fit_own_codes(given: Given, rig: Lattice, draft: Recipe) -> OwnCodes | None:
    """The codes among a request's arrays, for the cells of the draft's photos; None where there are
    none. rig : the lattice of codes in its window.

    Raises RequestError where they have other cells.
    """
    if f"{OWN_CODES}.{_SIDES[0]}" not in given:
        return None
    primal, dual = (given[f"{OWN_CODES}.{name}"] for name in _SIDES)
    cells = primal.shape[1:]
    program = next(program for program in draft.programs.values() if program.coded)
    lattice = find_code_lattice(program, rig)
    for shape in (lattice.shape, lattice.grid):
        if cells in (shape, (shape[0] * shape[1],)):
            return OwnCodes(_as_bits(primal), _as_bits(dual), shape)
    said = [" x ".join(map(str, shape)) for shape in (cells, lattice.grid, lattice.shape)]
    more = f", or {said[2]} for window {lattice.window}" * (said[1] != said[2])
    raise RequestError(
        f"{OWN_CODES} has codes of {said[0]} cells; the grid is {said[1]}{more}",
        hint=f"give codes x {said[1]}",
    )


def _as_bits(levels: Floats) -> Levels:
    """Codes (K, cells), as bits where they are."""
    flat = levels.reshape(len(levels), -1)
    return flat.astype(np.bool_) if np.all((flat == 0.0) | (flat == 1.0)) else flat
