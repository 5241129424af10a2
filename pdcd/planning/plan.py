"""A plan for a request and a rig: codes, shots, refreshes, seconds, light. Nothing is run here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from pdcd.codes.orders import is_order
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.panels.curve import UNKNOWN_CURVES, Curves, compute_pattern_light
from pdcd.panels.frames import Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import Patterns
from pdcd.panels.schedule import SLOTS, build_frames, count_slot_rows
from pdcd.protocol.plan_summary import (
    CaptureScheme,
    LeakErrors,
    PilotCost,
    PlanSummary,
    Prediction,
    ShotSummary,
)
from pdcd.recipes.parts import repeat_shots
from pdcd.recipes.programs import FloodlitProgram, LongRangeProgram, Program, find_inner_program
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.runs.record import DarkPhoto
from pdcd.words import FamilyName, ScheduleName

PatternPair = tuple[Patterns, Patterns]

COINS: tuple[FamilyName, ...] = ("bernoulli", "rademacher")
"""Families in whose codes every cell is lit by chance."""


@dataclass(frozen=True)
class LeakProbe:
    """A dark photo that decides on black exposures (`pdcd.planning.look`).

    limit : RMS error by leaks, relative to the answer, above which they are wanted. may_add :
        whether they may be added; if not, there is only a warning. average : whether everything may
        be shown more often against the noise of ambient light (`pdcd.planning.average`).
    """

    limit: float
    may_add: bool
    average: bool = False


@dataclass(frozen=True, eq=False)
class ShotSequence:
    """What both panels show in a shot, over and over.

    program, pair : the program, and all patterns that it made; both None for a white shot. passes :
    how often they are shown. primal_black, dual_black : for a shot that measures what a black panel
    leaks.
    """

    program: Program | None
    pair: PatternPair | None
    grid: tuple[int, int]
    window: str
    schedule: ScheduleName
    passes: int
    primal_black: bool
    dual_black: bool
    curves: Curves
    dark_s: float = 0.0
    """Time for which both panels are black after each row."""

    @property
    def count(self) -> int:
        """Pairs of patterns."""
        return 1 if self.pair is None else len(self.pair[0])

    @property
    def lattice(self) -> Lattice:
        """Where the code cells lie."""
        return Lattice(self.grid, self.window)

    def frames(self, pairs: int | None = None, times: int = 1) -> Frames:
        """Refreshes of the shot; for test exposures `pairs` limits it to that many pairs, each
        shown so many `times`."""
        shown = self.pair
        if shown is not None and pairs:
            shown = shown[0][:pairs], shown[1][:pairs]
        return build_frames(
            shown,
            self.grid,
            window=self.window,
            schedule=self.schedule,
            passes=self.passes if pairs is None else times,
            primal_black=self.primal_black,
            dual_black=self.dual_black,
            dark_s=self.dark_s,
        )

    def lit_s(self, row_hz: float) -> float:
        """Time for which an average cell of the projector is lit in the shot."""
        if self.primal_black:
            return 0.0
        rows = sum(SLOTS[self.schedule][0]) * self.passes
        if self.pair is None:
            return rows / row_hz
        lattice, primal, curve = self.lattice, self.pair[0], self.curves[0]
        cells, count = lattice.lattice_cells, len(primal)
        levels = sum(
            float(compute_pattern_light(primal, k, cells, curve).mean()) for k in range(count)
        )
        return rows * lattice.fields * levels / row_hz


@dataclass(frozen=True)
class Plan:
    """All that the engine needs to know; `frames` builds the refreshes of a shot on demand."""

    recipe: Recipe
    how: CaptureScheme
    """What the recipe was made of, besides its target."""
    patterns: dict[str, PatternPair]
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
    """Time by which frames are sent to the mask later, or earlier."""
    dark_s: float = 0.0
    """Time for which both panels are black after each row."""
    iso: int | None = None
    """None: the camera's lowest."""
    smooth: bool = False
    """Whether the indirect photo is to be corrected for its smooth light
    (`pdcd.pictures.smooth`)."""
    prediction: Prediction | None = None
    prior: str | None = None
    """What guided the codes, in words."""
    reasons: tuple[str, ...] = ()
    """Why cells, window, schedule and parts are what they are, a line each."""
    curves: Curves = UNKNOWN_CURVES
    """The light of both panels for each level that they are sent."""
    look: LeakProbe | None = None
    """Which leaks to look for; None where black exposures are settled."""
    leaks: LeakErrors | None = None
    """The leaks that were found."""
    dark: DarkPhoto | None = None
    """The photo whose ambient light is subtracted from the photos of a pilot."""
    unasked: bool = False
    """Whether the pilot is the program's own choice (`pdcd.planning.defaults`)."""
    exact_passes: Mapping[str, int] = field(default_factory=dict)
    """By program, how often exact sequences are shown that were already shown before the number of
    codes changed; others fill as many slots as codes do."""
    otherwise: Plan | None = None
    """The plan instead of a pilot of all codes, when its scouts show no sharp paths."""

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.recipe.target.grid

    @property
    def family(self) -> str:
        """How the codes are made; "none" where there are none."""
        return self.how.family or "none"

    def repeated(self, exposures: int) -> Plan:
        """The same plan, of single exposures, with each taken that often."""
        return replace(
            self,
            how=msgspec.structs.replace(self.how, repeat=exposures),
            recipe=repeat_shots(self.recipe, exposures),
        )

    @property
    def cut(self) -> bool:
        """Whether any shot opens less than whole cells."""
        return any(self.window_of(shot) != "whole" for shot in self.recipe.shots)

    def window_of(self, shot: Shot) -> str:
        """Window mode of a shot: that of the rig for codes, whole cells for all else."""
        coded = not shot.white and is_windowed(self.recipe.programs[shot.program])
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

    def sequence(self, shot: Shot) -> ShotSequence:
        """What a shot shows over and over."""
        pair = program = None
        if not shot.white:
            program = self.recipe.programs[shot.program]
            pair = self.patterns[shot.program]
            if shot.only is not None:
                one = slice(shot.only, shot.only + 1)
                pair = pair[0][one], pair[1][one]
        return ShotSequence(
            program=program,
            pair=pair,
            grid=self.grid,
            window=self.window_of(shot),
            schedule=self.schedule,
            passes=self.passes_of(shot),
            primal_black=shot.primal_black,
            dual_black=shot.dual_black,
            curves=self.curves,
            dark_s=self.dark_s,
        )

    def frames(self, shot: Shot) -> Frames:
        """Refreshes of a shot."""
        return self.sequence(shot).frames()

    def refreshes(self, shot: Shot) -> int:
        """Number of refreshes of a shot, without building them."""
        fields = 1 if shot.white else Lattice(self.grid, self.window_of(shot)).fields
        slots = self.pairs_of(shot) * self.passes_of(shot) * fields
        return slots * count_slot_rows(self.schedule)

    def light_share(self, shot: Shot) -> float:
        """Mean share of light that a path keeps, compared with a floodlit exposure as long."""
        duty = 1.0 / (count_slot_rows(self.schedule) * self.row_s * self.row_hz)
        if shot.primal_black or shot.dual_black:
            return 0.0
        if shot.white:
            return duty
        lattice = Lattice(self.grid, self.window_of(shot))
        kept = average_pair_light(self.patterns[shot.program], lattice.lattice_cells, self.curves)
        return duty * kept * lattice.opening.area

    @property
    def last_exposed(self) -> Shot:
        """The last shot that has an exposure of its own."""
        return [shot for shot in self.recipe.shots if not shot.beside][-1]

    def exposure_s(self, shot: Shot) -> float:
        """Planned time between opening and closing the shutter."""
        return self.refreshes(shot) * self.row_s + self.delay_s + 2.0 * self.settle_s

    @property
    def row_s(self) -> float:
        """Time of a row, with the dark time after it."""
        return 1.0 / self.row_hz + self.dark_s

    def codes_without_pilot(self, limit_s: float) -> int:
        """Codes of the coded photo when a pilot ends with its scouts, and no exposure is longer
        than `limit_s`."""
        coded = next(shot for shot in self.recipe.shots if shot.kind in ("coded", "far"))
        codes_s = self.refreshes(coded) * self.row_s
        around_s = self.exposure_s(coded) - codes_s
        most = self.how.coded + self.how.pilot - SCOUTS
        for count in range(most, self.how.coded, -1):
            fits = codes_s * count / self.how.coded + around_s <= limit_s
            if fits and count % self.how.parts == 0 and is_order(count // self.how.parts):
                return count
        return self.how.coded

    def summary(self, limit_s: float | None = None) -> PlanSummary:
        """The plan in figures. If the longest exposure is given, they include what a pilot costs
        at most, and what it costs if it ends with its scouts."""
        whole = self._summary()
        if limit_s is None or self.how.pilot <= SCOUTS:
            return whole
        pilot_s = [self.exposure_s(shot) for shot in self.recipe.shots if shot.only is not None]
        if self.otherwise is not None:
            stopped_codes, short = self.otherwise.how.coded, self.otherwise.summary()
            stopped_files, stopped_s = short.raw_files, short.seconds
        else:
            stopped_codes = self.codes_without_pilot(limit_s)
            more_s = (stopped_codes / self.how.coded - 1.0) * sum(
                self.refreshes(shot) / self.row_hz
                for shot in self.recipe.shots
                if shot.kind in ("coded", "far")
            )
            stopped_files = whole.raw_files - len(pilot_s) + SCOUTS
            stopped_s = whole.seconds - sum(pilot_s[SCOUTS:]) + more_s
        cost = PilotCost(
            raw_files=len(pilot_s),
            seconds=sum(pilot_s),
            scouts=SCOUTS,
            stopped_codes=stopped_codes,
            stopped_raw_files=stopped_files,
            stopped_seconds=stopped_s,
        )
        return msgspec.structs.replace(whole, pilot_cost=cost)

    def _summary(self) -> PlanSummary:
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
            guards=self.schedule != "none" or self.dark_s > 0.0,
            schedule=self.schedule,
            dark_s=self.dark_s,
            passes=self.passes,
            parts=self.how.parts,
            shots=shots,
            refreshes=sum(s.refreshes * s.exposures for s in shots),
            seconds=sum(s.exposure_s * s.exposures for s in shots),
            light_share=next(s.light_share for s in shots if s.name == main),
            raw_files=len(self.recipe.shots),
            pilot=self.how.pilot,
            prediction=self.prediction,
            prior=self.prior,
            reasons=self.reasons,
            black_level=self.how.black_level if self.look is None else "auto",
            leaks=self.leaks,
            split=self.recipe.split,
        )


