"""Codes of cells and their partners: lit together as often as by chance, counted pair by pair."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.independent import make_balanced_codes, make_partner_codes
from pdcd.probing.wanted import shift_cells

GRID = (12, 16)
N = GRID[0] * GRID[1]
RNG = np.random.default_rng(3)
PARTNERS = {
    "shift": shift_cells(GRID, (2, 3)),
    "shift back": shift_cells(GRID, (0, -5)),
    "mirror": np.arange(N).reshape(GRID)[:, ::-1].ravel(),
    "permutation": RNG.permutation(N),
    "any": RNG.integers(-1, N, N),
    "all one": np.zeros(N, dtype=np.intp),
    "none": np.full(N, -1),
    "own": np.arange(N),
}


def codes_of(partner: NDArray[np.intp], count: int, p: float, seed: int = 0) -> NDArray[np.bool_]:
    rng = np.random.default_rng(seed)
    return make_partner_codes(make_balanced_codes((1, partner.size), count, p, rng), partner, rng)


@pytest.mark.parametrize("name", PARTNERS)
@pytest.mark.parametrize(
    ("count", "p"), [(100, 0.1), (64, 0.5), (130, 0.3), (40, 0.9), (32, 0.125)]
)
def test_partners_meet_as_often_as_by_chance(name: str, count: int, p: float) -> None:
    partner = PARTNERS[name]
    codes = codes_of(partner, count, p)
    on = round(p * count)
    assert codes.shape == (count, partner.size) and np.all(codes.sum(axis=0) == on)
    pairs = np.flatnonzero((partner >= 0) & (partner != np.arange(partner.size)))
    met = np.array([np.sum(codes[:, n] & codes[:, partner[n]]) for n in pairs], dtype=float)
    if not pairs.size:
        return
    # Where cells share a partner, or rings close, all of them keep to it, too.
    off = np.abs(met - on * on / count)
    assert np.mean(off < 1.0) > 0.99
    if met.size > 100 and name != "mirror":
        assert met.mean() == pytest.approx(on * on / count, abs=4.0 * 0.5 / np.sqrt(met.size))


def test_other_cells_meet_by_chance() -> None:
    codes = codes_of(PARTNERS["permutation"], 100, 0.2).astype(float)
    together = codes.T @ codes
    others = ~np.eye(N, dtype=np.bool_)
    others[np.arange(N), PARTNERS["permutation"]] = False
    others[PARTNERS["permutation"], np.arange(N)] = False
    assert together[others].mean() == pytest.approx(4.0, rel=0.01)
    assert together[others].var() == pytest.approx(4.0 * 0.8 * 0.8 * 100 / 99, rel=0.1)


@pytest.mark.parametrize(
    ("ring", "count", "p"), [(3, 10, 0.5), (3, 4, 0.75), (4, 4, 0.25), (5, 8, 0.5)]
)
def test_rings_close(ring: int, count: int, p: float) -> None:
    partner = np.roll(np.arange(ring), 1)
    for seed in range(20):
        codes = codes_of(partner, count, p, seed)
        on = round(p * count)
        assert np.all(codes.sum(axis=0) == on)
        met = np.sum(codes & codes[:, partner], axis=0)
        assert np.sum(np.abs(met - on * on / count) >= 1.0) <= 1


def test_the_same_seed_gives_the_same_codes() -> None:
    partner = PARTNERS["any"]
    assert np.array_equal(codes_of(partner, 64, 0.25), codes_of(partner, 64, 0.25))
    assert not np.array_equal(codes_of(partner, 64, 0.25), codes_of(partner, 64, 0.25, 1))
