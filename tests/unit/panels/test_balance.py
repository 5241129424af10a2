"""Making up for missed refreshes: rows to play next, by hand-made logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pdcd.calibration.shown import PanelSequence, pack_frames
from pdcd.codes.make import make_codes
from pdcd.errors import SyncError
from pdcd.panels.balance import (
    catch_up,
    count_lit_weights,
    join_logs,
    measure_still_level,
    play_all,
    streams,
)
from pdcd.panels.frames import BLACK, WHITE, FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.words import ScheduleName
from tests import bench_rig

HZ = 60.0
T_NS = 16_666_667


def frames_of(
    count: int = 4, *, schedule: ScheduleName = "full", window: str = "whole", passes: int = 1
) -> Frames:
    codes = make_codes("bernoulli", Lattice((3, 4), window).shape, count, dual="complement")
    return build_frames(
        bench_rig.pairs(codes), (3, 4), window=window, schedule=schedule, passes=passes
    )


def log_of(
    rows: Sequence[int], lasts: Sequence[int] | None = None, *, dual: Sequence[int] | None = None
) -> FrameLog:
    """Rows shown for so many refreshes each; `dual` where the mask showed other ones."""
    shown = np.array(rows, dtype=np.int32)
    long = np.ones(len(rows), dtype=np.int64) if lasts is None else np.array(lasts)
    at = 5_000_000 + T_NS * np.append(0, np.cumsum(long))
    return FrameLog(
        shown, shown if dual is None else np.array(dual, np.int32), at[:-1].copy(), at[:-1].copy(),
        np.array([at[-1], at[-1]]), np.append(0, long[:-1] - 1).astype(np.int32), "test", True,
    )  # fmt: skip


def undisturbed(frames: Frames, log: FrameLog, row_hz: float) -> bool:
    """Whether all codes have equal weights and met no other's light: misses did no harm."""
    try:
        return catch_up(frames, log, row_hz) is None
    except SyncError:
        return False


@pytest.mark.parametrize("row", [0, 3, 11])
def test_a_stretched_guard_is_harmless(row: int) -> None:
    lasts = np.ones(12, dtype=int)
    lasts[row] = 5
    log = log_of(range(12), lasts.tolist())
    assert catch_up(frames_of(), log, HZ) is None
    assert log.missed.sum() == (4 if row < 11 else 0)


def test_codes_planned_twice_and_lit_thrice_are_brought_to_four_times() -> None:
    """Three is no multiple of the plan, and no code may be shown less than it was."""
    lasts = [1, 2, *[1] * 10]
    more = catch_up(frames_of(2, passes=2), log_of(range(12), lasts), HZ)
    assert more is not None
    np.testing.assert_array_equal(more, [0, 1, 2, 3, 4, 5, 3, 4, 5])


def test_a_mask_that_stayed_black_asks_for_its_code_alone() -> None:
    more = catch_up(frames_of(), log_of(range(12), dual=[0, 1, 2, 3, 3, 5, *range(6, 12)]), HZ)
    assert more is not None
    np.testing.assert_array_equal(more, [3, 4, 5])


def test_a_projector_that_slipped_alone_cannot_be_undone() -> None:
    """Without guards, light of a code that stays on meets the next mask."""
    frames = frames_of(4, schedule="none")
    log = log_of(range(4))
    log.primal_ns[2:] += T_NS
    log.end_ns[0] += T_NS
    with pytest.raises(SyncError):
        catch_up(frames, log, HZ)
    guarded = log_of(range(12))
    guarded.primal_ns[5:] += T_NS
    guarded.end_ns[0] += T_NS
    assert undisturbed(frames_of(), guarded, HZ)


def test_black_shots_are_weighed_by_their_open_mask() -> None:
    codes = make_codes("bernoulli", (3, 4), 3, dual="complement")
    frames = build_frames(
        bench_rig.pairs(codes), (3, 4), window="whole", schedule="full", passes=1, primal_black=True
    )
    more = catch_up(frames, log_of(range(9), [1, 1, 1, 1, 2, 1, 1, 1, 1]), HZ)
    assert more is not None
    np.testing.assert_array_equal(more, [0, 1, 2, 6, 7, 8])
    dark = build_frames(
        bench_rig.pairs(codes), (3, 4), window="whole", schedule="full", passes=1, dual_black=True
    )
    assert catch_up(dark, log_of(range(9), [1, 1, 1, 1, 2, 1, 1, 1, 1]), HZ) is None


