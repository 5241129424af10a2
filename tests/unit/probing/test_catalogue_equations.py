"""The paper's equations: each test is named after the row that it checks.

Dense matrices are worked out here; photos come from the program's refreshes and optics. Rows about
what chance does to codes are held against codes that are drawn in the room of plans.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.recipes.programs import SignedProgram
from tests import bench_rig, catalogue_rig
from tests.catalogue_rig import photo, scene_of, show, transport
from tests.taken import take

GRID = (4, 5)
N = 20
T = transport(N)
RNG = np.random.default_rng(3)


def signs(count: int, seed: int, family: str = "bernoulli", grid: tuple[int, int] = GRID) -> Any:
    """+-1 codes (K, N)."""
    bits = make_codes(family, grid, count, dual="same", seed=seed).primal
    return np.where(bits, 1.0, -1.0)


def test_e1_light_transport_with_an_open_mask_is_t_times_i() -> None:
    light = RNG.random((1, N)).astype(np.float32).astype(float)  # panels store single precision
    seen = photo(show(light, np.ones((1, N)), GRID), scene_of(T, GRID))
    np.testing.assert_allclose(seen, T @ light[0], rtol=1e-12)


def test_e1_the_quantised_photo_is_within_half_a_number_of_the_sensor(tmp_path: Path) -> None:
    light = np.round(np.random.default_rng(5).random(bench_rig.GRID), 2)
    config = bench_rig.config(tmp_path)
    made = take(config, goal="illuminated", illumination=light.tolist(), codes=8)
    record, shot = made.manifest.run, made.manifest.run.shots[0]
    gain = record.profile.row(shot.iso).gain_e_per_dn
    weight_s = made.manifest.realised["white"]["weight_s"]
    unit = gain * shot.f_number**2 / np.array(record.responsivity_e) / weight_s
    lit = light.astype(np.float32).astype(float).ravel()
    truth = (bench_rig.transport() @ lit).reshape(*bench_rig.GRID, 1)
    off_dn = np.abs(made.image - truth) / unit
    assert off_dn.max() <= 0.5 + 1e-6
    assert off_dn.max() > 0.05  # it is quantised indeed


def test_e2_probing_equation_holds_for_any_known_matrix() -> None:
    """N pairs, one open cell each, make any matrix; the sum over m is taken by a loop."""
    pi = RNG.random((N, N)).astype(np.float32).astype(float)
    seen = photo(show(pi, np.eye(N), GRID), scene_of(T, GRID))
    brute = [sum(pi[n, m] * T[n, m] for m in range(N)) for n in range(N)]
    np.testing.assert_allclose(seen, brute, rtol=1e-12)


@pytest.mark.parametrize(("family", "exact"), [("hadamard", True), ("bernoulli", False)])
def test_e4_rank_one_split_adds_up_to_the_matrix_that_is_reported(family: str, exact: bool) -> None:
    """Sum of m i^T against 1 - I over 4, in Frobenius norm and largest entry; 0 with K > N."""
    codes = make_codes(family, GRID, 32, dual="complement", seed=2)
    split = sum(np.outer(m, i) for m, i in zip(codes.dual + 0.0, codes.primal + 0.0, strict=True))
    realised = show(codes.primal, codes.dual, GRID).dense() / catalogue_rig.REFRESH_S
    np.testing.assert_allclose(realised, split, rtol=1e-12, atol=1e-12)
    error = split / 32 - 0.25 * (1.0 - np.eye(N))
    frobenius, largest = np.linalg.norm(error), np.abs(error).max()
    if exact:
        assert largest == 0.0
    else:
        # Entries of random codes scatter by sqrt(p(1-p) (1 - p(1-p)) / K) = 0.077 each.
        assert frobenius == pytest.approx(0.0765 * np.sqrt(N * (N - 1)), rel=0.2)


@pytest.mark.parametrize("shift", [(0, 1), (1, -2), (-1, 0)])
def test_e8_mask_of_a_shifted_code_samples_the_off_diagonal(shift: tuple[int, int]) -> None:
    """m_n = i_(n+w) gives T_(n, n+w); cells whose partner is off the grid are closed."""
    h = signs(32, seed=1, family="hadamard")
    bits = h > 0
    pair = [
        SignedProgram(((1.0, shift),), half).pairs(bits, Lattice(GRID)) for half in (True, False)
    ]
    plus, minus = (show(i, m, GRID) for i, m in pair)
    seen = (photo(plus, scene_of(T, GRID)) - photo(minus, scene_of(T, GRID))) / 32
    want = np.zeros(N)
    for n in range(N):
        r, c = n // GRID[1] + shift[0], n % GRID[1] + shift[1]
        if 0 <= r < GRID[0] and 0 <= c < GRID[1]:
            want[n] = T[n, r * GRID[1] + c]
    np.testing.assert_allclose(seen, want, atol=1e-12)
