"""Levels that programs send to both panels, against loops over their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import shift_cells
from pdcd.recipes.programs import (
    BlockProgram,
    CodedProgram,
    GainProgram,
    IlluminatedProgram,
    LongRangeProgram,
    SignedBlockProgram,
    SignedMatrixProgram,
    SignedProgram,
    extend_partners,
    extend_values,
    find_inner_program,
)

GRID = (3, 4)
N, K = 12, 5
WHOLE, QUARTER = Lattice(GRID), Lattice(GRID, "quarter")
RNG = np.random.default_rng(3)
BITS = RNG.integers(0, 2, (K, N)).astype(np.bool_)
WARP = np.array([3, 1, -1, 0, 7, 7, 2, 11, -1, 5, 6, 4])
Floats = NDArray[np.float64]


def signs(bits: NDArray[np.bool_]) -> Floats:
    return np.where(bits, 1.0, -1.0)


def halves(mask: Floats, *, positive: bool) -> tuple[NDArray[np.bool_], Floats]:
    """Both pairs of each code in turn, of masks (K, N) of both signs."""
    lights, masks = [], []
    scaled = mask / np.abs(mask).max()
    for bits, row in zip(BITS, scaled, strict=True):
        lights += [bits, ~bits]
        sides = [np.maximum(row, 0.0), np.maximum(-row, 0.0)]
        masks += sides if positive else sides[::-1]
    return np.array(lights), np.array(masks)


@pytest.mark.parametrize("complement", [False, True])
def test_a_mask_shows_the_code_of_each_partner_or_its_complement(complement: bool) -> None:
    program = CodedProgram(WARP, complement)
    primal, dual = program.pairs(BITS, WHOLE)
    assert primal is BITS
    for k in range(K):
        for n, m in enumerate(WARP):
            assert dual[k, n] == (m >= 0 and BITS[k, m] != complement)


def test_partners_may_be_a_shift_or_the_cells_themselves() -> None:
    _, own = CodedProgram(None, True).pairs(BITS, WHOLE)
    np.testing.assert_array_equal(own, ~BITS)
    _, beside = CodedProgram((1, -1), False).pairs(BITS, WHOLE)
    expected = np.zeros((K, N), np.bool_)
    for row in range(2):
        for col in range(1, 4):
            expected[:, row * 4 + col] = BITS[:, (row + 1) * 4 + col - 1]
    np.testing.assert_array_equal(beside, expected)


def test_an_illumination_and_a_gain_dim_one_panel_each() -> None:
    light, gain = RNG.random(N), RNG.random(N)
    inner = CodedProgram(None, True, 0.25)
    primal, dual = IlluminatedProgram(inner, light).pairs(BITS, WHOLE)
    np.testing.assert_allclose(primal, BITS * light)
    np.testing.assert_array_equal(dual, ~BITS)
    primal, dual = GainProgram(inner, gain).pairs(BITS, WHOLE)
    np.testing.assert_array_equal(primal, BITS)
    np.testing.assert_allclose(dual, ~BITS * gain)
    both = GainProgram(IlluminatedProgram(inner, light), gain)
    assert both.p == 0.25 and both.coded and find_inner_program(both) is inner
    assert not IlluminatedProgram(BlockProgram(light, light), light).coded


@pytest.mark.parametrize("positive", [True, False])
def test_signed_codes_show_a_sum_over_partners_in_two_halves(positive: bool) -> None:
    program = SignedProgram(((2.0, WARP), (-0.5, None), (1.5, (0, 1))), positive)
    h = signs(BITS)
    mask = np.zeros((K, N))
    for k in range(K):
        for n in range(N):
            mask[k, n] = -0.5 * h[k, n]
            mask[k, n] += 2.0 * h[k, WARP[n]] if WARP[n] >= 0 else 0.0
            mask[k, n] += 1.5 * h[k, n + 1] if n % 4 < 3 else 0.0
    primal, dual = program.pairs(BITS, WHOLE)
    wanted = halves(mask, positive=positive)
    np.testing.assert_array_equal(primal, wanted[0])
    np.testing.assert_allclose(dual, wanted[1])


def test_a_sum_of_nothing_keeps_the_mask_closed() -> None:
    _, dual = SignedProgram(((0.0, None),), True).pairs(BITS, WHOLE)
    assert dual.shape == (2 * K, N) and not dual.any()


@pytest.mark.parametrize("positive", [True, False])
def test_any_matrix_is_shown_as_its_product_with_the_codes(positive: bool) -> None:
    matrix = RNG.standard_normal((N, N))
    program = SignedMatrixProgram(matrix, positive)
    primal, dual = program.pairs(BITS, WHOLE)
    h = signs(BITS)
    plain = h @ matrix.T
    # The diagonal of what the codes count, entry by entry, made what it should be.
    counted = plain.T @ h / len(h)
    own = np.array([matrix[n, n] - counted[n, n] for n in range(N)])
    assert np.abs(own).max() > 0.1
    wanted = halves(plain + own * h, positive=positive)
    np.testing.assert_array_equal(primal, wanted[0])
    np.testing.assert_allclose(dual, wanted[1])
    realised = (plain + own * h).T @ h / len(h)
    np.testing.assert_allclose(np.diag(realised), np.diag(matrix), atol=1e-12)


def test_codes_beyond_the_grid_do_not_enter_a_matrix() -> None:
    matrix = RNG.standard_normal((N, N))
    bits = RNG.random((K, 20)) < 0.5
    _, dual = SignedMatrixProgram(matrix, True).pairs(bits, QUARTER)
    inner = bits.reshape(K, 4, 5)[:, :3, :4].reshape(K, N)
    h = signs(inner)
    plain = h @ matrix.T
    grid = (plain + (matrix.diagonal() - np.mean(plain * h, axis=0)) * h).reshape(K, 3, 4)
    mask = np.pad(grid, ((0, 0), (0, 1), (0, 1)), mode="edge").reshape(K, 20)
    np.testing.assert_allclose(dual[0::2] - dual[1::2], mask / np.abs(mask).max(), atol=1e-12)


@pytest.mark.parametrize("positive", [True, False])
def test_exact_blocks_of_both_signs(positive: bool) -> None:
    camera, projector = RNG.standard_normal((2, N)), RNG.standard_normal((2, N))
    program = SignedBlockProgram(camera, projector, positive)
    lights, masks = program.pairs(BITS, WHOLE)
    assert lights.shape == masks.shape == (4, N)
    assert lights.min() >= 0.0 and masks.min() >= 0.0
    assert lights.max() == 1.0 and masks.max() == 1.0
    other = SignedBlockProgram(camera, projector, not positive).pairs(BITS, WHOLE)
    sign = 1.0 if positive else -1.0
    difference = masks.T @ lights - other[1].T @ other[0]
    exact = camera.T @ projector / np.abs(camera).max() / np.abs(projector).max()
    np.testing.assert_allclose(sign * difference, exact, atol=1e-12)
    # Products of one sign are in one half alone.
    np.testing.assert_allclose(masks.T @ lights, sum(
        np.maximum(sign * np.outer(c, p), 0.0) for c, p in zip(camera, projector, strict=True)
    ) / np.abs(camera).max() / np.abs(projector).max(), atol=1e-12)  # fmt: skip


@pytest.mark.parametrize(("radius", "p"), [(0, 1.0 / 2.0), (1, 1.0 / 10.0), (2, 1.0 / 26.0)])
def test_far_codes_are_dark_around_what_is_lit(radius: int, p: float) -> None:
    program = LongRangeProgram(radius)
    assert program.coded and program.p == pytest.approx(p)
    bits = np.zeros((3, N), np.bool_)
    bits[0, 0] = bits[1, 6] = True
    primal, dual = program.pairs(bits, WHOLE)
    assert primal is bits and dual[2].all()
    for k, (row, col) in enumerate(((0, 0), (1, 2))):
        for n in range(N):
            far = max(abs(n // 4 - row), abs(n % 4 - col)) > radius
            assert dual[k, n] == far


def test_partners_go_on_over_the_far_edges() -> None:
    """A quarter window has one row and column more: they have the partner of the last ones, moved
    as far, where that still lies on the lattice."""
    found = extend_partners(WARP, QUARTER).reshape(4, 5)
    for row in range(4):
        for col in range(5):
            inner = WARP[min(row, 2) * 4 + min(col, 3)]
            tr, tc = inner // 4 + max(row - 2, 0), inner % 4 + max(col - 3, 0)
            there = inner >= 0 and tr < 4 and tc < 5
            assert found[row, col] == (tr * 5 + tc if there else -1)
    np.testing.assert_array_equal(extend_partners(None, QUARTER), np.arange(20))
    np.testing.assert_array_equal(extend_partners((0, 1), QUARTER), shift_cells((4, 5), (0, 1)))
    values = np.arange(24.0).reshape(2, N)
    wide = np.pad(values.reshape(2, 3, 4), ((0, 0), (0, 1), (0, 1)), mode="edge")
    np.testing.assert_array_equal(extend_values(values, QUARTER), wide.reshape(2, 20))
