"""Request + rig -> a plan: what a request leaves open, resolved against the configuration."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from pdcd.bench.grey import curves_of
from pdcd.bench.tables import Config
from pdcd.codes.pilot.codes import MATCHED, SCOUTS
from pdcd.errors import ConfigError, RequestError
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import check_binary
from pdcd.panels.schedule import slot_rows
from pdcd.planning.brightness import as_bright
from pdcd.planning.far import grey_masks, mask_reasons
from pdcd.planning.grey import grey_reasons, unsaid
from pdcd.planning.guards import choose_schedule, lag_rows
from pdcd.planning.look import looking, settled
from pdcd.planning.measured import (
    FAR_QUIET,
    QUIET,
    plane_reasons,
    quietest,
    reasons_for,
    times_measured,
    wandered_reasons,
    window_for,
)
from pdcd.planning.memory import check_memory, memory_bytes
from pdcd.planning.off_axis import depth_reasons, on_bench
from pdcd.planning.pairs import pairs_of, settled_family, white_slots
from pdcd.planning.plan import Plan, shows_codes, windowed
from pdcd.protocol.plan_summary import How
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import NOTHING, Given, target_of
from pdcd.recipes.isolation import FAMILIES as ISOLATION
from pdcd.recipes.isolation import check_isolation
from pdcd.recipes.make import draft_of, finished
from pdcd.recipes.parts import check_parts, part_codes
from pdcd.recipes.recipe import Recipe
from pdcd.watch import Watch
from pdcd.words import BlackLevel, FamilyName, ScheduleName

RANGES = ("long-range", "short-range")
"""Goals of light by its range."""
FAR = ("relit", *RANGES)
"""Goals that may take photos of far light."""


class ExposureLimitError(RequestError):
    """An exposure would be longer than the rig allows."""


def make_plan(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None = None,
    given: Given = NOTHING,
    watch: Watch | None = None,
    *,
    compared: bool = False,
) -> Plan:
    """Resolve a request against the configuration.

    `mask_lag_s` is the lag of the mask that the display measured; None where it is not known.
    `given` holds the request's arrays. A `watch` is told how many programs have their codes, and
    may end the work. Of plans that are `compared` with many others codes are made in short time
    (`How.woven`). Raises RequestError when the request contradicts itself, the rig, or the limits.
    """
    request = on_bench(request, config)
    blacks = settled(request, config)
    how = _how(request, config, blacks.level, compared=compared)
    draft = draft_of(target_of(request, given, grid), how)
    smoothable = _smoothable(draft, request)
    lattice = Lattice(grid, window_of(request, config, grid))
    schedule = schedule_of(request, config, mask_lag_s)
    family = settled_family(request.family, config.schedule.family, draft, how)
    _check_family(family, how, draft)
    coded = any(program.coded for program in draft.programs.values())
    known = family if coded or family in ISOLATION else None
    how = msgspec.structs.replace(how, family=known)
    recipe = finished(draft, how)
    slot_s = slot_rows(schedule) / config.row_hz
    check_isolation(recipe, slot_s=slot_s, limit_s=config.limits.max_exposure_s)
    passes = _passes(request, config, recipe, how, lattice, slot_s)
    needed = memory_bytes(recipe, how, family, lattice, passes, config)
    check_memory(needed, config, grid)
    curves = curves_of(config)
    patterns = pairs_of(
        recipe,
        how,
        family,
        lattice,
        p=request.p,
        seed=request.seed,
        watch=watch or Watch(),
        curves=curves,
        passes=passes,
    )
    if config.display.planes_per_refresh > 1:
        for pair in patterns.values():
            check_binary(*pair)
    slots = (part_codes(how.coded, how.parts) or how.codes) * passes
    # Far light has no Hadamard codes; balanced ones stand in for them.
    far = draft.coded is None and family == "balanced" and request.family is None
    usual = family == "hadamard" or far
    plan = Plan(
        recipe=recipe,
        how=how,
        patterns=patterns,
        p=next((p.p for p in recipe.programs.values() if shows_codes(p)), 0.5),
        window=lattice.window,
        schedule=schedule,
        passes=passes,
        white_slots=white_slots(recipe, patterns, lattice, slots, curves),
        row_hz=config.row_hz,
        settle_s=config.rig.settle_s,
        delay_s=abs(config.mask_delay_rows) / config.row_hz,
        iso=config.camera.iso,
        memory_bytes=needed,
        reasons=(
            *_brightness(request, how),
            *reasons_for(config, grid, lattice.window, schedule, mask_lag_s),
            *plane_reasons(config),
            *wandered_reasons(recipe, lattice.window),
            *grey_reasons(patterns.values(), config),
            *mask_reasons(recipe, how, request, config, lattice),
            *depth_reasons(recipe, part_codes(how.coded, how.parts), lattice.window),
        ),
        curves=curves,
        smooth=smoothable and (usual if request.smooth is None else request.smooth),
    )
    _check_limit(max(plan.exposure_s(s) for s in recipe.shots), config)
    plan = looking(plan, blacks.look)
    if how.coded:
        return plan
    scouts_first = msgspec.structs.replace(request, pilot=SCOUTS)
    otherwise = make_plan(scouts_first, config, grid, mask_lag_s, given, watch)
    return replace(plan, otherwise=otherwise)


def _how(
    request: CaptureRequest, config: Config, black_level: BlackLevel, *, compared: bool
) -> How:
    """How to photograph, before the family is settled; `compared` as of `make_plan`. Raises
    RequestError."""
    total = config.schedule.codes if request.codes is None else request.codes
    if request.equal_brightness:
        total = as_bright(total, request)
    parts, grey = check_parts(request), _grey_masks(request, config)
    # Parts would err alike; and many plans that are compared would take minutes.
    woven = grey and parts == 1 and not compared and not unsaid(config.projector, config)
    how = How(
        codes=total,
        pilot=request.pilot if isinstance(request.pilot, int) else 0,
        parts=parts,
        repeat=request.repeat,
        method=request.method,
        family=None,
        black_level=black_level,
        white=request.white,
        buckets=config.camera.buckets if request.method == "pairs" else 1,
        grey_masks=grey,
        woven=woven,
    )
    if how.coded < 0 or (how.coded == 0 and how.pilot not in MATCHED):
        raise RequestError(
            f"a pilot of {how.pilot} leaves none of {total} codes",
            hint="the pilot's codes are counted among all: ask for more codes or a smaller pilot",
        )
    part_codes(how.coded, how.parts)
    return how


def _grey_masks(request: CaptureRequest, config: Config) -> bool:
    """Whether masks of far light may have grey levels. Raises RequestError."""
    if request.grey_masks is not None and request.goal not in FAR:
        raise RequestError(
            f"goal {request.goal} takes no photo of far light, which grey masks are for",
            hint="leave out grey_masks",
        )
    return request.goal in FAR and grey_masks(request, config)


def _brightness(request: CaptureRequest, how: How) -> tuple[str, ...]:
    """Why there are that many codes."""
    if not request.equal_brightness or request.p is None:
        return ()
    lit = f"{request.p * how.codes:g}"
    return (
        f"{how.codes} codes: matched cells are lit in {lit} of them, as they would be at p = 1/2",
    )


def _smoothable(draft: Recipe, request: CaptureRequest) -> bool:
    """Whether there is a photo whose smooth light can be corrected. Raises RequestError."""
    found = draft.coded is not None and draft.coded.wanted.uniform == (0.0, 1.0)
    found = found or any(photo.beyond for photo in draft.photos)
    if request.smooth and not found:
        raise RequestError(
            f"goal {request.goal} takes no photo of indirect light under full light to smooth",
            hint="leave out smooth",
        )
    return found


def window_of(request: CaptureRequest, config: Config, grid: tuple[int, int]) -> str:
    """Part of a mask cell that opens. Raises ConfigError for cells that the panels cannot show."""
    width_px, height_px = config.projector.size_px
    cell_px = min(height_px / grid[0], width_px / grid[1])
    if cell_px < 1.0:
        raise ConfigError(
            f"a grid of {grid[0]} x {grid[1]} cells is finer than the projector's pixels",
            device="projector",
            hint="use a coarser scene grid",
        )
    asked = request.window or config.schedule.window
    return window_for(asked, config, grid)


def schedule_of(request: CaptureRequest, config: Config, mask_lag_s: float | None) -> ScheduleName:
    """Refreshes of a code, as asked for or as the rig has them."""
    asked = config.schedule.guards if request.guards is None else request.guards
    if asked == "auto" and times_measured(config):
        return quietest(config, mask_lag_s, FAR_QUIET if request.goal in RANGES else QUIET)
    return choose_schedule(asked, *lag_rows(config, mask_lag_s))


def _check_family(family: FamilyName, how: How, draft: Recipe) -> None:
    """Refuse what a family of codes cannot do."""
    if how.pilot and family != "hadamard" and draft.coded is not None:  # far light needs none
        raise RequestError(f"a pilot cannot guide {family} codes", hint="take the family hadamard")
    if family in ISOLATION and how.method != "coded":
        raise RequestError(
            f"method {how.method} does not isolate paths", hint="take the family hadamard"
        )
    if family in ISOLATION and draft.target.goal.name == "transport":
        raise RequestError(
            f"a slice of T is taken in photos of its own patterns, not by {family}",
            hint="leave out the family",
        )
    if family in ISOLATION and how.parts > 1:
        raise RequestError(f"{family} has no codes to split", hint="leave out the parts")
    if how.repeat > 1 and (how.parts > 1 or how.method != "coded" or draft.sums):
        raise RequestError(
            "only a coded photo in one piece can be repeated", hint="leave out repeat, or the parts"
        )


def _passes(
    request: CaptureRequest,
    config: Config,
    recipe: Recipe,
    how: How,
    lattice: Lattice,
    slot_s: float,
) -> int:
    """Whole passes over the codes that fit into the exposure asked for; one where none was.

    Refuses one pass that is too long before the codes are made: a million of them would only be
    made to be refused.
    """
    programs = recipe.programs.values()
    in_windows = any(windowed(program) for program in programs)
    shown = how.coded or how.codes  # a pilot of all codes leaves none, and shows them itself
    one_pass_s = shown * slot_s * (lattice.fields if in_windows else 1)
    if any(program.coded for program in programs):
        _check_limit(one_pass_s / max(how.parts, shown if recipe.stack else 1), config)
    if request.exposure_s is None:
        return 1
    passes = int(request.exposure_s / one_pass_s + 1e-9)
    if passes < 1:
        raise RequestError(
            f"an exposure of {request.exposure_s:g} s is shorter than one pass over "
            f"{shown} codes ({one_pass_s:.3g} s)",
            hint="ask for fewer codes or a longer exposure",
        )
    return passes


def _check_limit(exposure_s: float, config: Config) -> None:
    """Refuse exposures that the rig's limits do not allow."""
    if exposure_s > config.limits.max_exposure_s:
        raise ExposureLimitError(
            f"the plan needs an exposure of {exposure_s:.1f} s; the limit is "
            f"{config.limits.max_exposure_s:g} s",
            hint="ask for fewer codes, or raise limits.max_exposure_s",
        )
