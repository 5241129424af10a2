"""Virtual scenes at their limits: bright spots, near-white albedo, grids of odd shapes."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics
from pdcd.virtual.scene.kernel import KernelEffect
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.radiosity import (
    Radiosity,
    Relief,
    compute_form_kernel,
    limit_kernel,
    make_radiosity_effects,
    solve_exchange,
)
from tests import bench_rig, oracles
from tests.hard_cases.case import Case, Floats, Outcome, worst
from tests.hard_cases.exposures import closing_ns, exact, log_of, realised

Long = NDArray[np.longdouble]

ALBEDO = 0.999
ODD_GRIDS = ((1, 1), (1, 7), (11, 1), (13, 17))
"""One cell, single lines, and primes that no tile and no patch of a scene divides."""


def _solved(system: Long, right: Long) -> Long:
    """Solution of a linear system in extended precision: Gauss, with the largest pivot."""
    a = np.concatenate([system, right], axis=1)
    n = len(system)
    for k in range(n):
        pivot = k + int(np.argmax(np.abs(a[k:, k])))
        a[[k, pivot]] = a[[pivot, k]]
        a[k] /= a[k, k]
        others = np.arange(n) != k
        a[others] -= a[others, k : k + 1] * a[k]
    return a[:, n:]


def _groove() -> Relief:
    """Two steep walls that meet in a line."""
    column = np.arange(48)
    return Relief(np.tile(8.0 * np.abs(column - 23.5), (36, 1)), (1.0, 1.0))


def _pit() -> Relief:
    """A deep bowl on a grid of primes."""
    y, x = np.ogrid[-1:1:37j, -1:1:41j]
    return Relief(8.0 * 41 * np.minimum(1.0, y**2 + x**2), (1.0, 1.0))


def _patches(relief: Relief) -> tuple[Radiosity, Floats]:
    """The exchange between patches of a relief of albedo 0.999, and the areas of the patches."""
    rows, cols = relief.height.shape
    albedo = np.full((rows * cols, 1), ALBEDO)
    (effect,) = make_radiosity_effects("test", relief, albedo, (np.ones(3),))
    area = effect.down.T @ (1.0 / relief.cosine) @ effect.across
    return effect, np.asarray(area.ravel())


def groove() -> Outcome:
    """Light between steep walls, against a solution with 64 bits of mantissa."""
    effect, area = _patches(_groove())
    kernel = limit_kernel(compute_form_kernel(_groove(), (12, 16)), area)
    long_kernel = kernel.astype(np.longdouble)
    passed_on = long_kernel * (area.astype(np.longdouble) * np.longdouble(ALBEDO))
    want = _solved(np.eye(area.size, dtype=np.longdouble) - passed_on, long_kernel)
    plain = bounces = kernel
    for _ in range(10):
        bounces = (kernel * (area * ALBEDO)) @ bounces
        plain = plain + bounces
    scale = want.max()
    errors = [float(np.abs(got - want).max() / scale) for got in (effect.exchange, plain)]
    return Outcome(*errors)


def conserved() -> Outcome:
    """No patch receives more than all light, however coarse the points: ``K A 1 <= 1``.

    K is found back from the sum over all bounces: ``K = X (1 + R A X)^-1``.
    """
    excess = []
    for relief in (_groove(), _pit()):
        effect, area = _patches(relief)
        all_bounces = np.eye(area.size) + (ALBEDO * area)[:, None] * effect.exchange
        kernel = np.linalg.solve(all_bounces.T, effect.exchange.T).T
        excess.append(max(0.0, float((kernel @ area).max()) - 1.0))
    return Outcome(max(excess))


def enclosure() -> Outcome:
    """A closed white room: what leaves a wall comes back a thousand times, 1 / (1 - albedo).

    Every wall sees all others, ``K A 1 = 1``, so ``X A 1 = 1 / (1 - albedo)`` exactly.
    """
    walls = 64
    area = np.full(walls, 0.25)
    kernel = np.full((walls, walls), 1.0 / 16.0)
    got = solve_exchange(kernel, area, np.full(walls, ALBEDO)) @ area
    want = 1 / (1 - Fraction(ALBEDO))
    bounces = float(np.sum(ALBEDO ** np.arange(1000)))
    return Outcome(worst(got, [want] * walls, want), worst(np.array([bounces]), [want], want))


def bright_spot() -> Outcome:
    """A spot that takes in 100 000 times the light of all else, spread through a Fourier transform.

    The transform mixes all cells: the rounding of the spot reaches the dark ones.
    """
    grid = (37, 41)
    y, x = np.ogrid[-36:37, -40:41]
    uneven = np.random.default_rng(1).random((73, 81))
    kernel = (1.0 + uneven) / (1.0 + np.hypot(y, x)) ** 3
    into = np.ones(37 * 41)
    into[5 * 41 + 7] = 1e5
    effect = KernelEffect("test", grid, kernel, np.ones(37 * 41), into)
    assert not effect._factors, "the case is for the Fourier route"
    got = effect.apply(np.ones((1, 37 * 41)))[0]
    dense = effect.dense()
    picked = np.array([0, 5 * 41 + 7, 700, 37 * 41 - 1])
    want = [Fraction(math.fsum(row)) for row in dense[picked].tolist()]
    return Outcome(worst(got[picked], want, min(want)))


def preset(name: str) -> Outcome:
    """A preset on odd grids: light, photo and split against its dense matrix and lossless sums."""
    errors = []
    for grid in ODD_GRIDS:
        scene = PRESETS[name](grid, {})
        rng = np.random.default_rng(5)
        left, right = rng.random((2, 3, scene.cells))
        coaxial = rng.random(scene.cells)
        dense = scene.dense()
        got_white = scene.white()
        got_photo = scene.photo(left, right, coaxial, np.zeros(scene.cells))
        probing = left.T @ right
        split_direct, split_indirect = scene.split()
        direct = np.zeros((scene.cells, 3))
        for effect in scene.effects:
            if effect.coaxial:
                direct += effect.tint * effect.dense().diagonal()[:, None]
        for c in range(3):
            white = np.array([math.fsum(row) for row in dense[c].tolist()])
            rest = probing * (dense[c] - np.diag(direct[:, c]))
            photo = np.array([math.fsum(row) for row in rest.tolist()]) + coaxial * direct[:, c]
            scale = white.max()
            errors += [
                np.abs(got_white[:, c] - white).max() / scale,
                np.abs(got_photo[:, c] - photo).max() / photo.max(),
                np.abs(split_direct[:, c] - dense[c].diagonal()).max() / scale,
                np.abs(split_indirect[:, c] - (white - dense[c].diagonal())).max() / scale,
            ]
    return Outcome(float(max(errors)))


def odd_whole() -> Outcome:
    """Realised matrix on odd grids with leaking panels, against fractions."""
    errors = []
    panels = PanelOptics(leak=1 / 300), PanelOptics(leak=1 / 50)
    for grid in ODD_GRIDS:
        codes = make_codes("balanced", grid, 4, dual="complement", seed=1)
        frames = build_frames(
            bench_rig.pairs(codes), grid, window="whole", schedule="full", passes=1
        )
        log = log_of(frames, jitter_ns=300_000)
        rows = exact(frames, log).matrix(Fraction(panels[0].leak), Fraction(panels[1].leak))
        want = [entry / 10**9 for row in rows for entry in row]
        errors.append(worst(realised(frames, log, *panels).dense(), want, max(want)))
    return Outcome(max(errors))


def odd_quarter() -> Outcome:
    """The same in quarter windows with slow panels, against matrix exponentials, pixel by pixel."""
    errors = []
    primal, dual = PanelOptics(0.001, 0.003, 1 / 500), PanelOptics(0.012, 0.005, 1 / 50)
    for grid in ((1, 1), (1, 5), (5, 1), (3, 5)):
        shape = Lattice(grid, "quarter").shape
        codes = make_codes("balanced", shape, 2, dual="complement", seed=1)
        frames = build_frames(
            bench_rig.pairs(codes), grid, window="quarter", schedule="full", passes=1
        )
        log = log_of(frames)
        got = realised(frames, log, primal, dual)
        lit = oracles.timeline(frames, log, primal, 0, True, 4)
        seen = oracles.timeline(frames, log, dual, 0, False, 4)
        pairs = oracles.pair_integrals(lit, seen, primal, dual, closing_ns(log) * 1e-9)
        want, coaxial = oracles.to_cells(pairs, grid, 4)
        errors.append(np.abs(got.dense() - want).max() / want.max())
        errors.append(np.abs(got.coaxial - coaxial).max() / want.max())
    return Outcome(float(max(errors)))


def _preset_case(name: str) -> Case:
    run: Callable[[], Outcome] = partial(preset, name)
    return Case(
        f"{name} on 1x1, 7x1, 1x11 and 17x13 cells",
        "of the brightest cell",
        "dense matrix, math.fsum",
        1e-12,
        run,
    )


CASES = (
    Case(
        "groove of albedo 0.999",
        "of the largest entry",
        "elimination in extended precision",
        1e-13,
        groove,
        "sum of ten bounces",
    ),
    Case(
        "groove and pit of albedo 0.999: light from nowhere",
        "of all light",
        "conservation of energy",
        1e-12,
        conserved,
    ),
    Case(
        "closed room of albedo 0.999",
        "relative",
        "1 / (1 - albedo) in fractions",
        1e-12,
        enclosure,
        "sum of a thousand bounces",
    ),
    Case(
        "scattering beside a spot 100 000 times as bright",
        "of the darkest cell",
        "dense matrix, math.fsum",
        1e-10,
        bright_spot,
    ),
    *(_preset_case(name) for name in PRESETS),
    Case(
        "realised matrix on 1x1, 7x1, 1x11 and 17x13 cells",
        "of the largest entry",
        "whole nanoseconds and fractions",
        1e-14,
        odd_whole,
    ),
    Case(
        "quarter windows on 1x1, 5x1, 1x5 and 5x3 cells",
        "of the largest entry",
        "matrix exponentials, pixel by pixel",
        1e-12,
        odd_quarter,
    ),
)
