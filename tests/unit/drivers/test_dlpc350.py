"""The display of DMDs on a video signal with a DLPC350: its commands in their order, each plane of
a picture in its time, and black at each failure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import dlpc_video
from drivers.dlpc900.link import list_devices
from drivers.dlpc_video import examine_dlpc_video
from drivers.virtual_dlpc900 import VirtualDmdFault
from pdcd.errors import ConfigError, DeviceLost, PdcdError, SyncError
from tests.dlpc_video_rig import (
    BOTH_350,
    PERIOD_NS,
    SIZES,
    Kind,
    Presenter,
    VideoBench,
    assert_log_is_shown,
    config,
    make_video_display,
    make_video_dmds,
    play,
    presenter,
    read_played,
)
from tests.panel_pixels import random_frames

__all__ = ["presenter"]
pytestmark = pytest.mark.usefixtures("presenter")

LIT = np.full(SIZES["dlpc350"][::-1], 0xFFFFFF, np.uint32)
POWER, VALIDATE, MODE = 0x0200, 0x1A1A, 0x1A1B
SOURCE, TRIGGER, RUN, TIMES, TABLE = 0x1A22, 0x1A23, 0x1A24, 0x1A29, 0x1A31
OFFSET, MAILBOX, ENTRY = 0x1A32, 0x1A33, 0x1A34
MIXED: tuple[Kind, Kind] = ("dlpc900", "dlpc350")


def make_bench(folder: Path, *faults: VirtualDmdFault, **how: Any) -> VideoBench:
    return VideoBench(folder, *faults, **{"kinds": BOTH_350, **how})


def set_up(exposure: str, period: str, blacks: list[int]) -> list[tuple[int, bytes]]:
    """All writes of a set-up, byte by byte as the tables of the guide have them."""
    mailbox = []
    for n, black in enumerate(blacks):
        what = "01" if n == 0 else f"{n << 2 | 3:02x}"  # on VSYNC; the others go on
        mailbox += [(OFFSET, bytes([n])), (ENTRY, bytes.fromhex(f"{what} 11 {black:02x}"))]
    return [
        (RUN, b"\0"),
        (POWER, b"\0"),
        (MODE, b"\1"),
        (RUN, b"\0"),
        (SOURCE, b"\0"),
        (TRIGGER, b"\0"),
        (TABLE, bytes.fromhex("17 01 17 00")),
        (TIMES, bytes.fromhex(exposure + period)),
        (MAILBOX, b"\2"),
        *mailbox,
        (MAILBOX, b"\0"),
        (VALIDATE, b"\0"),
        (RUN, b"\2"),
        (RUN, b"\2"),
    ]


@pytest.mark.parametrize(
    ("dark_us", "exposure", "blacks"),
    [(0, "ab 02 00 00", [0] * 23 + [2]), (240, "bb 01 00 00", [2] * 24)],
)
def test_what_is_sent_in_its_order_and_to_the_byte(
    tmp_path: Path, dark_us: int, exposure: str, blacks: list[int]
) -> None:
    """Stop and park; then planes of (1e6 / 60 * 0.998 - 230) / 24 = 683 us."""
    bench = make_bench(tmp_path, dlpc={"dark_us": dark_us})
    bench.display.connect()
    for sent in bench.sent:
        assert sent == [(RUN, b"\0"), (POWER, b"\1"), *set_up(exposure, "ab 02 00 00", blacks)]
        del sent[:]
    bench.display.load(random_frames((6, 8), "whole", 24))
    assert bench.sent == [[], []]  # what follows its signal is left alone


def test_a_report_of_it(tmp_path: Path) -> None:
    """Flags, sequence, length of command and data, command, data, zeros: 64 bytes."""
    bench, reports = make_bench(tmp_path), []
    mask = bench.dmds[1]
    take = mask.write_report
    mask.write_report = lambda report: (reports.append(report), take(report))[1]  # type: ignore
    bench.display.connect()
    (found,) = (one for one in reports if one[4:6] == b"\x29\x1a")
    assert found[:1] + found[2:] == bytes.fromhex("40 0a00 291a ab020000 ab020000") + bytes(50)


def test_each_plane_is_shown_in_its_row_and_time(tmp_path: Path) -> None:
    """Beside a DLPC900, which then has planes as long."""
    assert_log_is_shown(make_bench(tmp_path, kinds=MIXED, dlpc={"dark_us": 240}), pictures=1)


def test_the_last_plane_is_dark_until_the_next_picture(tmp_path: Path) -> None:
    bench = make_bench(tmp_path)
    bench.display.connect()
    log = play(bench.display, 30)
    mask, now_ns = bench.dmds[1], bench.clock.now_ns()
    mask.drive_video(LIT, now_ns)
    played = read_played(mask, now_ns, now_ns + PERIOD_NS)
    assert [at_ns - now_ns for at_ns, _ in played] == [683_000 * n for n in range(25)]
    assert played[-1][1] is None and log.dark_s is not None
    assert log.dark_s[23] == pytest.approx(1e-9 * PERIOD_NS - 24 * 683e-6, abs=2e-9)
    assert not log.dark_s[:23].any()


@pytest.mark.parametrize(
    ("options", "kind", "told"),
    [
        ({"least_exposure_us": 700}, ConfigError, "exposure or period"),
        ({"warns": 8}, ConfigError, "black missing"),
        ({"validate_s": 60.0}, DeviceLost, "does not end the validation"),
        ({"wake_s": 60.0}, DeviceLost, "stays parked"),
        ({"mode_s": 60.0}, DeviceLost, "does not take patterns"),
        ({"lock_told": "main"}, DeviceLost, "0x071c"),
    ],
)
def test_what_a_device_does_not_do_is_told_and_it_is_dark(
    tmp_path: Path, options: Any, kind: type[PdcdError], told: str
) -> None:
    bench = make_bench(tmp_path, **options)
    with pytest.raises(kind, match=told):
        bench.display.connect()
    assert all(map(bench.stays_dark, bench.dmds)) and Presenter.said[-1] == "black"


@pytest.mark.parametrize(
    ("unit", "dlpc"),
    [
        ({"starts": 1}, {}),
        ({"validate_s": 2.0, "wake_s": 5.0, "mode_s": 2.0}, {}),
        ({"vsync_type": 2}, {"vsync_trigger": 2}),
        ({"lock_told": "main"}, {"lock_from": "main"}),
        ({"after_stop": "black"}, {}),
    ],
)
def test_units_that_the_guide_leaves_open(tmp_path: Path, unit: Any, dlpc: Any) -> None:
    bench = make_bench(tmp_path, dlpc=dlpc, **unit)
    bench.display.connect()
    assert not bench.stays_dark(bench.dmds[1])


def test_no_error_code_is_asked_of_it(tmp_path: Path) -> None:
    """It has none, and might not answer."""
    deaf = VirtualDmdFault("deaf", 0x0100, times=1000)
    bench = make_bench(tmp_path, deaf, VirtualDmdFault("error", TRIGGER))
    with pytest.raises(DeviceLost, match=r"refused a command \(no code after 0x1a23\)"):
        bench.display.connect()
    info = make_bench(tmp_path, deaf, VirtualDmdFault("error", 0x0205)).display.connect()
    assert info.identity["firmware of the mask"] == "unknown"


def test_one_that_never_answers_a_stop_is_parked_all_the_same(tmp_path: Path) -> None:
    bench = make_bench(tmp_path, VirtualDmdFault("deaf", RUN, times=1000))
    with pytest.raises(DeviceLost, match="does not answer") as caught:
        bench.display.connect()
    assert caught.value.device == "mask" and all(map(bench.stays_dark, bench.dmds))


def test_pictures_that_come_too_early_are_told(tmp_path: Path) -> None:
    """A device that gives up is not left as it is."""
    bench = make_bench(tmp_path)
    bench.display.load(random_frames((6, 8), "whole", 24))
    mask, now_ns = bench.dmds[1], bench.clock.now_ns()
    mask.drive_video(LIT, now_ns)
    mask.drive_video(LIT, now_ns + PERIOD_NS - 100_000)  # within the time of the last black
    mask.drive_video(LIT, now_ns + PERIOD_NS - 600_000 + PERIOD_NS)
    bench.clock.sleep_until_ns(now_ns + 2 * PERIOD_NS)
    with pytest.raises(SyncError, match="gave up its sequence"):
        bench.display.play(lambda *_: None, lambda: False)
    assert bench.stays_dark(mask)


def test_what_it_does_not_have_is_refused_and_it_is_dark(tmp_path: Path) -> None:
    bench = make_bench(tmp_path, dlpc={"rest": "idle"})
    with pytest.raises(ConfigError, match="toggle"):
        bench.display.connect()
    assert bench.stays_dark(bench.dmds[0])
    dmds = make_video_dmds((SIZES["dlpc350"],) * 2, bench.clock, kinds=BOTH_350)
    wrong = make_video_display(config(tmp_path), dmds, bench.clock)  # of 256 x 192
    with pytest.raises(ConfigError, match="912 x 1140"):
        wrong.connect()
    bench = make_bench(tmp_path, dlpc={"dark_us": 229})
    with pytest.raises(ConfigError, match="230 us or not at all"):
        bench.display.connect()
    assert all(map(bench.stays_dark, bench.dmds))


def test_the_display_of_loaded_patterns_leaves_it_alone(tmp_path: Path) -> None:
    bench = make_bench(tmp_path, kinds=MIXED)
    backend = bench.display._context.shared.usb_backend
    assert [one.controller for one in list_devices(backend)] == ["DLPC900"]
    both = list_devices(backend, "DLPC900", "DLPC350")
    assert [one.controller for one in both] == ["DLPC900", "DLPC350"]


def test_one_that_is_not_there_is_told(tmp_path: Path) -> None:
    bench = make_bench(tmp_path, dlpc={"mask": "C"})
    with pytest.raises(DeviceLost, match="no DLPC900 or DLPC350 is 'C'"):
        bench.display.connect()
    assert bench.stays_dark(bench.dmds[0])


def test_the_doctor_shows_the_thirds_of_the_planes_never_once_and_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dlpc_video, "examine_display", lambda _: iter(()))
    bench = make_bench(tmp_path)
    seen: list[Any] = []
    sleep = type(bench.display._context.patience).sleep

    def look_at_it(patience: Any, seconds: float) -> None:
        if seconds == 10.0:
            mask, now_ns = bench.dmds[1], bench.clock.now_ns()
            words = sum(
                ((np.arange(912) * 24 // 912 == n).astype(np.uint32) << bit)
                for n, bit in enumerate([*range(8, 16), *range(16, 24), *range(8)])
            )
            mask.drive_video(np.tile(np.asarray(words, np.uint32), (1140, 1)), now_ns)
            seen.extend(read_played(mask, now_ns, now_ns + PERIOD_NS))
        sleep(patience, seconds)

    monkeypatch.setattr(type(bench.display._context.patience), "sleep", look_at_it)
    found = {f.what: f for f in examine_dlpc_video(bench.display._context)}
    assert found["DLPC350"].state == "good" and found["order of planes"].state == "unknown"
    light = sum(plane[0].astype(int) for _, plane in seen if plane is not None)
    np.testing.assert_array_equal(light, np.arange(912) * 3 // 912)  # bars as `make_bars` has them
    assert all(map(bench.stays_dark, bench.dmds))
