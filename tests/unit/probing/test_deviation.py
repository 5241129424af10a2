"""Sums over rows of probing matrices, against the matrices themselves."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.probing.deviation import compute_row_deviations, row_weights_s
from pdcd.probing.realised import Factors, sum_signed_factors
from pdcd.probing.wanted import (
    FullPart,
    Grid,
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
    shift_cells,
)
from tests import bench_rig

Floats = NDArray[np.float64]
EPS = float(np.finfo(np.float64).eps)

GRIDS = [(1, 1), (1, 7), (6, 8)]
SUMS = [
    "u",
    "u same",
    "warp shift",
    "near1 near3",
    "outer near3 warp",
    "full near1 warp outer same u",
]


def part(name: str, grid: Grid, rng: np.random.Generator) -> MatrixPart:
    n = grid[0] * grid[1]
    match name:
        case "u":
            return UniformPart(n)
        case "same":
            return MatchPart(np.arange(n))
        case "warp":
            return MatchPart(rng.integers(-1, n, n))
        case "shift":
            return MatchPart(shift_cells(grid, (1, -1)))
        case "near1" | "near3":
            return NearPart(grid, int(name[-1]))
        case "outer":
            return OuterPart(rng.normal(size=n), rng.normal(size=n))
    return FullPart(rng.normal(size=(n, n)))


def some_sum(names: str, grid: Grid, *, lit: bool) -> WantedMatrix:
    """A sum of such parts with weights at random, under a light that is dark here and there."""
    rng = np.random.default_rng(len(names))
    light = rng.random(grid[0] * grid[1]) if lit else None
    if light is not None:
        light[light < 0.3] = 0.0
    parts = tuple((float(rng.normal()), part(name, grid, rng)) for name in names.split())
    return WantedMatrix(grid, parts, light)


def some_factors(cells: int, rank: int = 9, seed: int = 0) -> Factors:
    rng = np.random.default_rng(seed)
    left, right = rng.normal(size=(2, rank, cells))
    return Factors(left, right, rng.random(cells), np.ones(cells))


@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("names", SUMS)
@pytest.mark.parametrize("grid", GRIDS)
def test_weights_and_deviations_are_those_of_the_matrices(
    grid: Grid, names: str, lit: bool
) -> None:
    wanted, got = some_sum(names, grid, lit=lit), some_factors(grid[0] * grid[1])
    whole, matrix = wanted.dense(), got.dense()
    np.fill_diagonal(matrix, got.coaxial)
    inner, norm = row_weights_s(got, wanted)
    np.testing.assert_allclose(inner, (matrix * whole).sum(axis=1), atol=1e-11)
    np.testing.assert_allclose(norm, (whole**2).sum(axis=1), atol=1e-11)
    mean, square, diagonal = exact(got, wanted, 0.7)
    found = compute_row_deviations(got, wanted, 0.7)
    np.testing.assert_allclose(found[0], mean, atol=1e-11)
    np.testing.assert_allclose(found[1] + found[0] ** 2, square, atol=1e-11)
    np.testing.assert_allclose(found[2], diagonal, atol=1e-11)


def exact(got: Factors, wanted: WantedMatrix, weight: float) -> tuple[Floats, Floats, Floats]:
    """Mean and mean square off the diagonal, and the diagonal, by sums of 64 bits of mantissa."""
    n = wanted.cells
    error = got.left.T.astype(np.longdouble) @ got.right.astype(np.longdouble) / weight
    error -= wanted.dense()
    np.fill_diagonal(error, 0.0)
    others = max(n - 1, 1)
    mean, square = error.sum(axis=1) / others, (error**2).sum(axis=1) / others
    diagonal = got.coaxial / weight - wanted.dense().diagonal()
    return mean.astype(np.float64), square.astype(np.float64), diagonal


def bound(got: Factors, wanted: WantedMatrix, weight: float) -> Floats:
    """What `compute_row_deviations` promises of its mean squares, (N,)."""
    camera, projector = wanted.products()
    left = np.concatenate([got.left / weight, camera])
    right = np.concatenate([got.right, projector])
    size = np.abs(left).T @ np.sqrt((right**2).mean(axis=1)) + np.abs(wanted.dense()).max()
    return np.asarray(32.0 * EPS * size**2)


def coded(grid: Grid, count: int, leak: float = 0.0, unit: float = 1.0) -> Factors:
    """Indirect codes on panels of which the dark cells leak, each shown for `unit` seconds."""
    codes = make_codes("hadamard", grid, count, dual="complement", seed=count)
    left = np.where(codes.dual, 1.0, leak)
    right = np.where(codes.primal, 1.0, leak)
    n = grid[0] * grid[1]
    return Factors(unit * left, right, np.sum(unit * left * right, axis=0), np.full(n, unit))


@pytest.mark.parametrize("names", ["u same", "u near1", "warp same", "outer shift"])
@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize(
    ("got", "grid"),
    [
        (coded((6, 8), 64), (6, 8)),
        (coded((12, 16), 16), (12, 16)),
        (coded((1, 40), 64, leak=0.01), (1, 40)),
        (coded((12, 16), 32, leak=0.01, unit=1e-7), (12, 16)),
        (coded((12, 16), 256, unit=1e6), (12, 16)),
        (some_factors(48, rank=60), (6, 8)),
        (
            sum_signed_factors(
                [
                    (1.0, coded((6, 8), 64, leak=0.1)),
                    (-1.0, coded((6, 8), 64, leak=0.1)),
                    (1.0, coded((6, 8), 32)),
                ]
            ),
            (6, 8),
        ),
    ],
)
def test_mean_squares_keep_their_bound(got: Factors, grid: Grid, names: str, lit: bool) -> None:
    wanted = some_sum(names, grid, lit=lit)
    weight = float(got.left.mean() * got.right.mean()) * len(got.left) or 1.0
    mean, square, _ = exact(got, wanted, weight)
    found = compute_row_deviations(got, wanted, weight)
    assert (found[1] >= 0.0).all()
    assert np.abs(found[0] - mean).max() <= np.sqrt(bound(got, wanted, weight)).max() * 1e-7
    assert (np.abs(found[1] + found[0] ** 2 - square) <= bound(got, wanted, weight)).all()


@pytest.mark.parametrize("cells", [1, 1025, 2049])
def test_weights_of_uniform_goals_do_not_depend_on_blocks(cells: int) -> None:
    """The pictures are divided by them: they are the same to the last bit."""
    got = some_factors(cells, rank=130)
    inner, _ = row_weights_s(got, bench_rig.uniform((1, cells), 0.0, 1.0))
    sums = np.sum(got.left * got.right.sum(axis=1)[:, None], axis=0)
    inside = np.sum(got.left * got.right, axis=0)
    np.testing.assert_array_equal(inner, 0.0 * got.coaxial + 1.0 * (sums - inside))
