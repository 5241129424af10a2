"""Each row of Tables 1 and 2 as a plain matrix is photographed as well as by its own goal."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.recipes.make import make_recipe
from tests import dense_recipe
from tests.sampled import sampled

GRID = (12, 16)
ROWS, COLS = GRID
N = ROWS * COLS
Floats = NDArray[np.float64]
RNG = np.random.default_rng(15)
LIGHT = np.round(0.1 + 0.9 * RNG.random(N), 3)
WARP = RNG.permutation(N)
WARP_B = np.where(RNG.random(N) < 0.2, -1, RNG.integers(0, N, N))
A, B = ((RNG.random(N) < 0.4).astype(float) for _ in range(2))
KERNEL = np.round(RNG.normal(size=(3, 3)), 2)


def matrix(entry: Any) -> Floats:
    return np.array([[float(entry(n, m)) for m in range(N)] for n in range(N)])


def far(n: int, m: int) -> int:
    return max(abs(n // COLS - m // COLS), abs(n % COLS - m % COLS))


def step(n: int, down: int, right: int) -> int:
    """m = n + w, or -1 beyond the border."""
    r, c = n // COLS + down, n % COLS + right
    return r * COLS + c if 0 <= r < ROWS and 0 <= c < COLS else -1


def tap(n: int, m: int) -> float:
    down, right = n // COLS - m // COLS, n % COLS - m % COLS
    return float(KERNEL[down + 1, right + 1]) if max(abs(down), abs(right)) <= 1 else 0.0


@cache
def transport() -> Floats:
    """Direct light, light that stays near, and light that goes everywhere."""
    rng = np.random.default_rng(2)
    albedo = 0.5 + 0.5 * rng.random(N)
    near = matrix(lambda n, m: 0.05 / (1 + far(n, m) ** 2))
    return np.asarray(albedo[:, None] * (near + 0.002) * albedo + np.diag(0.5 * albedo))


# id of the row: the goal that is made for it, its arrays and numbers, and the matrix's elements.
TABLES: dict[str, tuple[str, dict[str, Any], dict[str, Any], Callable[[int, int], float]]] = {
    "T1.1": ("illuminated", {"illumination": LIGHT}, {}, lambda n, m: LIGHT[m]),
    "T1.2": ("illuminated", {"illumination": LIGHT}, {}, lambda n, m: LIGHT[m]),
    "T1.3": ("diagonal", {}, {}, lambda n, m: n == m),
    "T1.4": ("off-diagonal", {}, {"shift": (1, -2)}, lambda n, m: step(n, 1, -2) == m),
    "T1.5": ("warped", {"warp": WARP}, {}, lambda n, m: WARP[n] == m),
    "T1.6": (
        "two-samples", {"warp": WARP, "warp_b": WARP_B}, {"mix": (0.75, -0.5)},
        lambda n, m: 0.75 * (WARP[n] == m) - 0.5 * (WARP_B[n] == m),
    ),
    "T1.7": ("indirect", {"illumination": LIGHT}, {}, lambda n, m: (n != m) * LIGHT[m]),
    "T2.1": ("diagonal", {}, {}, lambda n, m: n == m),
    "T2.2": ("indirect", {}, {}, lambda n, m: n != m),
    "T2.3": ("long-range", {}, {"radius": 2}, lambda n, m: far(n, m) > 2),
    "T2.4": ("short-range", {}, {"radius": 2}, lambda n, m: 0 < far(n, m) <= 2),
    "T2.5": (
        "blocked", {"region_a": A, "region_b": B}, {}, lambda n, m: 1 - A[n] * B[m]
    ),
    "T2.6": (
        "descattered", {}, {"shift": (0, -1)},
        lambda n, m: (step(n, 0, -1) >= 0) * ((n == m) - 1.0 * (step(n, 0, -1) == m)),
    ),
    "T2.7": ("filtered", {"kernel": KERNEL}, {}, tap),
    "Fig. 8": ("fraction", {}, {"p": 0.25}, lambda n, m: 1.0 if n == m else 0.25),
    "Fig. 9(d)": (
        "off-diagonal", {}, {"shift": (0, 1), "p": 0.25},
        lambda n, m: (step(n, 0, 1) >= 0) * (1.0 if step(n, 0, 1) == m else 0.25),
    ),
    "Fig. 11": ("indirect", {"warp": WARP}, {}, lambda n, m: WARP[n] != m),
    "two warps but white": (
        "fraction", {"warp": WARP}, {"p": 0.5}, lambda n, m: 1.0 if WARP[n] == m else 0.5
    ),
}  # fmt: skip


@pytest.mark.parametrize("row", TABLES)
def test_row_as_a_plain_matrix_is_as_good_as_its_goal(row: str) -> None:
    name, arrays, numbers, entry = TABLES[row]
    pi = matrix(entry)
    own = dense_recipe.target(GRID, name, arrays, **numbers)
    plain = dense_recipe.target(GRID, "relit", {"matrix": pi})
    errors = []
    for target in (own, plain):
        recipe, realised = dense_recipe.matrix_of(target, CaptureScheme())
        errors.append(dense_recipe.error(realised, pi, transport()))
    assert errors[1] <= max(1.1 * errors[0], 1e-6)
    assert recipe.split and recipe.pictures.keys() == {"relit"}
    if row in ("T1.1", "T1.2", "T2.5"):  # levels are kept in single precision
        assert np.abs(realised - pi).max() < 1e-6
    if row in ("T2.2", "Fig. 11"):  # what is blocked is blocked exactly, and little else
        assert np.abs(realised[pi == 0.0]).max() == 0.0
        assert errors[1] < 0.01


@pytest.mark.parametrize("kept", [0.3, 1.7, 3.3, -0.5])
def test_any_weight_of_the_matched_cell(kept: float) -> None:
    pi = np.ones((N, N))
    pi[np.arange(N), WARP] = kept
    _, realised = dense_recipe.matrix_of(
        dense_recipe.target(GRID, "relit", {"matrix": pi}), CaptureScheme()
    )
    assert dense_recipe.error(realised, pi, transport()) < 0.02
    np.testing.assert_allclose(realised[np.arange(N), WARP], kept, atol=1e-5)


@pytest.mark.parametrize("rank", sampled([3, 1, 9], 3))
def test_matrices_of_low_rank_are_exact(rank: int) -> None:
    rng = np.random.default_rng(rank)
    seen, lit = rng.random((rank, N)), rng.random((rank, N))
    sparse = seen * (rng.random(seen.shape) < 0.5)
    recipe, realised = dense_recipe.matrix_of(
        dense_recipe.target(GRID, "relit", {"matrix": sparse.T @ lit}), CaptureScheme()
    )
    np.testing.assert_allclose(realised, sparse.T @ lit, atol=1e-6 * (sparse.T @ lit).max())
    assert len(recipe.shots) <= (1 if rank < 9 else 2)


@pytest.mark.parametrize("lit", [None, "half"])
@pytest.mark.parametrize("rank", [1, 3])
def test_what_is_wanted_in_all_is_the_matrix_whatever_light_its_photos_have(
    rank: int, lit: str | None
) -> None:
    """Errors are told against it: photos of a light of their own must not lose that."""
    rng = np.random.default_rng(40 + rank)
    pi = rng.random((rank, N)).T @ rng.random((rank, N))
    if rank == 3:
        pi[np.arange(N), WARP] += 1.0
    light = None if lit is None else 0.25 + 0.5 * rng.random(N)
    arrays = {"matrix": pi} if light is None else {"matrix": pi, "illumination": light}
    wanted = dense_recipe.target(GRID, "relit", arrays)
    recipe = make_recipe(wanted, CaptureScheme())
    expected = pi if light is None else pi * light
    np.testing.assert_allclose(recipe.wanted.dense(), expected, atol=1e-5 * expected.max())
    image = np.arange(1.0, N + 1.0, dtype=np.float64)
    others = (expected - np.diag(expected.diagonal())) @ image
    found = recipe.wanted.others(image[None])[0]
    np.testing.assert_allclose(found, others, rtol=1e-4)
    squares = np.sum(expected**2, axis=1) - expected.diagonal() ** 2
    np.testing.assert_allclose(recipe.wanted.squares(), squares, rtol=1e-4)


def test_sums_of_everything_say_what_they_are() -> None:
    rng = np.random.default_rng(8)
    pi = rng.random((N, 2)) @ rng.random((2, N)) - 0.5 * matrix(lambda n, m: WARP[n] == m)
    pi += 0.5 * matrix(lambda n, m: far(n, m) <= 2)
    plain = dense_recipe.target(GRID, "relit", {"matrix": pi})
    recipe, realised = dense_recipe.matrix_of(plain, CaptureScheme())
    assert dense_recipe.error(realised, pi, transport()) < 0.005
    told = "; ".join(recipe.split)
    assert all(part in told for part in ("rank 2", "within 2 cells", "one cell each"))
    np.testing.assert_allclose(recipe.wanted.dense(), pi, atol=1e-6 * pi.max())


def test_noise_is_photographed_as_a_rest() -> None:
    pi = 1.0 - np.eye(N) + 1e-3 * np.random.default_rng(9).standard_normal((N, N))
    recipe, realised = dense_recipe.matrix_of(
        dense_recipe.target(GRID, "relit", {"matrix": pi}), CaptureScheme()
    )
    assert dense_recipe.error(realised, pi, transport()) < 0.01
    assert any("the rest" in line for line in recipe.split)


def test_what_a_warp_matches_is_counted_alone_although_codes_are_shared() -> None:
    """Direct light of a cell that shares its column with its partner would come through whole."""
    goal = dense_recipe.target(GRID, "warped", {"warp": WARP.astype(float)})
    _, realised = dense_recipe.matrix_of(goal, CaptureScheme())
    pi = matrix(lambda n, m: WARP[n] == m)
    other = realised[np.arange(N), np.arange(N)][WARP != np.arange(N)]
    assert np.abs(other).max() < 1e-9
    assert dense_recipe.error(realised, pi, transport()) < 0.5


def test_of_two_matches_the_one_that_most_cells_have_gets_the_codes_with_partners() -> None:
    """The other one has cells that see nothing of it, and they would want photos of their own."""
    pi = matrix(lambda n, m: 1.0 - 0.5 * (WARP_B[n] == m) - (WARP[n] == m))
    recipe, realised = dense_recipe.matrix_of(
        dense_recipe.target(GRID, "relit", {"matrix": pi}), CaptureScheme()
    )
    assert "unmatched" not in {photo.name for photo in recipe.photos}
    assert dense_recipe.error(realised, pi, transport()) < 0.05


def test_stripes_under_a_warp_keep_all_but_the_matched_cell() -> None:
    goal = dense_recipe.target(GRID, "split", {"warp": WARP_B.astype(float)}, period=4)
    recipe = make_recipe(goal, CaptureScheme())
    for photo in recipe.photos:
        dense = photo.wanted.dense()
        lit = dense.max(axis=0)
        blocked = matrix(lambda n, m: (WARP_B[n] >= 0) and WARP_B[n] != m)
        np.testing.assert_array_equal(dense, blocked * lit)
        assert lit.mean() == 0.5


def test_what_scattered_weights_have_in_common_is_a_photo_of_its_own() -> None:
    """Direct light keeps its weight, of few codes too, but for the scale of the photo."""
    pi = np.random.default_rng(50).random((N, N))
    wanted = dense_recipe.target(GRID, "relit", {"matrix": pi})
    recipe, realised = dense_recipe.matrix_of(wanted, CaptureScheme(codes=16))
    assert {photo.name for photo in recipe.photos} == {"even", "matched"}
    assert np.abs(realised - pi).diagonal().max() < 0.05
