"""Codes that light cells less than half of the time: partial spreads and projective planes."""

from __future__ import annotations

import itertools
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig
from pdcd.codes.make import make_codes
from pdcd.codes.orders import count_spread_subspaces, make_partial_spread
from pdcd.codes.singer import (
    count_plane_lines,
    make_difference_set,
    make_projective_plane_codes,
)
from pdcd.errors import RequestError
from pdcd.virtual.scene.presets import PRESETS
from tests import bench_rig
from tests.taken import take
from tests.unit.codes._oracles import probing


def off_diagonal(matrix: NDArray[np.int64]) -> NDArray[np.int64]:
    return matrix[~np.eye(len(matrix), dtype=bool)]


@pytest.mark.parametrize(
    ("n", "t"), [(2, 1), (7, 1), (4, 2), (6, 2), (7, 2), (9, 2), (3, 2), (6, 3), (8, 3), (9, 4)]
)
def test_subspaces_of_a_spread_meet_in_zero_alone(n: int, t: int) -> None:
    bases = make_partial_spread(n, t)
    assert bases.shape == (count_spread_subspaces(n, t), t)
    seen: set[int] = set()
    for basis in bases.tolist():
        subsets = itertools.chain.from_iterable(
            itertools.combinations(basis, size) for size in range(t + 1)
        )
        space = {reduce(xor, subset, 0) for subset in subsets}
        assert len(space) == 2**t and max(space) < 2**n  # the basis is independent
        assert not (space - {0}) & seen
        seen |= space - {0}
    if n % t == 0:
        assert len(seen) == 2**n - 1  # a whole spread


@pytest.mark.parametrize(("t", "count"), [(2, 16), (2, 128), (3, 64), (3, 512), (4, 256), (4, 512)])
def test_hadamard_products_meet_in_exactly_the_wanted_number(t: int, count: int) -> None:
    """p K on the diagonal; elsewhere p^2 K but for cells of one product: p K, or 0."""
    p = 0.5**t
    matrix = probing(make_codes("hadamard", (12, 11), count, dual="same", p=p, seed=3))
    assert np.all(np.diag(matrix) == p * count)
    pairs = off_diagonal(matrix)
    assert set(np.unique(pairs)) <= {0, round(p * p * count), round(p * count)}
    spaces = count_spread_subspaces(count.bit_length() - 1, t)
    assert np.mean(pairs == p * p * count) > 1.0 - 1.5 / spaces


@pytest.mark.parametrize(("t", "count"), [(2, 16), (2, 64), (3, 64)])
def test_as_few_cells_as_products_make_the_probing_matrix_exact(t: int, count: int) -> None:
    cells = count_spread_subspaces(count.bit_length() - 1, t)
    p = 0.5**t
    codes = make_codes("hadamard", (1, cells), count, dual="same", p=p, seed=1)
    want = p * count * (p + (1.0 - p) * np.eye(cells))
    assert np.array_equal(probing(codes), want)
    codes = make_codes("hadamard", (1, cells), count, dual="complement", p=p, seed=1)
    assert np.array_equal(probing(codes), p * (1.0 - p) * count * (1.0 - np.eye(cells)))


@pytest.mark.parametrize(
    ("q", "lines"),
    [
        (2, 7),
        (3, 13),
        (4, 21),
        (5, 31),
        (7, 57),
        (8, 73),
        (9, 91),
        pytest.param(16, 273, marks=pytest.mark.long),
    ],
)
def test_singer_codes_of_as_many_cells_keep_direct_and_an_exact_share(q: int, lines: int) -> None:
    """The designs of the catalogue: Pi = q I + 1 1^T in integers, direct and 1/(q + 1) of all
    else; and with the complement as dual q (1 1^T - I), indirect light alone."""
    p = 1.0 / (q + 1)
    assert count_plane_lines(p) == lines
    same = probing(make_codes("singer", (1, lines), lines, dual="same", p=p, seed=5))
    assert np.array_equal(same, q * np.eye(lines) + 1)
    other = probing(make_codes("singer", (1, lines), lines, dual="complement", p=p, seed=5))
    assert np.array_equal(other, q * (1 - np.eye(lines)))


@pytest.mark.parametrize("p", [0.2 + 1e-8, 0.2 - 1e-8, 0.5, 1 / 33, 1 / 7, 0.3, 0.9])
def test_shares_that_no_plane_has_are_refused(p: float) -> None:
    with pytest.raises(RequestError) as caught:
        count_plane_lines(p)
    shares = [3, 4, 5, 6, 8, 9, 10, 12, 14, 17, 18, 20, 24, 26, 28, 30, 32]
    assert str(caught.value.hint).endswith(", ".join(f"1/{n}" for n in shares))


