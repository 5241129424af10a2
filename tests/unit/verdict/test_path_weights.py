"""Weights of paths that a verdict speaks of, against the whole matrix entry by entry."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.probing.convolved import SameRowPart
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import MatchPart, MatrixPart, NearPart, UniformPart, WantedMatrix
from pdcd.recipes.recipe import RecipePhoto
from pdcd.verdict.matrices import (
    compute_blocked_weight,
    compute_direct_weight_errors,
    compute_light_share,
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
