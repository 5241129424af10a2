"""Request + rig -> a plan: codes, shots, refreshes, seconds, light; nothing is run here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pdcd import planes
from pdcd.bitplanes import check_binary
from pdcd.codes import hadamard_fits, make_codes
from pdcd.codes.prior import prior_codes
from pdcd.config import Config
from pdcd.errors import ConfigError
from pdcd.goals import MATRICES, PLANES, Goal, check_goal
from pdcd.interfaces import Frames
from pdcd.isolation import FAMILIES as ISOLATION
from pdcd.isolation import isolated
from pdcd.lattice import Lattice
from pdcd.parts import check_parts, coin_signs, in_parts, part_codes, part_seed
from pdcd.patterns import Patterns, compact, levels_of
from pdcd.pilot import MATCHED, SCOUTS, pilot_codes
from pdcd.programs import Floodlit, Program, extended
from pdcd.recipe import Recipe, Shot
from pdcd.recipes import make_recipe
from pdcd.repeat import repeated
from pdcd.request import (
    BlackLevel,
    CaptureRequest,
    GuardsName,
    PlanSummary,
    Prediction,
    ShotSummary,
)
from pdcd.schedule import build_frames, choose_guards, choose_window, slot_rows

Pair = tuple[Patterns, Patterns]


@dataclass(frozen=True)
class Plan:
    """All that the engine needs to know; `frames` builds the refreshes of a shot on demand."""

    recipe: Recipe
    patterns: dict[str, Pair]
    """Projector and mask patterns of each program."""
    family: str
    count: int
    pilot: int
    parts: int
    p: float
    grid: tuple[int, int]
    window: str
    guards: GuardsName
    passes: int
    white_slots: int
    refresh_hz: float
    """Rows of frames a second: refreshes, or the planes that each of them carries."""
    settle_s: float
    delay_s: float = 0.0
    """Time by which the mask is sent its frames later, or earlier."""
    repeat: int = 1
    smooth: bool = False
    """Whether the indirect photo is to be corrected for its smooth light (`pdcd.smooth`)."""
    black_level: BlackLevel = "none"
    """Which leaks further shots measure."""
    prediction: Prediction | None = None
    prior: str | None = None
    """What guided the codes, in words."""
    otherwise: Plan | None = None
    """What is done instead of a pilot of all codes when its scouts see no sharp paths."""

    def window_of(self, shot: Shot) -> str:
        """Window mode of a shot: that of the rig for codes, whole cells for all else."""
        windowed = not shot.white and _windowed(self.recipe.programs[shot.program])
        return self.window if windowed else "whole"

    def passes_of(self, shot: Shot) -> int:
        """How often a shot's sequence is shown: exact ones fill as many slots as codes would."""
        if shot.white:
            return self.white_slots
        if self.recipe.programs[shot.program].coded:
            return self.passes
        return max(1, round(self.count * self.passes / len(self.patterns[shot.program][0])))

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
            guards=self.guards,
            passes=self.passes_of(shot) if pairs is None else 1,
            primal_black=shot.primal_black,
            dual_black=shot.dual_black,
        )

    def refreshes(self, shot: Shot) -> int:
        """Number of refreshes of a shot, without building them."""
        fields = 1 if shot.white else Lattice(self.grid, self.window_of(shot)).fields
        slots = self.pairs_of(shot) * self.passes_of(shot) * fields
        return slots * slot_rows(self.guards)

    def light_share(self, shot: Shot) -> float:
        """Mean share of a floodlit exposure of the same length that a path keeps."""
        duty = 1.0 / slot_rows(self.guards)
        if shot.primal_black or shot.dual_black:
            return 0.0
        if shot.white:
            return duty
        lattice = Lattice(self.grid, self.window_of(shot))
        kept = _kept(self.patterns[shot.program], lattice.lattice_cells)
        return duty * kept / lattice.fields

    def exposure_s(self, shot: Shot) -> float:
        """Planned time between opening and closing the shutter."""
        return self.refreshes(shot) / self.refresh_hz + self.delay_s + 2.0 * self.settle_s

    def summary(self) -> PlanSummary:
        """The plan in figures."""
        alike = {name: len(self.recipe.stack) for name in self.recipe.stack[:1]}
        copied = {s.copy_of for s in self.recipe.shots}
        alike |= {s.name: self.repeat for s in self.recipe.shots if s.name in copied}
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
            if s.name not in self.recipe.stack[1:] and not s.copy_of
        )
        photos = {photo.name: photo for photo in self.recipe.photos}
        last = self.recipe.main
        first = photos[last].shots[0][1] if last in photos else self.recipe.stack[0]
        single = first in self.recipe.stack or first in self.recipe.sums
        main = self.recipe.stack[0] if single else first
        return PlanSummary(
            goal=self.recipe.goal.name,
            family=self.family,
            codes=self.count + self.pilot,
            p=self.p,
            grid=self.grid,
            window=self.window,
            guards=self.guards != "none",
            schedule=self.guards,
            passes=self.passes,
            parts=self.parts,
            shots=shots,
            refreshes=sum(s.refreshes * s.exposures for s in shots),
            seconds=sum(s.exposure_s * s.exposures for s in shots),
            light_share=next(s.light_share for s in shots if s.name == main),
            raw_files=len(self.recipe.shots),
            pilot=self.pilot,
            prediction=self.prediction,
            prior=self.prior,
        )


