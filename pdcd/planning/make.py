"""Request + rig -> a plan: what a request leaves open, resolved against the configuration."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import Config
from pdcd.codes.hadamard import hadamard_fits
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError
from pdcd.frames.bitplanes import check_binary
from pdcd.frames.lattice import Lattice
from pdcd.frames.patterns import compact
from pdcd.frames.schedule import slot_rows
from pdcd.pilot.codes import MATCHED, SCOUTS, pilot_codes
from pdcd.planning.guards import choose_schedule, choose_window, lag_rows
from pdcd.planning.plan import Pair, Plan, mean_light, windowed
from pdcd.recipes.arrays import goal_of
from pdcd.recipes.isolation import FAMILIES as ISOLATION
from pdcd.recipes.isolation import isolated
from pdcd.recipes.make import make_recipe
from pdcd.recipes.parts import check_parts, coin_signs, in_parts, part_codes, part_seed
from pdcd.recipes.programs import Program, extended
from pdcd.recipes.recipe import Recipe
from pdcd.recipes.repeat import repeated
from pdcd.request import CaptureRequest
from pdcd.words import BlackLevel


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
    defaults = config.schedule
    total = request.codes if request.codes is not None else defaults.codes
    count = total - request.pilot
    if count < 0 or (count == 0 and request.pilot not in MATCHED):
        raise ConfigError(
            f"a pilot of {request.pilot} leaves none of {total} codes",
            hint="the pilot's codes are counted among all: ask for more codes or a smaller pilot",
        )
    black: BlackLevel = request.black_level or defaults.black_level
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
        request.window or defaults.window, config.rig.misregistration_px / cell_px
    )
    asked = defaults.guards if request.guards is None else request.guards
    schedule = choose_schedule(asked, *lag_rows(config, mask_lag_s))
    family = _family(request, defaults.family, recipe, part_count, parts)
    _check_family(family, request, parts, recipe)
    slot_s = slot_rows(schedule) / config.row_hz
    if family in ISOLATION:
        recipe = isolated(recipe, family, slot_s=slot_s, limit_s=config.limits.max_exposure_s)
    recipe = repeated(recipe, request.repeat)
    lattice = Lattice(grid, window)
    in_windows = any(windowed(program) for program in recipe.programs.values())
    shown = count or total  # a pilot of all codes leaves none, and shows them itself
    one_pass_s = shown * slot_s * (lattice.fields if in_windows else 1)
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
        schedule=schedule,
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
        patterns[name] = compiled(program, recipe, lattice, bits)
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
    shape = lattice.shape if windowed(program) else lattice.grid
    return make_codes(family, shape, count, dual="same", p=p, seed=seed).primal


def compiled(program: Program, recipe: Recipe, lattice: Lattice, bits: NDArray[np.bool_]) -> Pair:
    """Patterns of a program over its own lattice, coded ones under the goal's illumination."""
    own = lattice if windowed(program) else Lattice(lattice.grid)
    primal, dual = program.pairs(bits, own)
    # A pilot looks at the whole scene: it learns paths, not the picture.
    if recipe.goal.light is not None and windowed(program):
        primal = primal * extended(recipe.goal.light, own)
    return compact(primal), compact(dual)


def _white_slots(recipe: Recipe, patterns: dict[str, Pair], lattice: Lattice, slots: int) -> int:
    """Slots of a white shot: as the goal itself, all; beside a coded one, as many as gather about
    its light, which keeps the camera at one setting."""
    for name, program in recipe.programs.items():
        if windowed(program):
            slots = round(slots * mean_light(patterns[name], lattice.lattice_cells))
            break
    return max(1, slots)
