"""Frames as tables: whole microseconds, planes that are alike, and rows by the sums of entries."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dlpc900.around import TableEntry
from drivers.dlpc900.commands import MOST_US
from drivers.dlpc900.sequence import (
    DmdSequence,
    count_fitting_codes,
    count_row_us,
    find_blocks,
    make_sequence,
)
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from pdcd.words import ScheduleName
from tests.panel_pixels import random_frames

GRID = (6, 8)


def frames_of(
    count: int, schedule: ScheduleName = "none", passes: int = 1, dark_s: float = 0.0
) -> Frames:
    codes = make_codes("balanced", GRID, count, dual="complement")
    pairs = pack_bits(codes.primal), pack_bits(codes.dual)
    return build_frames(
        pairs, GRID, window="whole", schedule=schedule, passes=passes, dark_s=dark_s
    )


def whole(sequence: DmdSequence) -> tuple[int, int]:
    return 0, sequence.asked.shape[1]


def lit(table: list[TableEntry]) -> list[tuple[bytes, int, int]]:
    """Each time of light: plane, begin and end, by the sums of the table."""
    found, at = [], 0
    for entry in table:
        if entry.plane:
            found.append((entry.plane, at, at + entry.exposure_us))
        at += entry.exposure_us + entry.dark_us
    return found


@pytest.mark.parametrize(
    ("hz", "row_us"), [(1e6 / 105, 105), (9523.81, 105), (8000.0, 125), (60.0, 16667)]
)
def test_rows_are_whole_microseconds(hz: float, row_us: int) -> None:
    assert count_row_us(hz) == row_us


def test_a_rate_between_them_is_refused_with_the_one_to_set() -> None:
    with pytest.raises(ConfigError, match=r"105\.26 us") as caught:
        count_row_us(9500.0)
    assert "9523.81" in str(caught.value.hint)


def test_an_entry_a_row_black_ones_without_a_plane() -> None:
    frames = frames_of(4, "both", dark_s=20e-6)
    sequence = make_sequence(frames, 105, 0)
    table = sequence.make_table(0, whole(sequence), joined=False)
    assert [entry[1:] for entry in table] == 7 * [(105, 20)] + [(105, 0)]
    assert [bool(entry.plane) for entry in table] == 4 * [True, False]
    assert len(sequence.planes[0].keys) == len(set(sequence.planes[0].keys)) == 4
    assert sequence.planes[0].rows == (0, 2, 4, 6)
    assert sequence.begins_us(0, whole(sequence)).tolist() == [125 * n for n in range(8)] + [980]


def test_pictures_that_are_alike_are_one_plane() -> None:
    """Equal patterns, white at any shift, and patterns without light."""
    frames = random_frames(GRID, "quarter", 8)
    primal = np.asarray(frames.primal_patterns, np.uint8).copy()
    primal[1], primal[2] = primal[0], 0
    index = np.array([0, 1, 2, BLACK, WHITE, WHITE, 0, 3], dtype=np.int32)
    shift = np.array([1, 1, 0, 0, 1, 2, 2, 0], dtype=np.uint8)
    frames = replace(frames, primal_patterns=primal, primal_index=index, shift=shift)
    planes = make_sequence(frames, 105, 0).planes[0]
    assert planes.plane.tolist() == [0, 0, -1, -1, 1, 1, 2, 3]
    assert planes.find_rows([planes.keys[2], planes.keys[0]]) == [6, 0]
    again = make_sequence(replace(frames, grid=(5, 8)), 105, 0).planes[0]
    assert not set(again.keys) & set(planes.keys), "another grid is another picture"


def test_times_that_are_none_and_grey_levels_are_refused() -> None:
    frames = frames_of(2)
    for times in ({"dark_s": np.array([0.0, -1e-6])}, {"delay_s": np.array([np.nan, 0.0])}):
        given_times: dict[str, Any] = times
        with pytest.raises(ConfigError):
            make_sequence(replace(frames, **given_times), 105, 0)
    with pytest.raises(ConfigError, match="grey levels"):
        make_sequence(random_frames(GRID, "whole", 8, grey=True), 105, 0)


@settings(max_examples=60)
@given(
    dark=st.lists(st.integers(0, 50), min_size=6, max_size=6),
    delay=st.lists(st.integers(-30, 30), min_size=6, max_size=6),
    rows=st.integers(-2, 2),
    joined=st.booleans(),
)
def test_light_is_where_the_log_says(
    dark: list[int], delay: list[int], rows: int, joined: bool
) -> None:
    """Tables, each begun by its lead, light each row from its stamp to the next, less the dark."""
    frames = replace(
        frames_of(2, "full"), dark_s=1e-6 * np.array(dark), delay_s=1e-6 * np.array(delay)
    )
    sequence = make_sequence(frames, 105, rows)
    block = whole(sequence)
    log = replace(sequence, blocks=(block,)).make_log([(10_000, 10_000)])
    assert log.mask_delay == rows and not log.verified and log.source == "dlpc900"
    leads = sequence.lead_us(block)
    assert min(leads) == 0
    for side, times_ns in enumerate((log.primal_ns, log.dual_ns)):
        zero_us = leads[side] - leads[0]
        found = lit(sequence.make_table(side, block, joined=joined))
        ends = np.append(times_ns[1:], log.end_ns[side])
        assert log.dark_s is not None
        ends[:-1] -= np.rint(1e9 * log.dark_s[:-1]).astype(int)
        planes = sequence.planes[side]
        wanted = [
            (planes.keys[planes.plane[n]], int(times_ns[n]) // 1000 - 10, int(ends[n]) // 1000 - 10)
            for n in range(len(log))
            if planes.plane[n] >= 0
        ]
        moved = [(key, begin + zero_us, end + zero_us) for key, begin, end in found]
        assert _merge(moved) == _merge(wanted)


def _merge(spans: list[tuple[bytes, int, int]]) -> list[tuple[bytes, int, int]]:
    """Spans of one plane that touch as one."""
    merged: list[tuple[bytes, int, int]] = []
    for key, begin, end in spans:
        if merged and merged[-1][0] == key and merged[-1][2] == begin:
            merged[-1] = key, merged[-1][1], end
        else:
            merged.append((key, begin, end))
    return merged


def test_one_table_where_there_is_room() -> None:
    sequence = make_sequence(frames_of(100, "both"), 105, 0)
    assert find_blocks(sequence, 200) == (((0, 200),), False)


def test_rows_that_are_alike_are_joined_where_there_is_none() -> None:
    """A white photo of a second, and codes with guards."""
    white = build_frames(None, GRID, window="whole", schedule="none", passes=9524)
    sequence = make_sequence(white, 105, 0)
    assert find_blocks(sequence, 399) == (((0, 9524),), True)
    (entry,) = sequence.make_table(0, whole(sequence), joined=True)
    assert entry.exposure_us == 9524 * 105
    guarded = make_sequence(frames_of(150, "full"), 105, 0)
    assert find_blocks(guarded, 399) == (((0, 450),), True)
    assert [len(guarded.make_table(s, (0, 450), joined=True)) for s in (0, 1)] == [150, 301]


def test_no_entry_is_longer_than_the_device_counts() -> None:
    white = build_frames(None, GRID, window="whole", schedule="none", passes=3000)
    sequence = make_sequence(white, 16667, 0)
    table = sequence.make_table(1, whole(sequence), joined=True)
    assert sum(entry.exposure_us for entry in table) == 3000 * 16667
    assert max(entry.exposure_us for entry in table) <= MOST_US and len(table) == 3


def test_passes_are_cut_into_whole_rounds() -> None:
    """24 rows a pass: blocks of 4 passes fit 99 entries, and all are alike."""
    sequence = make_sequence(frames_of(12, "both", passes=10), 105, 0)
    blocks, joined = find_blocks(sequence, 99)
    assert blocks == ((0, 96), (96, 192), (192, 240)) and not joined
    tables = [sequence.make_table(0, block, joined=False) for block in blocks[:2]]
    assert tables[0] == tables[1]
    single = make_sequence(frames_of(120, "both"), 105, 0)
    assert find_blocks(single, 100)[0] == ((0, 100), (100, 200), (200, 240))


def test_a_log_of_blocks_is_black_between_them() -> None:
    sequence = make_sequence(frames_of(12, "both", passes=2), 100, 0)
    cut = replace(sequence, blocks=((0, 24), (24, 48)))
    log = cut.make_log([(0, 0), (5_000_000, 5_000_007)])
    assert len(log) == 49 and log.primal_shown[24] == BLACK == log.dual_shown[24]
    assert log.primal_ns[[0, 23, 24, 25]].tolist() == [0, 2_300_000, 2_400_000, 5_000_000]
    assert log.dual_ns[25] == 5_000_007 and log.end_ns.tolist() == [7_400_000, 7_400_007]
    assert log.primal_shown[25:].tolist() == list(range(24, 48))


def test_how_many_codes_fit() -> None:
    both, none = make_sequence(frames_of(300, "both"), 105, 0), frames_of(300)
    assert count_fitting_codes(both, 399, 399) == 199
    assert count_fitting_codes(make_sequence(none, 105, 0), 399, 200) == 200
