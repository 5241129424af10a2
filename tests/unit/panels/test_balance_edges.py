"""Lost refreshes at the edges: what is joined, sent, counted and asked for, number by number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import SyncError
from pdcd.panels.balance import (
    LitWeights,
    catch_up,
    count_lit_weights,
    join_logs,
    play_all,
    streams,
)
from pdcd.panels.frames import BLACK, FrameLog, Frames
from pdcd.panels.schedule import build_frames
from pdcd.words import ScheduleName

HZ = 50.0
T_NS = 20_000_000


def frames_of(
    count: int, schedule: ScheduleName = "none", window: str = "whole", **black: bool
) -> Frames:
    bits = np.zeros((count, 1 if window == "whole" else 2), dtype=np.uint8)
    return build_frames((bits, bits), (2, 3), window=window, schedule=schedule, passes=1, **black)


def log_of(primal: list[int], dual: list[int], lasts: list[int] | None = None) -> FrameLog:
    """Rows of both panels that change together, for so many refreshes each."""
    at = 7_000 + T_NS * np.append(0, np.cumsum(lasts or [1] * len(primal)))
    return FrameLog(
        np.array(primal, np.int32), np.array(dual, np.int32), at[:-1].copy(), at[:-1].copy(),
        np.array([at[-1], at[-1]]), np.zeros(len(primal), np.int32), "test", True,
    )  # fmt: skip


def test_both_streams_wait_for_each_other() -> None:
    rows = np.array([3, 4, 5], dtype=np.int32)
    for delay, primal, dual in (
        (0, [3, 4, 5], [3, 4, 5]),
        (2, [3, 4, 5, BLACK, BLACK], [BLACK, BLACK, 3, 4, 5]),
        (-1, [BLACK, 3, 4, 5], [3, 4, 5, BLACK]),
    ):
        found = streams(rows, delay)
        assert [stream.tolist() for stream in found] == [primal, dual]
        assert {stream.dtype for stream in found} == {np.dtype(np.int32)}


def test_a_joined_log_holds_both_passes_and_the_black_between_them() -> None:
    first, second = log_of([0, 1], [1, 0], [1, 2]), log_of([2], [3])
    first = replace(first, end_ns=np.array([500, 600]), missed=np.array([0, 4], np.int32))
    second = replace(
        second, primal_ns=np.array([900]), dual_ns=np.array([950]), end_ns=np.array([1000, 1100]),
        missed=np.array([2], np.int32), primal_asked=np.array([7], np.int32), mask_delay=1,
        source="other",
    )  # fmt: skip
    whole = join_logs([first, second])
    assert whole.primal_shown.tolist() == [0, 1, BLACK, 2]
    assert whole.dual_shown.tolist() == [1, 0, BLACK, 3]
    assert whole.primal_ns.tolist() == [*first.primal_ns.tolist(), 500, 900]
    assert whole.dual_ns.tolist() == [*first.dual_ns.tolist(), 600, 950]
    assert whole.end_ns.tolist() == [1000, 1100]
    assert whole.missed.tolist() == [0, 4, 0, 2]
    assert whole.asked[0].tolist() == [0, 1, BLACK, 7]
    assert whole.asked[1].tolist() == [0, 1, BLACK, 0]
    assert (whole.mask_delay, whole.source) == (1, "other")
    assert join_logs([first]) is first


@pytest.mark.parametrize("on_miss", ["balance", "retake"])
def test_only_one_policy_shows_codes_again(on_miss: str) -> None:
    """Under another the log is what it is, harm included."""
    played: list[list[int]] = []

    def play(rows: NDArray[np.int32]) -> FrameLog:
        played.append(rows.tolist())
        return log_of(rows.tolist(), rows.tolist(), [2, 1, 1] if len(played) == 1 else None)

    log = play_all(play, frames_of(3), on_miss=on_miss, rounds=1, row_hz=HZ)
    assert played == ([[0, 1, 2], [1, 2]] if on_miss == "balance" else [[0, 1, 2]])
    assert log.primal_shown.tolist() == ([0, 1, 2, -1, 1, 2] if len(played) == 2 else [0, 1, 2])


@pytest.mark.parametrize(
    ("realised", "planned", "level"),
    [([2, 2], [1, 1], 2.0), ([3, 6], [2, 4], 1.5), ([2, 3], [1, 1], None), ([0, 0], [1, 2], 0.0),
     ([1, 2], [1, 1], None), ([], [], 1.0)],
)  # fmt: skip
def test_one_level_is_that_of_all_pairs(
    realised: list[int], planned: list[int], level: float | None
) -> None:
    weights = LitWeights(np.array(realised, np.int64), np.array(planned, np.int64), ())
    assert weights.level == level


def test_a_dark_mask_has_no_weights_to_be_equal() -> None:
    frames = frames_of(3, dual_black=True)
    weights = count_lit_weights(frames, log_of([0, 1, 2], [0, 1, 2], [1, 5, 1]), HZ)
    assert weights.level == 1.0 and not weights.slots


def test_all_is_shown_again_where_nothing_was_seen() -> None:
    more = catch_up(frames_of(3), log_of([BLACK] * 3, [0, 1, 2]), HZ)
    assert more is not None and more.tolist() == [0, 1, 2] and more.dtype == np.int32


def test_sub_shifts_of_the_first_code_are_weighed_apart() -> None:
    """All four show pattern 0, each under another shift."""
    frames = frames_of(1, "both", "quarter")
    shown = list(range(8))
    lost = [*shown[:4], 3, *shown[5:]]  # the mask stays black under the third one
    more = catch_up(frames, log_of(shown, lost), HZ)
    assert more is not None and more.tolist() == [4, 5]


@pytest.mark.parametrize(("own", "harm"), [([0, 1], False), ([1, 0], True)])
def test_a_mask_of_another_code_does_harm_either_way(own: list[int], harm: bool) -> None:
    """Also where the pair that is seen comes after all that are planned."""
    log = log_of([0, 1], own)
    if harm:
        with pytest.raises(SyncError, match="2 refreshes"):
            catch_up(frames_of(2), log, HZ)
    else:
        assert catch_up(frames_of(2), log, HZ) is None


@pytest.mark.parametrize("schedule", ["lag", "lead"])
def test_a_projector_may_hold_a_code_longer_beside_its_guard(schedule: ScheduleName) -> None:
    """Before the open refresh or behind it: the light over it is of the same code."""
    log = log_of([0, 1, 2, 3], [0, 1, 2, 3])
    log.primal_ns[1 if schedule == "lag" else 3] += T_NS // 4 * 3
    assert catch_up(frames_of(2, schedule), log, HZ) is None


@pytest.mark.parametrize(("late_ns", "harm"), [(9_000_000, False), (11_000_000, True)])
def test_half_a_refresh_is_the_next_one(late_ns: int, harm: bool) -> None:
    """A projector that changes late by less than half of a refresh is on time."""
    log = log_of([0, 1, 2], [0, 1, 2])
    log.primal_ns[1:] += late_ns
    log.end_ns[0] += late_ns
    if harm:
        with pytest.raises(SyncError):
            catch_up(frames_of(3), log, HZ)
    else:
        assert catch_up(frames_of(3), log, HZ) is None
