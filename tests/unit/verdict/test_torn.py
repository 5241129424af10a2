"""Where a warp tears, told of every pair of cells that touch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.probing.wanted import MatchPart, NearPart, UniformPart, WantedMatrix, shift_cells
from pdcd.recipes.recipe import RecipePhoto
from pdcd.verdict.matrices import count_torn_cells, warp_tear_share

GRID = (5, 7)
N = 35


def expected(partner: np.ndarray) -> float:
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
    some = rng.permutation(N)
    some[rng.random(N) < 0.4] = -1
    halves = shift_cells(GRID, (0, 1))
    halves[np.arange(N) % 7 >= 4] = shift_cells(GRID, (0, -3))[np.arange(N) % 7 >= 4]
    return {
        "shift": shift_cells(GRID, (1, -2)), "chance": rng.permutation(N), "some": some,
        "halves": halves, "none": np.full(N, -1),
    }  # fmt: skip


@pytest.mark.parametrize("name", warps())
def test_cells_tear_where_the_partners_of_neighbours_do_not_lie_together(name: str) -> None:
    partner = warps()[name]
    assert count_torn_cells(partner, GRID) == pytest.approx(expected(partner))
    if name in ("shift", "none"):
        assert count_torn_cells(partner, GRID) == 0.0
    if name == "halves":
        assert count_torn_cells(partner, GRID) == pytest.approx(2 * 5 / (partner >= 0).sum())


def test_only_light_of_matched_cells_through_parted_windows_counts() -> None:
    partner = warps()["chance"]
    shots: Any = [_Shot("a", "quarter"), _Shot("b", "whole")]
    match = (1.0, MatchPart(partner))

    def share(name: str, *parts: Any) -> float:
        return warp_tear_share([RecipePhoto("p", WantedMatrix(GRID, parts), ((1.0, name),))], shots)

    assert share("a", match) == count_torn_cells(partner, GRID) > 0.9
    assert share("b", match) == 0.0
    assert share("a", match, (1.0, UniformPart(N))) == 0.0
    assert share("a", (1.0, NearPart(GRID, 1))) == 0.0
    assert share("a", (1.0, MatchPart(np.arange(N)))) == 0.0


class _Shot:
    def __init__(self, name: str, window: str) -> None:
        self.name, self.window = name, window
