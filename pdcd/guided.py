"""Plans that follow what is known of the scene: by a prior beforehand, by a pilot on the way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
from scipy import sparse

from pdcd.codes.orders import is_order
from pdcd.errors import ConfigError
from pdcd.pilot import SCOUTS
from pdcd.plan import Plan, with_links
from pdcd.programs import Coded, Program, Signed, Under
from pdcd.request import PilotCost, PlanSummary


def by_prior(plan: Plan, links: Any, seed: int) -> Plan:
    """The same plan, its codes keeping cells apart that a prior links: sparse (N, N), >= 0.

    Raises
    ------
    ConfigError
        The plan has a pilot, other codes than Hadamard's, or a goal whose codes no links can guide.
    """
    if plan.pilot:
        raise ConfigError(
            "a prior and a pilot are both asked for",
            hint="give one: a pilot learns what a prior tells",
        )
    if plan.family != "hadamard" or not guidable(plan):
        raise ConfigError(
            f"a prior cannot guide the {plan.family} codes of goal {plan.recipe.goal.name}",
            hint="it guides hadamard codes for indirect, direct, diagonal and short-range light; "
            "leave out the prior",
        )
    return with_links(plan, links, seed)


def guidable(plan: Plan) -> bool:
    """Whether all half-lit codes of a plan pair each cell with itself, as links assume it."""
    coded = [p for p in plan.recipe.programs.values() if p.coded and p.p == 0.5]
    return bool(coded) and all(_own(program) for program in coded)


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
    """Whether a pilot is complete after the first `taken` shots, and went on after its scouts."""
    return plan.pilot > SCOUTS and taken == _position(plan, plan.recipe.stack[-1]) + 1


def stopped(plan: Plan, seed: int, limit_s: float) -> Plan:
    """The plan that is left of one with a pilot when that ends with its scouts.

    The codes of all further pilot photos go to the coded photo, as far as there is a Hadamard
    matrix and an exposure of `limit_s` holds them. Passes stay, and so does the time of all codes.
    """
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
    count = _stopped_count(plan, limit_s)
    more_s = (count / plan.count - 1.0) * sum(
        plan.exposure_s(shot) - 2.0 * plan.settle_s
        for shot in plan.recipe.shots
        if shot.kind == "coded"
    )
    cost = PilotCost(
        raw_files=len(pilot_s),
        seconds=sum(pilot_s),
        scouts=SCOUTS,
        stopped_codes=count,
        stopped_raw_files=whole.raw_files - len(pilot_s) + SCOUTS,
        stopped_seconds=whole.seconds - sum(pilot_s[SCOUTS:]) + more_s,
    )
    return msgspec.structs.replace(whole, pilot_cost=cost)


def _stopped_count(plan: Plan, limit_s: float) -> int:
    """Codes of the coded photo when a pilot ends with its scouts."""
    coded = next(shot for shot in plan.recipe.shots if shot.kind == "coded")
    per_code_s = (plan.exposure_s(coded) - 2.0 * plan.settle_s) / plan.count
    most = plan.count + plan.pilot - SCOUTS
    for count in range(most, plan.count, -1):
        fits = count * per_code_s + 2.0 * plan.settle_s <= limit_s
        if fits and count % plan.parts == 0 and is_order(count // plan.parts):
            return count
    return plan.count


def _position(plan: Plan, name: str) -> int:
    return next(i for i, shot in enumerate(plan.recipe.shots) if shot.name == name)
