"""Direct light that is known to be in a photo of indirect light, taken out."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.pictures.combine import remove_direct_light
from pdcd.pictures.picture import Picture
from pdcd.pictures.to_quads import QuadWeights, compute_direct_share
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

GRID = (6, 8)


def realised(coaxial: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Factors:
    ones = np.ones((1, coaxial.size))
    return Factors(ones, ones, coaxial, ones[0])


def test_what_is_taken_out_is_what_was_put_in() -> None:
    rng = np.random.default_rng(0)
    direct, indirect = rng.uniform(0.2, 1.0, (2, *GRID, 3))
    share = rng.uniform(-0.1, 0.4, GRID)
    coded = indirect + share[..., None] * direct
    sigma, of_white = rng.uniform(0.1, 0.2, (2, *GRID, 3))
    of_white[1, 2, 0] = np.inf
    found = remove_direct_light(Picture(coded, sigma), Picture(direct + indirect, of_white), share)
    image, error = found.image, found.sigma
    known = np.isfinite(of_white)
    assert image[known] == pytest.approx(indirect[known], rel=1e-12)
    # Of a full quad nothing is taken out, and the bar has as much as its white light puts in.
    put_in = share[1, 2] * (direct + indirect)[1, 2, 0]
    assert image[1, 2, 0] == coded[1, 2, 0]
    assert error[1, 2, 0] == pytest.approx(np.hypot(sigma[1, 2, 0], put_in), rel=1e-12)
    # By draws of noise, not by the formula.
    noise = rng.standard_normal((2, 20_000)) * [[sigma[0, 0, 1]], [of_white[0, 0, 1]]]
    r = share[0, 0]
    seen = (noise[0] - r * noise[1]) / (1.0 - r)
    assert error[0, 0, 1] == pytest.approx(seen.std(), rel=0.03)


def test_shares_not_worth_it_and_shares_that_leave_nothing() -> None:
    cells = CellMap.block(GRID, (12, 16))
    weights = QuadWeights(np.full((12, 16), 2.0), None)
    there = np.full(48, 0.2)
    there[3] = 0.1
    share = compute_direct_share(realised(there), weights, cells)
    assert share is not None and share.shape == (12, 16)
    assert share[0, 6] == pytest.approx(0.05) and share[11, 0] == pytest.approx(0.1)
    assert compute_direct_share(realised(1e-5 * there), weights, cells) is None
    there[7] = 1.5
    assert compute_direct_share(realised(there), weights, cells) is None
