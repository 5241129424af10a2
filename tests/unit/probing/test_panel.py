"""One panel's response: hard time constants, and integrals without cancellation."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig
from pdcd.probing.panel import (
    PanelOptics,
    compute_decay_integral,
    offset_cells,
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


def test_panel_from_config() -> None:
    config = PanelConfig(size_px=(8, 8), rise_s=0.1, fall_s=0.2, contrast=250.0, skew_s=-0.002)
    assert PanelOptics.from_config(config) == PanelOptics(0.1, 0.2, 0.004, -2_000_000)
    assert PanelOptics.from_config(PanelConfig(size_px=(8, 8))) == PanelOptics()


def test_offset_in_cells_is_rows_then_columns() -> None:
    projector = PanelConfig(size_px=(1024, 768))
    mask = PanelConfig(size_px=(1600, 1200), offset_px=(8.0, -4.0))
    assert offset_cells(projector, mask, (48, 64)) == (-0.25, 0.5)
