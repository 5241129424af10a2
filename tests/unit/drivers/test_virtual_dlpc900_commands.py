"""The virtual DLPC900 byte by byte: reports, replies, what it refuses, and in which order."""

from __future__ import annotations

import struct

import pytest

from drivers.virtual_dlpc900 import (
    VirtualDmdOptions,
)
from tests.dmd_client import (
    BEGIN,
    CONFIGURE,
    DATA,
    DEFINE,
    MODE,
    PAUSE,
    RUN,
    START,
    STOP,
    entry_bytes,
)
from tests.virtual_dmd_rig import BLACK_IMAGE, VirtualDmdRig, entry, report

# Reports


def test_reports_by_hand() -> None:
    rig = VirtualDmdRig(begun=False)
    device = rig.device
    device.write_report(report(0x40, 7, 3, 0, 0x24, 0x1A, 0))  # stop, and say so
    assert device.read_report() == report(0x40, 7, 0, 0)
    assert device.read_report() is None
    device.write_report(report(0x00, 8, 3, 0, 0x1B, 0x1A, 3))  # on the fly, without a word
    assert device.read_report() is None
    device.write_report(report(0xC0, 9, 2, 0, 0x1B, 0x1A))
    assert device.read_report() == report(0xC0, 9, 1, 0, 3)
    device.write_report(report(0x40, 10, 3, 0, 0x1B, 0x1A, 4))  # there is no such mode
    assert device.read_report() == report(0x60, 10, 0, 0)
    device.write_report(report(0xC0, 11, 2, 0, 0x00, 0x01))
    assert device.read_report() == report(0xC0, 11, 1, 0, 6)
    device.write_report(report(0x80, 12, 2, 0, 0x1B, 0x1A))  # wants no reply, and gets none
    assert device.read_report() is None


def test_a_command_of_several_reports() -> None:
    rig = VirtualDmdRig()
    order = struct.pack("<HI40H", 40, 40, *range(40))
    rig.client.configure([entry_bytes(n, 105) for n in range(40)])
    whole = struct.pack("<BBHH", 0x40, 77, 2 + len(order), 0x1A32) + order
    assert len(whole) == 92
    rig.device.write_report(whole[:64])
    assert rig.device.read_report() is None, "half of it is nothing yet"
    rig.device.write_report(whole[64:])  # shorter than a report: filled up
    assert rig.device.read_report() == report(0x40, 77, 0, 0)


# Refusals


@pytest.mark.parametrize(
    ("code", "data", "refused"),
    [
        (MODE, b"\4", 6),
        (MODE, b"\3\0", 6),
        (MODE, b"\2", 5),  # from video mode only
        (RUN, b"\3", 6),
        (RUN, b"", 6),
        (RUN, bytes([START]), 16),  # nothing is configured
        (0x0200, b"\3", 6),
        (0x0201, b"\2", 6),
        (0x1A1D, struct.pack("<Bhh", 0, -21, 0), 13),
        (0x1A1E, struct.pack("<Bhh", 0, 0, 20_001), 13),
        (0x1A1D, struct.pack("<Bhh", 2, 0, 0), 6),
        (0x1A35, struct.pack("<HB", 104, 0), 13),
        (0x1A35, struct.pack("<HB", 105, 2), 6),
        (0x1A36, b"\2", 6),
        (DEFINE, entry()[:11], 6),
        (DEFINE, entry(index=400), 15),
        (DEFINE, entry(index=399), 0),
        (DEFINE, entry(exposure_us=104), 14),
        (DEFINE, entry(exposure_us=50), 14),
        (DEFINE, entry(exposure_us=2**24 - 1, dark_us=2**24 - 1), 0),
        (DEFINE, entry(kind=0x12), 16),
        (DEFINE, entry(extra=2), 16),
        (DEFINE, entry(bit=24), 10),
        (DEFINE, entry(bit=31), 10),
        (DEFINE, entry(image=18), 17),
        (DEFINE, entry(image=16, bit=15), 0),
        (DEFINE, entry(image=16, bit=16), 17),  # the 401st plane
        # several things are wrong: the first byte that is decides
        (DEFINE, entry(index=400, exposure_us=50, image=18), 15),
        (DEFINE, entry(exposure_us=50, bit=24, image=18), 14),
        (DEFINE, entry(kind=0x12, bit=24), 16),
        (DEFINE, entry(bit=24, image=18), 10),
        (CONFIGURE, struct.pack("<HI", 0, 0), 15),
        (CONFIGURE, struct.pack("<HI", 401, 0), 15),
        (CONFIGURE, struct.pack("<HI", 1, 0), 16),
        (CONFIGURE, struct.pack("<H", 1), 6),
        (0x1A32, struct.pack("<HIH", 1, 1, 0), 15),
        (0x1A32, struct.pack("<HIH", 2, 1, 0), 6),
        (0x1A32, struct.pack("<HI", 0, 0), 6),
        (BEGIN, struct.pack("<HI", 18, 1000), 17),
        (BEGIN, struct.pack("<HI", 17, 1000), 0),
        (BEGIN, struct.pack("<HI", 0, 48), 6),
        (BEGIN, struct.pack("<HI", 0, 2**31), 6),
        (BEGIN + 2, struct.pack("<HI", 0, 1000), 4),  # there is one controller
        (DATA, struct.pack("<H", 2) + b"\0\0", 5),  # no image was announced
    ],
)
def test_what_is_refused(code: int, data: bytes, refused: int) -> None:
    rig = VirtualDmdRig()
    assert rig.client.refuses(code, data) == refused
    if refused:
        assert rig.client.error() == refused, "it may be read again"
        assert rig.client.error_text()
    rig.client.run(STOP)
    assert rig.client.error() == 0, "the code is that of the last command"


