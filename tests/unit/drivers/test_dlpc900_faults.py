"""The display of two DMDs: faults at any moment, and both devices at once on a real clock."""

from __future__ import annotations

import threading
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
from pdcd.bench.tables import Config
from pdcd.errors import Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.panels.draw import draw
from pdcd.panels.frames import WHITE
from pdcd.panels.schedule import build_frames
from tests.dlpc900_rig import (
    GRID,
    NO_DEVICE,
    ROW_US,
    Dlpc900Rig,
    ScriptedDmd,
    ignore,
    looked_at,
    never,
    opened,
    random_codes,
)

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
