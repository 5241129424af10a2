"""Spans of both panels: where they begin, what they ask for, and what they let through."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.curve import make_power_curve
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import pack_levels
from pdcd.probing.panel import PanelOptics, Trajectory
from pdcd.probing.spans import (
    compute_span_light,
    compute_span_weights,
    find_frame_spans,
    find_span_starts,
    meet_spans,
)


def starts_of(
    content: list[int], at: list[int], end: int, *, skew: int = 0, opened: int = 0
) -> tuple[list[int], list[int]]:
    rows, starts = find_span_starts(
        np.array(content, np.int32), np.array(at, np.int64), end, PanelOptics(skew_ns=skew), opened
    )
    return rows, starts.tolist()


def test_spans_begin_where_the_content_changes() -> None:
    """First black, last black; what repeats belongs to the span before."""
    assert starts_of([5, 5, 7, BLACK, 7], [10, 20, 30, 40, 50], 60) == (
        [-1, 0, 2, 3, 4, -1],
        [0, 10, 30, 40, 50, 60],
    )
    assert starts_of([BLACK, 4, BLACK], [10, 20, 30], 40) == ([-1, 1, 2], [0, 20, 30])
    assert starts_of([], [], 40) == ([-1], [0])


def test_spans_count_from_the_opening_and_by_when_the_light_comes() -> None:
    assert starts_of([5, 7], [10, 30], 50, skew=4, opened=3) == ([-1, 0, 1, -1], [0, 11, 31, 51])
    # What began before the opening begins with it.
    assert starts_of([5, 7], [10, 30], 50, opened=35) == ([-1, 0, 1, -1], [0, 0, 0, 15])


def test_light_does_not_come_before_that_of_the_row_before() -> None:
    assert starts_of([5, 7, 9], [10, 40, 30], 50) == ([-1, 0, 1, 2, -1], [0, 10, 40, 40, 50])


def frames_of(primal: list[int], dual: list[int], shift: list[int], window: str) -> Frames:
    rng = np.random.default_rng(1)
    lattice = Lattice((2, 2), window)
    grey = pack_levels(rng.random((2, lattice.lattice_cells)))
    rows = np.arange(len(primal), dtype=np.int32)
    return Frames(
        grey, grey, np.array(primal, np.int32), np.array(dual, np.int32), np.array(shift, np.uint8),
        rows, rows < 0, (2, 2), lattice.shape, window,
    )  # fmt: skip


def test_sub_shifts_begin_spans_of_patterns_but_not_of_even_panels() -> None:
    frames = frames_of([0, 0, WHITE, WHITE, BLACK], [1, 1, 1, 0, 0], [0, 1, 1, 2, 3], "quarter")
    shown, at = np.arange(5, dtype=np.int32), np.arange(10, 60, 10, dtype=np.int64)
    rows, starts = find_frame_spans(frames, shown, at, 60, PanelOptics(), 0, True)
    assert (rows, starts.tolist()) == ([-1, 0, 1, 2, 4], [0, 10, 20, 30, 50])
    rows, starts = find_frame_spans(frames, shown, at, 60, PanelOptics(), 0, False)
    assert (rows, starts.tolist()) == ([-1, 0, 1, 3, 4, -1], [0, 10, 20, 40, 50, 60])


def test_a_row_that_was_not_shown_is_black() -> None:
    frames = frames_of([0, 1], [0, 1], [0, 0], "whole")
    shown, at = np.array([1, BLACK, 0], np.int32), np.array([10, 20, 30], np.int64)
    rows, starts = find_frame_spans(frames, shown, at, 40, PanelOptics(), 0, True)
    assert (rows, starts.tolist()) == ([-1, 1, BLACK, 0, -1], [0, 10, 20, 30, 40])


@pytest.mark.parametrize("primal_side", [True, False])
def test_what_a_span_asks_of_the_pixels_of_either_panel(primal_side: bool) -> None:
    frames = frames_of([1, WHITE, BLACK], [1, WHITE, BLACK], [3, 0, 0], "quarter")
    lattice = Lattice((2, 2), "quarter")

    def asked(row: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return compute_span_light(
            frames, lattice, row, make_power_curve(2.0), primal_side=primal_side
        )

    light = np.rint(255.0 * frames.primal_patterns[1].astype(np.float64)) ** 2 / 255.0**2
    place = lattice.primal_field_values if primal_side else lattice.dual_field_values
    np.testing.assert_allclose(asked(0), place(light, 3).ravel(), atol=1e-7)
    count = 16 if primal_side else 40
    white = np.ones(count)
    if not primal_side:
        white[9::10] = 0.0  # the rest of the panel stays black
    np.testing.assert_array_equal(asked(1), white)
    for row in (2, -1):
        np.testing.assert_array_equal(asked(row), np.zeros(count))


@pytest.mark.parametrize("slow", [False, True])
def test_overlaps_of_spans_are_integrals_of_both_fields(slow: bool) -> None:
    """By sums over short steps; the exposure cuts the last span."""
    primal = PanelOptics(0.003, 0.005) if slow else PanelOptics()
    dual = PanelOptics(0.004, 0.004) if slow else PanelOptics()
    p_start, d_start = (np.array(at, np.int64) * 1_000_000 for at in ([0, 4, 9], [0, 2, 6, 20]))
    weights, opens = compute_span_weights(primal, dual, p_start, d_start, exposure_ns=12_000_000)
    p_rates, d_rates = primal.rates, dual.rates
    assert weights.shape == (3 * p_rates.size, 4 * d_rates.size)
    assert opens.shape == (3, 4 * d_rates.size)
    step = 1e-6
    time = (np.arange(12_000) + 0.5) * step
    p = np.searchsorted(p_start * 1e-9, time, side="right") - 1
    d = np.searchsorted(d_start * 1e-9, time, side="right") - 1
    wanted, alone = np.zeros(weights.shape), np.zeros(opens.shape)
    for b, d_rate in enumerate(d_rates):
        seen = np.exp(-d_rate * (time - d_start[d] * 1e-9)) * step
        np.add.at(alone, (p, d * d_rates.size + b), seen)
        for a, p_rate in enumerate(p_rates):
            lit = seen * np.exp(-p_rate * (time - p_start[p] * 1e-9))
            np.add.at(wanted, (p * p_rates.size + a, d * d_rates.size + b), lit)
    np.testing.assert_allclose(weights.toarray(), wanted, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(opens.toarray(), alone, rtol=1e-6, atol=1e-12)


def test_spans_that_meet_give_the_time_of_pairs_of_pixels() -> None:
    """Three of either; those that are dark, or meet a shut mask, are left out."""
    light = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    masks = np.array([[0.0, 0.0], [1.0, 0.5], [0.0, 0.0]])
    track = Trajectory(PanelOptics(), np.array([0, 2, 5], np.int64), 2, lambda span: masks[span])
    lit_ns, open_ns = np.array([0, 3, 6], np.int64), np.array([0, 2, 5], np.int64)
    rows, opens = compute_span_weights(PanelOptics(), PanelOptics(), lit_ns, open_ns, exposure_ns=8)
    left, alive, open_s = meet_spans(light, track, rows, opens.sum(axis=0))
    assert alive.tolist() == [True, False, False]
    np.testing.assert_allclose(left, [[1e-9, 0.5e-9]])
    np.testing.assert_allclose(open_s, [3e-9, 1.5e-9])
    assert track.reached == 3
