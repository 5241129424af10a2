"""What the driver of real panels says of them, and the log that it makes of vblanks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.x11 import build_frame_log, has_several_codes
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.presenter.messages import LOG_COLUMNS, Column, Ready

PERIOD_NS = 10_000_000


def log_of(vblanks: list[int], *, flipped: bool = True) -> np.ndarray[Any, Any]:
    log = np.zeros((len(vblanks), LOG_COLUMNS), dtype=np.int64)
    log[:, Column.MSC] = vblanks
    log[:, Column.NS] = log[:, Column.MSC] * PERIOD_NS
    log[:, Column.FLIPPED] = flipped
    return log


def rows(*numbers: int) -> np.ndarray[Any, Any]:
    return np.array(numbers, dtype=np.int32)


def test_a_row_is_shown_from_its_vblank_and_late_by_those_that_passed() -> None:
    ready = Ready("present-complete", 100.0, {})
    found = build_frame_log(rows(0, 1, BLACK), rows(BLACK, 0, 1), log_of([7, 8, 11, 12]), ready)
    assert found.primal_shown.tolist() == [0, 1, BLACK]
    assert found.dual_shown.tolist() == [BLACK, 0, 1]
    assert found.primal_asked is not None and found.primal_asked.tolist() == [0, 1, BLACK]
    assert found.dual_asked is not None and found.dual_asked.tolist() == [BLACK, 0, 1]
    assert found.primal_ns.tolist() == found.dual_ns.tolist() == [n * PERIOD_NS for n in (7, 8, 11)]
    assert found.primal_ns is not found.dual_ns
    assert found.end_ns.tolist() == [12 * PERIOD_NS] * 2
    assert found.missed.tolist() == [0, 0, 2] and found.missed.dtype == np.int32
    assert (found.source, found.verified, found.mask_delay) == ("present-complete", True, 0)


def test_a_black_that_came_late_is_no_missed_row() -> None:
    found = build_frame_log(rows(0, 1), rows(0, 1), log_of([7, 8, 15]), Ready("clock", 100.0, {}))
    assert found.missed.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("source", "flips", "verified"),
    [
        ("present-complete", [1, 1, 1], True),
        ("present-complete", [1, 0, 1], False),  # one was copied
        ("present-complete", [0, 0, 0], False),
        ("clock", [1, 1, 1], False),
        ("swap", [1, 1, 1], False),
    ],
)
def test_a_log_is_proof_where_the_source_is_one_and_every_frame_was_a_flip(
    source: Any, flips: list[int], verified: bool
) -> None:
    log = log_of([1, 2, 3])
    log[:, Column.FLIPPED] = flips
    found = build_frame_log(rows(0, 1), rows(0, 1), log, Ready(source, 100.0, {}))
    assert (found.source, found.verified) == (source, verified)


def frames_of(primal: list[int], dual: list[int], shift: list[int]) -> Frames:
    patterns, count = np.zeros((4, 2), np.uint8), len(primal)
    return Frames(
        patterns, patterns, np.array(primal, np.int32), np.array(dual, np.int32),
        np.array(shift, np.uint8), np.zeros(count, np.int32), np.zeros(count, np.bool_),
        (3, 4), (3, 4), "whole",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("primal", "dual", "shift", "several"),
    [
        ([0, 0], [0, 0], [0, 0], False),
        ([0, 1], [0, 0], [0, 0], True),
        ([0, 0], [0, 1], [0, 0], True),
        ([0, 0], [0, 0], [0, 1], True),
        ([0, 1], [0, BLACK], [0, 0], False),  # behind a black mask nothing is seen
        ([0, 0], [WHITE, WHITE], [0, 3], False),  # an open mask has no sub-shift
        ([0, 0], [WHITE, 0], [0, 0], True),
    ],
)
def test_a_miss_makes_codes_unequal_where_there_are_several(
    primal: list[int], dual: list[int], shift: list[int], several: bool
) -> None:
    assert has_several_codes(frames_of(primal, dual, shift)) is several


@pytest.mark.parametrize("count", [5, 6])
def test_planes_of_a_picture_have_their_part_of_the_refresh_each_time_it_is_shown(
    count: int,
) -> None:
    """The second of three pictures lasts two refreshes of 10 ms; the third may be half empty."""
    starts, period_ns = (0.1, 0.4), 10_000_000
    late = [0, 1, 0]
    log = np.zeros((4, LOG_COLUMNS), dtype=np.int64)
    log[:, Column.MSC] = [100, 101, 103, 104]
    log[:, Column.NS] = log[:, Column.MSC] * period_ns
    primal = np.arange(10, 10 + count, dtype=np.int32)
    found = build_frame_log(primal, primal + 50, log, Ready("clock", 100.0, {}), starts)

    wanted: list[tuple[int, int, int]] = []
    for picture, again in enumerate(late):
        for turn in range(1 + again):
            for plane, start in enumerate(starts):
                at_ns = int(log[picture, Column.NS]) + round((turn + start) * period_ns)
                lost = late[picture - 1] if picture and not turn and not plane else 0
                wanted.append((10 + 2 * picture + plane, at_ns, lost))
    end_ns = 1040 * 1_000_000 + 1_000_000  # black begins with its own first plane
    if count == 5:  # the plane that fills the last picture up is black already
        end_ns = wanted.pop()[1]
    rows, times_ns, missed = (list(column) for column in zip(*wanted, strict=True))
    assert found.primal_shown.tolist() == rows
    assert found.dual_shown.tolist() == [row + 50 for row in rows]
    assert found.primal_ns.tolist() == found.dual_ns.tolist() == times_ns
    assert found.missed.tolist() == missed
    assert found.end_ns.tolist() == [end_ns, end_ns]
    assert found.primal_shown.dtype == found.missed.dtype == np.int32


def test_planes_never_run_backwards_where_stamps_jitter() -> None:
    log = np.zeros((3, LOG_COLUMNS), dtype=np.int64)
    log[:, Column.MSC] = [100, 101, 102]
    log[:, Column.NS] = [1_000_000_000, 1_008_000_000, 1_020_000_000]
    rows = np.arange(4, dtype=np.int32)
    found = build_frame_log(rows, rows, log, Ready("clock", 100.0, {}), (0.0, 0.9))
    assert found.primal_ns.tolist() == [
        1_000_000_000, 1_009_000_000, 1_009_000_000, 1_017_000_000,
    ]  # fmt: skip