def goal_of(request: CaptureRequest, grid: tuple[int, int]) -> Goal:
    """The goal a request asks for, with all its arrays read. Raises ConfigError."""
    given = {name: getattr(request, name) for name in (*PLANES, *MATRICES)}
    arrays = {name: planes.load(name, v) for name, v in given.items() if v is not None}
    for name in PLANES:
        if name in arrays and arrays[name].shape != grid:
            raise ConfigError(
                f"{name} is {arrays[name].shape[0]} x {arrays[name].shape[1]}, the grid is "
                f"{grid[0]} x {grid[1]} cells",
                hint="give one value for each cell",
            )
    return check_goal(
        Goal(
            name=request.goal,
            grid=grid,
            p=request.p,
            shift=request.shift,
            radius=request.radius,
            mix=request.mix,
            period=request.period,
            planes={name: a.ravel() for name, a in arrays.items() if name in PLANES},
            matrices={name: a for name, a in arrays.items() if name in MATRICES},
        )
    )


def make_plan(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None = None,
) -> Plan:
    """Resolve a request against the configuration.

    `mask_lag_s` is the lag of the mask that the display measured; None where it is not known.
    Raises ConfigError when the request contradicts itself, the rig, or the limits.
    """
    schedule = config.schedule
    total = request.codes if request.codes is not None else schedule.codes
    count = total - request.pilot
    if count < 0 or (count == 0 and request.pilot not in MATCHED):
        raise ConfigError(
            f"a pilot of {request.pilot} leaves none of {total} codes",
            hint="the pilot's codes are counted among all: ask for more codes or a smaller pilot",
        )
    black: BlackLevel = request.black_level or schedule.black_level
    wanted = goal_of(request, grid)
    recipe = make_recipe(
        wanted,
        black_level=black,
        white=request.white,
        codes=count,
        pilot=request.pilot,
        method=request.method,
    )
    photos = {photo.name: photo for photo in recipe.photos}
    smoothable = "coded" in photos and photos["coded"].wanted.uniform == (0.0, 1.0)
    if request.smooth and not smoothable:
        raise ConfigError(
            f"goal {recipe.goal.name} takes no photo of indirect light under full light to smooth",
            hint="leave out smooth",
        )
    parts = check_parts(request)
    part_count = part_codes(count, parts)
    recipe = in_parts(recipe, parts)
    cell_px = min(config.projector.size_px[1] / grid[0], config.projector.size_px[0] / grid[1])
    if cell_px < 1.0:
        raise ConfigError(
            f"a grid of {grid[0]} x {grid[1]} cells is finer than the projector's pixels",
            device="projector",
            hint="use a coarser scene grid",
        )
    window = choose_window(
        request.window or schedule.window, config.rig.misregistration_px / cell_px
    )
    asked = schedule.guards if request.guards is None else request.guards
    guards = choose_guards(asked, *lag_rows(config, mask_lag_s))
    family = _family(request, schedule.family, recipe, part_count, parts)
    _check_family(family, request, parts, recipe)
    slot_s = slot_rows(guards) / config.row_hz
    if family in ISOLATION:
        recipe = isolated(recipe, family, slot_s=slot_s, limit_s=config.limits.max_exposure_s)
    recipe = repeated(recipe, request.repeat)
    lattice = Lattice(grid, window)
    windowed = any(_windowed(program) for program in recipe.programs.values())
    shown = count or total  # a pilot of all codes leaves none, and shows them itself
    one_pass_s = shown * slot_s * (lattice.fields if windowed else 1)
    coded = any(program.coded for program in recipe.programs.values())
    if coded:  # before the codes are made: a million of them would only be made to be refused
        _check_limit(one_pass_s / max(parts, shown if recipe.stack else 1), config)
    passes = _passes(request, one_pass_s, shown)
    patterns = _patterns(recipe, request, lattice, family, part_count, parts)
    if config.display.planes_per_refresh > 1:
        for pair in patterns.values():
            check_binary(*pair)
    plan = Plan(
        recipe=recipe,
        patterns=patterns,
        family=family if coded or family in ISOLATION else "none",
        count=count,
        pilot=request.pilot,
        parts=parts,
        p=next((p.p for p in recipe.programs.values() if p.coded), 0.5),
        grid=grid,
        window=window,
        guards=guards,
        passes=passes,
        white_slots=_white_slots(recipe, patterns, lattice, (part_count or total) * passes),
        refresh_hz=config.row_hz,
        settle_s=config.rig.settle_s,
        delay_s=abs(config.mask_delay_rows) / config.row_hz,
        repeat=request.repeat,
        smooth=smoothable and (family == "hadamard" if request.smooth is None else request.smooth),
        black_level=black,
    )
    _check_limit(max(plan.exposure_s(s) for s in recipe.shots), config)
    if count:
        return plan
    scouts_first = msgspec.structs.replace(request, pilot=SCOUTS)
    return replace(plan, otherwise=make_plan(scouts_first, config, grid, mask_lag_s))


