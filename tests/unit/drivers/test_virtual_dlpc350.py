"""The virtual DLPC350 byte by byte: what it refuses, what it finds in a table, what of a picture
stands when; and another's program, unchanged, on its USB."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.virtual_dlpc900 import VirtualDmdBus
from pdcd.bench.clock import VirtualClock
from tests.dlpc_video_rig import is_dark, read_played
from tests.dmd_client import DmdClient
from tests.virtual_dlpc350 import VirtualDlpc350, VirtualDlpc350Options

POWER, SIGNAL, MAIN, VALIDATE, MODE, RUN = 0x0200, 0x071C, 0x1A0C, 0x1A1A, 0x1A1B, 0x1A24
SOURCE, TRIGGER, TIMES, TABLE = 0x1A22, 0x1A23, 0x1A29, 0x1A31
OFFSET, MAILBOX, DATA = 0x1A32, 0x1A33, 0x1A34
LIT = np.full((1140, 912), 0xFFFFFF, np.uint32)


class Rig:
    """A device, on a signal, and its client."""

    def __init__(self, **options: Any) -> None:
        self.clock = VirtualClock()
        given = VirtualDlpc350Options(report_s=0.0, **options)
        self.device = VirtualDlpc350(self.clock, "A1", given)
        self.device.connect_video(60.0)
        self.client = DmdClient(VirtualDmdBus(self.device), product=0x6401)

    def sleep(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(1e9 * seconds))

    def enter(self) -> None:
        self.client.write(MODE, b"\1")
        self.sleep(0.1)
        self.client.write(SOURCE, b"\0")
        self.client.write(TRIGGER, b"\0")

    def fill(self, *entries: str, times: tuple[int, int] = (400, 400), repeat: int = 1) -> int:
        """A table of these three bytes each; what its validation finds."""
        last = len(entries) - 1
        self.client.write(TABLE, bytes([last, repeat, last, 0]))
        self.client.write(TIMES, struct.pack("<II", *times))
        self.client.write(MAILBOX, b"\2")
        self.client.write(OFFSET, b"\0")
        self.client.write(DATA, bytes.fromhex("".join(entries)))
        self.client.write(MAILBOX, b"\0")
        self.client.write(VALIDATE, b"\0")
        assert self.client.read(VALIDATE)[0] & 0x80
        self.sleep(0.05)
        return self.client.read(VALIDATE)[0]

    def start(self) -> None:
        self.client.write(RUN, b"\2")
        self.client.write(RUN, b"\2")


@pytest.mark.parametrize(
    ("entries", "times", "found"),
    [
        (["011102"], (400, 400), 0),
        (["011102", "071100"], (400, 400), 8),  # nothing black before the next picture
        (["011102"], (234, 400), 1),
        (["011102"], (401, 400), 1),
        (["011102"], (400, 629), 16),
        (["011102"], (400, 630), 0),
        (["611102"], (400, 400), 2),  # plane 24
        (["011202"], (400, 400), 2),  # two bits
        (["01110a"], (400, 400), 4),  # shares its trigger, and is black
        (["001100"], (400, 400), 0),
    ],
)
def test_a_validation_finds(entries: list[str], times: tuple[int, int], found: int) -> None:
    rig = Rig()
    rig.enter()
    assert rig.fill(*entries, times=times) == found
    assert rig.client.refuses(RUN, b"\2") == (-1 if found & 3 else 0)


def test_nothing_starts_that_was_not_validated_to_its_end() -> None:
    rig = Rig(validate_s=1.0)
    rig.enter()
    rig.fill("011102")
    assert rig.client.read(VALIDATE) == b"\x80" and rig.client.refuses(RUN, b"\2") == -1
    rig.sleep(1.0)
    rig.client.write(TIMES, struct.pack("<II", 500, 500))
    assert rig.client.refuses(RUN, b"\2") == -1  # other times than those
    rig.client.write(VALIDATE, b"\0")
    rig.sleep(1.0)
    rig.start()
    assert rig.client.read(MAIN)[0] & 2
    for command, data in ((TIMES, bytes(8)), (TABLE, bytes(4)), (MODE, b"\0"), (MAILBOX, b"\2")):
        assert rig.client.refuses(command, data) == -1  # while it runs


@pytest.mark.parametrize(("black", "until_us"), [("02", 1200), ("00", None)])
def test_planes_stand_in_the_order_of_the_table(black: str, until_us: int | None) -> None:
    """Plane 7 is bit 7 of green, 15 of red, 23 of blue; 23 is inverted."""
    rig = Rig(vsync_type=2)
    rig.enter()
    rig.fill("1e1100", "3f1100", f"5f11{int(black, 16) | 1:02x}")
    rig.start()
    words = np.random.default_rng(5).integers(0, 2**24, LIT.shape).astype(np.uint32)
    at_ns = rig.clock.now_ns()
    rig.device.drive_video(words, at_ns)
    played = read_played(rig.device, at_ns, at_ns + 16_000_000)
    wanted = [words >> 15 & 1, words >> 23 & 1, 1 - (words >> 7 & 1)]
    assert [ns - at_ns for ns, _ in played[:3]] == [0, 400_000, 800_000]
    for (_, plane), want in zip(played, wanted, strict=False):
        assert plane is not None and np.array_equal(plane, want == 1)
    assert [ns - at_ns for ns, _ in played[3:]] == ([] if until_us is None else [1_200_000])
    assert is_dark(rig.device) is False
    rig.sleep(0.016)
    assert is_dark(rig.device) is (until_us is not None)


@pytest.mark.parametrize(("overrun", "bits"), [("stops", 0xC1), ("misses", 1)])
def test_a_picture_that_comes_before_the_end_of_the_last(overrun: Any, bits: int) -> None:
    rig = Rig(overrun=overrun)
    rig.enter()
    rig.fill("011100", "071102")
    rig.start()
    at_ns = rig.clock.now_ns()
    rig.device.drive_video(LIT, at_ns)
    rig.device.drive_video(LIT, at_ns + 1_029_999)  # 2 planes, 230 us of black
    assert rig.client.read(0x1A0A)[0] == bits
    rig.device.drive_video(LIT, at_ns + 2_000_000)
    again = read_played(rig.device, at_ns + 2_000_000, at_ns + 2_100_000)[0][1]
    assert (again is None) is (overrun == "stops")


@pytest.mark.parametrize("after_stop", ["black", "holds"])
def test_what_stands_after_a_stop_and_in_standby(after_stop: Any) -> None:
    rig = Rig(after_stop=after_stop)
    rig.device.drive_video(LIT, rig.clock.now_ns())
    assert not is_dark(rig.device)  # plain video
    rig.client.write(POWER, b"\1")
    rig.device.drive_video(LIT, rig.clock.now_ns())
    assert is_dark(rig.device) and rig.client.read(MAIN)[0] & 1
    assert rig.client.refuses(MODE, b"\1") == -1
    rig.client.write(POWER, b"\0")
    assert rig.client.read(MAIN)[0] & 1
    rig.sleep(1.0)
    assert not rig.client.read(MAIN)[0] & 1
    rig.enter()
    rig.fill("011102", repeat=0)
    rig.start()
    now_ns = rig.clock.now_ns()
    rig.device.drive_video(LIT, now_ns)
    rig.client.write(RUN, b"\0")
    rig.sleep(0.01)
    assert is_dark(rig.device) is (after_stop == "black")


PYCRAFTER = """
import numpy as np, usb.core
from tests.virtual_dlpc350 import VirtualDlpc350, VirtualDlpc350Options
from drivers.virtual_dlpc900 import VirtualDmdBus
from pdcd.bench.clock import RealClock
device = VirtualDlpc350(RealClock(), "A1", VirtualDlpc350Options(validate_s=0.001, mode_s=0.01))
bus, find = VirtualDmdBus(device, kernel_driver=False), usb.core.find
usb.core.find = lambda **how: find(backend=bus, **how)
device.connect_video(60.0)
import pycrafter4500
pycrafter4500.pattern_mode(num_pats=3, bit_depth=1, period=4000)
words = np.random.default_rng(0).integers(0, 2**24, (1140, 912)).astype(np.uint32)
at_ns = device.clock.now_ns()
device.drive_video(words, at_ns)
shown = device.list_changes(at_ns, at_ns + 12_000_000)
print([ns - at_ns for ns, _ in shown], [one.bit for _, one in shown],
      all(one.words is words for _, one in shown))
pycrafter4500.power_down()
print(device.find_content())
"""


def test_pycrafter4500_shows_three_planes_on_it(tmp_path: Path) -> None:
    """A program that was written for the real one, as it is on PyPI: bits 7, 15 and 23 of its
    patterns are the highest of green, red and blue."""
    pytest.importorskip("pycrafter4500", reason="pycrafter4500 IS MISSING (PyPI, for this test)")
    done = subprocess.run(
        [sys.executable, "-c", PYCRAFTER], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["[0, 4000000, 8000000] [15, 23, 7] True", "None"]
