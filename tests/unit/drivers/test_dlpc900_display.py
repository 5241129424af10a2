"""The display of two DMDs: what it sends them, and how its sequences start."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.errors import SyncError
from pdcd.panels.draw import draw
from pdcd.panels.frames import BLACK
from pdcd.panels.schedule import build_frames
from tests.dlpc900_rig import (
    GRID,
    ROW_US,
    SIZE,
    Dlpc900Rig,
    ignore,
    looked_at,
    never,
    opened,
    random_codes,
    shown,
)
from tests.panel_pixels import random_frames

# What is sent


def test_a_device_is_taken_over_in_the_guides_order() -> None:
    """Status first; stopped before its mode is changed, and after; the table before its picture;
    the picture before the start; then it shows a plane without light, for ever."""
    rig, _ = opened()
    sent = [one.command for one in rig.dmds[1].sent if not one.flags & 0x80]
    assert sent[:11] == [
        0x1A24, 0x0201, 0x1A1B, 0x1A24, 0x1A1D, 0x1A35, 0x1A34, 0x1A31, 0x1A2A, 0x1A2B, 0x1A24,
    ]  # fmt: skip
    assert rig.dmds[1].sent[0].command == 0x1A0A
    writes = {one.command: one.data for one in rig.dmds[1].sent if not one.flags & 0x80}
    assert writes[0x1A1B] == b"\x03" and writes[0x1A24] == b"\x02" and writes[0x0201] == b"\0"
    assert writes[0x1A35].hex() == "690000" and writes[0x1A31].hex() == "010000000000"
    assert writes[0x1A34].hex() == "0000e8030011000000000000"
    data = [one for one in rig.dmds[1].sent if one.command == 0x1A2B]
    assert all(one.flags == 0 for one in data), "no answer may be asked to data"
    assert all(dmd.black for dmd in rig.dmds)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_every_plane_of_every_row_is_what_is_drawn(window: str) -> None:
    rig, display = opened(start="software")
    frames = random_frames(GRID, window, 40)
    frames = replace(frames, dark_s=np.full(40, 20e-6))
    display.load(frames)
    assert all(dmd.black for dmd in rig.dmds)
    tables: list[Any] = []
    log = display.play(ignore, looked_at(rig, tables))
    views = panels_of(rig.config())
    for view, table in zip((views.projector, views.mask), tables, strict=True):
        assert len(table) == 41 and not table[40][0].any(), "it ends on a plane without light"
        for row, (plane, exposure_us, dark_us) in enumerate(table[:40]):
            np.testing.assert_array_equal(plane, draw(frames, view, row) > 0)
            assert (exposure_us, dark_us) == (ROW_US, 20 if row < 39 else 0)
    np.testing.assert_array_equal(np.diff(log.primal_ns), 145_000)
    assert log.dark_s is not None and set(log.dark_s) == {20e-6} and log.delay_s is None
    assert not log.verified and all(dmd.black for dmd in rig.dmds)


def test_pictures_are_sent_the_last_one_first_with_their_errors_asked_for() -> None:
    rig, display = opened()
    rig.forget()
    display.load(random_codes(60))
    for dmd in rig.dmds:
        assert [one.data[0] for one in dmd.said(0x1A2A)] == [3, 2, 1, 0]
        order = [one.command for one in dmd.sent if one.command in (0x1A2A, 0x1A2B, 0x0100)]
        ends = [n for n, command in enumerate(order) if command == 0x0100]
        assert len(ends) == 4 and all(order[n - 1] == 0x1A2B for n in ends)


def test_pictures_are_sent_where_entries_changed_and_outlive_black() -> None:
    """By the guide, as many entries that show the same keep their pictures, whatever their times
    and order."""
    rig, display = opened()
    frames = random_codes(60)
    white = build_frames(None, GRID, window="whole", schedule="none", passes=3)
    slower, few = replace(frames, dark_s=np.full(60, 5e-6)), random_codes(24, 2)
    display.load(slower)
    loads: Any = ((slower, []), (frames, []), (white, [4, 0]), (few, [5, 0]))
    for other, pictures in loads:
        rig.forget()
        display.load(other)
        assert [[one.data[0] for one in dmd.said(0x1A2A)] for dmd in rig.dmds] == [pictures] * 2
    rig.forget()
    display.load(frames)
    assert [one.data[0] for one in rig.dmds[0].said(0x1A2A)] == [3, 2, 1, 0]
    entries = [one.data[0] for one in rig.dmds[0].said(0x1A34)]
    assert entries == [*range(25)], "what the 24 codes had changed"
    rig.forget()
    display.load(frames)
    assert not rig.dmds[0].said(0x1A34) and all(dmd.order == (60,) for dmd in rig.dmds)


def test_a_device_that_takes_no_order_of_entries_is_black_all_the_same() -> None:
    rig, display = opened(start="software")
    for dmd in rig.dmds:
        dmd.refuses = {0x1A32: 3}
    frames = random_codes(30)
    display.load(frames)
    assert all(dmd.black and dmd.table == (1, 0) for dmd in rig.dmds)
    rig.forget()
    tables: list[Any] = []
    display.play(ignore, looked_at(rig, tables))
    views = panels_of(rig.config())
    for dmd, table, view in zip(rig.dmds, tables, (views.projector, views.mask), strict=True):
        assert [one.data[0] for one in dmd.said(0x1A2A)] == [2, 1, 0, 0], "they were lost meanwhile"
        np.testing.assert_array_equal(table[29][0], draw(frames, view, 29) > 0)
        assert dmd.black


@pytest.mark.parametrize("start", ["software", "chain", "trigger"])
def test_what_comes_around_again_and_again_is_sent_once(start: str) -> None:
    """As the parts of a stream: orders of entries alone choose among them, each with its planes,
    its times and its trigger; what else is shown in between parts them."""
    rig, display = opened(start=start)
    views = panels_of(rig.config())
    white = build_frames(None, GRID, window="whole", schedule="none", passes=3)
    parts = [white, *(random_codes(20, seed, passes=seed) for seed in (1, 2, 3))]
    sent = []
    for turn in range(6):
        rig.forget()
        for frames in (*parts, *([random_codes(30, 4)] if turn == 3 else [])):
            display.load(frames)
            assert all(dmd.black for dmd in rig.dmds)
            display._arm(0)
            for side, view in enumerate((views.projector, views.mask)):
                dmd = rig.dmds[side]
                leads = start == "chain" and side == 0
                table = shown(dmd)[leads:]
                assert len(table) == len(frames) + 1 and not table[-1][0].any()
                for row, (plane, exposure_us, dark_us) in enumerate(table[:-1]):
                    np.testing.assert_array_equal(plane, draw(frames, view, row) > 0)
                    assert (exposure_us, dark_us) == (ROW_US, 0)
                longer = {n - 1 for n in range(1, 400) if dmd.entries.get(n, bytes(6))[5] & 0x80}
                assert turn < 4 or longer.isdisjoint(dmd.order), "they take longer by the guide"
                waits = [dmd.entries[n][5] >> 7 for n in dmd.order]
                assert waits == [start == "trigger" or (start == "chain" and side == 1)] + [0] * (
                    len(dmd.order) - 1
                )
            display.black()
        sent.append([len(dmd.said(0x1A2A, 0x1A34)) for dmd in rig.dmds])
    assert all(min(sent[n]) > 0 for n in (0, 1, 2, 3, 4)), sent
    assert sent[5] == [0, 0]


def test_tables_that_come_around_but_do_not_lie_side_by_side_are_sent_each_time() -> None:
    """Where the device takes no order of entries, or has no room."""
    for refuses, count in (({0x1A32: 3}, 20), ({}, 180), ({}, 200)):
        rig, display = opened(start="software")
        for dmd in rig.dmds:
            dmd.refuses = dict(refuses)
        view = panels_of(rig.config()).mask
        for seed in (1, 2, 3) * 4:
            frames = random_codes(count, seed)
            display.load(frames)
            tables: list[Any] = []
            display.play(ignore, looked_at(rig, tables))
            for row in (0, 23, 24, count - 1) if count > 24 else (0, count - 1):
                np.testing.assert_array_equal(tables[1][row][0], draw(frames, view, row) > 0)
            assert all(dmd.black for dmd in rig.dmds)


def test_both_halves_of_a_panel_with_two_controllers() -> None:
    rig = Dlpc900Rig(start="software")
    rig.dmds[0].answers[0x1A0A] = b"\x11"
    display = rig.make()
    display.connect()
    frames = random_codes(30)
    rig.forget()
    display.load(frames)
    said = rig.dmds[0].said(0x1A2A, 0x1A2C)
    assert [(one.command, one.data[0]) for one in said] == [
        (0x1A2A, 2), (0x1A2C, 2), (0x1A2A, 1), (0x1A2C, 1), (0x1A2A, 0), (0x1A2C, 0),
    ]  # fmt: skip
    begin = rig.dmds[0].pictures[1, 0x1A2C][:8]
    assert begin == b"Spld" + bytes([SIZE[0] // 2, 0, SIZE[1], 0])
    tables: list[Any] = []
    display.play(ignore, looked_at(rig, tables))
    view = panels_of(rig.config()).projector
    np.testing.assert_array_equal(tables[0][29][0], draw(frames, view, 29) > 0)


def test_options_of_what_guides_leave_open() -> None:
    rig, display = opened(trigger_bit=0, led=7, edge="falling", start="trigger")
    assert rig.dmds[0].said(0x1A35)[0].data.hex() == "690001"
    display.load(random_codes(2))
    assert rig.dmds[0].entries[1].hex() == "01007d000071000000000108"


# How it starts


def test_one_edge_starts_both_that_wait_for_it() -> None:
    """Right after `load` black is the sequence that waits; entry 0 alone does."""
    rig, display = opened(start="trigger")
    display.load(random_codes(8))
    display.black()
    for dmd in rig.dmds:
        assert dmd.waits and dmd.table == (9, 9)
        assert [dmd.entries[n][5] >> 7 for n in range(9)] == [1] + [0] * 8
    edge_ns = rig.clock.now_ns()
    for dmd in rig.dmds:
        dmd.trigger()
    rig.clock.sleep_until_ns(edge_ns + 50_000_000)
    log = display.play(ignore, never)
    np.testing.assert_array_equal(log.dual_ns, log.primal_ns)
    assert edge_ns <= log.primal_ns[0] and log.end_ns.max() <= rig.clock.now_ns()
    display.black()
    assert all(dmd.black and not dmd.waits for dmd in rig.dmds), "no edge lights it any more"


def test_a_black_that_is_not_right_after_load_waits_for_nothing() -> None:
    rig, display = opened(start="trigger")
    display.load(random_codes(8))
    display.black()
    display.black()
    assert not any(dmd.waits for dmd in rig.dmds) and all(dmd.black for dmd in rig.dmds)


def test_black_is_looked_at_and_made_anew_where_it_has_ended() -> None:
    rig, display = opened()
    rig.forget()
    display.black()
    assert [one.command for one in rig.dmds[0].sent] == [0x1A0C]
    rig.dmds[0].runs_from_ns = None  # whatever ended it
    display.black()
    assert rig.dmds[0].black and rig.dmds[0].said(0x1A34)


@pytest.mark.parametrize(("triggered", "who"), [((), "projector and the mask"), ((0,), "mask")])
def test_a_trigger_that_does_not_come_is_told(triggered: tuple[int, ...], who: str) -> None:
    rig, display = opened(start="trigger")
    display.load(random_codes(8))
    display.black()
    for number in triggered:
        rig.dmds[number].trigger()
    with pytest.raises(SyncError, match=f"no trigger came to the {who}, or") as caught:
        display.play(ignore, never)
    assert "TRIG_IN_1" in str(caught.value.hint)
    assert all(dmd.black and not dmd.waits for dmd in rig.dmds)


@pytest.mark.parametrize(
    ("delay_us", "leads"), [(0, (105, 105)), (40, (105, 145)), (-40, (145, 105))]
)
def test_a_chain_begins_with_as_much_black_as_the_mask_needs(
    delay_us: int, leads: tuple[int, int]
) -> None:
    rig = Dlpc900Rig(start="chain")
    rig.dmds[0].wired = rig.dmds[1]
    display = rig.make()
    display.connect()
    frames = replace(random_codes(8), delay_s=np.full(8, 1e-6 * delay_us))
    display.load(frames)
    display.black()
    assert not rig.dmds[1].waits
    tables: list[Any] = []
    log = display.play(ignore, looked_at(rig, tables))
    first, *_ = tables[0]
    assert not first[0].any() and first[1] == leads[0] and len(tables[0]) == len(tables[1]) + 1
    assert int.from_bytes(rig.dmds[1].said(0x1A35)[-1].data[:2], "little") == leads[1]
    np.testing.assert_array_equal(log.dual_ns - log.primal_ns, 1000 * delay_us)


def test_a_delay_of_the_mask_is_a_later_trigger() -> None:
    rig, display = opened(start="trigger")
    display.load(replace(random_codes(4), delay_s=np.array([30e-6, 30e-6, 40e-6, 30e-6])))
    display.black()
    delays = [int.from_bytes(dmd.said(0x1A35)[-1].data[:2], "little") for dmd in rig.dmds]
    assert delays == [105, 135]
    for dmd in rig.dmds:  # a sequence that runs takes no other
        said = [(one.command, one.data[:1]) for one in dmd.said(0x1A24, 0x1A35)]
        assert [command for command, _ in said][-3:] == [0x1A24, 0x1A35, 0x1A24]
        assert (said[-3][1], said[-1][1]) == (b"\0", b"\2")
    assert [entry[1] for entry in shown(rig.dmds[1])][:4] == [125, 135, 115, 125]


def test_a_mask_delayed_by_whole_rows_waits_on_black() -> None:
    rig = Dlpc900Rig(start="software")
    display = rig.make(rig.config(mask_delay_refreshes=2))
    display.connect()
    display.load(random_codes(4))
    tables: list[Any] = []
    log = display.play(ignore, looked_at(rig, tables))
    lit = [[bool(entry[0].any()) for entry in table] for table in tables]
    assert lit == [[True] * 4 + [False] * 3, [False] * 2 + [True] * 4 + [False]]
    assert log.mask_delay == 2 and log.dual_asked is not None
    assert log.dual_asked.tolist() == [BLACK, BLACK, 0, 1, 2, 3]


def test_passes_that_fit_no_table_are_shown_one_after_the_other() -> None:
    rig, display = opened(start="software")
    frames = random_codes(150, passes=4)
    display.load(frames)
    rig.forget()
    log = display.play(ignore, never)
    assert len(log) == 601 and (log.primal_shown == BLACK).sum() == 1
    tables = [one.data.hex() for one in rig.dmds[0].said(0x1A31) if not one.flags & 0x80]
    assert tables == ["2d012d010000"] * 2
    assert not rig.dmds[0].said(0x1A34, 0x1A2A), "both show the same"


def test_show_holds_the_first_row() -> None:
    rig, display = opened(start="trigger")
    frames = random_codes(5)
    display.show(frames)
    view = panels_of(rig.config()).projector
    for dmd in rig.dmds:
        assert dmd.table == (1, 0) and not dmd.waits and not dmd.black
    np.testing.assert_array_equal(shown(rig.dmds[0])[0][0], draw(frames, view, 0) > 0)
    display.black()
    assert all(dmd.black for dmd in rig.dmds)
