"""The pairs of patterns that the programs of a plan show, and the family they are made by."""

from __future__ import annotations

from typing import cast

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.codes.far import far_codes
from pdcd.codes.hadamard import hadamard, hadamard_fits, prior_codes
from pdcd.codes.independent import chained
from pdcd.codes.lines import comb_codes, matched_codes, row_codes
from pdcd.codes.make import make_codes
from pdcd.codes.pilot.codes import pilot_codes
from pdcd.codes.woven import woven
from pdcd.errors import RequestError
from pdcd.panels.curve import UNKNOWN, Curves, code_to_send, sequence_to_send
from pdcd.panels.lattice import Lattice
from pdcd.planning.plan import (
    COINS,
    Pair,
    Plan,
    chosen_together,
    lattice_of,
    mean_light,
    shows_codes,
    windowed,
)
from pdcd.protocol.plan_summary import How
from pdcd.recipes.off_axis import Keyed, KeyedRange, Rows
from pdcd.recipes.partners import far_partners, partner_links
from pdcd.recipes.parts import coin_signs, part_codes, part_seed
from pdcd.recipes.programs import Coded, Far, Levels, Program, extended, on_lattice, within
from pdcd.recipes.recipe import Recipe
from pdcd.watch import Watch
from pdcd.words import FamilyName

Bools = NDArray[np.bool_]

FEWEST_LIT = 16
"""Codes that light a cell from which on Hadamard ones serve cells matched with others."""


def resolve_family(
    asked: FamilyName | None, default: FamilyName, draft: Recipe, how: How
) -> FamilyName:
    """The family asked for. Where codes must be lit in another share than 1/2 that Hadamard codes
    cannot do with this number, balanced ones stand in for them unless they were asked for by name;
    and in parts, whose spread tells of errors only where phases are left to chance. So they do for
    cells matched with others that are lit in few codes: there are too few Hadamard columns to keep
    the cells' own light apart, and chains of balanced ones do (`pdcd.codes.independent`)."""
    family = asked or default
    main = next((p.p for p in draft.programs.values() if shows_codes(p)), 0.5)
    lines = any(isinstance(p, KeyedRange) for p in draft.programs.values())
    if family != "hadamard" or main == 0.5 or asked is not None or lines:
        return family
    inner = [within(program) for program in draft.programs.values()]
    elsewhere = any(isinstance(p, Coded) and p.partner is not None for p in inner)
    few = elsewhere and main * how.coded < FEWEST_LIT
    fits = how.parts == 1 and not few and hadamard_fits(how.coded, main)
    return family if fits else "balanced"


def pairs_of(
    recipe: Recipe,
    how: How,
    family: FamilyName,
    lattice: Lattice,
    *,
    p: float | None,
    seed: int,
    watch: Watch,
    curves: Curves = UNKNOWN,
    passes: int = 1,
) -> dict[str, Pair]:
    """Patterns of every program, as they are sent to panels with these curves; each part of a split
    photo has codes of its own.

    `p` is the share of lit cells that the request names, None where it leaves that open. `watch`
    is told of every program that is done.
    """
    part_of = {shot.program: shot.part for shot in recipe.shots}
    patterns, slots = {}, how.coded * passes
    watch.expect(float(len(recipe.programs)))
    for name, program in recipe.programs.items():
        part = part_of.get(name, 0)
        own_seed = part_seed(seed, how.parts, part)
        bits: Levels
        if not program.coded:
            bits = np.zeros((0, 0), dtype=np.bool_)
        elif name == "pilot":
            bits = pilot_codes(lattice.grid, how.pilot, seed)
        else:
            count = part_codes(how.coded, how.parts)
            bits = _bits(program, lattice, family, count, p, own_seed, watch)
        if part and family == "hadamard" and program.p == 0.5:
            bits = coin_signs(bits > 0, own_seed)
        patterns[name] = _compiled(program, recipe, lattice, bits, curves, slots)
        watch.did(1.0)
    return patterns


def linked_pairs(
    plan: Plan, links: scipy.sparse.csr_array, seed: int, watch: Watch | None = None
) -> dict[str, Pair]:
    """Patterns of the programs that Hadamard codes can serve which keep linked cells (N, N) apart;
    `links` is sparse. A `watch` may end the work."""
    alive = watch or Watch()
    lattice = Lattice(plan.grid, plan.window)
    between = _onto_lattice(lattice, links)
    part_of = {shot.program: shot.part for shot in plan.recipe.shots}
    count = part_codes(plan.how.coded, plan.how.parts)
    found = {}
    for name, program in plan.recipe.programs.items():
        alive()
        if windowed(program) and program.p == 0.5:
            part = part_of.get(name, 0)
            # The generator is the one that `make_codes` takes, so that no links give the usual
            # codes.
            own_seed = part_seed(seed, plan.how.parts, part)
            rng = np.random.Generator(np.random.PCG64(own_seed))
            # Parts in which the same cells share columns err alike by chance, and their spread then
            # shows nothing of it.
            bits = prior_codes(lattice.shape, count, between, rng, apart=part > 0)
            if part:
                bits = coin_signs(bits, own_seed)
            found[name] = _compiled(program, plan.recipe, lattice, bits, plan.curves, 1)
    return found


