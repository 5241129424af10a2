"""Plans that follow what is known of the scene: from a prior beforehand, or from a pilot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import msgspec
import scipy

from pdcd.bench.tables import Config
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.codes.pilot.links import SHARP
from pdcd.pictures.learn import PilotFindings
from pdcd.planning.memory import check_memory
from pdcd.planning.pairs import make_linked_pairs
from pdcd.planning.plan import Plan
from pdcd.recipes.make import make_recipe
from pdcd.recipes.programs import CodedProgram, Program, SignedProgram, find_inner_program
from pdcd.runs.record import ShotRecord
from pdcd.watch import Watch

if TYPE_CHECKING:
    from pdcd.planning.prior import GivenPrior


def with_links(
    plan: Plan, links: scipy.sparse.csr_array, seed: int, watch: Watch | None = None
) -> Plan:
    """The same plan with Hadamard codes that keep linked cells (sparse (N, N)) apart; a `watch` may
    end the work."""
    return replace(plan, patterns={**plan.patterns, **make_linked_pairs(plan, links, seed, watch)})


def follow_prior(plan: Plan, prior: GivenPrior, seed: int) -> Plan:
    """A `can_be_guided` plan with codes that keep cells apart which the prior links."""
    return replace(with_links(plan, prior.links, seed), prior=prior.name)


def can_be_guided(plan: Plan) -> bool:
    """Whether a plan has Hadamard codes that pair each cell with itself, as links assume."""
    coded = [p for p in plan.recipe.programs.values() if p.coded and p.p == 0.5]
    fits = bool(coded) and all(_own(program) for program in coded)
    return fits and plan.family == "hadamard"


def _own(program: Program) -> bool:
    program = find_inner_program(program)
    if isinstance(program, SignedProgram):
        return all(partner is None for _, partner in program.taps)
    return isinstance(program, CodedProgram) and program.partner is None


@dataclass(frozen=True)
class PilotOutcome:
    """What becomes of a plan once the photos of its pilot were evaluated.

    outcome : "stopped" where its scouts show no sharp paths, and the rest of its codes go to the
        coded photo; "guided" where the codes that follow keep linked cells apart; "no use" where
        they cannot. told : the decision and its cost in words, where nobody asked for the pilot.
    """

    plan: Plan
    outcome: Literal["stopped", "guided", "no use"]
    told: str


def decide_after_pilot(
    plan: Plan,
    learned: PilotFindings,
    shots: Sequence[ShotRecord],
    *,
    scouts: bool,
    seed: int,
    limit_s: float,
    watch: Watch,
) -> PilotOutcome | None:
    """The plan to go on with after a pilot, or its `scouts` alone, was evaluated; None where the
    scouts say that the plan is to go on as it is.

    shots : all that were taken. limit_s : the longest exposure of the rig.
    """
    if scouts and learned.promising:
        return None
    outcome: Literal["stopped", "guided", "no use"]
    unasked = plan.unasked
    if scouts:
        plan, outcome = end_pilot(plan, seed, limit_s), "stopped"
    elif learned.pays:
        plan, outcome = with_links(plan, learned.links, seed, watch), "guided"
    else:
        outcome = "no use"
    if not unasked:
        return PilotOutcome(plan, outcome, "")
    told = _pilot_words(plan, learned, shots)
    return PilotOutcome(replace(plan, reasons=(*plan.reasons, f"pilot: {told}")), outcome, told)


def end_pilot(plan: Plan, seed: int, limit_s: float) -> Plan:
    """The plan that is left of one with a pilot when that ends with its scouts.

    The codes of all further pilot photos go to the coded photo, as far as there is a Hadamard
    matrix and an exposure of `limit_s` holds them. Passes stay the same, and so does the time of
    all codes. Exact sequences stay the same, as they may have been shown.
    """
    exact = {
        shot.program: plan.passes_of(shot)
        for shot in plan.recipe.shots
        if not shot.white and not plan.recipe.programs[shot.program].coded
    }
    if plan.otherwise is not None:
        return replace(plan.otherwise, iso=plan.iso, exact_passes=exact)
    how = msgspec.structs.replace(
        plan.how, codes=SCOUTS + plan.codes_without_pilot(limit_s), pilot=SCOUTS
    )
    primal, dual = plan.patterns["pilot"]
    short = replace(
        plan,
        recipe=make_recipe(plan.recipe.target, how),
        how=how,
        exact_passes=exact,
        patterns={**plan.patterns, "pilot": (primal[:SCOUTS], dual[:SCOUTS])},
    )
    cells = plan.grid[0] * plan.grid[1]
    return with_links(short, scipy.sparse.csr_array((cells, cells)), seed)


def resume_pilot(full: Plan, ended: Plan, config: Config, sharpness: float) -> Plan:
    """The plan of a pilot that goes on after all, once ambient light is known.

    full : the plan before its scouts ended the pilot. ended : the plan after that, with its black
    exposures, and what dark photos showed. Codes that were shown since no longer count. Raises
    RequestError where it would take too much memory.
    """
    how = msgspec.structs.replace(full.how, black_level=ended.how.black_level, late=True)
    recipe = make_recipe(full.recipe.target, how)
    check_memory(recipe, how, config)
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
        look=None,
        leaks=ended.leaks,
        dark=ended.dark,
        otherwise=None,
        reasons=(*ended.reasons, text),
    )


def _pilot_words(plan: Plan, learned: PilotFindings, shots: Sequence[ShotRecord]) -> str:
    """What a pilot that nobody asked for found, what follows, and what it cost, in words."""
    single = [s for s in shots if s.name in plan.recipe.stack]
    cost_s = sum(s.open_s for s in single)
    light = f"sharpness {learned.sharpness:.2g}, limit {SHARP:g}"
    if not learned.promising:
        found = f"no mirrors ({light})"
    elif learned.pays:
        kept = "kept apart" if plan.recipe.coded is not None else "taken off"
        found = f"sharp paths, which are {kept} ({light})"
    else:
        found = f"sharp light without a map ({light})"
    how = plan.how
    return (
        f"{found}: {how.coded} codes in {how.parts} exposure{'s' * (how.parts > 1)}; the look took "
        f"{len(single)} RAW files and {cost_s:.2g} s"
    )
