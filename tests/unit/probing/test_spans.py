"""Spans of both panels: where they begin, what they ask for, and what they let through."""

from __future__ import annotations

import numpy as np

from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.lattice import Lattice
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
