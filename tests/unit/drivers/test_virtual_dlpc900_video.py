"""The virtual DLPC900 on a video signal, byte by byte: when it takes which mode, what of a picture
stands when, and what it makes of signals that come wrong."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.virtual_dlpc900 import (
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import VirtualClock
from tests.dlpc_video_rig import is_dark, read_played
from tests.dmd_client import CONFIGURE, DEFINE, MODE, RUN, START, STOP, DmdClient, entry_bytes

SIZE = (8, 6)
STATUS, MAIN = 0x1A0A, 0x1A0C
LIT = np.full((6, 8), 0xFFFFFF, np.uint32)
DARK = np.zeros((6, 8), np.uint32)


class VideoRig:
    """A device in video mode, on a signal of 60 Hz, and its client."""

    def __init__(self, *, refresh_hz: float | None = 60.0, **options: Any) -> None:
        self.clock = VirtualClock()
        given = VirtualDmdOptions(report_s=0.0, **options)
        self.device = VirtualDlpc900(self.clock, choose_dmd_model(SIZE), "A1", given)
        if refresh_hz is not None:
            self.device.connect_video(refresh_hz)
        self.client = DmdClient(VirtualDmdBus(self.device))
        self.client.run(STOP)
        self.client.write(MODE, b"\0")

    def sleep(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(1e9 * seconds))

    def enter(self) -> None:
        self.client.write(MODE, b"\2")
        self.sleep(0.3)
        assert self.client.read(MODE) == b"\2"

    def define(self, count: int = 24, exposure_us: int = 600, dark_us: int = 0) -> int:
        """Entry n shows plane n; what the configuration is refused by."""
        for n in range(count):
            self.client.write(DEFINE, entry_bytes(n, exposure_us, dark_us, bit=n, wait=n == 0))
        return self.client.refuses(CONFIGURE, struct.pack("<HI", count, 0))

    def begin(self, **lut: int) -> None:
        self.enter()
        assert self.define(**lut) == 0
        self.client.run(START)

    def show(self, words: Any) -> int:
        """A picture that begins now; when that was."""
        at_ns = self.clock.now_ns()
        self.device.drive_video(words, at_ns)
        return at_ns


def test_no_mode_leads_to_it_but_video_and_no_video_without_a_signal() -> None:
    rig = VideoRig(refresh_hz=None)
    assert rig.client.read(MAIN)[0] & 8 == 0 and rig.client.refuses(MODE, b"\2") == 5
    rig.device.connect_video(60.0)
    assert rig.client.read(MAIN)[0] & 8 == 8
    for other in (b"\1", b"\3"):
        rig.client.write(MODE, other)
        assert rig.client.refuses(MODE, b"\2") == 5
    rig.client.write(MODE, b"\0")
    rig.client.write(MODE, b"\2")
    rig.sleep(0.29)
    assert rig.client.read(MODE) == b"\0" and rig.client.refuses(DEFINE, entry_bytes(0, 600)) == 5
    rig.sleep(0.01)
    assert rig.client.read(MODE) == b"\2"
    rig.device.disconnect_video(rig.clock.now_ns())
    assert rig.define() == 0 and rig.client.refuses(RUN, bytes([START])) == 5


def test_each_plane_of_a_picture_stands_at_its_time_and_black_after_the_last() -> None:
    """Bit n of green is plane n, of red plane 8 + n, of blue plane 16 + n."""
    rig = VideoRig()
    rig.begin(exposure_us=500, dark_us=100)
    rng = np.random.default_rng(3)
    rgb = rng.integers(0, 256, (6, 8, 3))
    words = (rgb[..., 0] << 16 | rgb[..., 1] << 8 | rgb[..., 2]).astype(np.uint32)
    assert is_dark(rig.device)
    at_ns = rig.show(words)
    rig.sleep(1 / 60)
    played = read_played(rig.device, at_ns, rig.clock.now_ns())
    assert len(played) == 49  # planes, their dark times, and until the next picture
    for n in range(24):
        (begin_ns, plane), (dark_ns, dark) = played[2 * n : 2 * n + 2]
        assert begin_ns - at_ns == 600_000 * n and dark_ns - begin_ns == 500_000 and dark is None
        np.testing.assert_array_equal(plane, rgb[..., (1, 0, 2)[n // 8]] >> n % 8 & 1)
    assert played[48][1] is None and played[48][0] - at_ns == 24 * 600_000 + 105_000
    assert rig.client.read(MAIN)[0] & 2 == 2  # it waits for the next picture
    later_ns = rig.show(LIT)
    assert read_played(rig.device, later_ns, later_ns + 1)[0][1] is not None


@pytest.mark.parametrize(("order", "shift"), [("GRB", 8), ("RGB", 16), ("BGR", 0)])
def test_the_order_of_colours_is_an_option(order: str, shift: int) -> None:
    rig = VideoRig(video_planes=order)
    rig.begin()
    at_ns = rig.show(DARK + np.uint32(1 << shift))
    first = read_played(rig.device, at_ns, at_ns + 700_000)
    assert first[0][1] is not None and first[0][1].all()
    assert first[1][1] is not None and not first[1][1].any()


@pytest.mark.parametrize(
    ("count", "exposure_us", "dark_us", "code"),
    [(24, 690, 0, 0), (24, 691, 0, 14), (24, 500, 191, 14), (24, 104, 0, 14), (12, 1380, 0, 0)],
)
def test_all_entries_and_the_black_that_ends_them_fit_a_picture(
    count: int, exposure_us: int, dark_us: int, code: int
) -> None:
    """24 x 690 + 105 = 16,665 us of 16,666.7; 105 us is the least that is exposed."""
    rig = VideoRig()
    rig.enter()
    if exposure_us < 105:
        assert rig.client.refuses(DEFINE, entry_bytes(0, exposure_us)) == code
        return
    assert rig.define(count, exposure_us, dark_us) == code
    assert rig.client.refuses(RUN, bytes([START])) == (16 if code else 0)


def test_a_first_entry_that_does_not_wait_is_refused_unless_the_unit_has_it_so() -> None:
    rig = VideoRig(video_waits=0)
    rig.enter()
    assert rig.define() == 16
    rig.client.write(DEFINE, entry_bytes(0, 600))
    assert rig.client.refuses(CONFIGURE, struct.pack("<HI", 1, 0)) == 0


@pytest.mark.parametrize("how", ["too early", "lost"])
def test_a_signal_that_goes_wrong_ends_the_sequence_and_is_told(how: str) -> None:
    rig = VideoRig(after_stop="holds")
    rig.begin()
    rig.show(LIT)
    rig.sleep(0.010)
    if how == "lost":
        rig.device.disconnect_video(rig.clock.now_ns())
    else:
        rig.show(LIT)
    assert not is_dark(rig.device)  # what was there stands, where stops are so
    assert rig.client.read(MAIN)[0] & 2 == 0 and rig.client.read(STATUS)[0] & 0xC0 == 0xC0
    rig.show(DARK)
    assert not is_dark(rig.device)  # and no picture reaches it any more


def test_plain_video_lights_whatever_has_a_level() -> None:
    rig = VideoRig()
    words = DARK.copy()
    words[2, 3] = 1
    at_ns = rig.show(words)
    ((_, lit),) = read_played(rig.device, at_ns, at_ns + 1)
    assert lit is not None and np.array_equal(lit, words > 0)
    rig.show(DARK)
    assert is_dark(rig.device)
    with pytest.raises(ValueError, match="mirrors"):
        rig.show(LIT[1:])
