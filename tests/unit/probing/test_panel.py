"""One panel's response: hard time constants, and integrals without cancellation."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig
from pdcd.probing.panel import (
    PanelOptics,
    Trajectory,
    compute_decay_integral,
    offset_cells,
    vblank_lag_s,
)


@pytest.mark.parametrize("duration", [1e-12, 1e-9, 1e-6, 1e-3])
def test_decay_integral_of_short_intervals_keeps_full_precision(duration: float) -> None:
    rate = 125.0
    x = Fraction(rate) * Fraction(duration)
    series = Fraction(duration) * sum(
        (-x) ** k / Fraction(int(np.prod(range(1, k + 2), dtype=object))) for k in range(12)
    )
    got = float(compute_decay_integral(np.array(rate), np.array(duration)))
    assert got == pytest.approx(float(series), rel=4e-16)


def test_decay_integral_without_decay_is_the_duration() -> None:
    got = compute_decay_integral(np.array([0.0, 1e-300]), np.array([0.3, 0.3]))
    np.testing.assert_allclose(got, 0.3, rtol=1e-15)


def track(panel: PanelOptics, pattern: list[list[bool]], step_s: float) -> Trajectory:
    targets = np.array(pattern)
    starts = np.arange(len(pattern), dtype=np.int64) * round(step_s * 1e9)
    return Trajectory(panel, starts, targets.shape[1], lambda s: targets[s])


def test_an_instant_panel_is_exactly_its_target() -> None:
    fields = track(PanelOptics(leak=0.01), [[True, False], [False, True]], 0.1).take(0, 2)
    assert fields.shape == (2, 1, 2)
    np.testing.assert_array_equal(fields[:, 0], [[1.0, 0.01], [0.01, 1.0]])


@pytest.mark.parametrize(("rise", "fall"), [(0.0, 0.01), (0.01, 0.0)])
def test_one_instant_and_one_slow_edge(rise: float, fall: float) -> None:
    fields = track(PanelOptics(rise, fall), [[True], [False]], 0.01).take(0, 2)
    up, down = fields[0, :, 0], fields[1, :, 0]
    if rise == 0.0:
        np.testing.assert_array_equal(up, [1.0, 0.0, 0.0])
        np.testing.assert_array_equal(down, [0.0, 0.0, 1.0])
    else:
        np.testing.assert_array_equal(up, [1.0, -1.0, 0.0])
        assert not down[1:].any()


def test_equal_and_nearly_equal_constants_agree() -> None:
    pattern = [[True, False], [False, True], [True, True], [False, False]]
    same = track(PanelOptics(0.005, 0.005), pattern, 0.007).take(0, 4).sum(axis=1)
    near = track(PanelOptics(0.005, 0.005 * (1 + 1e-12)), pattern, 0.007).take(0, 4).sum(axis=1)
    np.testing.assert_allclose(same, near, rtol=0, atol=1e-11)


def test_taking_piece_by_piece_gives_the_same_fields() -> None:
    rng = np.random.default_rng(0)
    pattern = (rng.random((9, 5)) < 0.5).tolist()
    whole = track(PanelOptics(0.002, 0.006, 0.01), pattern, 0.004).take(0, 9)
    pieces = track(PanelOptics(0.002, 0.006, 0.01), pattern, 0.004)
    np.testing.assert_array_equal(pieces.take(0, 4), whole[0:4])
    np.testing.assert_array_equal(pieces.take(3, 7), whole[3:7])
    np.testing.assert_array_equal(pieces.take(7, 9), whole[7:9])


def test_panel_from_config() -> None:
    config = PanelConfig(size_px=(8, 8), rise_s=0.1, fall_s=0.2, contrast=250.0, skew_s=-0.002)
    assert PanelOptics.from_config(config) == PanelOptics(0.1, 0.2, 0.004, -2_000_000)
    assert PanelOptics.from_config(PanelConfig(size_px=(8, 8))) == PanelOptics()


def test_offset_in_cells_is_rows_then_columns() -> None:
    projector = PanelConfig(size_px=(1024, 768))
    mask = PanelConfig(size_px=(1600, 1200), offset_px=(8.0, -4.0))
    assert offset_cells(projector, mask, (48, 64)) == (-0.25, 0.5)


def test_rates_are_those_of_both_edges() -> None:
    np.testing.assert_allclose(PanelOptics(0.001, 0.01).rates, [0.0, 1000.0, 100.0])
    np.testing.assert_allclose(PanelOptics(0.01, 0.01).rates, [0.0, 100.0])
    np.testing.assert_array_equal(PanelOptics().rates, [0.0])


@pytest.mark.parametrize(
    ("projector_hz", "mask_hz", "phase_s", "apart"),
    [
        (60.0, 60.0, 0.006, 0.006),
        (60.0, 60.0, 0.012, 0.012 - 1 / 60),  # nearer to the vblank before
        (60.0, 120.0, 0.006, 0.006),  # the slower panel sets the pace
        (120.0, 60.0, 0.006, 0.006),
    ],
)
def test_panels_are_apart_by_their_phase(
    projector_hz: float, mask_hz: float, phase_s: float, apart: float
) -> None:
    size = (100, 100)
    projector = PanelConfig(size_px=size, refresh_hz=projector_hz)
    mask = PanelConfig(size_px=size, refresh_hz=mask_hz, phase_s=phase_s)
    assert vblank_lag_s(projector, mask) == pytest.approx(apart, abs=1e-12)
