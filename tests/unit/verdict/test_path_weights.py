"""Weights of paths that a verdict speaks of, and where warps tear, against loops over entries."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.probing.convolved import SameRowPart
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import (
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
    shift_cells,
)
from pdcd.recipes.recipe import RecipePhoto
from pdcd.verdict.matrices import (
    compute_blocked_weight,
    compute_direct_weight_errors,
    compute_light_share,
    count_torn_cells,
    judge_never_shown,
    measure_common_error,
    warp_tear_share,
)

GRID, N = (3, 4), 12


def some(seed: int) -> Factors:
    rng = np.random.default_rng(seed)
    left, right = rng.random((5, N)), rng.random((5, N))
    return Factors(left, right, rng.random(N), rng.random(N))


def dense(realised: Factors) -> np.ndarray:
    whole = realised.left.T @ realised.right
    whole[np.arange(N), np.arange(N)] = realised.coaxial
    return np.asarray(whole)


def test_of_matched_cells() -> None:
    rng = np.random.default_rng(3)
    first, second = (rng.permutation(N) for _ in range(2))
    first[:3] = -1  # cells without a match block nothing
    first[5] = 5
    parts = ((1.0, UniformPart(N)), (-1.0, MatchPart(first)), (-1.0, MatchPart(second)))
    realised = some(1)
    entries = [
        dense(realised)[n, m]
        for partner in (first, second)
        for n, m in enumerate(partner)
        if m >= 0
    ]
    found = compute_blocked_weight(realised, WantedMatrix(GRID, parts), 0.25)
    assert found == pytest.approx(np.mean(entries) / 0.25, rel=1e-12)


def test_of_rows() -> None:
    realised = some(2)
    row = np.arange(N) // GRID[1]
    same = row[:, None] == row
    wanted = WantedMatrix(GRID, ((1.0, UniformPart(N)), (-1.0, SameRowPart(GRID))))
    found = compute_blocked_weight(realised, wanted, 2.0)
    assert found == pytest.approx(dense(realised)[same].mean() / 2.0, rel=1e-12)


@pytest.mark.parametrize(
    "parts", [((1.0, SameRowPart(GRID)),), ((1.0, UniformPart(N)), (-1.0, NearPart(GRID, 1)))]
)
def test_photos_that_block_neither_have_nothing_left(
    parts: tuple[tuple[float, MatrixPart], ...],
) -> None:
    assert compute_blocked_weight(some(4), WantedMatrix(GRID, parts), 1.0) == 0.0


def test_light_counts_by_its_weight_where_both_pictures_are_known() -> None:
    light, answer = np.full((50, 3), 10.0), np.full((50, 3), 2.0)
    light[0], answer[1] = np.nan, np.inf
    assert compute_light_share(0.06, light, answer) == pytest.approx(0.3)
    assert compute_light_share(0.06, light, np.zeros((50, 3))) == 0.0


def test_cells_of_a_photo_of_direct_light_alone_get_equal_weights_and_others_need_not() -> None:
    """A white photo has all light beside it, and is no matter of the cells' own weights."""
    realised = replace(some(5), coaxial=np.where(np.arange(N) < 3, 0.6, 1.0))
    shots: Any = {"a": SimpleNamespace(realised=realised, missed=0)}

    def errors(*parts: tuple[float, MatrixPart]) -> dict[str, float]:
        photo = RecipePhoto("p", WantedMatrix(GRID, parts), ((1.0, "a"),))
        return compute_direct_weight_errors([photo], shots, "scalar")

    own = realised.coaxial
    found = errors((1.0, MatchPart(np.arange(N))))
    assert found == {"p": pytest.approx(np.std(own) / np.mean(own))}
    assert not errors((1.0, UniformPart(N)))
    assert not errors((1.0, UniformPart(N)), (-1.0, MatchPart(np.arange(N))))


def add_up(parts: list[Factors]) -> Factors:
    left, right = (
        np.concatenate([getattr(one, side) for one in parts]) for side in ("left", "right")
    )
    return Factors(left, right, np.sum(left * right, axis=0), left.sum(axis=0))


def take_random_parts(
    primal: np.ndarray, dual: np.ndarray, count: int, pairs: int
) -> list[Factors]:
    """Parts of random codes and their complements, lit and open with these shares of all pairs."""
    rng = np.random.default_rng(7)
    parts = []
    for _ in range(count):
        code = rng.random((pairs, N)) < 0.5
        right, left = code * primal, ~code * dual
        parts.append(Factors(left, right, np.sum(left * right, axis=0), left.sum(axis=0)))
    return parts


def dim(cells: slice, share: float) -> np.ndarray:
    found = np.ones(N)
    found[cells] = share
    return found


INDIRECT = WantedMatrix(GRID, ((1.0, UniformPart(N)), (-1.0, MatchPart(np.arange(N)))))


