"""Descent between bounds, held against bounded least squares by a trust region (scipy)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from pdcd.arrays import Singles
from pdcd.codes.woven import Function, follow_descent

Floats = NDArray[np.float64]
RNG = np.random.default_rng(5)
MATRIX = RNG.standard_normal((60, 40)) * np.geomspace(1.0, 0.1, 40)
WANTED = RNG.standard_normal(60)


def squares(calls: list[Singles] | None = None) -> Function:
    def errs(place: Singles) -> tuple[float, Singles]:
        if calls is not None:
            calls.append(place.copy())
        off = MATRIX @ place.astype(np.float64) - WANTED
        return float(off @ off), (2.0 * MATRIX.T @ off).astype(np.float32)

    return errs


def test_the_least_value_within_bounds_is_found() -> None:
    start = np.full(40, 0.5, np.float32)
    calls: list[Singles] = []
    found = follow_descent(squares(calls), start, 300)
    best = lsq_linear(MATRIX, WANTED, (0.0, 1.0), tol=1e-12)
    assert 10 < np.sum((best.x > 0.01) & (best.x < 0.99)) < 30  # Some are held, some are free.
    assert found.dtype == np.float32
    assert np.allclose(found, best.x, atol=5e-3)
    value, _ = squares()(found)
    assert value == pytest.approx(2.0 * best.cost, rel=1e-5)
    assert all(place.min() >= 0.0 and place.max() <= 1.0 for place in calls)
    # It ends by itself where nothing lower is found.
    assert len(calls) < 250


def test_it_ends_after_so_many_steps_and_each_leads_down() -> None:
    start, values = np.full(40, 0.5, np.float32), []
    for steps in range(6):
        values.append(squares()(follow_descent(squares(), start, steps))[0])
    assert values[0] == squares()(start)[0]
    assert values == sorted(values, reverse=True) and values[5] < values[1] < values[0]
    calls: list[Singles] = []
    follow_descent(squares(calls), start, 3)
    assert 4 <= len(calls) <= 10


def test_where_there_is_no_slope_it_stays() -> None:
    start = np.array([0.0, 1.0, 0.3], np.float32)

    def flat(place: Singles) -> tuple[float, Singles]:
        # What leads further down lies beyond the bounds.
        return float(place[0] - place[1]), np.array([1.0, -1.0, 0.0], np.float32)

    assert np.array_equal(follow_descent(flat, start, 50), start)


def test_a_slope_that_misleads_ends_it() -> None:
    start = np.full(3, 0.5, np.float32)

    def upwards(place: Singles) -> tuple[float, Singles]:
        return float(place.sum()), np.full(3, -1.0, np.float32)

    assert np.array_equal(follow_descent(upwards, start, 50), start)


def test_what_was_met_is_forgotten_where_it_misleads() -> None:
    """A valley that bends (Rosenbrock), whose curvature changes all along."""

    def valley(place: Singles) -> tuple[float, Singles]:
        x, y = 2.0 * place.astype(np.float64)
        value = (1.0 - x) ** 2 + 100.0 * (y - x**2) ** 2
        slope = [-2.0 * (1.0 - x) - 400.0 * x * (y - x**2), 200.0 * (y - x**2)]
        return float(value), np.array([2.0 * s for s in slope], np.float32)

    found = follow_descent(valley, np.array([0.0, 0.9], np.float32), 400)
    assert np.allclose(found, 0.5, atol=0.02)
