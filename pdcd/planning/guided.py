"""Plans that follow what is known of the scene: by a prior beforehand, by a pilot on the way."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import scipy

from pdcd.bench.tables import Config
from pdcd.codes.orders import is_order
from pdcd.codes.pilot.codes import MATCHED, SCOUTS
from pdcd.codes.pilot.links import SHARP
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.planning.make import make_plan
from pdcd.planning.memory import check_memory, memory_bytes
from pdcd.planning.pairs import linked_pairs
from pdcd.planning.plan import Plan
from pdcd.planning.prior import GivenPrior, load_prior
from pdcd.protocol.request import CaptureRequest, PilotCost, PlanSummary
from pdcd.recipes.arrays import NOTHING, Given
from pdcd.recipes.make import recipe_of
from pdcd.recipes.programs import Coded, Program, Signed, within
from pdcd.watch import Watch


def plan_for(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None = None,
    given: Given = NOTHING,
    watch: Watch | None = None,
) -> Plan:
    """Resolve a request that names its number of codes, and follow its prior.

    A `watch` is told how far it is, and may end the work.

    Raises
    ------
    RequestError
        As `make_plan`, or the prior is unsound, comes with a pilot, or cannot guide these codes.
    """
    if request.pilot == SCOUTS:
        raise RequestError(
            f"a pilot of {SCOUTS} codes finds nothing", hint=f"take one of {MATCHED}, or from 32"
        )
    plan = make_plan(request, config, grid, mask_lag_s, given, watch)
    if request.prior is None:
        return plan
    if plan.how.pilot:
        raise RequestError(
            "a prior and a pilot are both asked for",
            hint="give one: a pilot learns what a prior tells",
        )
    if not guidable(plan):
        raise RequestError(
            f"a prior cannot guide the codes of goal {request.goal}, family {plan.family}",
            hint="it guides hadamard codes of the goals indirect, direct, diagonal, split and "
            "short-range; leave out the prior",
        )
    return by_prior(plan, load_prior(request.prior, grid, given), request.seed)


def with_links(
    plan: Plan, links: scipy.sparse.csr_array, seed: int, watch: Watch | None = None
) -> Plan:
    """The same plan with Hadamard codes that keep linked cells (sparse (N, N)) apart; a `watch` may
    end the work."""
    return replace(plan, patterns={**plan.patterns, **linked_pairs(plan, links, seed, watch)})


def by_prior(plan: Plan, prior: GivenPrior, seed: int) -> Plan:
    """The same `guidable` plan with codes that keep cells apart which the prior links."""
    return replace(with_links(plan, prior.links, seed), prior=prior.name)


def guidable(plan: Plan) -> bool:
    """Whether a plan has Hadamard codes which pair each cell with itself, as links assume it."""
    coded = [p for p in plan.recipe.programs.values() if p.coded and p.p == 0.5]
    fits = bool(coded) and all(_own(program) for program in coded)
    return fits and plan.family == "hadamard"


def _own(program: Program) -> bool:
    program = within(program)
    if isinstance(program, Signed):
        return all(partner is None for _, partner in program.taps)
    return isinstance(program, Coded) and program.partner is None


def scouted(plan: Plan, taken: int) -> bool:
    """Whether the scouts of a pilot, and no more, are among the first `taken` shots of a plan."""
    return plan.how.pilot > SCOUTS and taken == _position(plan, plan.recipe.stack[SCOUTS - 1]) + 1


def piloted(plan: Plan, taken: int) -> bool:
    """Whether a pilot is complete after the first `taken` shots, and has codes left to guide."""
    if plan.how.pilot <= SCOUTS or not plan.how.coded:
        return False
    return taken == _position(plan, plan.recipe.stack[-1]) + 1


def stopped(plan: Plan, seed: int, limit_s: float) -> Plan:
    """The plan that is left of one with a pilot when that ends with its scouts.

    The codes of all further pilot photos go to the coded photo, as far as there is a Hadamard
    matrix and an exposure of `limit_s` holds them. Passes stay, and so does the time of all codes;
    exact sequences stay as they may have been shown.
    """
    exact = {
        shot.program: plan.passes_of(shot)
        for shot in plan.recipe.shots
        if not shot.white and not plan.recipe.programs[shot.program].coded
    }
    if plan.otherwise is not None:
        return replace(plan.otherwise, iso=plan.iso, exact_passes=exact)
    how = msgspec.structs.replace(
        plan.how, codes=SCOUTS + _stopped_count(plan, limit_s), pilot=SCOUTS
    )
    primal, dual = plan.patterns["pilot"]
    short = replace(
        plan,
        recipe=recipe_of(plan.recipe.target, how),
        how=how,
        exact_passes=exact,
        patterns={**plan.patterns, "pilot": (primal[:SCOUTS], dual[:SCOUTS])},
    )
    cells = plan.grid[0] * plan.grid[1]
    return with_links(short, scipy.sparse.csr_array((cells, cells)), seed)


def resumed(full: Plan, ended: Plan, config: Config, sharpness: float) -> Plan:
    """The plan of a pilot that goes on after all, once ambient light is known.

    full : as it was before its scouts ended it. ended : what became of it, with its black
    exposures, and what dark photos told. Codes that were shown since count no more. Raises
    RequestError where it would take too much memory.
    """
    how = msgspec.structs.replace(full.how, black_level=ended.how.black_level, late=True)
    recipe = recipe_of(full.recipe.target, how)
    lattice, family = Lattice(full.grid, full.window), how.family or config.schedule.family
    bytes_ = memory_bytes(recipe, how, family, lattice, full.passes, config)
    check_memory(bytes_, config, full.grid)
    text = (
        "pilot: it goes on, as ambient light had hidden sharp light (sharpness "
        f"{sharpness:.2g} without it, limit {SHARP:g}); codes that were shown before count no more"
    )
    return replace(
        full,
        recipe=recipe,
        how=how,
        white_slots=ended.white_slots,
        iso=ended.iso,
        memory_bytes=bytes_,
        look=None,
        leaks=ended.leaks,
        dark=ended.dark,
        otherwise=None,
        reasons=(*ended.reasons, text),
    )


def summary(plan: Plan, limit_s: float) -> PlanSummary:
    """A plan in figures: what a pilot costs at most, and what if it ends with its scouts."""
    whole = plan.summary()
    if plan.how.pilot <= SCOUTS:
        return whole
    pilot_s = [plan.exposure_s(shot) for shot in plan.recipe.shots if shot.only is not None]
    if plan.otherwise is not None:
        stopped_codes, short = plan.otherwise.how.coded, plan.otherwise.summary()
        stopped_files, stopped_s = short.raw_files, short.seconds
    else:
        stopped_codes = _stopped_count(plan, limit_s)
        more_s = (stopped_codes / plan.how.coded - 1.0) * sum(
            plan.refreshes(shot) / plan.row_hz
            for shot in plan.recipe.shots
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


def _stopped_count(plan: Plan, limit_s: float) -> int:
    """Codes of the coded photo when a pilot ends with its scouts."""
    coded = next(shot for shot in plan.recipe.shots if shot.kind in ("coded", "far"))
    codes_s = plan.refreshes(coded) / plan.row_hz
    around_s = plan.exposure_s(coded) - codes_s
    most = plan.how.coded + plan.how.pilot - SCOUTS
    for count in range(most, plan.how.coded, -1):
        fits = codes_s * count / plan.how.coded + around_s <= limit_s
        if fits and count % plan.how.parts == 0 and is_order(count // plan.how.parts):
            return count
    return plan.how.coded


def _position(plan: Plan, name: str) -> int:
    return next(i for i, shot in enumerate(plan.recipe.shots) if shot.name == name)