@pytest.mark.parametrize(
    ("primal", "dual", "near", "expected"),
    [
        (np.ones(N), np.ones(N), 0, 0.0),
        # 1 / 0.75 of the others' weight, less 1, and -1 of what is never lit.
        (dim(slice(3), 0.0), np.ones(N), 0, np.sqrt((9 * (1 / 3) ** 2 + 3) / 12)),
        # Cells that are never open are unknown, and no error.
        (np.ones(N), dim(slice(3), 0.0), 0, 0.0),
        # Codes that keep all light, where that from near is not wanted.
        (np.ones(N), np.ones(N), 1, None),
    ],
)
def test_what_parts_have_in_common_is_told_from_chance(
    primal: np.ndarray, dual: np.ndarray, near: int, expected: float | None
) -> None:
    wanted = INDIRECT
    if near:
        wanted = WantedMatrix(GRID, ((1.0, UniformPart(N)), (-1.0, NearPart(GRID, near))))
        off = ~np.eye(N, dtype=bool)
        expected = float(np.sqrt(1.0 - wanted.dense()[off].mean()))
    parts = take_random_parts(primal, dual, 4, 400)
    found = measure_common_error(add_up(parts), parts, wanted)
    assert expected is not None and found == pytest.approx(expected, abs=0.06)
    assert measure_common_error(add_up(parts), parts[:1], wanted) == 0.0


@pytest.mark.parametrize(
    ("primal", "dual", "told"),
    [
        (np.ones(N), np.ones(N), []),
        (dim(slice(3), 0.02), np.ones(N), ["lights 3 of 12 cells, which have 25 %"]),
        (dim(slice(3), 0.2), np.ones(N), []),
        (np.ones(N), dim(slice(2), 0.02), ["opens 2 of 12 cells, 16.7 %"]),
    ],
)
def test_cells_that_no_code_shows_are_counted(
    primal: np.ndarray, dual: np.ndarray, told: list[str]
) -> None:
    found = list(judge_never_shown("it", add_up(take_random_parts(primal, dual, 1, 60)), INDIRECT))
    assert len(found) == len(told)
    assert all(words in one.text for words, one in zip(told, found, strict=True))


def test_cells_whose_light_nobody_wants_need_not_be_lit() -> None:
    """A region that is dark by an illumination, and one that is a fiftieth as bright."""
    light = dim(slice(3), 0.0) * dim(slice(3, 5), 0.02)
    realised = add_up(take_random_parts(light, np.ones(N), 1, 60))
    assert not list(judge_never_shown("it", realised, INDIRECT.under(light)))
    seen = WantedMatrix(GRID, ((1.0, OuterPart(dim(slice(3), 0.0), np.ones(N))),))
    realised = add_up(take_random_parts(np.ones(N), dim(slice(3), 0.0), 1, 60))
    assert not list(judge_never_shown("it", realised, seen))


WIDE = (5, 7)


def count_tears(partner: np.ndarray) -> float:
    """Pair by pair of the eight cells around each."""
    bad = 0
    for n in np.flatnonzero(partner >= 0):
        row, col = divmod(int(n), 7)
        differ = False
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                r, c = row + down, col + right
                if 0 <= r < 5 and 0 <= c < 7 and partner[r * 7 + c] >= 0:
                    (a, b), (d, e) = divmod(int(partner[n]), 7), divmod(int(partner[r * 7 + c]), 7)
                    differ |= max(abs(d - a - down), abs(e - b - right)) > 1
        bad += differ
    return bad / max(int((partner >= 0).sum()), 1)


def warps() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    some = rng.permutation(35)
    some[rng.random(35) < 0.4] = -1
    halves = shift_cells(WIDE, (0, 1))
    halves[np.arange(35) % 7 >= 4] = shift_cells(WIDE, (0, -3))[np.arange(35) % 7 >= 4]
    return {
        "shift": shift_cells(WIDE, (1, -2)), "chance": rng.permutation(35), "some": some,
        "halves": halves, "none": np.full(35, -1),
    }  # fmt: skip


@pytest.mark.parametrize("name", warps())
def test_cells_tear_where_the_partners_of_neighbours_do_not_lie_together(name: str) -> None:
    partner = warps()[name]
    assert count_torn_cells(partner, WIDE) == pytest.approx(count_tears(partner))
    if name in ("shift", "none"):
        assert count_torn_cells(partner, WIDE) == 0.0
    if name == "halves":
        assert count_torn_cells(partner, WIDE) == pytest.approx(2 * 5 / (partner >= 0).sum())


def test_only_light_of_matched_cells_through_parted_windows_counts() -> None:
    partner = warps()["chance"]
    windows = {"a": "quarter", "b": "whole"}
    shots: Any = [SimpleNamespace(name=name, window=window) for name, window in windows.items()]
    match = (1.0, MatchPart(partner))

    def share(name: str, *parts: Any) -> float:
        return warp_tear_share([RecipePhoto("p", WantedMatrix(WIDE, parts), ((1.0, name),))], shots)

    assert share("a", match) == count_torn_cells(partner, WIDE) > 0.9
    assert share("b", match) == 0.0
    assert share("a", match, (1.0, UniformPart(35))) == 0.0
    assert share("a", (1.0, NearPart(WIDE, 1))) == 0.0
    assert share("a", (1.0, MatchPart(np.arange(35)))) == 0.0
