"""How much memory a job will take at its peak, foreseen before any of it is taken.

Bytes of arrays over codes and cells, counted in what the code that makes them holds at a time: of
the codes while they are made, of the patterns while they are compiled, and of what decoding holds,
which are all shots' factors and pictures. The counts are upper bounds, at most `SLACK` times what
is really taken once that is more than `BASE`; `tests/e2e/planning/test_memory.py` measures it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass

from pdcd.bench.grey import curves_of
from pdcd.bench.placed import compute_mock_frame
from pdcd.bench.tables import Config
from pdcd.codes.far import binary_masks_bytes
from pdcd.codes.greyed import can_make_grey_masks, grey_masks_bytes
from pdcd.codes.woven import joint_codes_bytes
from pdcd.errors import RequestError
from pdcd.panels.curve import COPIES, UNKNOWN_CURVES
from pdcd.panels.lattice import Lattice
from pdcd.panels.map import Map
from pdcd.pictures.exposed import LARGE_QUADS
from pdcd.planning.plan import find_code_lattice, has_joint_codes, is_windowed
from pdcd.probing.deviation import EXACT_CELLS
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import CELL_BLOCK
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.recipes.isolation import Isolation
from pdcd.recipes.off_axis import KeyedProgram, KeyedRangeProgram, RowProgram
from pdcd.recipes.parts import count_part_codes
from pdcd.recipes.programs import (
    BlockProgram,
    CodedProgram,
    ConvolvedProgram,
    LongRangeProgram,
    Program,
    SignedBlockProgram,
    SignedMatrixProgram,
    SignedProgram,
    find_inner_program,
)
from pdcd.recipes.recipe import Recipe, RecipePhoto
from pdcd.words import FamilyName

BASE = 32 * 2**20
"""Bytes of all that is small: frames and logs, blocks of fixed size, one RAW file."""
SLACK = 5.0
"""Largest factor by which the estimate may be above what is measured."""
_REAL_QUADS = 3_100_000
"""Bayer quads of the largest frame of a supported camera; its size is known from the first photo
on only."""


@dataclass(frozen=True)
class _PerQuad:
    """Bytes for each quad of the frame: of every shot, sum of shots, photo and picture, and of what
    is there once however many there are. Of several goals' peaks, the decoding of RAW files
    included."""

    shot: int
    sum: int
    photo: int
    picture: int
    once: int


_LARGE = _PerQuad(shot=9, sum=37, photo=80, picture=35, once=94)
_SMALL = _PerQuad(shot=9, sum=49, photo=104, picture=59, once=150)
"""Of frames below `LARGE_QUADS`, whose error bars have double precision."""
_LEFT = 0.75
"""Share of the most memory for pictures that is still taken when they are made."""
_AGAIN = 1.25
"""Rows of a matrix over those of a run that lost no refresh: lost codes are shown again."""

_MAKING = {"bernoulli": 10, "rademacher": 2, "balanced": 4, "hadamard": 4, "singer": 4}
"""Bytes a code and cell while codes of a family are made."""


def memory_bytes(
    recipe: Recipe,
    how: CaptureScheme,
    family: FamilyName,
    lattice: Lattice,
    passes: int,
    config: Config,
) -> int:
    """Peak of planning, taking and decoding, in bytes beside the program itself and the scene."""
    target = recipe.target
    given = sum(a.nbytes for a in (*target.planes.values(), *target.matrices.values()))
    grey = UNKNOWN_CURVES != curves_of(config)
    planning, kept = planning_bytes(recipe, how, family, lattice, COPIES if grey else 1)
    decoding = kept + decoding_bytes(recipe, how, lattice, passes, config)
    return BASE + 3 * given + max(planning, decoding)


def planning_bytes(
    recipe: Recipe, how: CaptureScheme, family: FamilyName, lattice: Lattice, copies: int
) -> tuple[int, int]:
    """Peak while all patterns are made, and what they take then, with so many copies of exact ones
    at most."""
    planning = kept = 0
    for name, program in recipe.programs.items():
        codes = how.pilot if name == "pilot" else count_part_codes(how.coded, how.parts)
        making, compiling, left = _of_program(
            program, recipe, family, codes or how.codes, lattice, copies
        )
        planning = max(planning, kept + max(making, compiling))
        kept += left
    return planning, kept


class MemoryLimitError(RequestError):
    """A job would take more memory than the rig allows it."""


def check_memory(needed: int, config: Config, grid: tuple[int, int]) -> None:
    """Refuse a job that needs more than the rig's limit. Raises MemoryLimitError."""
    limit = memory_limit_bytes(config)
    if needed > limit:
        raise MemoryLimitError(
            f"this takes {_mega(needed)} of memory on a grid of {grid[0]} x {grid[1]} cells; the "
            f"limit is {_mega(limit)}",
            hint="ask for fewer codes, photos or passes, or raise limits.memory_bytes",
        )


def memory_limit_bytes(config: Config) -> int:
    """Most bytes that a job may take: as configured, else half of the machine's memory."""
    if config.limits.memory_bytes is not None:
        return config.limits.memory_bytes
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2