def white_slots(
    recipe: Recipe,
    patterns: dict[str, Pair],
    lattice: Lattice,
    slots: int,
    curves: Curves = UNKNOWN,
) -> int:
    """Slots of a white shot: as the goal itself, all; beside a coded one, as many as gather about
    its light, which keeps the camera at one setting."""
    for name, program in recipe.programs.items():
        if shows_codes(program):
            cells = lattice_of(program, lattice).lattice_cells
            slots = round(slots * mean_light(patterns[name], cells, curves))
            break
    return max(1, slots)


def _bits(
    program: Program,
    lattice: Lattice,
    family: FamilyName,
    count: int,
    p: float | None,
    seed: int,
    watch: Watch,
) -> Levels:
    """Code bits (K, L) of a coded program, or levels."""
    lines = _line_codes(program, lattice, family, count, seed)
    if lines is not None:
        return lines
    share, inner = program.p, within(program)
    own = lattice_of(program, lattice)
    rng = np.random.Generator(np.random.PCG64(seed))
    if isinstance(inner, Far) and inner.radius and family not in COINS:
        if chosen_together(program, lattice, count, family):
            return woven(own.shape, count, inner.radius, seed, watch)
        return far_codes(own.shape, count, share, rng, grey=inner.grey)
    if share != 0.5 and p is None and not isinstance(inner, Coded):
        # The best share of lit cells, rounded to what balanced codes can do.
        share = max(1, round(share * count)) / count
        family = "bernoulli" if family in COINS else "balanced"
    far = far_partners(program, lattice.grid) if family == "hadamard" else ()
    links = partner_links(far, lattice)
    if links is not None:
        return hadamard(own.shape, count, share, rng, links)
    bits = make_codes(family, own.shape, count, dual="same", p=share, seed=seed).primal
    if family == "balanced" and isinstance(inner, Coded) and inner.partner is not None:
        return chained(bits, on_lattice(inner.partner, own), rng)
    return bits


def _line_codes(
    program: Program, lattice: Lattice, family: FamilyName, count: int, seed: int
) -> Bools | None:
    """Code bits (K, L) of goals of off-axis benches; None for other programs and families.

    Raises RequestError for a family that cannot do what the program needs.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    if isinstance(program, KeyedRange):
        if family != "hadamard":
            raise RequestError(
                f"{family} codes cannot key a range of depths", hint="leave out the family"
            )
        return comb_codes(lattice.shape, count, program.period, rng)
    if family == "hadamard" and isinstance(program, Keyed):
        return matched_codes(lattice.shape, count, rng)
    if family == "hadamard" and isinstance(program, Rows):
        return row_codes(lattice.shape, count, rng)
    return None


def _compiled(
    program: Program, recipe: Recipe, lattice: Lattice, bits: Levels, curves: Curves, slots: int
) -> Pair:
    """Patterns of a program over its own lattice, coded ones under the goal's illumination."""
    own = lattice_of(program, lattice)
    # Only codes that come in levels are given to the program that takes them.
    primal, dual = program.pairs(cast(Bools, bits), own)
    # A pilot looks at the whole scene: it learns paths, not the picture.
    if recipe.target.light is not None and shows_codes(program):
        primal = primal * extended(recipe.target.light, own)
    if program.coded:
        return code_to_send(primal, dual, curves)
    # Exact sequences are shown over and over, for as long as codes would take.
    return sequence_to_send(primal, dual, curves, slots // len(primal))


def _onto_lattice(lattice: Lattice, links: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Links between cells (N, N) -> between code cells (L, L).

    With quarter windows each cell is served by four code cells, so a path links all of these.
    """
    n, shape = lattice.cells, lattice.shape
    row, column = np.divmod(np.arange(n), lattice.grid[1])
    more = range(shape[0] - lattice.grid[0] + 1)
    code_cell = [(row + down) * shape[1] + column + right for down in more for right in more]
    onto = scipy.sparse.csr_array(
        (
            np.full(len(code_cell) * n, 1.0 / len(code_cell)),
            (np.concatenate(code_cell), np.tile(np.arange(n), len(code_cell))),
        ),
        shape=(lattice.lattice_cells, n),
    )
    return onto @ links @ onto.T