@pytest.mark.parametrize("delay", [-3, -1, 0, 2])
def test_a_delayed_mask_is_paired_with_its_own_light(delay: int) -> None:
    frames = frames_of(4, schedule="none")
    primal, dual = streams(np.arange(4, dtype=np.int32), delay)
    assert len(primal) == len(dual) == 4 + abs(delay)
    log = log_of(primal.tolist(), dual=dual.tolist())
    assert undisturbed(frames, log, HZ) is (delay == 0)
    aware = FrameLog(
        log.primal_shown, log.dual_shown, log.primal_ns, log.dual_ns, log.end_ns, log.missed,
        "test", True, mask_delay=delay,
    )  # fmt: skip
    assert undisturbed(frames, aware, HZ)


@settings(max_examples=30)
@given(
    lasts=st.lists(st.integers(1, 3), min_size=12, max_size=12),
    stale=st.sets(st.sampled_from([1, 5, 7, 10]), max_size=3),
    unlucky=st.integers(0, 5),
)
def test_all_weights_end_equal(lasts: list[int], stale: set[int], unlucky: int) -> None:
    """Random stretches and stale masks in the first pass and one stretch in the second."""
    frames = frames_of()
    passes: list[FrameLog] = []

    def play(rows: NDArray[np.int32]) -> FrameLog:
        long = list(lasts) if not passes else [1] * len(rows)
        dual = rows.tolist()
        if not passes:
            for row in sorted(stale):
                dual[row] = dual[row - 1]
        elif len(passes) == 1 and unlucky < len(rows):
            long[unlucky] = 2
        log = log_of(rows.tolist(), long, dual=dual)
        shift = 10**9 * len(passes)
        passes.append(log)
        return FrameLog(
            log.primal_shown, log.dual_shown, log.primal_ns + shift, log.dual_ns + shift,
            log.end_ns + shift, log.missed, "test", True,
        )  # fmt: skip

    log = play_all(play, frames, on_miss="balance", rounds=9, row_hz=HZ)
    lit = np.zeros(4)
    ends = np.append(log.dual_ns[1:], log.end_ns[1])
    for p, d, start, end in zip(log.primal_shown, log.dual_shown, log.dual_ns, ends, strict=True):
        if d >= 0 and not frames.guard[d] and p != BLACK:
            assert frames.primal_index[p] == frames.dual_index[d]
            lit[frames.dual_index[d]] += round((end - start) / T_NS)
    assert lit.min() == lit.max() >= 1


def test_passes_that_do_not_end_are_given_up() -> None:
    frames = frames_of()
    with pytest.raises(SyncError, match="2 further passes do not"):
        play_all(
            lambda rows: log_of(rows.tolist(), [1, 2, *[1] * (len(rows) - 2)]),
            frames, on_miss="balance", rounds=2, row_hz=HZ,
        )  # fmt: skip


def test_the_last_pass_that_is_allowed_is_played() -> None:
    """The mask misses all codes at first: one more pass over all of them mends that."""
    played = []

    def play(rows: NDArray[np.int32]) -> FrameLog:
        played.append(rows)
        return log_of(rows.tolist(), dual=[0] * 12 if len(played) == 1 else None)

    play_all(play, frames_of(), on_miss="balance", rounds=1, row_hz=HZ)
    assert [len(rows) for rows in played] == [12, 12]


def test_a_stall_of_seconds_is_not_made_up_for_by_hours() -> None:
    played = []

    def play(rows: NDArray[np.int32]) -> FrameLog:
        played.append(rows)
        return log_of(rows.tolist(), [1, 300, *[1] * (len(rows) - 2)])

    with pytest.raises(SyncError, match="do not mend"):
        play_all(play, frames_of(), on_miss="balance", rounds=3, row_hz=HZ)
    assert len(played) == 1


