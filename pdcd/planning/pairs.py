"""The pairs of patterns that the programs of a plan show, and their family."""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.arrays import Bools
from pdcd.codes.far import make_long_range_codes
from pdcd.codes.hadamard import can_make_hadamard_codes, make_hadamard_codes, make_prior_codes
from pdcd.codes.independent import make_partner_codes
from pdcd.codes.lines import make_comb_codes, make_matched_codes, make_row_codes
from pdcd.codes.make import make_codes
from pdcd.codes.pilot.codes import make_pilot_codes
from pdcd.errors import RequestError
from pdcd.panels.curve import UNKNOWN_CURVES, Curves, prepare_codes, prepare_sequence
from pdcd.panels.lattice import Lattice
from pdcd.planning.own_codes import OwnCodes
from pdcd.planning.plan import (
    COINS,
    PatternPair,
    Plan,
    average_pair_light,
    find_code_lattice,
    has_code_mask,
    is_windowed,
)
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.recipes.off_axis import KeyedProgram, KeyedRangeProgram, RowProgram
from pdcd.recipes.partners import link_partners, list_distant_partners
from pdcd.recipes.parts import count_part_codes, derive_part_seed, randomise_signs
from pdcd.recipes.programs import (
    CodedProgram,
    LongRangeProgram,
    Program,
    extend_partners,
    extend_values,
    find_inner_program,
)
from pdcd.recipes.recipe import Recipe
from pdcd.watch import Watch
from pdcd.words import FamilyName, ShownFamilyName

_FEWEST_LIT = 16
"""Codes that light a cell from which on Hadamard ones serve cells matched with others."""


def resolve_family(
    asked: FamilyName | None, default: FamilyName, draft: Recipe, how: CaptureScheme
) -> FamilyName:
    """The family asked for, or balanced codes where Hadamard ones do not serve.

    Balanced codes replace Hadamard codes that were not asked for by name in three cases: if cells
    are to be lit in another share than 1/2 that Hadamard codes cannot have with this number; in
    parts with such a share, whose spread shows errors only where phases are left to chance; and for
    cells matched with others that are lit in few codes. In the last case there are too few Hadamard
    columns to keep the cells' own light apart, while chains of balanced ones do
    (`pdcd.codes.independent`)."""
    family = asked or default
    main = next((p.p for p in draft.programs.values() if has_code_mask(p)), 0.5)
    lines = any(isinstance(p, KeyedRangeProgram) for p in draft.programs.values())
    if family != "hadamard" or main == 0.5 or asked is not None or lines:
        return family
    inner = [find_inner_program(program) for program in draft.programs.values()]
    elsewhere = any(isinstance(p, CodedProgram) and p.partner is not None for p in inner)
    few = elsewhere and main * how.coded < _FEWEST_LIT
    fits = how.parts == 1 and not few and can_make_hadamard_codes(how.coded, main)
    return family if fits else "balanced"


def make_pattern_pairs(
    recipe: Recipe,
    how: CaptureScheme,
    family: ShownFamilyName,
    lattice: Lattice,
    *,
    p: float | None,
    seed: int,
    watch: Watch,
    curves: Curves = UNKNOWN_CURVES,
    passes: int = 1,
    own: OwnCodes | None = None,
) -> dict[str, PatternPair]:
    """Patterns of every program, as they are sent to panels with these curves; each part of a split
    photo has codes of its own.

    `p` is the share of lit cells that the request names, None where it leaves that open. `own` :
    codes that came with the request. `watch` counts the programs that are done.
    """
    part_of = {shot.program: shot.part for shot in recipe.shots}
    patterns, slots = {}, how.coded * passes
    watch.expect(float(len(recipe.programs)))
    for name, program in recipe.programs.items():
        part = part_of.get(name, 0)
        own_seed = derive_part_seed(seed, how.parts, part)
        there, bits = find_code_lattice(program, lattice), np.zeros((0, 0), dtype=np.bool_)
        if not program.coded:
            pass
        elif own is not None:
            program = own.in_place_of(program, part, how.parts)
        elif name == "pilot":
            bits = make_pilot_codes(lattice.grid, how.pilot, seed)
        else:
            count = count_part_codes(how.coded, how.parts)
            bits = _bits(program, lattice, family, count, p, own_seed)
        if part and family == "hadamard" and program.p == 0.5:
            bits = randomise_signs(bits, own_seed)
        patterns[name] = _compiled(program, recipe, there, bits, curves, slots)
        watch.did(1.0)
    return patterns