def has_code_mask(program: Program) -> bool:
    """Whether the mask of a program shows codes."""
    return program.coded and not isinstance(program, FloodlitProgram)


def is_windowed(program: Program) -> bool:
    """Whether a program runs in the rig's window mode: where the mask shows codes, except for light
    from beyond a radius.

    Parted windows keep a cell's mask away from the borders of the projector's cells, so that its
    direct light stays with its own code. Where no light from within a radius gets in, there is none
    to be kept apart; and windows of whole cells have the border of that radius where it is wanted.
    """
    return has_code_mask(program) and not is_long_range(program)


def find_code_lattice(program: Program, rig: Lattice) -> Lattice:
    """Where the code cells of a program lie: on the lattice of the rig, or whole cells."""
    return rig if is_windowed(program) else Lattice(rig.grid)


def is_long_range(program: Program) -> bool:
    """Whether a program keeps only light from beyond a radius."""
    inner = find_inner_program(program)
    return isinstance(inner, LongRangeProgram) and inner.radius > 0


def average_pair_light(pair: PatternPair, cells: int, curves: Curves = UNKNOWN_CURVES) -> float:
    """Mean over pairs and paths of the product of both panels' light."""
    primal, dual = (
        np.array(
            [compute_pattern_light(patterns, k, cells, curve).mean() for k in range(len(patterns))]
        )
        for patterns, curve in zip(pair, curves, strict=True)
    )
    return float(np.mean(primal * dual))