def asks_for_lag(request: CaptureRequest, config: Config) -> bool:
    """Whether the plan of a request depends on the lag of the mask."""
    asked = config.schedule.guards if request.guards is None else request.guards
    return asked == "auto"


def lag_rows(config: Config, mask_lag_s: float | None) -> tuple[float | None, float]:
    """Lag of the mask and its jitter in rows of frames, as `pdcd.schedule` takes them."""
    jitter_s = math.hypot(config.projector.jitter_s, config.mask.jitter_s)
    lag = None if mask_lag_s is None else mask_lag_s * config.row_hz
    return lag, jitter_s * config.row_hz


def _check_family(family: str, request: CaptureRequest, parts: int, recipe: Recipe) -> None:
    """Refuse what a family of codes cannot do."""
    if request.pilot and family != "hadamard":
        raise ConfigError(f"a pilot cannot guide {family} codes", hint="take the family hadamard")
    if family in ISOLATION and request.method != "coded":
        raise ConfigError(
            f"method {request.method} does not isolate paths", hint="take the family hadamard"
        )
    if family in ISOLATION and parts > 1:
        raise ConfigError(f"{family} has no codes to split", hint="leave out the parts")
    if request.repeat > 1 and (parts > 1 or request.method != "coded" or recipe.sums):
        raise ConfigError(
            "only a coded photo in one piece can be repeated", hint="leave out repeat, or the parts"
        )


def _check_limit(exposure_s: float, config: Config) -> None:
    """Refuse exposures that the rig's limits do not allow."""
    if exposure_s > config.limits.max_exposure_s:
        raise ConfigError(
            f"the plan needs an exposure of {exposure_s:.1f} s; the limit is "
            f"{config.limits.max_exposure_s:g} s",
            hint="ask for fewer codes, or raise limits.max_exposure_s",
        )


def _passes(request: CaptureRequest, one_pass_s: float, count: int) -> int:
    """Whole passes over the codes that fit into the exposure asked for; one where none was."""
    if request.exposure_s is None:
        return 1
    passes = int(request.exposure_s / one_pass_s + 1e-9)
    if passes < 1:
        raise ConfigError(
            f"an exposure of {request.exposure_s:g} s is shorter than one pass over "
            f"{count} codes ({one_pass_s:.3g} s)",
            hint="ask for fewer codes or a longer exposure",
        )
    return passes


def _patterns(
    recipe: Recipe,
    request: CaptureRequest,
    lattice: Lattice,
    family: str,
    part_count: int,
    parts: int,
) -> dict[str, Pair]:
    """Patterns of every program; each part of a split photo has codes of its own."""
    part_of = {shot.program: shot.part for shot in recipe.shots}
    patterns = {}
    for name, program in recipe.programs.items():
        seed = part_seed(request.seed, parts, part_of.get(name, 0))
        bits = _bits(name, program, request, lattice, family, part_count, seed)
        if part_of.get(name, 0) and family == "hadamard" and program.p == 0.5:
            bits = coin_signs(bits, seed)
        patterns[name] = _compile(program, recipe, lattice, bits)
    return patterns


