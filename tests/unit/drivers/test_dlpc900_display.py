"""The display of two DMDs: what it sends them, when it believes them, and how it goes black."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest
import usb.core

from drivers.dlpc900.display import Dlpc900Display
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import DriverContext, SharedState
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, PanelConfig
from pdcd.errors import Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.panels.draw import draw
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from tests.dlpc900_rig import NO_DEVICE, ROW_US, SIZE, Dlpc900Rig, ScriptedDmd
from tests.panel_pixels import random_frames

GRID = (6, 8)


def never() -> bool:
    return False


def ignore(*_: int) -> None:
    pass


def random_codes(count: int, seed: int = 1, passes: int = 1) -> Frames:
    rng = np.random.default_rng(seed)
    pairs = tuple(pack_bits(rng.random((count, GRID[0] * GRID[1])) < 0.5) for _ in range(2))
    return build_frames((pairs[0], pairs[1]), GRID, window="whole", schedule="none", passes=passes)


def opened(**options: Any) -> tuple[Dlpc900Rig, Dlpc900Display]:
    rig = Dlpc900Rig(**options)
    display = rig.make()
    display.connect()
    return rig, display


def shown(dmd: ScriptedDmd) -> list[tuple[Any, int, int]]:
    """Each entry of the device's table: its plane, exposure and dark time."""
    found = []
    for number in range(dmd.table[0]):
        entry = dmd.entries[number]
        times = int.from_bytes(entry[2:5], "little"), int.from_bytes(entry[6:9], "little")
        found.append((dmd.plane(*dmd.place_of(number)), *times))
    return found


def shows_once(dmd: ScriptedDmd) -> bool:
    """Whether its table is one that ends, not that of black."""
    return dmd.table[1] > 0


def looked_at(rig: Dlpc900Rig, at: list[Any]) -> Callable[[], bool]:
    """What asks whether it is cancelled: takes down the tables once both show them."""

    def look() -> bool:
        if not at and all(shows_once(dmd) for dmd in rig.dmds):
            at.extend(shown(dmd) for dmd in rig.dmds)
        return False

    return look


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
    assert writes[0x1A34].hex() == "0000e8030011000000010000"
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
    display.load(frames)
    loads: Any = (
        (frames, []),
        (slower, []),
        (white, [4, 0]),
        (frames, [3, 2, 1, 0]),
        (few, [5, 0]),
    )
    for other, pictures in loads:
        rig.forget()
        display.load(other)
        assert [[one.data[0] for one in dmd.said(0x1A2A)] for dmd in rig.dmds] == [pictures] * 2
    rig.forget()
    display.load(frames)
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


def test_pictures_that_are_full_make_room() -> None:
    """All pictures hold one set of 200 codes, and not a second one."""
    rig, display = opened(start="software")
    for seed in (1, 2, 3, 1):
        frames = random_codes(200, seed)
        display.load(frames)
        tables: list[Any] = []
        display.play(ignore, looked_at(rig, tables))
        view = panels_of(rig.config()).mask
        for row in (0, 23, 24, 199):
            np.testing.assert_array_equal(tables[1][row][0], draw(frames, view, row) > 0)


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


# What is refused


