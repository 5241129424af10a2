"""Code families and the robust sequence: rows C5, C7 and R4 to R6 of the catalogue."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.planning.make import make_plan
from pdcd.probing.panel import PanelOptics
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.programs import SignedProgram
from tests import bench_rig, catalogue_rig, oracles
from tests.catalogue_rig import photo, scene_of, show, transport
from tests.frame_logs import REFRESH_NS

GRID = (4, 5)
N = 20
T = transport(N)
D = np.diag(T)
S = T.sum(axis=1) - D


def random_bits(count: int, p: float, seed: int = 0) -> Any:
    return make_codes("bernoulli", GRID, count, dual="same", p=p, seed=seed).primal + 0.0


def test_c5_warped_codes_are_exact_on_a_permutation_with_any_codes() -> None:
    """T_(n, a_n) alone: mask and light of a pair are the same code, however few there are."""
    rng = np.random.default_rng(4)
    warp = rng.permutation(N)
    mirror = np.zeros((N, N))
    mirror[np.arange(N), warp] = 0.5 + rng.random(N)
    bits = random_bits(3, 0.5).astype(bool)
    halves = []
    for half in (True, False):
        light, mask = SignedProgram(((1.0, warp),), half).pairs(bits, Lattice(GRID))
        shown = show(light, mask, GRID)
        halves.append(photo(shown, scene_of(mirror, GRID)))
    np.testing.assert_allclose((halves[0] - halves[1]) / 3, mirror.sum(axis=1), rtol=1e-12)


@pytest.mark.parametrize("fine", [16, 24])
def test_c7_cells_survive_the_way_through_pixels(fine: int) -> None:
    """A code drawn in `fine` x `fine` pixels a cell, averaged over cells, is the code again."""
    grid = (2, 3)
    codes = make_codes("bernoulli", grid, 4, dual="complement", seed=1)
    frames = build_frames(bench_rig.pairs(codes), grid, window="whole", schedule="none", passes=1)
    cell = oracles.cell_of(grid, fine)
    for k, bits in enumerate(codes.primal):
        drawn = oracles.pixel_targets(frames, k, fine, True, (0.0, 0.0))
        means = np.bincount(cell, weights=drawn) / fine**2
        np.testing.assert_array_equal(means, bits)


def test_r4_paths_within_a_cell_count_as_direct_and_all_others_the_same() -> None:
    """Pixel pairs, not cells: around each window the whole code cell is 0, exactly; with more
    Hadamard codes than cells all other pairs meet K / 4 times."""
    grid, fine, count = (2, 2), 4, 16
    codes = make_codes("hadamard", Lattice(grid, "quarter").shape, count, dual="complement", seed=2)
    frames = build_frames(bench_rig.pairs(codes), grid, window="quarter", schedule="none", passes=1)
    meets = np.zeros((64, 64))
    for k in range(len(frames)):
        lit = oracles.pixel_targets(frames, k, fine, True, (0.0, 0.0))
        opened = oracles.pixel_targets(frames, k, fine, False, (0.0, 0.0))
        meets += np.outer(opened, lit)
    y, x = np.divmod(np.arange(64), grid[1] * fine)
    y, x = (y + 0.5) / fine, (x + 0.5) / fine
    same = np.zeros((64, 64), dtype=bool)
    for n in range(64):
        down = 0.0 if 0.25 <= y[n] % 1.0 < 0.75 else 0.5
        right = 0.0 if 0.25 <= x[n] % 1.0 < 0.75 else 0.5
        own = (np.floor(y[n] + down), np.floor(x[n] + right))
        same[n] = (np.floor(y + down) == own[0]) & (np.floor(x + right) == own[1])
    assert np.all(meets[same] == 0.0)
    assert np.all(meets[~same] == count / 4)
    shown = show(codes.primal, codes.dual, grid, window="quarter")
    own_means, _ = oracles.to_cells(meets, grid, fine)
    np.testing.assert_allclose(shown.dense() / catalogue_rig.REFRESH_S, own_means, rtol=1e-12)


def test_r5_robust_sequence_costs_a_twelfth_and_indirect_light_a_quarter_of_that() -> None:
    """30 s of refreshes gather 0.625 s of floodlight."""
    request = CaptureRequest(goal="indirect", codes=128, window="quarter", white=False)
    plan = make_plan(request, Config(), (48, 64))
    shot = plan.recipe.shots[0]
    assert 30.0 * plan.light_share(shot) == pytest.approx(0.625, rel=1e-3)


def test_r6_skew_of_one_refresh_is_harmless_and_more_is_not() -> None:
    codes = make_codes("hadamard", GRID, 32, dual="complement", seed=1)
    for refreshes, leaks in ((-1.0, False), (1.0, False), (1.2, True), (-1.2, True)):
        mask = PanelOptics(skew_ns=round(refreshes * REFRESH_NS))
        shown = show(codes.primal, codes.dual, GRID, mask=mask)
        assert bool(shown.coaxial.max() > 1e-9) is leaks