def _family(request: CaptureRequest, default: str, recipe: Recipe, count: int, parts: int) -> str:
    """The family asked for. Where codes must be lit in another share than 1/2 that Hadamard codes
    cannot do with this number, balanced ones stand in for them unless they were asked for by name;
    and in parts, whose spread tells of errors only where phases are left to chance."""
    family = request.family or default
    main = next((p.p for p in recipe.programs.values() if p.coded), 0.5)
    if family != "hadamard" or main == 0.5 or request.family is not None:
        return family
    return family if parts == 1 and hadamard_fits(count, main) else "balanced"


def _bits(
    name: str,
    program: Program,
    request: CaptureRequest,
    lattice: Lattice,
    family: str,
    count: int,
    seed: int,
) -> NDArray[np.bool_]:
    """Code bits (K, L) of a coded program, none for others."""
    if not program.coded:
        return np.zeros((0, 0), dtype=np.bool_)
    if name == "pilot":
        return pilot_codes(lattice.grid, request.pilot, request.seed)
    p = program.p
    if p != 0.5 and request.p is None:
        # The best share of lit cells, rounded to what balanced codes can do.
        p = max(1, round(p * count)) / count
        family = "bernoulli" if family in ("bernoulli", "rademacher") else "balanced"
    shape = lattice.shape if _windowed(program) else lattice.grid
    return make_codes(family, shape, count, dual="same", p=p, seed=seed).primal()


def _compile(program: Program, recipe: Recipe, lattice: Lattice, bits: NDArray[np.bool_]) -> Pair:
    """Patterns of a program over its own lattice, coded ones under the goal's illumination."""
    own = lattice if _windowed(program) else Lattice(lattice.grid)
    primal, dual = program.pairs(bits, own)
    # A pilot looks at the whole scene: it learns paths, not the picture.
    if recipe.goal.light is not None and _windowed(program):
        primal = primal * extended(recipe.goal.light, own)
    return compact(primal), compact(dual)


def with_links(plan: Plan, links: Any, seed: int) -> Plan:
    """The same plan with Hadamard codes that keep linked cells (N, N) apart."""
    lattice = Lattice(plan.grid, plan.window)
    n, shape = lattice.cells, lattice.shape
    row, column = np.divmod(np.arange(n), plan.grid[1])
    # With quarter windows each cell is served by four code cells, so a path links all of these.
    more = range(shape[0] - plan.grid[0] + 1)
    code_cell = [(row + down) * shape[1] + column + right for down in more for right in more]
    onto = sparse.csr_array(
        (
            np.full(len(code_cell) * n, 1.0 / len(code_cell)),
            (np.concatenate(code_cell), np.tile(np.arange(n), len(code_cell))),
        ),
        shape=(lattice.lattice_cells, n),
    )
    part_of = {shot.program: shot.part for shot in plan.recipe.shots}
    coded = {}
    for name, program in plan.recipe.programs.items():
        if _windowed(program) and program.p == 0.5:
            # The generator is the one that `make_codes` takes, so that no links give the usual
            # codes.
            own = part_seed(seed, plan.parts, part_of.get(name, 0))
            rng = np.random.Generator(np.random.PCG64(own))
            bits = prior_codes(shape, plan.count // plan.parts, onto @ links @ onto.T, rng)
            if part_of.get(name, 0):
                bits = coin_signs(bits, own)
            coded[name] = _compile(program, plan.recipe, lattice, bits)
    return replace(plan, patterns={**plan.patterns, **coded})


def _white_slots(recipe: Recipe, patterns: dict[str, Pair], lattice: Lattice, slots: int) -> int:
    """Slots of a white shot: as the goal itself, all; beside a coded one, as many as gather about
    its light, which keeps the camera at one setting."""
    for name, program in recipe.programs.items():
        if _windowed(program):
            slots = round(slots * _kept(patterns[name], lattice.lattice_cells))
            break
    return max(1, slots)


def _windowed(program: Program) -> bool:
    """Whether a program runs in the rig's window mode: where the mask shows codes."""
    return program.coded and not isinstance(program, Floodlit)


def _kept(pair: Pair, cells: int) -> float:
    """Mean over pairs and paths of the product of both panels' levels."""
    primal, dual = (
        np.array([levels_of(patterns, k, cells).mean() for k in range(len(patterns))])
        for patterns in pair
    )
    return float(np.mean(primal * dual))
