"""The display of two DMDs: what it refuses, and what devices say of themselves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config, PanelConfig
from pdcd.errors import ConfigError, DeviceLost, SyncError
from pdcd.panels.frames import Frames
from tests.dlpc900_rig import (
    ROW_US,
    SIZE,
    Dlpc900Rig,
    ignore,
    never,
    opened,
    random_codes,
    shows_once,
)

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
    ("start", "times", "words"),
    [
        ("trigger", {"delay_s": np.array([0.0, -30e-6])}, "rows of 95 us are shorter"),
        ("trigger", {"delay_s": np.full(2, 0.07)}, "delay of the mask of 70 ms is too long"),
        ("trigger", {"delay_s": np.full(2, 65_431e-6)}, "delay of the mask of 65.4 ms is too long"),
        ("trigger", {"dark_s": np.full(2, 17.0)}, "of 17 s are too long"),
        ("software", {"delay_s": np.full(2, 1e-5)}, "cannot be delayed"),
    ],
)
def test_times_that_no_device_has_are_refused(
    start: str, times: dict[str, Any], words: str
) -> None:
    _, display = opened(start=start)
    with pytest.raises(ConfigError, match=words):
        display.load(replace(random_codes(2), **times))


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
