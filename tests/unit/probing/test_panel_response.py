"""Spans of one panel: what it goes to, and how fast."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig
from pdcd.probing.panel import (
    PanelOptics,
    Trajectory,
    blur_cells,
    offset_cells,
    vblank_lag_s,
)

MS = 1_000_000


def levels(panel: PanelOptics, asked: list[list[float]], starts_ms: list[int]) -> Trajectory:
    targets = np.array(asked)
    starts = np.array(starts_ms, dtype=np.int64) * MS
    return Trajectory(panel, starts, targets.shape[1], lambda span: targets[span])


def test_a_panel_leaves_its_leak_for_what_it_is_asked_and_comes_back() -> None:
    """Rise 2 ms, fall 5 ms, leak 0.1; white for 3 ms, then grey, then black."""
    panel = PanelOptics(0.002, 0.005, 0.1)
    track = levels(panel, [[1.0], [0.5], [0.0]], [0, 3, 7])
    assert (track.fields, track.pixels, track.reached) == (3, 1, 0)
    found = track.take(0, 3)[:, :, 0]
    first = 1.0 - 0.9 * np.exp(-3 / 2)
    grey = 0.5 * 0.9 + 0.1
    second = grey + (first - grey) * np.exp(-4 / 5)
    np.testing.assert_allclose(
        found, [[1.0, -0.9, 0.0], [grey, 0.0, first - grey], [0.1, 0.0, second - 0.1]], atol=1e-15
    )
    assert track.reached == 3


def test_full_light_has_no_leak_whatever_the_rounding() -> None:
    leak = 1 / 3
    found = levels(PanelOptics(leak=leak), [[1.0, 0.0, 0.5]], [0]).take(0, 1)
    assert found.shape == (1, 1, 3)
    assert found[0, 0, 0] == 1.0 and found[0, 0, 1] == leak
    assert found[0, 0, 2] == pytest.approx(2 / 3)


def test_calls_may_begin_one_span_before_the_last_one_ended() -> None:
    """Each span is asked for once."""
    asked: list[int] = []

    def target(span: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        asked.append(span)
        return np.array([float(span % 2)])

    track = Trajectory(PanelOptics(), np.arange(5, dtype=np.int64), 1, target)
    assert track.take(0, 2).ravel().tolist() == [0.0, 1.0]
    assert track.reached == 2
    assert track.take(1, 3).ravel().tolist() == [1.0, 0.0]
    assert track.take(3, 5).ravel().tolist() == [1.0, 0.0]
    assert track.reached == 5 and asked == [0, 1, 2, 3, 4]


def test_blur_is_in_cells_down_and_across() -> None:
    projector = PanelConfig(size_px=(100, 60))
    mask = PanelConfig(size_px=(10, 10), blur_px=3.0)
    assert blur_cells(projector, mask, (20, 50)) == pytest.approx((1.0, 1.5))
    assert blur_cells(projector, projector, (20, 50)) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("first", "second", "apart"),
    [(0.001, 0.004, 0.003), (0.004, 0.001, -0.003), (0.0, 0.005, -0.005), (0.0, 0.0, 0.0)],
)
def test_half_a_period_apart_the_mask_leads(first: float, second: float, apart: float) -> None:
    """At 100 Hz; the difference is taken from minus half a period up to half of one."""
    projector = PanelConfig(size_px=(8, 8), refresh_hz=100.0, phase_s=first)
    mask = PanelConfig(size_px=(8, 8), refresh_hz=100.0, phase_s=second)
    assert vblank_lag_s(projector, mask) == pytest.approx(apart, abs=1e-15)


def test_panel_from_config() -> None:
    config = PanelConfig(size_px=(8, 8), rise_s=0.1, fall_s=0.2, contrast=250.0, skew_s=-0.002)
    assert PanelOptics.from_config(config) == PanelOptics(0.1, 0.2, 0.004, -2_000_000)
    assert PanelOptics.from_config(PanelConfig(size_px=(8, 8))) == PanelOptics()


def test_offset_in_cells_is_rows_then_columns() -> None:
    projector = PanelConfig(size_px=(1024, 768))
    mask = PanelConfig(size_px=(1600, 1200), offset_px=(8.0, -4.0))
    assert offset_cells(projector, mask, (48, 64)) == (-0.25, 0.5)
