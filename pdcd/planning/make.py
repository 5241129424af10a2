"""From a request and a rig to a plan, in one pass: defaults, decisions, codes.

A plan is made once, and again only after photos were evaluated (`pdcd.planning.guided`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import msgspec

from pdcd.bench.devices import CameraInfo
from pdcd.bench.grey import curves_of
from pdcd.bench.tables import Config
from pdcd.codes.pilot.codes import MATCHED, SCOUTS
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import check_binary
from pdcd.planning.bench_fit import (
    add_bench_plane,
    explain_bench_fit,
    explain_bit_planes,
    explain_depth_codes,
    explain_wandering_light,
    resolve_window,
)
from pdcd.planning.defaults import can_average, resolve_defaults
from pdcd.planning.grey import (
    can_use_grey_masks,
    explain_grey_levels,
    explain_long_range_masks,
)
from pdcd.planning.guided import can_be_guided, follow_prior
from pdcd.planning.look import resolve_black_level, with_leak_probe
from pdcd.planning.memory import check_memory
from pdcd.planning.own_codes import OwnCodes, count_own_codes, fit_own_codes
from pdcd.planning.pairs import count_white_slots, make_pattern_pairs, resolve_family
from pdcd.planning.plan import LeakProbe, PatternPair, Plan, has_code_mask, is_windowed
from pdcd.planning.schedule_fit import RANGES, resolve_slot
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import NO_ARRAYS, Given, read_target
from pdcd.recipes.isolation import ISOLATION_FAMILIES as ISOLATION
from pdcd.recipes.isolation import check_isolation
from pdcd.recipes.make import finish_recipe, make_draft_recipe
from pdcd.recipes.parts import check_parts, count_part_codes
from pdcd.recipes.recipe import Recipe
from pdcd.watch import Watch
from pdcd.words import BlackLevel, ScheduleName, ShownFamilyName

_FAR = ("relit", *RANGES)
"""Goals that may take photos of far light."""


class ExposureLimitError(RequestError):
    """An exposure would be longer than the rig allows."""


@dataclass(frozen=True)
class _Decisions:
    """All that is decided of a plan before its codes are made.

    recipe, how : what is photographed, and how. family : set also for a recipe without codes. own :
    codes that came with the request. smooth : whether smooth light is to be corrected. look : a
    dark photo to take; None where black exposures are settled.
    """

    request: CaptureRequest
    recipe: Recipe
    how: CaptureScheme
    family: ShownFamilyName
    own: OwnCodes | None
    lattice: Lattice
    schedule: ScheduleName
    dark_s: float
    passes: int
    smooth: bool
    look: LeakProbe | None


def plan_request(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    camera: CameraInfo | None,
    mask_lag_s: float | None,
    given: Given = NO_ARRAYS,
    watch: Watch | None = None,
) -> Plan:
    """The plan of a request that names no error and no time: what it leaves open is resolved, and
    everything is planned in one pass.

    `camera` is None where it is not known yet. If nobody asked for a pilot but there is one, the
    plan assumes that it goes on; its `otherwise` is for scouts that show no sharp paths. Raises
    RequestError as `plan_with_prior`.
    """
    request = count_own_codes(request, given)
    found = resolve_defaults(request, config, grid, camera, mask_lag_s)
    average, unasked = can_average(request, config), found.otherwise is not None
    plan = plan_with_prior(found.request, config, grid, mask_lag_s, given, watch, average=average)
    plan = replace(plan, unasked=unasked, reasons=(*plan.reasons, *found.reasons))
    if found.otherwise is None:
        return plan
    other = make_plan(found.otherwise, config, grid, mask_lag_s, given, watch, average=average)
    other = replace(other, unasked=unasked, reasons=(*other.reasons, *found.reasons))
    return replace(plan, otherwise=other)


def plan_with_prior(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None = None,
    given: Given = NO_ARRAYS,
    watch: Watch | None = None,
    *,
    average: bool = False,
) -> Plan:
    """Plan a request that names its number of codes, and follow its prior; `average` and `watch`
    are those of `make_plan`.

    Raises
    ------
    RequestError
        As `make_plan`, or the prior is unsound, comes with a pilot, or cannot guide these codes.
    """
    if request.pilot == SCOUTS:
        raise RequestError(
            f"a pilot of {SCOUTS} codes finds nothing", hint=f"take one of {MATCHED}, or from 32"
        )
    plan = make_plan(request, config, grid, mask_lag_s, given, watch, average=average)
    if request.prior is None:
        return plan
    if plan.how.pilot:
        raise RequestError(
            "a prior and a pilot are both asked for",
            hint="give one: a pilot learns what a prior tells",
        )
    if not can_be_guided(plan):
        raise RequestError(
            f"a prior cannot guide the codes of goal {request.goal}, family {plan.family}",
            hint="it guides hadamard codes of the goals indirect, direct, diagonal, split and "
            "short-range; leave out the prior",
        )
    from pdcd.planning.prior import load_prior  # few requests have one

    return follow_prior(plan, load_prior(request.prior, grid, given), request.seed)


def make_plan(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None = None,
    given: Given = NO_ARRAYS,
    watch: Watch | None = None,
    *,
    average: bool = False,
) -> Plan:
    """Plan a request that leaves nothing open but what the configuration settles.

    `mask_lag_s` is the lag of the mask that the display measured; None where it is not known.
    `given` holds the request's arrays. A `watch` gets the number of programs that have their codes,
    and may end the work. `average` : whether everything may be shown more often against the noise
    of ambient light. Raises RequestError when the request contradicts itself, the rig, or the
    limits.
    """
    decided = _decide(request, config, grid, mask_lag_s, given, average=average)
    plan = _with_codes(decided, config, mask_lag_s, watch or Watch())
    if plan.how.coded:
        return plan
    scouts_first = msgspec.structs.replace(decided.request, pilot=SCOUTS)
    otherwise = make_plan(scouts_first, config, grid, mask_lag_s, given, watch)
    return replace(plan, otherwise=otherwise)


def _decide(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None,
    given: Given,
    *,
    average: bool = False,
) -> _Decisions:
    """Resolve a request against the configuration; no codes are made. Arguments and errors as of
    `make_plan`."""
    request = add_bench_plane(request, config)
    blacks = resolve_black_level(request, config, average=average)
    how = _how(request, config, blacks.level)
    draft = make_draft_recipe(read_target(request, given, grid), how)
    smoothable = _smoothable(draft, request)
    lattice = Lattice(grid, resolve_window(request, config, grid))
    slot = resolve_slot(request, config, mask_lag_s)
    own = fit_own_codes(given, lattice, draft)
    family: ShownFamilyName = "given"
    if own is None:
        family = resolve_family(request.family, config.schedule.family, draft, how)
    _check_family(family, how, draft)
    coded = any(program.coded for program in draft.programs.values())
    known = family if coded or family in ISOLATION else None
    how = msgspec.structs.replace(how, family=known)
    recipe = finish_recipe(draft, how)
    check_isolation(recipe, slot_s=slot.slot_s, limit_s=config.limits.max_exposure_s)
    passes = _passes(request, config, recipe, how, lattice, slot.slot_s)
    check_memory(recipe, how, config)
    # Far light has no Hadamard codes; balanced ones replace them.
    far = draft.coded is None and family == "balanced" and request.family is None
    usual = family == "hadamard" or far
    return _Decisions(
        request=request,
        recipe=recipe,
        how=how,
        family=family,
        own=own,
        lattice=lattice,
        schedule=slot.schedule,
        dark_s=slot.dark_s,
        passes=passes,
        smooth=smoothable and (usual if request.smooth is None else request.smooth),
        look=blacks.look,
    )


def _with_codes(
    decided: _Decisions, config: Config, mask_lag_s: float | None, watch: Watch
) -> Plan:
    """The plan with its codes made. Raises RequestError for exposures that last too long."""
    request, recipe, how = decided.request, decided.recipe, decided.how
    lattice, passes, curves = decided.lattice, decided.passes, curves_of(config)
    patterns = make_pattern_pairs(
        recipe,
        how,
        decided.family,
        lattice,
        p=request.p,
        seed=request.seed,
        watch=watch,
        curves=curves,
        passes=passes,
        own=decided.own,
    )
    if config.display.planes_per_refresh > 1:
        for pair in patterns.values():
            check_binary(*pair)
    slots = (count_part_codes(how.coded, how.parts) or how.codes) * passes
    row_s = 1.0 / config.row_hz + decided.dark_s
    plan = Plan(
        recipe=recipe,
        how=how,
        patterns=patterns,
        p=_share_lit(decided),
        window=lattice.window,
        schedule=decided.schedule,
        passes=passes,
        white_slots=count_white_slots(recipe, patterns, lattice, slots, curves),
        row_hz=config.row_hz,
        settle_s=config.rig.settle_s,
        delay_s=abs(config.mask_delay_rows) * row_s,
        dark_s=decided.dark_s,
        iso=config.camera.iso,
        reasons=tuple(_reasons(decided, patterns, config, mask_lag_s)),
        curves=curves,
        smooth=decided.smooth,
    )
    _check_limit(max(plan.exposure_s(s) for s in recipe.shots), config)
    return with_leak_probe(plan, decided.look)


def _reasons(
    decided: _Decisions, patterns: dict[str, PatternPair], config: Config, mask_lag_s: float | None
) -> Iterator[str]:
    """Why cells, window, schedule and codes are what they are, a line each."""
    request, recipe, how, lattice = decided.request, decided.recipe, decided.how, decided.lattice
    yield from _brightness(request, how)
    if decided.own is not None:
        yield from decided.own.explain(recipe, lattice)
    yield from explain_bench_fit(config, lattice.grid, lattice.window, decided.schedule, mask_lag_s)
    if decided.dark_s > 0.0:
        late = "at an unknown time" if mask_lag_s is None else f"{1e6 * mask_lag_s:.3g} us later"
        yield f"dark time: {1e6 * decided.dark_s:.3g} us after each code; the mask follows {late}"
    yield from explain_bit_planes(config)
    yield from explain_wandering_light(recipe, lattice.window)
    yield from explain_grey_levels(patterns.values(), config)
    yield from explain_long_range_masks(recipe, request, config, lattice)
    yield from explain_depth_codes(recipe, count_part_codes(how.coded, how.parts), lattice.window)


def _share_lit(decided: _Decisions) -> float:
    """Share of codes in which a cell is lit."""
    if decided.own is not None:
        return float(decided.own.primal.mean())
    programs = decided.recipe.programs.values()
    return next((p.p for p in programs if has_code_mask(p)), 0.5)


def _how(request: CaptureRequest, config: Config, black_level: BlackLevel) -> CaptureScheme:
    """How to photograph, before the family is settled. Raises RequestError."""
    total = config.schedule.codes if request.codes is None else request.codes
    if request.equal_brightness:
        from pdcd.planning.code_counts import scale_code_count  # few requests ask for it

        total = scale_code_count(total, request)
    how = CaptureScheme(
        codes=total,
        pilot=request.pilot if isinstance(request.pilot, int) else 0,
        parts=check_parts(request),
        repeat=request.repeat,
        method=request.method,
        family=None,
        black_level=black_level,
        white=request.white,
        buckets=config.camera.buckets if request.method == "pairs" else 1,
        grey_masks=_grey_masks(request, config),
    )
    if how.coded < 0 or (how.coded == 0 and how.pilot not in MATCHED):
        raise RequestError(
            f"a pilot of {how.pilot} leaves none of {total} codes",
            hint="the pilot's codes are counted among all: ask for more codes or a smaller pilot",
        )
    count_part_codes(how.coded, how.parts)
    return how


def _grey_masks(request: CaptureRequest, config: Config) -> bool:
    """Whether masks of far light may have grey levels. Raises RequestError."""
    if request.grey_masks is not None and request.goal not in _FAR:
        raise RequestError(
            f"goal {request.goal} takes no photo of far light, which grey masks are for",
            hint="leave out grey_masks",
        )
    return request.goal in _FAR and can_use_grey_masks(request, config)


def _brightness(request: CaptureRequest, how: CaptureScheme) -> tuple[str, ...]:
    """Why there are so many codes."""
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


def _check_family(family: ShownFamilyName, how: CaptureScheme, draft: Recipe) -> None:
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
    how: CaptureScheme,
    lattice: Lattice,
    slot_s: float,
) -> int:
    """Whole passes over the codes that fit into the exposure asked for; one where none was.

    If a single pass is too long the request is refused here, before codes are made in vain.
    """
    programs = recipe.programs.values()
    in_windows = any(is_windowed(program) for program in programs)
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