def make_linked_pairs(
    plan: Plan, links: scipy.sparse.csr_array, seed: int, watch: Watch | None = None
) -> dict[str, PatternPair]:
    """Patterns of those programs that Hadamard codes can serve; the codes keep linked cells apart.
    `links` is sparse (N, N). A `watch` may end the work."""
    alive = watch or Watch()
    lattice = Lattice(plan.grid, plan.window)
    between = _onto_lattice(lattice, links)
    part_of = {shot.program: shot.part for shot in plan.recipe.shots}
    count = count_part_codes(plan.how.coded, plan.how.parts)
    found = {}
    for name, program in plan.recipe.programs.items():
        alive()
        if is_windowed(program) and program.p == 0.5:
            part = part_of.get(name, 0)
            # The generator is the one that `make_codes` takes, so that no links give the usual
            # codes.
            own_seed = derive_part_seed(seed, plan.how.parts, part)
            rng = np.random.Generator(np.random.PCG64(own_seed))
            # If the same cells shared columns in all parts, their errors would be alike by chance,
            # and the spread of parts would not show them.
            bits = make_prior_codes(lattice.shape, count, between, rng, apart=part > 0)
            if part:
                bits = randomise_signs(bits, own_seed)
            found[name] = _compiled(program, plan.recipe, lattice, bits, plan.curves, 1)
    return found


def count_white_slots(
    recipe: Recipe,
    patterns: dict[str, PatternPair],
    lattice: Lattice,
    slots: int,
    curves: Curves = UNKNOWN_CURVES,
) -> int:
    """Slots of a white shot: as the goal itself, all; with a coded one, as many as gather about its
    light, which keeps the camera at one setting."""
    for name, program in recipe.programs.items():
        if has_code_mask(program):
            cells = find_code_lattice(program, lattice).lattice_cells
            slots = round(slots * average_pair_light(patterns[name], cells, curves))
            break
    return max(1, slots)


def _bits(
    program: Program,
    lattice: Lattice,
    family: ShownFamilyName,
    count: int,
    p: float | None,
    seed: int,
) -> Bools:
    """Code bits (K, L) of a coded program."""
    lines = _line_codes(program, lattice, family, count, seed)
    if lines is not None:
        return lines
    share, inner = program.p, find_inner_program(program)
    own = find_code_lattice(program, lattice)
    rng = np.random.Generator(np.random.PCG64(seed))
    if isinstance(inner, LongRangeProgram) and inner.radius and family not in COINS:
        return make_long_range_codes(own.shape, count, share, rng, grey=inner.grey)
    if share != 0.5 and p is None and not isinstance(inner, CodedProgram):
        # The best share of lit cells, rounded to what balanced codes can do.
        share = max(1, round(share * count)) / count
        family = "bernoulli" if family in COINS else "balanced"
    far = list_distant_partners(program, lattice.grid) if family == "hadamard" else ()
    links = link_partners(far, lattice)
    if links is not None:
        return make_hadamard_codes(own.shape, count, share, rng, links)
    bits = make_codes(family, own.shape, count, dual="same", p=share, seed=seed).primal
    if family == "balanced" and isinstance(inner, CodedProgram) and inner.partner is not None:
        return make_partner_codes(bits, extend_partners(inner.partner, own), rng)
    return bits


def _line_codes(
    program: Program, lattice: Lattice, family: ShownFamilyName, count: int, seed: int
) -> Bools | None:
    """Code bits (K, L) of goals of off-axis benches; None for other programs and families.

    Raises RequestError for a family that cannot do what the program needs.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    if isinstance(program, KeyedRangeProgram):
        if family != "hadamard":
            raise RequestError(
                f"{family} codes cannot key a range of depths", hint="leave out the family"
            )
        return make_comb_codes(lattice.shape, count, program.period, rng)
    if family == "hadamard" and isinstance(program, KeyedProgram):
        return make_matched_codes(lattice.shape, count, rng)
    if family == "hadamard" and isinstance(program, RowProgram):
        return make_row_codes(lattice.shape, count, rng)
    return None


def _compiled(
    program: Program, recipe: Recipe, lattice: Lattice, bits: Bools, curves: Curves, slots: int
) -> PatternPair:
    """Patterns of a program over a lattice, coded ones under the goal's illumination."""
    primal, dual = program.pairs(bits, lattice)
    # A pilot looks at the whole scene: it learns paths, not the picture.
    if recipe.target.light is not None and has_code_mask(program):
        primal = primal * extend_values(recipe.target.light, lattice)
    if program.coded:
        return prepare_codes(primal, dual, curves)
    # Exact sequences are shown over and over, for as long as codes would take.
    return prepare_sequence(primal, dual, curves, slots // len(primal))


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