@pytest.mark.parametrize("dark_us", [1, 49])
def test_the_shortest_dark_time_is_an_option(dark_us: int) -> None:
    client = VirtualDmdRig(VirtualDmdOptions(least_dark_us=50)).client
    assert client.refuses(DEFINE, entry(dark_us=dark_us)) == 12
    assert client.refuses(DEFINE, entry(dark_us=0)) == 0
    assert client.refuses(DEFINE, entry(dark_us=50)) == 0
    assert VirtualDmdRig().client.refuses(DEFINE, entry(dark_us=dark_us)) == 0


RUNNING = [
    (MODE, b"\0"),
    (MODE, b"\3"),
    (DEFINE, entry()),
    (CONFIGURE, struct.pack("<HI", 1, 0)),
    (0x1A32, struct.pack("<HIH", 1, 1, 0)),
    (BEGIN, struct.pack("<HI", 0, 1000)),
    (DATA, struct.pack("<H", 0)),
    (0x0201, b"\1"),
    (0x1A1D, bytes(5)),
    (0x1A35, struct.pack("<HB", 105, 0)),
    (0x1A36, b"\0"),
]


@pytest.mark.parametrize(("code", "data"), RUNNING)
def test_what_has_to_wait_for_the_end(code: int, data: bytes) -> None:
    client = VirtualDmdRig().client
    client.configure([entry()], most=0)
    assert client.load(0, BLACK_IMAGE) == 0
    client.run(START)
    assert client.refuses(code, data) == 5
    client.run(PAUSE)
    assert client.refuses(code, data) == 5, "a pause is no end"
    client.run(START)
    assert client.read(0x1A0C) == b"\2"
    client.run(STOP)
    assert client.read(0x1A0C) == b"\0"
    if (code, data) != (DATA, struct.pack("<H", 0)):
        assert client.refuses(code, data) == 0


@pytest.mark.parametrize(
    ("mode", "allowed"),
    [(0, set()), (1, {DEFINE, CONFIGURE, RUN}), (3, {DEFINE, CONFIGURE, RUN, BEGIN})],
)
def test_what_each_mode_allows(mode: int, allowed: set[int]) -> None:
    client = VirtualDmdRig().client
    client.write(MODE, bytes([mode]))
    for code, data in (
        (DEFINE, entry()),
        (CONFIGURE, struct.pack("<HI", 1, 1)),
        (BEGIN, struct.pack("<HI", 0, 1000)),
        (RUN, bytes([START])),
    ):
        assert client.refuses(code, data) == (0 if code in allowed else 5), hex(code)
    client.run(STOP)
    client.run(STOP)


def test_it_begins_with_its_own_pattern_and_no_mode_is_changed_before_a_stop() -> None:
    rig = VirtualDmdRig(begun=False)
    assert rig.device.find_content() is not None
    assert rig.client.refuses(MODE, b"\3") == 5
    rig.client.run(STOP)
    assert rig.device.find_content() is None
    assert rig.client.refuses(MODE, b"\3") == 0
    dark = VirtualDmdRig(VirtualDmdOptions(startup=False), begun=False)
    assert dark.device.find_content() is None and dark.client.read(0x1A0C) == b"\0"


def test_parked_mirrors_do_nothing() -> None:
    client = VirtualDmdRig().client
    client.configure([entry()], most=0)
    client.write(0x0200, b"\1")
    assert client.read(0x1A0C) == b"\1" and client.read(0x0200) == b"\1"
    for code, data in [*RUNNING[:7], (0x0201, b"\1"), (RUN, bytes([START]))]:
        assert client.refuses(code, data) == 5
    client.run(STOP)
    client.write(0x0200, b"\0")
    assert client.read(0x1A0C) == b"\0" and client.read(MODE) == b"\3"
    client.run(START)
