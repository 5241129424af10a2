"""Request + rig -> a plan: codes, shots, refreshes, seconds, light; nothing is run here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from pdcd.codes.far import woven_fits
from pdcd.panels.curve import UNKNOWN, Curves, light_of
from pdcd.panels.frames import Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import Patterns
from pdcd.panels.schedule import build_frames, slot_rows
from pdcd.protocol.request import How, Leaks, PlanSummary, Prediction, ShotSummary
from pdcd.recipes.goals import Target
from pdcd.recipes.parts import repeated
from pdcd.recipes.programs import Far, Floodlit, Program, within
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.runs.record import DarkPhoto
from pdcd.words import FamilyName, ScheduleName

Pair = tuple[Patterns, Patterns]

COINS: tuple[FamilyName, ...] = ("bernoulli", "rademacher")
"""Families of which every cell is lit by chance in every code."""


@dataclass(frozen=True)
class Look:
    """A dark photo that decides on black exposures (`pdcd.planning.look`).

    limit : RMS error by leaks, relative to the answer, from which they are wanted. may_add : else a
        warning is all. average : whether everything may be shown more often against the noise of
        ambient light (`pdcd.planning.average`).
    """

    limit: float
    may_add: bool
    average: bool = False


@dataclass(frozen=True)
class Plan:
    """All that the engine needs to know; `frames` builds the refreshes of a shot on demand."""

    recipe: Recipe
    how: How
    """What the recipe was made by, beside its target."""
    patterns: dict[str, Pair]
    """Projector and mask patterns of each program, as they are sent."""
    p: float
    window: str
    schedule: ScheduleName
    passes: int
    white_slots: int
    row_hz: float
    """Rows of frames a second: refreshes, or the planes that each of them carries."""
    settle_s: float
    delay_s: float = 0.0
    """Time by which the mask is sent its frames later, or earlier."""
    iso: int | None = None
    """None: the camera's lowest."""
    memory_bytes: int = 0
    """Foreseen peak of planning, taking and decoding (`pdcd.planning.memory`)."""
    smooth: bool = False
    """Whether the indirect photo is to be corrected for its smooth light
    (`pdcd.pictures.smooth`)."""
    prediction: Prediction | None = None
    prior: str | None = None
    """What guided the codes, in words."""
    reasons: tuple[str, ...] = ()
    """Why cells, window, schedule and parts are what they are, a line each."""
    curves: Curves = UNKNOWN
    """What light both panels make of what they are sent."""
    look: Look | None = None
    """Which leaks to look for; None where black exposures are settled."""
    leaks: Leaks | None = None
    """What was found."""
    dark: DarkPhoto | None = None
    """The photo whose ambient light is taken off the photos of a pilot."""
    unasked: bool = False
    """Whether the pilot is the program's own choice (`pdcd.planning.unasked`)."""
    exact_passes: Mapping[str, int] = field(default_factory=dict)
    """By program, how often exact sequences are shown that were shown before the number of codes
    changed; others fill as many slots as codes do."""
    otherwise: Plan | None = None
    """What is done instead of a pilot of all codes when its scouts see no sharp paths."""

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.recipe.target.grid

    @property
    def family(self) -> str:
        """How the codes are made; "none" where there are none."""
        return self.how.family or "none"

    def scaled(self, passes: int, repeat: int) -> Plan:
        """The same plan, of single exposures, with its codes shown `passes` times in each of
        `repeat` exposures."""
        return replace(
            self,
            passes=passes,
            white_slots=self.white_slots * passes // self.passes,
            how=msgspec.structs.replace(self.how, repeat=repeat),
            recipe=repeated(self.recipe, repeat),
        )

    def outline(self) -> Plan:
        """The same plan for those who only show its shots: of the recipe the shots and what they
        show are left, but not the photos, pictures and sums that are made of them."""
        recipe = self.recipe
        target = Target(recipe.target.goal, recipe.target.grid)
        bare = replace(recipe, target=target, photos=(), pictures={}, sums={}, meant=None)
        return replace(self, recipe=bare, otherwise=None)

    def window_of(self, shot: Shot) -> str:
        """Window mode of a shot: that of the rig for codes, whole cells for all else."""
        coded = not shot.white and windowed(self.recipe.programs[shot.program])
        return self.window if coded else "whole"

    def passes_of(self, shot: Shot) -> int:
        """How often a shot's sequence is shown: exact ones fill as many slots as codes would."""
        if shot.white:
            return self.white_slots
        if self.recipe.programs[shot.program].coded:
            return self.passes
        if shot.program in self.exact_passes:
            return self.exact_passes[shot.program]
        return max(1, round(self.how.coded * self.passes / len(self.patterns[shot.program][0])))

    def pairs_of(self, shot: Shot) -> int:
        """Pairs of patterns in a shot's sequence."""
        return 1 if shot.white or shot.only is not None else len(self.patterns[shot.program][0])

    def frames(self, shot: Shot, *, pairs: int | None = None) -> Frames:
        """Refreshes of a shot; `pairs` limits it to that many pairs, once (test exposures)."""
        shown = None
        if not shot.white:
            primal, dual = self.patterns[shot.program]
            first = shot.only or 0
            last = first + (pairs or self.pairs_of(shot))
            shown = (primal[first:last], dual[first:last])
        return build_frames(
            shown,
            self.grid,
            window=self.window_of(shot),
            schedule=self.schedule,
            passes=self.passes_of(shot) if pairs is None else 1,
            primal_black=shot.primal_black,
            dual_black=shot.dual_black,
        )

    def refreshes(self, shot: Shot) -> int:
        """Number of refreshes of a shot, without building them."""
        fields = 1 if shot.white else Lattice(self.grid, self.window_of(shot)).fields
        slots = self.pairs_of(shot) * self.passes_of(shot) * fields
        return slots * slot_rows(self.schedule)

    def light_share(self, shot: Shot) -> float:
        """Mean share of a floodlit exposure of the same length that a path keeps."""
        duty = 1.0 / slot_rows(self.schedule)
        if shot.primal_black or shot.dual_black:
            return 0.0
        if shot.white:
            return duty
        lattice = Lattice(self.grid, self.window_of(shot))
        kept = mean_light(self.patterns[shot.program], lattice.lattice_cells, self.curves)
        return duty * kept * lattice.opening.area

    def exposure_s(self, shot: Shot) -> float:
        """Planned time between opening and closing the shutter."""
        return self.refreshes(shot) / self.row_hz + self.delay_s + 2.0 * self.settle_s

    def summary(self) -> PlanSummary:
        """The plan in figures."""
        alike = {name: len(self.recipe.stack) for name in self.recipe.stack[:1]}
        copied = {s.copy_of for s in self.recipe.shots}
        alike |= {name: self.how.repeat * alike.get(name, 1) for name in copied if name}
        shots = tuple(
            ShotSummary(
                name=s.name,
                exposures=alike.get(s.name, 1),
                codes=0 if s.white else self.pairs_of(s),
                refreshes=self.refreshes(s),
                exposure_s=self.exposure_s(s),
                light_share=self.light_share(s),
            )
            for s in self.recipe.shots
            if s.name not in self.recipe.stack[1:] and not s.copy_of and not s.beside
        )
        photos = {photo.name: photo for photo in self.recipe.photos}
        last = self.recipe.main
        first = photos[last].shots[0][1] if last in photos else self.recipe.stack[0]
        exposed = {shot.name: shot.beside or shot.name for shot in self.recipe.shots}
        first = exposed.get(first, first)
        single = first in self.recipe.stack or first in self.recipe.sums
        main = self.recipe.stack[0] if single else first
        return PlanSummary(
            goal=self.recipe.target.goal.name,
            family=self.family,
            codes=self.how.codes,
            p=self.p,
            grid=self.grid,
            window=self.window,
            guards=self.schedule != "none",
            schedule=self.schedule,
            passes=self.passes,
            parts=self.how.parts,
            shots=shots,
            refreshes=sum(s.refreshes * s.exposures for s in shots),
            seconds=sum(s.exposure_s * s.exposures for s in shots),
            light_share=next(s.light_share for s in shots if s.name == main),
            raw_files=len(self.recipe.shots),
            memory_bytes=self.memory_bytes,
            pilot=self.how.pilot,
            prediction=self.prediction,
            prior=self.prior,
            reasons=self.reasons,
            black_level=self.how.black_level if self.look is None else "auto",
            leaks=self.leaks,
            split=self.recipe.split,
        )