def _of_program(
    program: Program,
    recipe: Recipe,
    family: FamilyName,
    codes: int,
    lattice: Lattice,
    copies: int,
) -> tuple[int, int, int]:
    """Bytes while the codes of a program are made, while its patterns are, and of those left."""
    own = find_code_lattice(program, lattice)
    cells, square = own.lattice_cells, own.cells**2
    if isinstance(program, Isolation):
        pairs = program.count()
        return 0, pairs * (16 * cells + 32), pairs * 5 * cells
    if not program.coded:
        blocks = copies * count_exact_pairs(program)
        return 0, blocks * 80 * cells, blocks * 16 * cells
    inner = find_inner_program(program)
    made = codes * cells
    bits = made * _MAKING.get(family, 10) + (codes**2 if family == "hadamard" else 0)
    lit = inner is not program or recipe.target.light is not None
    if isinstance(inner, SignedProgram | SignedMatrixProgram | ConvolvedProgram):
        dense = 3 * 8 * square if isinstance(inner, SignedMatrixProgram) else 0
        return bits, made * (56 + 40 * lit) + dense, made * (9 + 8 * lit)
    if isinstance(inner, RowProgram):
        return bits, made * (8 + 60 * lit), made * (2 + 8 * lit)
    several = (
        8
        if isinstance(inner, CodedProgram | LongRangeProgram | KeyedProgram | KeyedRangeProgram)
        else 4
    )
    if has_joint_codes(program, lattice, codes, family):
        compiling = grey_masks_bytes(codes, cells) + made * 80
        return joint_codes_bytes(codes, cells), compiling, made * 9
    if (
        isinstance(inner, LongRangeProgram)
        and inner.radius
        and inner.grey
        and can_make_grey_masks(codes, cells)
    ):
        compiling = grey_masks_bytes(codes, cells) + made * (40 + 30 * lit)
        return bits, compiling, made * (5 + 4 * lit)
    if isinstance(inner, LongRangeProgram) and inner.radius:
        return (
            bits,
            binary_masks_bytes(codes, cells) + made * (several + 30 * lit),
            made * (1 + 4 * lit),
        )
    return bits, made * (several + 30 * lit), made * (1 + 4 * lit)


def decoding_bytes(
    recipe: Recipe, how: CaptureScheme, lattice: Lattice, passes: int, config: Config
) -> int:
    """Bytes of all shots' factors and pictures, and of the largest step in making them."""
    cells = lattice.cells
    ranks, folded = _ranks(recipe, how, lattice, passes, config)
    kept = 16 * cells * sum(ranks.values())
    # Chunks are put together, or folded into one matrix, before there are pictures.
    widest = max(ranks.values(), default=0)
    reading = 48 * cells**2 if folded else 16 * widest * cells
    pictures = picture_bytes(recipe, frame_quads(config, lattice.grid))
    judging = max((_judging(photo, ranks, cells) for photo in recipe.photos), default=0)
    return kept + max(reading, pictures, int(_LEFT * pictures) + judging)


def picture_bytes(recipe: Recipe, quads: int) -> int:
    """Bytes of all that has a value for each quad, at the most of it."""
    each = _SMALL if quads < LARGE_QUADS else _LARGE
    return quads * (
        each.shot * len(recipe.shots)
        + each.sum * len(recipe.sums)
        + each.photo * len(recipe.photos)
        + each.picture * len(recipe.pictures)
        + each.once
    )


def frame_quads(config: Config, grid: tuple[int, int]) -> int:
    """Quads of the camera's frame; of one that is not known, as many as a real one may have."""
    given = config.camera.place.map
    if isinstance(given, Map):
        return given.size_px[0] * given.size_px[1]
    if config.camera.driver != "mock":
        return _REAL_QUADS
    rows, cols = compute_mock_frame(config, grid)
    return rows * cols


def _ranks(
    recipe: Recipe, how: CaptureScheme, lattice: Lattice, passes: int, config: Config
) -> tuple[dict[str, int], bool]:
    """Rows of the factors of each shot's matrix, and whether any had more than there are cells:
    these are folded."""
    fields = PanelOptics.from_config(config.projector).rates.size
    ranks, folded = {}, False
    for shot in recipe.shots:
        program = None if shot.white else recipe.programs[shot.program]
        rows = _AGAIN * passes * _spans(program, how, shot.only is not None) * fields
        if program is not None and is_windowed(program):
            rows *= lattice.fields
        folded = folded or rows > lattice.cells
        ranks[shot.name] = min(math.ceil(rows) + 2 * fields, lattice.cells)
    return ranks, folded


def _judging(photo: RecipePhoto, ranks: Mapping[str, int], cells: int) -> int:
    """Bytes of comparing what a photo's panels did with what was wanted."""
    rank = sum(ranks.get(name, 0) for _, name in photo.shots)
    joined = 16 * rank * cells if len(photo.shots) > 1 else 0
    pairs = 24 * cells**2 if cells <= EXACT_CELLS else 0
    return joined + max(32 * rank * min(2 * CELL_BLOCK, cells) + 24 * rank**2, pairs)


def _spans(program: Program | None, how: CaptureScheme, single: bool) -> int:
    """Times that a panel changes in one pass of a shot."""
    if program is None or single:
        return 1
    if isinstance(program, Isolation):
        return max(program.count(), how.coded)
    if not program.coded:
        return max(count_exact_pairs(program), how.coded)  # repeated to fill as many
    codes = count_part_codes(how.coded, how.parts) or how.codes
    twice = isinstance(
        find_inner_program(program),
        SignedProgram | SignedMatrixProgram | ConvolvedProgram | RowProgram,
    )
    return 2 * codes if twice else codes


def count_exact_pairs(program: Program) -> int:
    """Pairs of a program without codes."""
    signed = isinstance(program, SignedBlockProgram)
    return (
        len(program.camera) * (1 + signed)
        if isinstance(program, BlockProgram | SignedBlockProgram)
        else 1
    )


def _mega(count: int) -> str:
    return f"{count / 2**20:.0f} MiB"
