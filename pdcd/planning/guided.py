"""Plans that follow what is known of the scene: by a prior beforehand, by a pilot on the way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
from scipy import sparse

from pdcd.bench.tables import Config
from pdcd.codes.linked import prior_codes
from pdcd.codes.orders import is_order
from pdcd.errors import ConfigError
from pdcd.frames.lattice import Lattice
from pdcd.pilot.codes import MATCHED, SCOUTS
from pdcd.planning.make import compiled, make_plan
from pdcd.planning.plan import Plan, windowed
from pdcd.planning.prior import GivenPrior, load_prior
from pdcd.recipes.parts import coin_signs, part_seed
from pdcd.recipes.programs import Coded, Program, Signed, Under
from pdcd.request import CaptureRequest, PilotCost, PlanSummary


def plan_for(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    mask_lag_s: float | None = None,
) -> Plan:
    """Resolve a request that names its number of codes, and follow its prior.

    Raises
    ------
    ConfigError
        As `make_plan`, or the prior is unsound, comes with a pilot, or cannot guide these codes.
    """
    if request.pilot == SCOUTS:
        raise ConfigError(
            f"a pilot of {SCOUTS} codes finds nothing", hint=f"take one of {MATCHED}, or from 32"
        )
    plan = make_plan(request, config, grid, mask_lag_s)
    if request.prior is None:
        return plan
    if plan.pilot:
        raise ConfigError(
            "a prior and a pilot are both asked for",
            hint="give one: a pilot learns what a prior tells",
        )
    if not guidable(plan):
        raise ConfigError(
            f"a prior cannot guide the codes of goal {plan.recipe.goal.name}, family {plan.family}",
            hint="it guides hadamard codes of the goals indirect, direct, diagonal, split and "
            "short-range; leave out the prior",
        )
    return by_prior(plan, load_prior(request.prior, grid), request.seed)


def by_prior(plan: Plan, prior: GivenPrior, seed: int) -> Plan:
    """The same `guidable` plan with codes that keep cells apart which the prior links."""
    return replace(with_links(plan, prior.links, seed), prior=prior.name)


def guidable(plan: Plan) -> bool:
    """Whether a plan has Hadamard codes which pair each cell with itself, as links assume it."""
    coded = [p for p in plan.recipe.programs.values() if p.coded and p.p == 0.5]
    fits = bool(coded) and all(_own(program) for program in coded)
    return fits and plan.family == "hadamard"


def _own(program: Program) -> bool:
    if isinstance(program, Under):
        return _own(program.program)
    if isinstance(program, Signed):
        return all(partner is None for _, partner in program.taps)
    return isinstance(program, Coded) and program.partner is None


def scouted(plan: Plan, taken: int) -> bool:
    """Whether the scouts of a pilot, and no more, are among the first `taken` shots of a plan."""
    return plan.pilot > SCOUTS and taken == _position(plan, plan.recipe.stack[SCOUTS - 1]) + 1


def piloted(plan: Plan, taken: int) -> bool:
    """Whether a pilot is complete after the first `taken` shots, and has codes left to guide."""
    if plan.pilot <= SCOUTS or not plan.count:
        return False
    return taken == _position(plan, plan.recipe.stack[-1]) + 1


def stopped(plan: Plan, seed: int, limit_s: float) -> Plan:
    """The plan that is left of one with a pilot when that ends with its scouts.

    The codes of all further pilot photos go to the coded photo, as far as there is a Hadamard
    matrix and an exposure of `limit_s` holds them. Passes stay, and so does the time of all codes.
    """
    if plan.otherwise is not None:
        return plan.otherwise
    unspent = plan.recipe.stack[SCOUTS:]
    recipe = replace(
        plan.recipe,
        shots=tuple(shot for shot in plan.recipe.shots if shot.name not in unspent),
        stack=plan.recipe.stack[:SCOUTS],
    )
    primal, dual = plan.patterns["pilot"]
    short = replace(
        plan,
        recipe=recipe,
        patterns={**plan.patterns, "pilot": (primal[:SCOUTS], dual[:SCOUTS])},
        count=_stopped_count(plan, limit_s),
        pilot=SCOUTS,
    )
    cells = plan.grid[0] * plan.grid[1]
    return with_links(short, sparse.csr_array((cells, cells)), seed)


def summary(plan: Plan, limit_s: float) -> PlanSummary:
    """A plan in figures: what a pilot costs at most, and what if it ends with its scouts."""
    whole = plan.summary()
    if plan.pilot <= SCOUTS:
        return whole
    pilot_s = [plan.exposure_s(shot) for shot in plan.recipe.shots if shot.only is not None]
    if plan.otherwise is not None:
        stopped_codes, short = plan.otherwise.count, plan.otherwise.summary()
        stopped_files, stopped_s = short.raw_files, short.seconds
    else:
        stopped_codes = _stopped_count(plan, limit_s)
        more_s = (stopped_codes / plan.count - 1.0) * sum(
            plan.refreshes(shot) / plan.refresh_hz
            for shot in plan.recipe.shots
            if shot.kind == "coded"
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
    coded = next(shot for shot in plan.recipe.shots if shot.kind == "coded")
    codes_s = plan.refreshes(coded) / plan.refresh_hz
    around_s = plan.exposure_s(coded) - codes_s
    most = plan.count + plan.pilot - SCOUTS
    for count in range(most, plan.count, -1):
        fits = codes_s * count / plan.count + around_s <= limit_s
        if fits and count % plan.parts == 0 and is_order(count // plan.parts):
            return count
    return plan.count


def _position(plan: Plan, name: str) -> int:
    return next(i for i, shot in enumerate(plan.recipe.shots) if shot.name == name)


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
        if windowed(program) and program.p == 0.5:
            # The generator is the one that `make_codes` takes, so that no links give the usual
            # codes.
            own = part_seed(seed, plan.parts, part_of.get(name, 0))
            rng = np.random.Generator(np.random.PCG64(own))
            bits = prior_codes(shape, plan.count // plan.parts, onto @ links @ onto.T, rng)
            if part_of.get(name, 0):
                bits = coin_signs(bits, own)
            coded[name] = compiled(program, plan.recipe, lattice, bits)
    return replace(plan, patterns={**plan.patterns, **coded})
