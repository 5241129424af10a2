"""How far one indirect photo is from the truth, by family, on scenes with known transport."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from tests.places import DATA

SEEDS = range(5)


def load_scene(name: str) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Transport (L, L) and grid (rows, cols) of a path-traced scene."""
    with np.load(DATA / f"{name}.npz") as file:
        rows, cols = file["grid"]
        return np.asarray(file["transport"], dtype=np.float64), (int(rows), int(cols))


def indirect_error(
    transport: NDArray[np.float64], grid: tuple[int, int], family: str, count: int, seed: int
) -> float:
    """RMS error of the indirect image over the RMS of the true one, weights normalised by mean."""
    codes = make_codes(family, grid, count, dual="complement", seed=seed)
    # float32 products of 0/1 entries are exact up to 2^24 codes, and fast.
    probing = codes.dual.astype(np.float32).T @ codes.primal.astype(np.float32)
    weight = probing.astype(np.float64) / count
    mean_weight = weight.sum() / (weight.size - len(weight))  # the diagonal adds nothing
    image = (weight / mean_weight * transport).sum(axis=1)
    truth = transport.sum(axis=1) - np.diag(transport)
    return float(np.sqrt(((image - truth) ** 2).mean() / (truth**2).mean()))


@pytest.mark.parametrize(("scene", "gain"), [("corner_32x24", 20.0), ("mirror_32x24", 3.5)])
def test_hadamard_beats_bernoulli_by_the_promised_factor(scene: str, gain: float) -> None:
    transport, grid = load_scene(scene)
    error = {
        family: np.mean([indirect_error(transport, grid, family, 128, seed) for seed in SEEDS])
        for family in ("bernoulli", "hadamard")
    }
    assert error["hadamard"] <= error["bernoulli"] / gain


def test_eight_hadamard_codes_beat_128_bernoulli_codes_on_smooth_transport() -> None:
    transport, grid = load_scene("corner_32x24")
    few = max(indirect_error(transport, grid, "hadamard", 8, seed) for seed in SEEDS)
    many = min(indirect_error(transport, grid, "bernoulli", 128, seed) for seed in SEEDS)
    assert few < many / 3
