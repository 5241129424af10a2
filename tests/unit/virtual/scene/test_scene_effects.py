"""Every effect against its own matrix, and the matrix against a definition written as loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse

from pdcd.virtual.scene import kernel as kernel_module
from pdcd.virtual.scene.effects import (
    Array,
    DenseEffect,
    DirectEffect,
    Effect,
    LowRankEffect,
    SparseEffect,
    make_tint,
    make_two_way_paths,
)
from pdcd.virtual.scene.kernel import KernelEffect, make_gaussian_kernel
from pdcd.virtual.scene.radiosity import Radiosity, Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene

Maker = Callable[[tuple[int, int], np.random.Generator], Effect]


def make_direct(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    return DirectEffect("d", rng.random(grid[0] * grid[1]))


def make_low_rank(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    n = grid[0] * grid[1]
    return LowRankEffect("l", rng.random((n, 2)), rng.random((n, 2)))


def make_sparse(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    n = grid[0] * grid[1]
    return SparseEffect(
        "s", scipy.sparse.csr_array(rng.random((n, n)) * (rng.random((n, n)) < 0.1))
    )


def make_dense(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    n = grid[0] * grid[1]
    return DenseEffect("m", rng.random((n, n)))


def make_gaussian(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    n = grid[0] * grid[1]
    return KernelEffect(
        "g", grid, make_gaussian_kernel(grid, (1.0, 0.8), 1.7), rng.random(n), rng.random(n)
    )


def make_any_kernel(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    n = grid[0] * grid[1]
    return KernelEffect("k", grid, rng.random((5, 3)), rng.random(n), rng.random(n))


def make_radiosity(grid: tuple[int, int], rng: np.random.Generator) -> Effect:
    n = grid[0] * grid[1]
    height = 2.0 * rng.random(grid)
    return make_radiosity_effects(
        "r", Relief(height, (1.0, 0.8)), 0.9 * rng.random((n, 1)), [np.ones(3)]
    )[0]


MAKERS: tuple[Maker, ...] = (
    make_direct,
    make_low_rank,
    make_sparse,
    make_dense,
    make_gaussian,
    make_any_kernel,
    make_radiosity,
)
GRIDS = [(1, 1), (1, 7), (5, 1), (4, 6), (7, 11), (13, 17)]


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("maker", MAKERS)
def test_apply_probe_and_diagonal_agree_with_the_matrix(
    maker: Maker, grid: tuple[int, int]
) -> None:
    rng = np.random.default_rng(1)
    effect = maker(grid, rng)
    n = grid[0] * grid[1]
    matrix = effect.dense()
    light, left, right = rng.random((3, n)), rng.normal(size=(5, n)), rng.normal(size=(5, n))
    probing = left.T @ right
    scale = max(1.0, float(matrix.max()) * n)
    assert matrix.shape == (n, n)
    np.testing.assert_allclose(effect.apply(light), light @ matrix.T, atol=1e-12 * scale)
    np.testing.assert_allclose(
        effect.probe(left, right), (probing * matrix).sum(axis=1), atol=1e-12 * scale
    )
    np.testing.assert_allclose(effect.diagonal(), np.diag(matrix), atol=1e-12)
    seen, lit = rng.integers(0, n, (2, 40))
    columns = effect.apply(np.eye(n))  # what each cell lit alone makes seen
    np.testing.assert_allclose(effect.entries(seen, lit), columns[lit, seen], atol=1e-12 * scale)


@pytest.mark.parametrize("maker", MAKERS)
def test_inputs_are_left_as_they_were(maker: Maker) -> None:
    effect = maker((3, 4), np.random.default_rng(2))
    light = np.random.default_rng(3).random((2, 12))
    before = light.copy()
    effect.apply(light)
    effect.probe(light, light)
    effect.diagonal()[:] = -1.0
    effect.dense()[:] = -1.0
    np.testing.assert_array_equal(light, before)
    assert effect.dense().min() >= 0.0
    assert effect.diagonal().min() >= 0.0


def test_kernel_matrix_is_the_sum_over_offsets() -> None:
    rng = np.random.default_rng(4)
    rows, cols = 3, 4
    taps, out, into = rng.random((3, 5)), rng.random(12), rng.random(12)
    expected = np.zeros((12, 12))
    for y_to in range(rows):
        for x_to in range(cols):
            for y_from in range(rows):
                for x_from in range(cols):
                    down, across = y_to - y_from, x_to - x_from
                    if abs(down) <= 1 and abs(across) <= 2:
                        n, m = y_to * cols + x_to, y_from * cols + x_from
                        expected[n, m] = out[n] * taps[down + 1, across + 2] * into[m]
    np.testing.assert_array_equal(
        KernelEffect("k", (rows, cols), taps, out, into).dense(), expected.astype(np.float64)
    )


def test_low_rank_and_radiosity_matrices_are_their_products() -> None:
    rng = np.random.default_rng(5)
    a, b = rng.random((4, 2)), rng.random((4, 2))
    low = LowRankEffect("l", a, b).dense()
    for n in range(4):
        for m in range(4):
            assert low[n, m] == pytest.approx(sum(a[n, j] * b[m, j] for j in range(2)), rel=1e-14)

    albedo, exchange = rng.random(6), rng.random((4, 4))
    down, across = rng.random((2, 2)), rng.random((3, 2))
    matrix = Radiosity("r", (2, 3), albedo, exchange, down, across).dense()
    for n in range(6):
        for m in range(6):
            total = 0.0
            for i in range(4):
                for j in range(4):
                    to = down[n // 3, i // 2] * across[n % 3, i % 2]
                    start = down[m // 3, j // 2] * across[m % 3, j % 2]
                    total += to * exchange[i, j] * start
            assert matrix[n, m] == pytest.approx(albedo[n] * total * albedo[m], rel=1e-13)


def test_both_routes_of_a_kernel_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    grid, light = (9, 11), rng.random((4, 99))
    taps, ones = rng.random((17, 21)), np.ones(99)
    monkeypatch.setattr(kernel_module, "FFT_COST", 0)
    by_fourier = KernelEffect("k", grid, taps, ones, ones)
    spread = by_fourier.apply(light)
    assert by_fourier._factors == ()
    monkeypatch.setattr(kernel_module, "FFT_COST", 10**9)
    separable = KernelEffect("k", grid, taps, ones, ones)
    np.testing.assert_allclose(separable.apply(light), spread, rtol=1e-12)
    assert len(separable._factors) == 17
    np.testing.assert_allclose(spread, light @ separable.dense().T, rtol=1e-12)


def test_a_gaussian_is_one_separable_term_and_keeps_its_light() -> None:
    grid = (40, 50)
    taps = make_gaussian_kernel(grid, (0.5, 0.25), 1.0)
    assert taps.shape == (79, 99)
    assert taps.sum() == pytest.approx(1.0, abs=1e-12)
    offsets = 0.5 * np.arange(-39, 40)
    assert (taps.sum(axis=1) * offsets**2).sum() == pytest.approx(1.0, rel=1e-6)
    ones = np.ones(2000)
    kernel = KernelEffect("g", grid, taps, ones, ones)
    assert len(kernel._factors) == 1
    # The centre keeps nearly all; a corner loses what lies beyond two edges.
    lit = np.zeros((2, 2000))
    lit[0, 20 * 50 + 25], lit[1, 0] = 1.0, 1.0
    back = kernel.apply(lit).sum(axis=1)
    assert back[0] == pytest.approx(1.0, abs=1e-6)
    assert 0.25 < back[1] < 0.5


def test_both_ways_adds_the_reverse_of_every_path() -> None:
    one_way = scipy.sparse.coo_array(([0.5, 0.25], ([0, 2], [1, 0])), shape=(3, 3))
    matrix = make_two_way_paths("m", one_way, np.ones(3)).dense()
    np.testing.assert_array_equal(matrix, [[0, 0.5, 0.25], [0.5, 0, 0], [0.25, 0, 0]])


def small_scene(ambient: Array | None = None) -> Scene:
    rng = np.random.default_rng(9)
    grid, n = (3, 4), 12
    effects = (
        DirectEffect("direct", rng.random(n), tint=make_tint(1.0, 0.5, 0.25)),
        KernelEffect("blur", grid, rng.random((3, 3)), rng.random(n), rng.random(n)),
        LowRankEffect(
            "veil", rng.random((n, 1)), rng.random((n, 1)), tint=make_tint(0.1, 0.2, 0.3)
        ),
        DenseEffect("rest", rng.random((n, n)), tint=make_tint(0.3, 0.1, 0.0)),
    )
    return Scene("small", grid, effects, ambient)


def test_scene_views_agree_with_its_matrix() -> None:
    scene = small_scene()
    whole = scene.dense()
    np.testing.assert_allclose(
        whole, sum(e.tint[:, None, None] * e.dense() for e in scene.effects), rtol=1e-15
    )
    np.testing.assert_allclose(scene.white(), whole.sum(axis=2).T, rtol=1e-13)
    direct, indirect = scene.split()
    np.testing.assert_allclose(direct, np.diagonal(whole, axis1=1, axis2=2).T, rtol=1e-14)
    off = whole * (1 - np.eye(12))
    np.testing.assert_allclose(indirect, off.sum(axis=2).T, rtol=1e-12)
    light = np.random.default_rng(10).random((5, 12))
    np.testing.assert_allclose(
        scene.apply(light), np.einsum("cnm,bm->bnc", whole, light), rtol=1e-13
    )


def test_photo_takes_direct_light_and_ambient_by_their_own_times() -> None:
    rng = np.random.default_rng(12)
    scene = small_scene(ambient=rng.random((12, 3)))
    left, right, zero = rng.random((7, 12)), rng.random((7, 12)), np.zeros(12)
    coaxial, open_s = rng.random(12), rng.random(12)
    photo = scene.photo(left, right, coaxial, open_s)
    whole = scene.dense()
    first = scene.effects[0]
    whole -= first.tint[:, None, None] * first.dense()
    expected = np.einsum("nm,cnm->nc", left.T @ right, whole)
    expected += coaxial[:, None] * first.diagonal()[:, None] * first.tint
    assert scene.ambient is not None
    expected += open_s[:, None] * scene.ambient
    np.testing.assert_allclose(photo, expected, rtol=1e-13)

    first_part = scene.photo(left[:3], right[:3], coaxial, open_s)
    second_part = scene.photo(left[3:], right[3:], zero, zero)
    np.testing.assert_allclose(first_part + second_part, photo, rtol=1e-13)