def shows_codes(program: Program) -> bool:
    """Whether the mask of a program shows codes."""
    return program.coded and not isinstance(program, Floodlit)


def windowed(program: Program) -> bool:
    """Whether a program runs in the rig's window mode: where the mask shows codes, but for light
    from beyond a radius.

    Parted windows keep a cell's mask away from the borders of the projector's cells, so that its
    direct light stays with its own code. Where no light from within a radius gets in, there is none
    to be kept apart; and windows of whole cells have the border of that radius where it is wanted.
    """
    return shows_codes(program) and not beyond(program)


def lattice_of(program: Program, rig: Lattice) -> Lattice:
    """Where the code cells of a program lie: on the lattice of the rig, or whole cells."""
    return rig if windowed(program) else Lattice(rig.grid)


def beyond(program: Program) -> bool:
    """Whether a program keeps light from beyond a radius alone."""
    inner = within(program)
    return isinstance(inner, Far) and inner.radius > 0


def chosen_together(program: Program, rig: Lattice, count: int, family: FamilyName | None) -> bool:
    """Whether so many codes of a program are chosen together with its masks."""
    inner = within(program)
    if not isinstance(inner, Far) or not inner.woven or not beyond(program) or family in COINS:
        return False
    return woven_fits(lattice_of(program, rig).shape, count, inner.p)


def mean_light(pair: Pair, cells: int, curves: Curves = UNKNOWN) -> float:
    """Mean over pairs and paths of the product of both panels' light."""
    primal, dual = (
        np.array([light_of(patterns, k, cells, curve).mean() for k in range(len(patterns))])
        for patterns, curve in zip(pair, curves, strict=True)
    )
    return float(np.mean(primal * dual))
