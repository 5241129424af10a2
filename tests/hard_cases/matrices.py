"""Wanted matrices that are nearly singular, and codes that cannot be told apart.

Patterns with grey levels are kept in single precision, so an answer by them is good to about 1e-7
of the light that goes into it, whatever the condition of the matrix: nothing is ever inverted.
"""

from __future__ import annotations

import math
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pdcd.codes.make import make_codes
from pdcd.codes.pilot.links import estimate_links
from pdcd.pictures.exposed import ComputedShot
from pdcd.planning.make import make_plan
from pdcd.probing.panel import PanelOptics
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.programs import BlockProgram, SignedBlockProgram, SignedMatrixProgram
from pdcd.sensor.cells import CellMap
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.scene import Scene
from tests import bench_rig
from tests.combined import combine_shots
from tests.hard_cases.case import Case, Floats, Outcome, worst
from tests.hard_cases.exposures import log_of, realised

GRID = bench_rig.GRID
CELLS = GRID[0] * GRID[1]
CONDITION = 1e8


def _ill_conditioned() -> Floats:
    """A matrix with singular values from 1 to 1e-8."""
    rng = np.random.default_rng(4)
    left, right = (np.linalg.qr(rng.normal(size=(CELLS, CELLS)))[0] for _ in range(2))
    return np.asarray(left * np.geomspace(1.0, 1.0 / CONDITION, CELLS) @ right)


def _nearly_alike() -> Floats:
    """A non-negative matrix whose rows differ from each other by 1e-9."""
    rng = np.random.default_rng(5)
    return np.asarray(rng.random(CELLS) + 1e-9 * rng.random((CELLS, CELLS)))


def _answer(program: type | None, **fields: Any) -> Floats:
    """Image of a goal on the test scene without a camera; `program` is what it must be made by."""
    with tempfile.TemporaryDirectory(prefix="pdcd-hard-") as folder:
        config = bench_rig.config(Path(folder))
        plan = make_plan(msgspec.convert(fields, CaptureRequest), config, GRID)
    if program is not None:
        assert all(isinstance(p, program) for p in plan.recipe.programs.values())
    scene = Scene("test", GRID, split_into_effects(bench_rig.transport()))
    shots = {}
    for shot in plan.recipe.shots:
        frames = plan.frames(shot)
        got = realised(frames, log_of(frames), PanelOptics(), PanelOptics())
        light = scene.photo(got.left, got.right, got.coaxial, got.open_s).reshape(*GRID, 3)
        shots[shot.name] = ComputedShot(light, np.ones_like(light), np.zeros(GRID, bool), got, {})
    pictures = combine_shots(plan.recipe, shots, CellMap.block(GRID, GRID))
    return pictures[plan.recipe.answer_name].image[..., 1].ravel()


def _against(image: Floats, matrix: Floats) -> float:
    """Worst error of ``(A o T) 1``, over the light that goes into the cell, ``(|A| o T) 1``."""
    products = matrix * bench_rig.transport()
    errors = []
    for got, row in zip(image, products.tolist(), strict=True):
        light = Fraction(math.fsum(map(abs, row)))
        errors.append(worst(np.array([got]), [Fraction(math.fsum(row))], light))
    return max(errors)


def by_blocks() -> Outcome:
    """Condition 1e8 by its singular vectors, in two photos."""
    matrix = _ill_conditioned()
    return Outcome(
        _against(
            _answer(SignedBlockProgram, goal="relit", matrix=matrix.tolist(), codes=64), matrix
        )
    )


def by_codes() -> Outcome:
    """Condition 1e8 by signed codes (eq. 9), fewer than its blocks would need."""
    matrix = _ill_conditioned()
    return Outcome(
        _against(
            _answer(SignedMatrixProgram, goal="relit", matrix=matrix.tolist(), codes=16), matrix
        )
    )


def dependent_rows() -> Outcome:
    """Rows 1e-9 apart, each a block of its own."""
    matrix = _nearly_alike()
    return Outcome(
        _against(_answer(BlockProgram, goal="relit", matrix=matrix.tolist(), codes=64), matrix)
    )


def equal_warps() -> Outcome:
    """The difference of two warps that are equal but for one cell: nothing but in that cell."""
    warp = np.random.default_rng(6).permutation(CELLS)
    other = warp.copy()
    other[4] = warp[7]
    matrix = np.eye(CELLS)[warp] - np.eye(CELLS)[other]
    image = _answer(
        None,
        goal="two-samples",
        warp=warp.reshape(GRID).tolist(),
        warp_b=other.reshape(GRID).tolist(),
        mix=[1.0, -1.0],
        codes=16,
    )
    want = [Fraction(math.fsum(row)) for row in (matrix * bench_rig.transport()).tolist()]
    sample = Fraction(float(bench_rig.transport()[np.arange(CELLS), warp].min()))
    return Outcome(worst(image, want, sample))


def twin_codes() -> Outcome:
    """A pilot in which two cells bear the same code: the fit is singular, its sum is not."""
    grid, twins, path = (4, 6), (3, 21), 0.8
    bits = make_codes("balanced", grid, 64, dual="same", seed=9).primal.copy()
    bits[:, twins[1]] = bits[:, twins[0]]
    transport = np.diag(np.full(24, 0.5))
    transport[12, twins[1]] = path
    found = estimate_links(bits, bits.astype(np.float64) @ transport.T, grid).toarray()
    return Outcome(abs(float(found[12].sum()) - path) / path)


_LIGHT = "of the light that goes into a cell"
_DENSE = "dense matrix, math.fsum"

CASES = (
    Case("relit, condition 1e8, by singular vectors", _LIGHT, _DENSE, 1e-7, by_blocks),
    Case("relit, condition 1e8, by signed codes", _LIGHT, _DENSE, 1e-7, by_codes),
    Case("relit, rows 1e-9 apart", _LIGHT, _DENSE, 1e-7, dependent_rows),
    Case("difference of nearly equal warps", "of the darkest sample", _DENSE, 1e-12, equal_warps),
    Case("pilot with twin codes", "of the path", "the path itself", 2e-3, twin_codes),
)
