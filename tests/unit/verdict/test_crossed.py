"""Direct light that gets past codes, told by how parts differ: photos of a dense transport."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.arrays import Floats
from pdcd.verdict.crossed import CrossedLight, compute_crossed_light

GRID, PARTS, CODES = (12, 16), 5, 24
CELLS = GRID[0] * GRID[1]


def told(
    late: float | Floats = 0.0,
    early: float | Floats = 0.0,
    known: float = 0.0,
    noise: float = 0.01,
) -> CrossedLight | None:
    """By photos of parts of random codes in front of a scene with ten times more direct light than
    indirect. late, early : share of a code's time for which it meets the one before or after it,
    of all cells or of each. known : the same of late codes, of which everybody knows."""
    random = np.random.default_rng(7)
    transport = random.gamma(0.3, size=(CELLS, CELLS)) / CELLS
    np.fill_diagonal(transport, 10.0 * 0.3 * random.uniform(0.2, 1.8, CELLS))
    direct = transport.diagonal()
    light, after, before = (np.empty((PARTS, CELLS)) for _ in range(3))
    weight = CODES / 4.0
    for part in range(PARTS):
        lit = random.integers(0, 2, (CODES, CELLS)).astype(np.float64)
        shut = 1.0 - lit
        photo: Floats = np.sum(shut * (lit @ transport.T), axis=0)
        after[part] = np.sum(lit[1:] * shut[:-1], axis=0) / weight
        before[part] = np.sum(lit[:-1] * shut[1:], axis=0) / weight
        past = (late + known) * after[part] + early * before[part]
        light[part] = photo / weight + past * direct
    light *= 1.0 + noise * random.normal(size=light.shape)
    believed = known * after
    left = np.maximum(transport.sum(axis=1) - light.mean(axis=0), 0.0)
    shown = left / (1.0 - believed.mean(axis=0))
    return compute_crossed_light(light, believed, (after, before), shown, GRID)


@pytest.mark.parametrize("known", [0.0, 0.1])
@pytest.mark.parametrize(("late", "early"), [(0.04, 0.0), (0.0, 0.05), (0.3, 0.0)])
def test_what_gets_past_codes_is_told(late: float, early: float, known: float) -> None:
    found = told(late, early, known)
    assert found is not None
    assert found.lost == pytest.approx(late + early, rel=0.25)
    assert found.share > 5.0 * found.lost / (1.0 + 10.0 * found.lost)


@pytest.mark.parametrize("axis", [0, 1])
def test_lines_that_are_set_one_after_another_are_told(axis: int) -> None:
    """Late at one end of the field and early at the other, as much on the whole."""
    at = (np.indices(GRID)[axis].ravel() + 0.5) / GRID[axis] - 0.5
    late, early = 0.3 * np.maximum(at, 0.0), 0.3 * np.maximum(-at, 0.0)
    found = told(late, early)
    assert found is not None
    assert found.lost == pytest.approx(np.sqrt(np.mean((late + early) ** 2)), rel=0.25)


@pytest.mark.parametrize("known", [0.0, 0.1])
def test_codes_that_meet_are_not_accused(known: float) -> None:
    assert told(known=known) == CrossedLight(0.0, 0.0)
    assert told(known=known, noise=0.0) == CrossedLight(0.0, 0.0)


def test_cells_of_which_nothing_is_known_do_not_count() -> None:
    nothing = np.full((PARTS, CELLS), np.nan)
    assert compute_crossed_light(nothing, nothing, (nothing, nothing), nothing[0], GRID) is None