@pytest.mark.parametrize(
    ("q", "wanted"),
    [
        (3, (0, 1, 3, 9)),
        (5, (0, 1, 3, 8, 12, 18)),
        (7, (0, 1, 3, 13, 32, 36, 43, 52)),
        (9, (0, 1, 6, 10, 23, 26, 34, 41, 53, 55)),
        (31, (0, 1, 3, 22)),
    ],
)
def test_planes_keep_their_lines(q: int, wanted: tuple[int, ...]) -> None:
    """Others would do as well, but codes of stored runs are made again by these."""
    found = make_difference_set(q)
    assert found[: len(wanted)] == wanted and len(found) == q + 1


@pytest.mark.parametrize("q", [6, 32, 37])
def test_orders_that_are_no_powers_of_primes_or_too_large_have_none(q: int) -> None:
    with pytest.raises(RequestError, match=f"order {q}"):
        make_difference_set(q)


@pytest.mark.parametrize(
    ("count", "hint"),
    [(6, "take 7 codes"), (8, "take 7 or 14 codes"), (15, "take 14 or 21 codes")],
)
def test_singer_codes_come_in_whole_sets(count: int, hint: str) -> None:
    with pytest.raises(RequestError) as caught:
        make_projective_plane_codes((2, 2), count, 1 / 3, np.random.default_rng(0))
    assert caught.value.hint == hint
    sets = make_projective_plane_codes((2, 3), 14, 1 / 3, np.random.default_rng(0))
    assert sets.shape == (14, 6) and (sets.reshape(2, 7, 6).sum(axis=1) == 3).all()


def test_singer_codes_of_more_cells_are_two_valued_and_exact_within_a_tile() -> None:
    q, lines, lattice = 4, 21, (17, 23)
    matrix = probing(make_codes("singer", lattice, lines, dual="same", p=0.2, seed=2))
    assert set(np.unique(matrix)) == {1, q + 1}
    row, col = np.divmod(np.arange(matrix.shape[0]), lattice[1])
    distance = np.hypot(row[:, None] - row, col[:, None] - col)
    shared = (matrix == q + 1) & ~np.eye(len(matrix), dtype=bool)
    assert distance[shared].min() > 0.7 * np.sqrt(lines)


def test_each_set_of_singer_codes_gives_the_lines_out_anew() -> None:
    twice = make_codes("singer", (17, 23), 42, dual="same", p=0.2, seed=2).primal
    first, second = (set_.astype(np.int64).T @ set_ for set_ in (twice[:21], twice[21:]))
    both = (first == 5) & (second == 5) & ~np.eye(17 * 23, dtype=bool)
    assert both.sum() < 0.2 * (first == 5).sum()


def fraction_error(name: str, family: str, count: int, p: float, share: float, seed: int) -> float:
    """RMS error of D + share S over its own RMS, photos scaled by their direct light."""
    scene = PRESETS[name]((24, 32), {})
    lit = make_codes(family, scene.grid, count, dual="same", p=p, seed=seed).primal.astype(
        np.float64
    )
    times = lit.sum(axis=0)
    photo = scene.photo(lit, lit, times, times) / times.mean()
    direct, indirect = scene.split()
    truth = direct + share * indirect
    return float(np.sqrt(np.mean((photo - truth) ** 2) / np.mean(truth**2)))


@pytest.mark.long
@pytest.mark.parametrize("name", ["open-book", "wax-disk", "milky-bottle"])
@pytest.mark.parametrize(("p", "count"), [(0.25, 128), (0.125, 512), (0.0625, 512)])
def test_hadamard_products_beat_balanced_codes_on_smooth_light(
    name: str, p: float, count: int
) -> None:
    error = {
        family: np.mean([fraction_error(name, family, count, p, p, seed) for seed in range(3)])
        for family in ("balanced", "hadamard")
    }
    assert error["hadamard"] < 0.85 * error["balanced"]


def test_singer_codes_beat_balanced_ones_where_light_stays_near() -> None:
    """273 codes for 1/17 on a wax disk, against as many balanced ones and one pass more."""
    singer = np.mean([fraction_error("wax-disk", "singer", 273, 1 / 17, 1 / 17, s) for s in (0, 1)])
    balanced = np.mean(
        [fraction_error("wax-disk", "balanced", 289, 1 / 17, 1 / 17, s) for s in (0, 1)]
    )
    assert singer < 0.2 * balanced


@pytest.mark.parametrize(
    ("family", "codes", "p"), [("singer", 21, 0.2), ("hadamard", 64, 0.25), ("rademacher", 64, 0.5)]
)
def test_a_capture_of_a_fraction(tmp_path: Path, family: str, codes: int, p: float) -> None:
    """Through the whole chain, on a grid of 3 x 4 cells, where two of them are exact."""
    scene = bench_rig.matrix_scene(tmp_path)
    camera = CameraConfig(noise="none")
    config = bench_rig.config(tmp_path, scene=scene, camera=camera)
    made = take(config, goal="fraction", p=p, codes=codes, family=family)
    assert made.error < (0.2 if family == "rademacher" else 1e-3)
