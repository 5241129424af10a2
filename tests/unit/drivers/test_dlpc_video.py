"""The display of DMDs on a video signal: its commands in their order, and black at each failure."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import dlpc_video
from drivers.dlpc900.video import divide_picture
from drivers.dlpc_video import DlpcVideoDisplay, examine_dlpc_video
from drivers.virtual_dlpc900 import VirtualDmdFault
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext, Finding, SharedState
from pdcd.errors import ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.panels.frames import split_dark_times
from pdcd.presenter.messages import Ready
from tests.dlpc_video_rig import (
    BOTH_350,
    DLPC,
    KINDS,
    PERIOD_NS,
    SIZES,
    Kind,
    Presenter,
    VideoBench,
    assert_log_is_shown,
    config,
    is_dark,
    play,
    presenter,
)
from tests.panel_pixels import random_frames

__all__ = ["presenter"]
pytestmark = pytest.mark.usefixtures("presenter")
LIT = np.full(SIZES["dlpc900"][::-1], 0xFFFFFF, np.uint32)
MODE, RUN, TABLE, ENTRY = 0x1A1B, 0x1A24, 0x1A31, 0x1A34


def test_what_is_sent_in_its_order_and_to_the_byte(tmp_path: Path) -> None:
    """Black by itself; stop; video; once locked, video-pattern; stop; 24 entries, of which the
    first waits; the table, for ever; start."""
    bench = VideoBench(tmp_path, dlpc={"dark_us": 40})
    bench.display.connect()
    exposure, dark = (648).to_bytes(3, "little"), (40).to_bytes(3, "little")
    entries = [
        (ENTRY, struct.pack("<H", n) + exposure + bytes([0x11 | 0x80 * (n == 0)]) + dark
         + b"\1" + struct.pack("<H", n << 11))
        for n in range(24)
    ]  # fmt: skip
    for sent in bench.sent:
        starts = [n for n, one in enumerate(sent) if one == (RUN, b"\2")]
        assert len(starts) == 2 and (MODE, b"\3") in sent[: starts[0]]
        assert sent[starts[0] + 1 :] == [
            (RUN, b"\0"),
            (MODE, b"\0"),
            (MODE, b"\2"),
            (RUN, b"\0"),
            *entries,
            (TABLE, struct.pack("<HI", 24, 0)),
            (RUN, b"\2"),
        ]
        del sent[:]
    bench.display.load(random_frames((6, 8), "whole", 24))
    assert bench.sent == [[], []]  # what follows its signal is left alone


def test_the_mode_is_not_asked_for_before_its_300_ms_are_over(tmp_path: Path) -> None:
    """A device that is asked earlier may tell a wrong one."""
    bench = VideoBench(tmp_path)
    device, times = bench.dmds[1], []
    take = device.write_report

    def write_report(report: bytes) -> None:
        flags, _, _, command, mode = struct.unpack_from("<BBHHB", report)
        if command == MODE:
            times.append((flags >> 7, mode, bench.clock.now_ns()))
        take(report)

    device.write_report = write_report  # type: ignore[method-assign]
    bench.display.connect()
    (asked,) = (n for n, (reads, mode, _) in enumerate(times) if not reads and mode == 2)
    assert times[asked + 1][2] - times[asked][2] >= 300_000_000


def test_what_is_shown_after_the_wedge_has_equal_planes_again(tmp_path: Path) -> None:
    bench, frames = VideoBench(tmp_path), random_frames((6, 8), "whole", 24)
    bench.display.show_wedge(frames)
    bench.display.black()
    bench.display.load(frames)
    for sent in bench.sent:
        lasts = [data[2:5] for command, data in sent if command == ENTRY][-24:]
        assert lasts == [(688).to_bytes(3, "little")] * 24


@pytest.mark.parametrize(
    "how",
    [
        {"kinds": KINDS},
        {"kinds": BOTH_350, "lock_told": "signal", "dlpc": {"lock_from": "signal"}},
        {"kinds": BOTH_350, "lock_told": "main", "dlpc": {"lock_from": "main"}},
    ],
)
def test_without_a_signal_it_says_so_and_asks_for_no_pattern_mode(
    tmp_path: Path, how: dict[str, Any]
) -> None:
    bench = VideoBench(tmp_path, refresh_hz=None, **how)
    with pytest.raises(DeviceLost, match="finds no video signal") as caught:
        bench.display.connect()
    assert caught.value.device == "projector" and "cable" in str(caught.value.hint)
    patterns = (MODE, b"\2" if how["kinds"] == KINDS else b"\1")
    assert patterns not in bench.sent[0] + bench.sent[1]
    assert all(map(is_dark, bench.dmds)) and Presenter.said[-1] == "black"


_CALLS: dict[tuple[Kind, Kind], dict[int, tuple[int, ...]]] = {
    KINDS: {MODE: (2, 3, 4, 5), RUN: (3, 4, 5, 6), ENTRY: (2, 25), TABLE: (3, 4)},
    BOTH_350: {
        0x0200: (1, 2), MODE: (1, 2), RUN: (1, 2, 3, 4, 5), 0x1A22: (1,), 0x1A23: (1,),
        0x1A29: (1,), TABLE: (1,), 0x1A33: (1, 2), 0x1A32: (1, 24), ENTRY: (1, 24),
        0x1A1A: (1, 2), 0x1A0C: (1, 3), 0x071C: (1, 2),
    },
}  # fmt: skip
"""Of a set-up, from the end of the first black on, reads included."""
FAULTS = [
    (kinds, VirtualDmdFault(fault, command, first=first))
    for kinds, commands in _CALLS.items()
    for command, calls in commands.items()
    for first in calls
    for fault in ("error", "deaf", "mute", "reset")
]

FORGIVEN = [
    (KINDS, VirtualDmdFault("error", TABLE, first=4)),
    (BOTH_350, VirtualDmdFault("error", RUN, first=1)),
    (BOTH_350, VirtualDmdFault("error", RUN, first=2)),
]
"""Not every firmware tells its table; in video mode there may be nothing to stop."""


@pytest.mark.parametrize(
    ("kinds", "fault"),
    FAULTS,
    ids=[f"{kinds[1]}-{f.kind}-{f.command:x}-{f.first}" for kinds, f in FAULTS],
)
def test_whatever_fails_while_it_is_set_up_no_picture_lights_it(
    tmp_path: Path, kinds: tuple[Kind, Kind], fault: VirtualDmdFault
) -> None:
    """Either it was mended, and follows its signal; or black by a plane of its own, or parked."""
    bench = VideoBench(tmp_path, fault, kinds=kinds)
    try:
        bench.display.connect()
    except PdcdError as err:
        assert err.device == "mask" and Presenter.said[-1] == "black"
        assert kinds == KINDS or isinstance(err, DeviceLost)
        if fault.kind == "reset":  # switched off: nobody can tell it anything
            return
        assert bench.stays_dark(bench.dmds[1])
    else:
        allowed = (kinds, fault) in FORGIVEN
        assert allowed or (kinds == KINDS and fault.kind != "error")
        assert bench.stays_dark(bench.dmds[1]) is False


def test_a_cancel_while_the_signal_is_waited_for_ends_black(tmp_path: Path) -> None:
    bench = VideoBench(tmp_path, refresh_hz=None)
    ends_ns = bench.clock.now_ns() + 1_000_000_000
    bench.display._context.patience._cancelled = lambda: bench.clock.now_ns() > ends_ns
    with pytest.raises(PdcdError, match="cancelled"):
        bench.display.connect()
    assert bench.clock.now_ns() < ends_ns + 500_000_000 and is_dark(bench.dmds[0])


@pytest.mark.parametrize("kinds", [KINDS, BOTH_350])
@pytest.mark.parametrize("after_stop", ["black", "holds"])
def test_a_signal_lost_while_a_picture_stood_is_an_error_and_then_black(
    tmp_path: Path, after_stop: Any, kinds: tuple[Kind, Kind]
) -> None:
    bench = VideoBench(tmp_path, after_stop=after_stop, kinds=kinds)
    bench.display.load(random_frames((6, 8), "whole", 24))
    mask, now_ns = bench.dmds[1], bench.clock.now_ns()
    mask.drive_video(np.full(SIZES[kinds[1]][::-1], 0xFFFFFF, np.uint32), now_ns)
    bench.clock.sleep_until_ns(now_ns + 5_000_000)
    mask.disconnect_video(bench.clock.now_ns())
    with pytest.raises(SyncError, match="has no video signal") as caught:
        bench.display.play(lambda *_: None, lambda: False)
    assert caught.value.device == "mask"
    if kinds == BOTH_350:  # parked: no picture of a signal that is back lights it
        assert bench.sent[1][-1] == (0x0200, b"\1")
        mask.connect_video(60.0)
        assert bench.stays_dark(mask)
    else:
        with pytest.raises(DeviceLost, match="finds no video signal"):
            bench.display.load(random_frames((6, 8), "whole", 24))
        assert bench.stays_dark(mask) and bench.sent[1][-1] == (RUN, b"\2")
        mask.connect_video(60.0)
    play(bench.display, 24)
    assert not bench.stays_dark(mask)  # the next job has it again


def test_a_device_that_gives_up_by_itself_is_told(tmp_path: Path) -> None:
    """After five planes of a picture; the sixth start of a sequence is that of its planes."""
    bench = VideoBench(tmp_path, VirtualDmdFault("abort", RUN, first=6, patterns=5))
    bench.display.load(random_frames((6, 8), "whole", 24))
    mask, now_ns = bench.dmds[1], bench.clock.now_ns()
    mask.drive_video(LIT, now_ns)
    bench.clock.sleep_until_ns(now_ns + PERIOD_NS)
    with pytest.raises(SyncError, match="gave up its sequence"):
        bench.display.play(lambda *_: None, lambda: False)
    assert bench.stays_dark(mask)


def test_black_that_the_display_process_cannot_show_needs_no_signal(tmp_path: Path) -> None:
    bench = VideoBench(tmp_path)
    bench.display.connect()
    Presenter.fault = DeviceLost("gone", device="display")
    with pytest.raises(DeviceLost):
        bench.display.black()
    assert all(map(bench.stays_dark, bench.dmds))


@pytest.mark.parametrize("kinds", [KINDS, BOTH_350])
@pytest.mark.parametrize("side", [0, 1])
def test_a_device_that_was_unplugged_is_told_and_the_other_one_is_black(
    tmp_path: Path, side: int, kinds: tuple[Kind, Kind]
) -> None:
    bench = VideoBench(tmp_path, kinds=kinds)
    bench.display.connect()
    bench.dmds[side].unplug()
    with pytest.raises(DeviceLost, match="unplugged"):
        bench.display.load(random_frames((6, 8), "whole", 24))
    with pytest.raises(DeviceLost, match="unplugged"):
        bench.display.black()
    Presenter.fault = DeviceLost("gone", device="display")
    with pytest.raises(DeviceLost):
        bench.display.black()
    assert bench.stays_dark(bench.dmds[1 - side])
    Presenter.fault = None
    bench.dmds[side].replug()
    bench.display.load(random_frames((6, 8), "whole", 24))
    assert not bench.stays_dark(bench.dmds[side])


@pytest.mark.parametrize(
    ("kinds", "rest", "last"),
    [
        (KINDS, "black", (RUN, b"\2")),
        (KINDS, "standby", (0x0200, b"\1")),
        (KINDS, "idle", (0x0201, b"\1")),
        (BOTH_350, "black", (0x0200, b"\1")),
        (BOTH_350, "standby", (0x0200, b"\1")),
    ],
)
def test_it_is_left_as_the_options_say_and_no_signal_lights_it(
    tmp_path: Path, kinds: tuple[Kind, Kind], rest: str, last: tuple[int, bytes]
) -> None:
    bench = VideoBench(tmp_path, kinds=kinds, dlpc={"rest": rest})
    bench.display.connect()
    bench.display.disconnect()
    for device, sent in zip(bench.dmds, bench.sent, strict=True):
        assert sent[-1] == last
        assert rest == "idle" or bench.stays_dark(device)
    assert Presenter.said[-1] == "close"


def test_a_unit_that_wants_the_first_entry_otherwise_says_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="code 16"):
        VideoBench(tmp_path, video_waits=0).display.connect()
    VideoBench(tmp_path, video_waits=0, dlpc={"vsync_bit": 0}).display.connect()


def test_the_log_has_the_times_of_the_table(tmp_path: Path) -> None:
    """24 planes of 688 us from each picture on, the last 40 us of each dark; then until the next
    picture; 30 rows end within the second one."""
    bench = VideoBench(tmp_path, dlpc={"dark_us": 40})
    bench.display.connect()
    log = play(bench.display, 30)
    rows = np.arange(30)
    wanted = PERIOD_NS * (rows // 24) + 688_000 * (rows % 24)
    assert np.abs(log.primal_ns - wanted).max() <= 1
    assert np.abs(log.end_ns - (wanted[-1] + 648_000)).max() <= 1
    lit = split_dark_times(log)
    black = np.flatnonzero(lit.primal_shown < 0)
    assert len(black) == 29
    lasts_ns = np.diff(np.append(lit.primal_ns, log.end_ns[0]))
    wanted_ns = np.where(rows[:29] == 23, PERIOD_NS - 24 * 688_000 + 40_000, 40_000)
    assert np.abs(lasts_ns[black] - wanted_ns).max() <= 1
    assert np.abs(np.delete(lasts_ns, black) - 648_000).max() <= 1


def test_the_log_is_what_mirrors_show_to_a_microsecond(tmp_path: Path) -> None:
    bench = VideoBench(tmp_path, dlpc={"dark_us": 40})
    assert_log_is_shown(bench)


@pytest.mark.parametrize(("lag_s", "warned"), [(0.0, 0), (40e-6, 0), (41e-6, 1), (None, 1)])
def test_a_phase_longer_than_the_dark_time_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lag_s: float | None, warned: int
) -> None:
    monkeypatch.setattr(Presenter, "ready", Ready("clock", 60.0, {}, lag_s))
    info = VideoBench(tmp_path, dlpc={"dark_us": 40}).display.connect()
    assert len(info.warnings) == warned
    assert info.identity["planes"] == "24 of 648 us, 40 us dark"


@pytest.mark.parametrize(
    ("shown", "dlpc", "told"),
    [
        ({"planes_per_refresh": 1}, {}, "24 planes"),
        ({"plane_starts": tuple(n / 24 for n in range(24))}, {}, "plane_starts"),
        ({"options": {"projector": "A", "mask": "B"}}, {}, "projector"),
        ({"options": {"dlpc": DLPC, "projector": "A", "mask": "B", "grab_px": [[0, 0], [9, 0]]}},
         {}, "planes are not taken apart"),
        ({}, {"mask": DLPC["projector"]}, "both"),
    ],
)  # fmt: skip
def test_options_that_cannot_be(tmp_path: Path, shown: Any, dlpc: Any, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        DlpcVideoDisplay.create(
            DriverContext(config(tmp_path, shown=shown, **dlpc), VirtualClock(), SharedState())
        )


@pytest.mark.parametrize(("measured_hz", "plane_us"), [(59.0, 688), (60.0, 688), (61.0, 677)])
def test_planes_fit_the_quickest_picture_there_may_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, measured_hz: float, plane_us: int
) -> None:
    """Of 60 Hz by the configuration, and as measured."""
    monkeypatch.setattr(Presenter, "ready", Ready("clock", measured_hz, {}, 0.0))
    info = VideoBench(tmp_path).display.connect()
    assert info.identity["planes"] == f"24 of {plane_us} us, 0 us dark"


def test_planes_that_are_too_short_are_refused() -> None:
    assert divide_picture(120.0, 0, 105).plane_us == 342
    assert divide_picture(120.0, 237, 105).exposure_us == 105
    limits = {"black_us": 230, "least_dark_us": 230}  # of a DLPC350
    assert divide_picture(120.0, 0, 235, **limits).exposure_us == 336
    assert divide_picture(60.0, 448, 235, **limits).exposure_us == 235
    for refresh_hz, dark_us, least_us, more in (
        (120.0, 238, 105, {}), (120.0, 230, 235, limits), (60.0, 449, 235, limits),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match="too short"):
            divide_picture(refresh_hz, dark_us, least_us, **more)


def test_the_doctor_tells_of_both_devices_and_shows_each_plane_longer_than_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        dlpc_video, "examine_display", lambda _: iter([Finding("X server", "good", "x")])
    )
    bench = VideoBench(tmp_path)
    shared = SharedState(usb_backend=bench.display._context.shared.usb_backend)
    context = DriverContext(bench.display._context.config, bench.clock, shared)
    found = {f.what: f for f in examine_dlpc_video(context)}
    assert found["DMD of the projector"].found == "DLPC900 VIDEO-P"
    assert found["order of planes"].state == "unknown" and "DMDs" not in found
    wedges = [
        [int.from_bytes(data[2:5], "little") for command, data in sent if command == ENTRY]
        for sent in bench.sent
    ]
    for exposures_us in wedges:
        wedge = next(
            exposures_us[n : n + 24]
            for n in range(len(exposures_us) - 23)
            if (np.diff(exposures_us[n : n + 24]) > 0).all()
        )
        assert wedge[-1] > 10 * wedge[0] and wedge[0] >= 105
    assert all(map(bench.stays_dark, bench.dmds))


def test_the_doctor_ends_with_what_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dlpc_video, "examine_display", lambda _: iter([]))
    bench = VideoBench(tmp_path, refresh_hz=None)
    last = list(examine_dlpc_video(bench.display._context))[-1]
    assert (last.what, last.state) == ("DMDs", "fault") and "video signal" in last.found