def zero_frames(
    count: int, schedule: ScheduleName = "none", window: str = "whole", **black: bool
) -> Frames:
    bits = np.zeros((count, 1 if window == "whole" else 2), dtype=np.uint8)
    return build_frames((bits, bits), (2, 3), window=window, schedule=schedule, passes=1, **black)


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
    first, second = log_of([0, 1], [1, 2], dual=[1, 0]), log_of([2], dual=[3])
    first = replace(first, end_ns=np.array([500, 600]), missed=np.array([0, 4], np.int32))
    second = replace(
        second, verified=False, primal_ns=np.array([900]), dual_ns=np.array([950]),
        end_ns=np.array([1000, 1100]), missed=np.array([2], np.int32),
        primal_asked=np.array([7], np.int32), mask_delay=1, source="other",
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
    assert not whole.verified and not join_logs([second, first]).verified
    assert join_logs([first]) is first


@pytest.mark.parametrize("on_miss", ["balance", "retake"])
def test_only_one_policy_shows_codes_again(on_miss: str) -> None:
    """Under another the log is what it is, harm included."""
    played: list[list[int]] = []

    def play(rows: NDArray[np.int32]) -> FrameLog:
        played.append(rows.tolist())
        return log_of(rows.tolist(), [2, 1, 1] if len(played) == 1 else None)

    log = play_all(play, zero_frames(3), on_miss=on_miss, rounds=1, row_hz=HZ)
    assert played == ([[0, 1, 2], [1, 2]] if on_miss == "balance" else [[0, 1, 2]])
    assert log.primal_shown.tolist() == ([0, 1, 2, -1, 1, 2] if len(played) == 2 else [0, 1, 2])


def test_a_dark_mask_has_no_weights_to_be_equal() -> None:
    frames = zero_frames(3, dual_black=True)
    weights = count_lit_weights(frames, log_of([0, 1, 2], [1, 5, 1]), HZ)
    assert weights.level == 1.0 and not weights.slots


def test_all_is_shown_again_where_nothing_was_seen() -> None:
    more = catch_up(zero_frames(3), log_of([BLACK] * 3, dual=[0, 1, 2]), HZ)
    assert more is not None and more.tolist() == [0, 1, 2] and more.dtype == np.int32


def test_sub_shifts_of_the_first_code_are_weighed_apart() -> None:
    """All four show pattern 0, each under another shift."""
    frames = zero_frames(1, "both", "quarter")
    shown = list(range(8))
    lost = [*shown[:4], 3, *shown[5:]]  # the mask stays black under the third one
    more = catch_up(frames, log_of(shown, dual=lost), HZ)
    assert more is not None and more.tolist() == [4, 5]


@pytest.mark.parametrize(("own", "harm"), [([0, 1], False), ([1, 0], True)])
def test_a_mask_of_another_code_does_harm_either_way(own: list[int], harm: bool) -> None:
    """Also where the pair that is seen comes after all that are planned."""
    log = log_of([0, 1], dual=own)
    if harm:
        with pytest.raises(SyncError, match="2 refreshes"):
            catch_up(zero_frames(2), log, HZ)
    else:
        assert catch_up(zero_frames(2), log, HZ) is None


@pytest.mark.parametrize("schedule", ["lag", "lead"])
def test_a_projector_may_hold_a_code_longer_beside_its_guard(schedule: ScheduleName) -> None:
    """Before the open refresh or behind it: the light over it is of the same code."""
    log = log_of(range(4))
    log.primal_ns[1 if schedule == "lag" else 3] += T_NS // 4 * 3
    assert catch_up(zero_frames(2, schedule), log, HZ) is None


@pytest.mark.parametrize(("late_ns", "harm"), [(7_500_000, False), (9_200_000, True)])
def test_half_a_refresh_is_the_next_one(late_ns: int, harm: bool) -> None:
    """A projector that changes late by less than half of a refresh is on time."""
    log = log_of(range(3))
    log.primal_ns[1:] += late_ns
    log.end_ns[0] += late_ns
    if harm:
        with pytest.raises(SyncError):
            catch_up(zero_frames(3), log, HZ)
    else:
        assert catch_up(zero_frames(3), log, HZ) is None


def test_a_stretched_code_asks_for_all_others_with_their_guards() -> None:
    lasts = [1, 1, 1, 1, 2, 1, 1, 1, 1, 1, 1, 1]
    more = catch_up(frames_of(), log_of(range(12), lasts), HZ)
    assert more is not None
    np.testing.assert_array_equal(more, [0, 1, 2, 6, 7, 8, 9, 10, 11])


W = WHITE
STILL = [BLACK, W, W, W, W, BLACK]
OPEN = [W] * 6


@pytest.mark.parametrize(
    ("primal", "dual", "lasts", "level"),
    [
        (STILL, OPEN, [1, 1, 1, 1, 1, 1], 1.0),
        (STILL, OPEN, [1, 1, 3, 1, 1, 1], 6 / 4),
        (STILL, OPEN, [2, 1, 1, 1, 1, 3], 1.0),  # only while the projector is black
        ([BLACK] * 6, [BLACK] * 6, [1, 1, 5, 1, 1, 1], 1.0),  # a dark photo
        ([W] * 6, [BLACK] * 6, [1, 1, 2, 1, 1, 1], 7 / 6),  # what leaks
        ([BLACK] * 6, OPEN, [1, 1, 1, 1, 1, 4], 9 / 6),  # the room, through an open mask
        ([W, W, BLACK, W, W, BLACK], OPEN, [1, 1, 2, 1, 1, 1], None),  # a pulse is later
        ([W, W, 0, 0, BLACK, BLACK], OPEN, [1, 1, 1, 2, 1, 1], None),  # pictures change
    ],
)
def test_a_late_refresh_makes_a_still_photo_lighter_and_spoils_no_other(
    primal: list[int], dual: list[int], lasts: list[int], level: float | None
) -> None:
    patterns = np.ones((1, 2, 3), np.bool_)
    shown = PanelSequence(
        "a", patterns, patterns, np.array(primal, np.int32), np.array(dual, np.int32)
    )
    assert measure_still_level(pack_frames(shown), log_of(range(6), lasts), HZ) == level
