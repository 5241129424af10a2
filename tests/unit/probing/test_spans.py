"""Spans of both panels: where they begin, what they ask for, and what they let through."""

from __future__ import annotations

import numpy as np

from pdcd.panels.frames import BLACK, Frames
from pdcd.panels.patterns import pack_levels
from pdcd.probing.panel import PanelOptics, Trajectory
from pdcd.probing.spans import compute_span_weights, find_frame_spans, find_span_starts, meet_spans


def starts_of(
    content: list[int], at: list[int], end: int, *, skew: int = 0, opened: int = 0
) -> tuple[list[int], list[int]]:
    rows, starts = find_span_starts(
        np.array(content, np.int32), np.array(at, np.int64), end, PanelOptics(skew_ns=skew), opened
    )
    return rows, starts.tolist()


def test_spans_count_from_the_opening_and_by_when_the_light_comes() -> None:
    assert starts_of([5, 7], [10, 30], 50, skew=4, opened=3) == ([-1, 0, 1, -1], [0, 11, 31, 51])
    # What began before the opening begins with it.
    assert starts_of([5, 7], [10, 30], 50, opened=35) == ([-1, 0, 1, -1], [0, 0, 0, 15])


def test_light_does_not_come_before_that_of_the_row_before() -> None:
    assert starts_of([5, 7, 9], [10, 40, 30], 50) == ([-1, 0, 1, 2, -1], [0, 10, 40, 40, 50])


def test_a_row_that_was_not_shown_is_black() -> None:
    grey = pack_levels(np.random.default_rng(1).random((2, 4)))
    both = np.arange(2, dtype=np.int32)
    frames = Frames(
        grey, grey, both, both, np.zeros(2, np.uint8), both, both < 0, (2, 2), (2, 2), "whole"
    )
    shown, at = np.array([1, BLACK, 0], np.int32), np.array([10, 20, 30], np.int64)
    rows, starts = find_frame_spans(frames, shown, at, 40, PanelOptics(), 0, True)
    assert (rows, starts.tolist()) == ([-1, 1, BLACK, 0, -1], [0, 10, 20, 30, 40])


def test_spans_after_the_end_meet_nothing() -> None:
    track = Trajectory(PanelOptics(), np.array([0], np.int64), 3, lambda span: np.ones(3))
    rows, opens = compute_span_weights(
        PanelOptics(),
        PanelOptics(),
        np.array([0, 9], np.int64),
        np.array([0], np.int64),
        exposure_ns=8,
    )
    left, alive, open_s = meet_spans(np.ones((1, 2)), track, rows[1:], opens[[1]].sum(axis=0))
    assert left.shape == (0, 3) and alive.tolist() == [False] and open_s.tolist() == [0.0] * 3
    assert track.reached == 0
