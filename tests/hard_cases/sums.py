"""Long sums: 100 000 codes, the realised matrix and the photo, in three precisions."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache

import numpy as np

from pdcd.codes.make import make_codes
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import Factors, collect_factors, compute_factors
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.scene import Scene
from tests import bench_rig
from tests.hard_cases.case import Case, Floats, Outcome, worst
from tests.hard_cases.exposures import Exact, closing_ns, exact, log_of, photo, spans

MANY = 100_000
GRID = bench_rig.GRID
CELLS = GRID[0] * GRID[1]
PRIMAL, DUAL = PanelOptics(leak=1 / 800), PanelOptics(leak=1 / 300)
NS = Fraction(1, 10**9)


@cache
def _many() -> tuple[Frames, FrameLog, Exact]:
    """28 minutes of codes without guards, refreshes late and early, the mask a bit behind."""
    codes = make_codes("balanced", GRID, MANY, dual="complement", seed=1)
    frames = build_frames(bench_rig.pairs(codes), GRID, window="whole", schedule="none", passes=1)
    log = log_of(frames, jitter_ns=300_000, phase_ns=1_234_567)
    return frames, log, exact(frames, log)


def _exact_matrix() -> list[list[Fraction]]:
    rows = _many()[2].matrix(Fraction(PRIMAL.leak), Fraction(DUAL.leak))
    return [[NS * entry for entry in row] for row in rows]


@cache
def _parts() -> list[Factors]:
    """The exposure chunk by chunk, as the mock camera takes it."""
    frames, log, _ = _many()
    return list(compute_factors(frames, log, PRIMAL, DUAL, open_ns=0, close_ns=closing_ns(log)))


@cache
def _program_matrix() -> Floats:
    return collect_factors(_parts()).dense()


@cache
def _levels() -> tuple[Floats, Floats, Floats]:
    """Length in s of every stretch (S,), and the levels of mask and projector then, (S, N)."""
    frames, log, _ = _many()
    span_ns, m, i = spans(frames, log)
    mask = np.where(m == 1, 1.0, DUAL.leak)
    light = np.where(i == 1, 1.0, PRIMAL.leak)
    return np.asarray(span_ns * 1e-9), mask, light


def _running(terms: Floats) -> Floats:
    """Sum over the first axis in float32, one term after the other."""
    total = np.cumsum(terms.astype(np.float32), axis=0)[-1]
    return np.asarray(total, dtype=np.float64)


def matrix() -> Outcome:
    """All entries of the realised matrix."""
    want = [entry for row in _exact_matrix() for entry in row]
    span_s, mask, light = _levels()
    plain = np.array([_running((span_s * mask[:, n])[:, None] * light) for n in range(CELLS)])
    scale = max(want)
    return Outcome(worst(_program_matrix(), want, scale), worst(plain, want, scale))


def matrix_by_fsum() -> Outcome:
    """One row of the realised matrix, its 300 000 terms added without loss."""
    span_s, mask, light = _levels()
    want = [Fraction(math.fsum((span_s * mask[:, 0] * light[:, m]).tolist())) for m in range(CELLS)]
    return Outcome(worst(_program_matrix()[0], want, max(want)))


def photograph() -> Outcome:
    """The mock's photo, chunk by chunk, each cell relative to itself."""
    transport = bench_rig.transport()
    scene = Scene("test", GRID, split_into_effects(transport))
    got = np.zeros((CELLS, 3))
    for part in _parts():
        got += scene.photo(part.left, part.right, part.coaxial, part.open_s)
    want = photo(_exact_matrix(), transport)
    span_s, mask, light = _levels()
    plain = _running((span_s[:, None] * mask) * (light @ transport.T))
    scale = min(want)
    return Outcome(worst(got[:, 1], want, scale), worst(plain, want, scale))


def photograph_by_fsum() -> Outcome:
    """The photo of one cell, its 3.6 million terms added without loss."""
    span_s, mask, light = _levels()
    transport = bench_rig.transport()
    terms = (span_s * mask[:, 0])[:, None] * light * transport[0]
    want = Fraction(math.fsum(terms.ravel().tolist()))
    got = float(_program_matrix()[0] @ transport[0])
    return Outcome(worst(np.array([got]), [want], want))


CASES = (
    Case(
        "100 000 codes: realised matrix",
        "of the largest entry",
        "whole nanoseconds and fractions",
        1e-14,
        matrix,
        "float32 sum over codes",
    ),
    Case(
        "100 000 codes: one row of the matrix",
        "of the largest entry",
        "math.fsum of all terms",
        1e-14,
        matrix_by_fsum,
    ),
    Case(
        "100 000 codes: photo",
        "of the darkest cell",
        "whole nanoseconds and fractions",
        1e-13,
        photograph,
        "float32 sum over codes",
    ),
    Case(
        "100 000 codes: photo of one cell",
        "relative",
        "math.fsum of all terms",
        1e-13,
        photograph_by_fsum,
    ),
)