@pytest.mark.parametrize(
    ("options", "frames", "words"),
    [
        ({"start": "trigger"}, random_codes(400), "400 rows .* 376 codes, each"),
        (
            {"start": "trigger"},
            random_codes(150, passes=4),
            "600 rows .* 399 codes, each shown once",
        ),
        ({"start": "software"}, random_codes(401), "401 different planes .* 376 codes, each"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_sent(
    options: dict[str, Any], frames: Frames, words: str
) -> None:
    rig, display = opened(**options)
    rig.forget()
    with pytest.raises(ConfigError, match=words) as caught:
        display.load(frames)
    assert "fewer codes" in str(caught.value.hint)
    assert ("chain" in str(caught.value.hint)) == words.startswith("600")
    assert not any(dmd.sent for dmd in rig.dmds)
    with pytest.raises(ConfigError, match="no frames are loaded"):
        display.play(ignore, never)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ({"delay_s": np.array([0.0, -30e-6])}, "rows of 95 us are shorter"),
        ({"delay_s": np.full(2, 0.07)}, "delay of the mask of 70 ms is too long"),
        ({"dark_s": np.full(2, 17.0)}, "of 17 s are too long"),
    ],
)
def test_times_that_no_device_has_are_refused(times: dict[str, Any], words: str) -> None:
    _, display = opened(start="trigger")
    with pytest.raises(ConfigError, match=words):
        display.load(replace(random_codes(2), **times))


def test_panels_without_a_trigger_cannot_be_delayed() -> None:
    _, display = opened(start="software")
    with pytest.raises(ConfigError, match="cannot be delayed"):
        display.load(replace(random_codes(2), delay_s=np.full(2, 1e-5)))


def test_rows_shorter_than_the_devices_least_are_refused() -> None:
    rig = Dlpc900Rig(start="software")
    rig.dmds[1].answers[0x1A42] = (200).to_bytes(2, "little")
    display = rig.make()
    display.connect()
    with pytest.raises(ConfigError, match="125 us are shorter than the devices' 200 us") as caught:
        display.load(random_codes(2))
    assert "5000.00" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mask": "A"}, "projector and mask are both 'A'"),
        ({"start": "wire"}, "start"),
        ({"plane_order": "XYZ"}, "plane_order"),
        ({"led": 8}, "led"),
    ],
)
def test_options_that_are_wrong_are_refused_by_create(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Dlpc900Rig(**options).make()


def test_planes_of_a_video_signal_and_a_virtual_clock_are_refused() -> None:
    rig = Dlpc900Rig()
    with pytest.raises(ConfigError, match="planes_per_refresh"):
        rig.make(rig.config(planes_per_refresh=24))
    rig = Dlpc900Rig(usb="libusb")
    with pytest.raises(ConfigError, match="virtual"):
        rig.make()


def test_one_device_by_two_names_is_refused() -> None:
    rig = Dlpc900Rig(mask="1-2.1")
    with pytest.raises(ConfigError, match=r"projector and mask are both A on port 1-2\.1"):
        rig.make().connect()


# What devices say of themselves


def test_a_kind_that_is_told_says_how_many_mirrors_there_are() -> None:
    rig = Dlpc900Rig()
    for dmd in rig.dmds:
        dmd.answers[0x0206] = b"\x01" + bytes(32)
    with pytest.raises(ConfigError, match=r"DLP6500 of 1920 x 1080 .* 96 x 64") as caught:
        rig.make().connect()
    assert caught.value.hint == "set projector.size_px = [1920, 1080]"
    panel = PanelConfig(size_px=(1024, 768), refresh_hz=1e6 / ROW_US)
    config: Config = msgspec.structs.replace(rig.config(), projector=panel, mask=panel)
    for dmd in rig.dmds:
        dmd.answers[0x0206] = b"\x05" + bytes(32)
        dmd.refuses = {0x0205: 6}
    info = rig.make(config).connect()
    assert info.identity["mask"] == "DLP5500 B"
    assert info.identity["firmware of the mask"] == "unknown" and not info.warnings


@pytest.mark.parametrize(
    ("status", "word"),
    [(0x00, "not initialised"), (0x03, "INCOMPATIBLE"), (0x05, "RESET"), (0x09, "FORCED_SWAP")],
)
def test_a_device_that_hides_a_failure_is_refused(status: int, word: str) -> None:
    rig = Dlpc900Rig()
    rig.dmds[1].answers[0x1A0A] = bytes([status])
    with pytest.raises(DeviceLost, match=f"not fit to work: .*{word}") as caught:
        rig.make().connect()
    assert caught.value.device == "mask" and not rig.usb.claimed


def test_a_parked_device_is_woken_up() -> None:
    rig = Dlpc900Rig()
    rig.dmds[0].answers[0x1A0C] = b"\x01"

    def wake(_: int) -> None:
        if rig.dmds[0].said(0x0200):
            rig.dmds[0].answers[0x1A0C] = b"\x00"

    rig.dmds[0].on_report = wake
    rig.make().connect()
    assert [one.data for one in rig.dmds[0].said(0x0200)] == [b"\0"]
    asleep = Dlpc900Rig()
    asleep.dmds[0].answers[0x1A0C] = b"\x01"
    with pytest.raises(DeviceLost, match="stays parked"):
        asleep.make().connect()


@pytest.mark.parametrize("status", [0x41, 0x81])
def test_a_sequence_that_was_given_up_is_told(status: int) -> None:
    rig, display = opened(start="software")
    display.load(random_codes(4))

    def look() -> bool:
        if shows_once(rig.dmds[1]):
            rig.dmds[1].answers[0x1A0A] = bytes([status])
        return False

    with pytest.raises(SyncError, match="gave up its sequence"):
        display.play(ignore, look)
    assert all(dmd.black for dmd in rig.dmds)


def test_a_sequence_that_ends_too_early_or_never_is_told() -> None:
    rig, display = opened(start="software")
    display.load(random_codes(300))

    def stop() -> bool:
        if shows_once(rig.dmds[0]):
            rig.dmds[0].runs_from_ns = None
        return False

    with pytest.raises(SyncError, match=r"ended its sequence .* ms too early"):
        display.play(ignore, stop)

    def hang() -> bool:
        if shows_once(rig.dmds[1]):
            rig.dmds[1].answers[0x1A0C] = b"\x02"
        return False

    with pytest.raises(SyncError, match="the mask did not end a sequence"):
        display.play(ignore, hang)


def test_warnings_are_for_panels_that_start_apart_and_old_firmware() -> None:
    rig = Dlpc900Rig(start="software")
    rig.dmds[0].answers[0x0205] = bytes([4, 0, 0, 3] + [0] * 12)
    info = rig.make().connect()
    assert info.row_times and info.refresh_hz == 8000.0
    apart, old = info.warnings
    assert "milliseconds apart" in apart and "firmware 3.0.4 of the projector" in old


@pytest.mark.parametrize(
    ("start", "skew_s", "lag_s"), [("trigger", 0.0, None), ("trigger", 3e-6, 3e-6),
                                   ("chain", 3e-6, 3e-6), ("software", 3e-6, None)],
)  # fmt: skip
def test_a_lag_is_told_where_it_was_measured(
    start: str, skew_s: float, lag_s: float | None
) -> None:
    rig = Dlpc900Rig(start=start)
    mask = PanelConfig(size_px=SIZE, refresh_hz=1e6 / ROW_US, skew_s=skew_s)
    info = rig.make(msgspec.structs.replace(rig.config(), mask=mask)).connect()
    assert info.mask_lag_s == lag_s


# Faults


@pytest.mark.parametrize("error", [NO_DEVICE, "silent", "refuses"])
def test_what_fails_in_an_upload_is_typed_and_the_other_panel_is_black(
    error: usb.core.USBError | str,
) -> None:
    rig, display = opened(start="software")
    dmd = rig.dmds[1]
    first = dmd.reports

    def fail(number: int) -> None:
        if number > first + 40:
            dmd.silent = error == "silent"
            dmd.refuses = {0x0100: 17} if error == "refuses" else {}
            if isinstance(error, usb.core.USBError):
                raise error

    dmd.on_report = fail
    if error == "refuses":
        dmd.on_report = lambda _: None
        dmd.answers[0x0100] = b"\x11"
    with pytest.raises(ConfigError if error == "refuses" else DeviceLost) as caught:
        display.load(random_codes(60))
    assert caught.value.device == "mask" and caught.value.hint
    with pytest.raises(ConfigError, match="no frames"):
        display.play(ignore, never)
    if error == "refuses":
        dmd.answers.clear()
        display.black()
    else:
        with pytest.raises(DeviceLost):
            display.black()
    assert rig.dmds[0].black
    dmd.on_report, dmd.silent = lambda _: None, False
    frames = random_codes(60)
    display.load(frames)  # which opens anew what was lost
    tables: list[Any] = []
    display.play(ignore, looked_at(rig, tables))
    view = panels_of(rig.config()).mask
    np.testing.assert_array_equal(tables[1][59][0], draw(frames, view, 59) > 0)
    assert all(dmd.black for dmd in rig.dmds)


def test_what_is_lost_for_good_is_let_go() -> None:
    rig, display = opened()

    def leave(_: int) -> None:
        raise NO_DEVICE

    rig.dmds[0].on_report = leave
    with pytest.raises(DeviceLost):
        display.disconnect()
    assert not rig.usb.claimed and rig.dmds[1].black
    display.disconnect()


def test_a_device_that_shows_video_may_refuse_to_stop() -> None:
    rig = Dlpc900Rig()
    for dmd in rig.dmds:
        dmd.refuses = {0x1A24: 5}

        def take(report: bytes, dmd: ScriptedDmd = dmd, taken: Any = dmd.take) -> None:
            if report[4:6] == b"\x1b\x1a":
                dmd.refuses = {}
            taken(report)

        dmd.take = take  # type: ignore[method-assign]
    rig.make().connect()
    assert all(dmd.black for dmd in rig.dmds)


def test_a_table_that_was_forgotten_is_sent_once_more() -> None:
    rig, display = opened(start="software")
    display.load(random_codes(8))
    dmd = rig.dmds[0]
    dmd.refuses = {0x1A31: 16}
    kept = dmd.take

    def take(report: bytes) -> None:
        if report[4:6] == b"\x34\x1a" and len(dmd.said(0x1A34)) > before:
            dmd.refuses = {}
        kept(report)

    before = len(dmd.said(0x1A34))
    dmd.take = take  # type: ignore[method-assign]
    display.play(ignore, never)
    indices = [one.data[0] for one in dmd.said(0x1A34)][before:]
    assert indices == [*range(9)]


def test_fewer_entries_than_were_sent_are_told() -> None:
    rig, display = opened()
    rig.dmds[0].answers[0x1A31] = b"\x05\0" + bytes(4)
    with pytest.raises(ConfigError, match="took 5 of 9 entries"):
        display.load(random_codes(8))


def test_a_cancel_makes_black_and_black_hears_none() -> None:
    rig, display = opened(start="software")
    display.load(random_codes(300))
    asked: list[int] = []

    def ask() -> bool:
        asked.append(rig.clock.now_ns())
        rig.cancelled = len(asked) > 2
        return rig.cancelled

    with pytest.raises(Cancelled):
        display.play(ignore, ask)
    assert all(dmd.black for dmd in rig.dmds)
    assert rig.cancelled
    display.black()
    with pytest.raises(Cancelled):
        display.load(random_codes(300, seed=5))
    display.disconnect()
    assert not rig.usb.claimed


def test_black_beside_an_upload_ends_it() -> None:
    rig, display = opened()
    done: list[BaseException] = []

    def black(number: int) -> None:
        if number == first + 60 and not done:
            done.append(KeyboardInterrupt())
            beside = threading.Thread(target=display.black)
            beside.start()
            while not display._turn > turn:
                pass
            beside_threads.append(beside)

    beside_threads: list[threading.Thread] = []
    turn, first = display._turn + 1, rig.dmds[0].reports
    rig.dmds[0].on_report = black
    with pytest.raises(SyncError, match="made black meanwhile"):
        display.load(random_codes(100))
    beside_threads[0].join()
    assert all(dmd.black for dmd in rig.dmds)


def test_rests_as_told() -> None:
    for rest, wanted in (
        ("black", []),
        ("standby", [(0x0200, b"\1")]),
        ("idle", [(0x0201, b"\1")]),
    ):
        rig, display = opened(rest=rest)
        rig.forget()
        display.disconnect()
        display.disconnect()
        said = rig.dmds[1].said(0x0200, 0x0201)
        assert [(one.command, one.data) for one in said] == wanted
        assert rig.dmds[1].black == (rest == "black") and not rig.usb.claimed


# Both at once, on a real clock


class SlowUsb(Dlpc900Rig):
    """Devices as of libusb: used from two threads."""

    def __init__(self) -> None:
        super().__init__(clock=RealClock(), start="software", usb="libusb")

    def make(self, config: Config | None = None) -> Dlpc900Display:
        config = config or self.config()
        rig = msgspec.structs.replace(config.rig, clock="real")
        config = msgspec.structs.replace(config, rig=rig)
        state = SharedState(usb_backend=self.usb)
        return Dlpc900Display.create(
            DriverContext(config, self.clock, state, cancelled=lambda: self.cancelled)
        )


def test_real_devices_are_loaded_at_the_same_time() -> None:
    rig = SlowUsb()
    display = rig.make()
    display.connect()
    met = threading.Barrier(2, timeout=20.0)

    def meet(begun: int, number: int) -> None:
        if number == begun + 30:
            met.wait()

    for dmd in rig.dmds:
        dmd.on_report = partial(meet, dmd.reports)
    frames = random_codes(60)
    display.load(frames)
    tables: list[Any] = []
    display.play(ignore, looked_at(rig, tables))
    for view, table in zip((panels_of(rig.config()).projector, panels_of(rig.config()).mask),
                           tables, strict=True):  # fmt: skip
        np.testing.assert_array_equal(table[59][0], draw(frames, view, 59) > 0)
    display.disconnect()


def test_what_fails_on_one_ends_the_other() -> None:
    rig = SlowUsb()
    display = rig.make()
    display.connect()
    gone = threading.Event()
    first = [dmd.reports for dmd in rig.dmds]

    def unplug(number: int) -> None:
        if number >= first[0] + 50:
            gone.set()
            raise NO_DEVICE

    def wait(number: int) -> None:
        if number == first[1] + 40:
            gone.wait(20.0)

    rig.dmds[0].on_report, rig.dmds[1].on_report = unplug, wait
    with pytest.raises(PdcdError, match="unplugged"):
        display.load(random_codes(300))
    with pytest.raises(DeviceLost):
        display.black()
    assert rig.dmds[1].black
    with pytest.raises(DeviceLost):
        display.disconnect()


def test_white_is_one_plane_all_over_the_field() -> None:
    rig, display = opened(start="software")
    frames = build_frames(None, GRID, window="whole", schedule="none", passes=2000)
    assert (frames.primal_index == WHITE).all()
    display.load(frames)
    tables: list[Any] = []
    display.play(ignore, looked_at(rig, tables))
    assert [len(table) for table in tables] == [2, 2]
    plane, exposure_us, _ = tables[1][0]
    assert plane.all() and exposure_us == 2000 * ROW_US


@pytest.mark.parametrize("seed", range(24))
def test_a_fault_at_any_moment_is_typed_and_leaves_the_rest_black(seed: int) -> None:
    """Unplugged, silent, or refusing for good, in an upload or while codes are shown."""
    rng = np.random.default_rng(seed)
    start = ("chain", "software")[seed % 2]
    rig = Dlpc900Rig(start=start)
    rig.dmds[0].wired = rig.dmds[1]
    display = rig.make()
    display.connect()
    frames = random_codes(50)
    begun = rig.dmds[0].reports
    display.load(random_codes(50, 2))
    display.play(ignore, never)
    per_photo = rig.dmds[0].reports - begun
    bad = int(rng.integers(2))
    at = rig.dmds[bad].reports + int(rng.integers(per_photo))
    kind = seed // 2 % 3

    def fail(number: int) -> None:
        if number >= at:
            if kind == 0:
                raise NO_DEVICE
            rig.dmds[bad].silent = kind == 1
            rig.dmds[bad].refuses = dict.fromkeys(range(0x0200, 0x2000), 5) if kind == 2 else {}

    rig.dmds[bad].on_report = fail
    with pytest.raises((DeviceLost, SyncError)) as caught:
        display.load(frames)
        display.play(ignore, never)
        display.black()
        display.load(frames)
        display.play(ignore, never)
    assert caught.value.hint
    with pytest.raises(DeviceLost):
        display.black()
    assert rig.dmds[1 - bad].black
    with pytest.raises(DeviceLost):
        display.disconnect()
    assert not rig.usb.claimed
