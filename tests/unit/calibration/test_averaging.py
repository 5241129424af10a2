"""Averages of stripes over blocks and whole periods, against sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.calibration.registration.averaging import StripeAverager

SHAPE = (64, 80)
RNG = np.random.default_rng(2)
WHITE = 100.0 + 50.0 * RNG.random(SHAPE)


def averaging(block: int = 2, period: float = 8.0, **dark: slice) -> StripeAverager:
    lit = np.ones(SHAPE, np.bool_)
    if dark:
        lit[dark["rows"], dark["cols"]] = False
    return StripeAverager(lit, WHITE, period, block)


@pytest.mark.parametrize("period", [8.0, 9.0, 10.0, 12.0, 16.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_stripes_go_out_of_averages(period: float, axis: int) -> None:
    found = averaging(1, period)
    at = np.indices(SHAPE)[axis] + 0.5
    waves = np.cos(2.0 * np.pi * at / period)
    smooth = found.smooth(found.over_white(WHITE * (0.5 + 0.5 * waves)))
    inside = found.places(1.0).astype(int)
    left = smooth[inside[:, 1], inside[:, 0]] - 0.5
    assert np.abs(left).max() < 0.003


def test_noise_of_an_average_is_that_of_its_weights() -> None:
    light = np.zeros((128, 128))
    light[64, 64] = 1.0
    wide = StripeAverager(np.ones((128, 128), np.bool_), np.ones((128, 128)), 16.0, 1)
    weights = wide.smooth(wide.over_white(light))
    assert wide.noise == pytest.approx(np.sqrt(np.sum(weights**2)), rel=0.03)


def test_places_lie_on_a_lattice_with_light_all_around() -> None:
    found = averaging(2, 8.0)
    places = found.places(8.0)
    x, y = np.unique(places[:, 0]), np.unique(places[:, 1])
    assert (np.diff(x) == 8.0).all() and (np.diff(y) == 8.0).all()
    assert len(places) == x.size * y.size
    # In the middle of blocks, and three half periods off the photo's edges.
    assert ((places - 1.0) % 2.0 == 0.0).all()
    assert x.min() >= 12.0 and x.max() <= 80.0 - 12.0
    assert y.min() >= 12.0 and y.max() <= 64.0 - 12.0
    holed = averaging(2, 8.0, rows=slice(30, 34), cols=slice(38, 42)).places(8.0)
    kept = {tuple(at) for at in holed.tolist()}
    lost = [at for at in places.tolist() if tuple(at) not in kept]
    assert kept < {tuple(at) for at in places.tolist()} and lost
    assert all(np.hypot(at[0] - 40.0, at[1] - 32.0) < 16.0 for at in lost)
