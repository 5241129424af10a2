"""The virtual DLPC900 byte by byte: reports, replies, what it refuses, and in which order."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest

from drivers.virtual_dlpc900 import (
    DLP6500,
    DLP9000,
    PLANES_BY_OTHERS,
    PLANES_BY_TI,
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdModel,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import VirtualClock
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
    CommandError,
    DmdClient,
    encode_erle,
    entry_bytes,
    make_image,
    pack_words,
)

SIZE = (16, 8)
BLACK_IMAGE = make_image(np.zeros((8, 16), np.uint32))


class Rig:
    """One device, stopped and in on-the-fly mode unless told otherwise, and its client."""

    def __init__(
        self,
        options: VirtualDmdOptions | None = None,
        model: VirtualDmdModel | None = None,
        *,
        begun: bool = True,
    ) -> None:
        self.clock = VirtualClock()
        self.device = VirtualDlpc900(
            self.clock, model or choose_dmd_model(SIZE), "A1", options or VirtualDmdOptions()
        )
        self.client = DmdClient(VirtualDmdBus(self.device))
        if begun:
            self.client.begin()

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def planes(self, count: int) -> list[list[list[int]]]:
        """What the first patterns of a sequence show, from its start on."""
        begun_ns = self.clock.now_ns()
        self.client.run(START)
        self.wait(0.05)
        shown = [
            (plane.words >> plane.bit & 1).tolist()
            for _, plane in self.device.list_changes(begun_ns, self.clock.now_ns())
            if plane is not None
        ]
        return shown[:count]


def report(*head: int) -> bytes:
    return bytes(head).ljust(64, b"\0")


# Reports


def test_reports_by_hand() -> None:
    rig = Rig(begun=False)
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
    rig = Rig()
    order = struct.pack("<HI40H", 40, 40, *range(40))
    rig.client.configure([entry_bytes(n, 105) for n in range(40)])
    whole = struct.pack("<BBHH", 0x40, 77, 2 + len(order), 0x1A32) + order
    assert len(whole) == 92
    rig.device.write_report(whole[:64])
    assert rig.device.read_report() is None, "half of it is nothing yet"
    rig.device.write_report(whole[64:])  # shorter than a report: filled up
    assert rig.device.read_report() == report(0x40, 77, 0, 0)


def test_a_report_with_a_report_id_is_another_command() -> None:
    rig = Rig()
    shifted = b"\0" + report(0x40, 7, 3, 0, 0x24, 0x1A, 0)  # as hidapi wants it, and pyusb not
    assert rig.client.device.write(1, shifted) == 65
    assert rig.device.read_report() is None


def test_a_command_longer_than_the_buffer() -> None:
    rig = Rig()
    assert rig.client.refuses(BEGIN, struct.pack("<HI", 0, 1000)) == 0
    assert rig.client.refuses(DATA, struct.pack("<H", 504) + bytes(504)) == 0
    assert rig.client.refuses(DATA, struct.pack("<H", 505) + bytes(505)) == 6
    assert rig.client.read(MODE) == b"\3", "the next command is understood"


def test_what_is_told_of_it() -> None:
    client = Rig(begun=False).client
    assert client.read(0x0205) == bytes([0, 0, 0, 6] * 4), "6.0.0, four times"
    assert client.read(0x0206) == b"\0virtual".ljust(32, b"\0"), "none of those there are"
    assert client.read(0x1A0A) == b"\1" and client.read(0x1A0B) == b"\1"
    assert client.read(0x1A0C) == b"\2", "its startup pattern runs"
    assert client.read(MODE) == b"\1" and client.read(0x0200) == b"\0"
    assert client.read(0x1A42) == struct.pack("<H", 105).ljust(32, b"\0")
    assert client.read(CONFIGURE) == bytes(6)
    assert client.read(0x1A35) == bytes([105, 0, 0])
    big = Rig(model=DLP9000, begun=False).client
    assert big.read(0x0206)[0] == 2 and big.read(0x1A0A) == b"\x11"


@pytest.mark.parametrize(
    ("code", "data"),
    [
        (0x1A1D, struct.pack("<Bhh", 1, -20, 20_000)),
        (0x1A1E, struct.pack("<Bhh", 0, 0, -5)),
        (0x1A35, struct.pack("<HB", 200, 1)),
        (0x1A36, b"\1"),
        (0x1A00, b"\2"),
        (0x1A02, b"\1"),
        (0x1A03, b"\3"),
        (0x1A07, b"\7"),
        (0x0B01, bytes(3)),
        (0x1100, bytes.fromhex("ff01ff01ff01")),
    ],
)
def test_what_was_written_is_read(code: int, data: bytes) -> None:
    client = Rig().client
    client.write(code, data)
    assert client.read(code) == data
    assert client.refuses(code, data + b"\0") == 6


# Refusals


def unknown(code: int, read: bool) -> Callable[[DmdClient], object]:
    return lambda client: client.read(code) if read else client.write(code, b"\0")


@pytest.mark.parametrize(
    "ask",
    [
        unknown(0x1A99, True),
        unknown(0x1A99, False),
        unknown(0x0100, False),  # some programs send this
        unknown(0x1A0C, False),
        unknown(RUN, True),
        unknown(DEFINE, True),
        lambda client: ask_for_another_part(client),
    ],
)
def test_commands_that_there_are_not(ask: Callable[[DmdClient], object]) -> None:
    client = Rig().client
    with pytest.raises(CommandError, match="3"):
        ask(client)


def ask_for_another_part(client: DmdClient) -> None:
    client.send(MODE, flags=0xC1)
    if client.fetch()[0] & 0x20:
        raise CommandError(client.error())


def entry(**changes: int) -> bytes:
    values = {"index": 0, "exposure_us": 105, **changes}
    return entry_bytes(**values)  # type: ignore[arg-type]


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
    rig = Rig()
    assert rig.client.refuses(code, data) == refused
    if refused:
        assert rig.client.error() == refused, "it may be read again"
        assert rig.client.error_text()
    rig.client.run(STOP)
    assert rig.client.error() == 0, "the code is that of the last command"


@pytest.mark.parametrize("dark_us", [1, 49])
def test_the_shortest_dark_time_is_an_option(dark_us: int) -> None:
    client = Rig(VirtualDmdOptions(least_dark_us=50)).client
    assert client.refuses(DEFINE, entry(dark_us=dark_us)) == 12
    assert client.refuses(DEFINE, entry(dark_us=0)) == 0
    assert client.refuses(DEFINE, entry(dark_us=50)) == 0
    assert Rig().client.refuses(DEFINE, entry(dark_us=dark_us)) == 0


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
    client = Rig().client
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
    client = Rig().client
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


def test_flash_has_one_plane() -> None:
    client = Rig().client
    client.write(MODE, b"\1")
    assert client.refuses(DEFINE, entry(bit=1)) == 11
    assert client.refuses(DEFINE, entry(image=1)) == 11


def test_it_begins_with_its_own_pattern_and_no_mode_is_changed_before_a_stop() -> None:
    rig = Rig(begun=False)
    assert rig.device.find_content() is not None
    assert rig.client.refuses(MODE, b"\3") == 5
    rig.client.run(STOP)
    assert rig.device.find_content() is None
    assert rig.client.refuses(MODE, b"\3") == 0
    dark = Rig(VirtualDmdOptions(startup=False), begun=False)
    assert dark.device.find_content() is None and dark.client.read(0x1A0C) == b"\0"


def test_video_pattern_mode_comes_after_video_with_a_locked_source_and_after_300_ms() -> None:
    client = Rig().client
    client.write(MODE, b"\0")
    assert client.refuses(MODE, b"\2") == 5, "no source"
    rig = Rig(VirtualDmdOptions(source_locked=True))
    client = rig.client
    assert client.read(0x1A0C) == b"\x18"
    assert client.refuses(MODE, b"\2") == 5, "from video mode only"
    client.write(MODE, b"\0")
    client.write(MODE, b"\2")
    begun_ns = rig.clock.now_ns()
    assert client.read(MODE) == b"\0" and client.refuses(DEFINE, entry()) == 5
    rig.clock.sleep_until_ns(begun_ns + 290_000_000)
    assert client.read(MODE) == b"\0"
    rig.clock.sleep_until_ns(begun_ns + 300_000_000)
    assert client.read(MODE) == b"\2" and client.refuses(DEFINE, entry(bit=23)) == 0
    assert client.refuses(BEGIN, struct.pack("<HI", 0, 1000)) == 5
    client.configure([entry()], most=0)
    client.run(START)
    assert client.read(0x1A0C) == b"\x1a" and rig.device.find_content() is None


def test_parked_mirrors_do_nothing() -> None:
    client = Rig().client
    client.configure([entry()], most=0)
    client.write(0x0200, b"\1")
    assert client.read(0x1A0C) == b"\1" and client.read(0x0200) == b"\1"
    for code, data in [*RUNNING[:7], (0x0201, b"\1"), (RUN, bytes([START]))]:
        assert client.refuses(code, data) == 5
    client.run(STOP)
    client.write(0x0200, b"\0")
    assert client.read(0x1A0C) == b"\0" and client.read(MODE) == b"\3"
    client.run(START)


# Images and entries

PLANES = np.random.default_rng(3).random((50, 8, 16)) < 0.5


def entries_of(count: int, **changes: int) -> list[bytes]:
    return [entry(index=n, image=n // 24, bit=n % 24, **changes) for n in range(count)]


@pytest.mark.parametrize("order", [PLANES_BY_TI, PLANES_BY_OTHERS, (0, 1, 2)])
def test_every_plane_is_shown_where_the_order_of_bytes_is_right(
    order: tuple[int, int, int],
) -> None:
    rig = Rig(VirtualDmdOptions(plane_bytes=order))
    rig.client.upload(PLANES, entries_of(50), order)
    assert rig.planes(50) == PLANES.astype(int).tolist()


def test_the_wrong_order_of_bytes_shows_other_planes() -> None:
    rig = Rig(VirtualDmdOptions(plane_bytes=PLANES_BY_OTHERS))
    rig.client.upload(PLANES[:24], entries_of(24), PLANES_BY_TI)
    exchanged = [*range(8, 16), *range(8), *range(16, 24)]
    assert rig.planes(24) == PLANES[exchanged].astype(int).tolist()


def test_planes_by_hand() -> None:
    """Plane 0 is the lowest bit of the second byte by TI, of the third by others."""
    for order, word in ((PLANES_BY_TI, 0x000100), (PLANES_BY_OTHERS, 0x000001)):
        rig = Rig(VirtualDmdOptions(plane_bytes=order))
        rig.client.configure([entry(bit=0), entry(index=1, bit=16)])
        words = np.full((8, 16), word, np.uint32)
        assert rig.client.load(0, make_image(words)) == 0
        assert rig.planes(2) == [np.ones((8, 16)).tolist(), np.zeros((8, 16)).tolist()]


def test_a_program_that_asks_for_every_reply_and_looks_for_errors_after_each() -> None:
    """As one much used program does: stop, mode, entries, configuration, images from the last on;
    ends of lines, sizes with the header, a last piece that may be empty."""
    rig = Rig(VirtualDmdOptions(plane_bytes=PLANES_BY_OTHERS), begun=False)
    client = rig.client

    def say(code: int, data: bytes, sequence: int = 0) -> None:
        client.send(code, data, flags=0x40, sequence=sequence)
        assert client.fetch()[:2] == (0x40, sequence)
        client.send(0x0100, flags=0xC0, sequence=0x22)
        assert client.fetch() == (0xC0, 0x22, b"\0")

    say(RUN, bytes([STOP]))
    say(MODE, b"\3")
    say(RUN, bytes([STOP]))
    images = []
    for first in (0, 24, 48):
        stream = encode_erle(pack_words(PLANES[first : first + 24], PLANES_BY_OTHERS), True)
        stream += bytes(-len(stream) % 4)
        head = b"Spld" + struct.pack("<HHI", 16, 8, 48 + len(stream)) + b"\xff" * 8 + bytes(5)
        images.append((head + b"\2\1").ljust(48, b"\0") + stream)
    for number in range(50):
        say(DEFINE, entry(index=number, image=number // 24, bit=number % 24, kind=0x71, extra=1))
    say(CONFIGURE, struct.pack("<HI", 50, 0))
    for index in (2, 1, 0):
        image = images[index]
        say(BEGIN, struct.pack("<HI", index, len(image)))
        for number in range(len(image) // 504 + 1):
            piece = image[504 * number : 504 * number + 504]
            say(DATA, struct.pack("<H", len(piece)) + piece, 0x11)
    assert rig.planes(50) == PLANES.astype(int).tolist()


def test_an_empty_piece_may_follow_an_image() -> None:
    client = Rig().client
    client.configure([entry()])
    assert client.load(0, BLACK_IMAGE) == 0
    assert client.refuses(DATA, struct.pack("<H", 0)) == 0
    assert client.refuses(DATA, struct.pack("<H", 1) + b"\0") == 17, "but none with anything in it"
    assert client.refuses(DATA, b"\0") == 6
    client.write(BEGIN, struct.pack("<HI", 0, len(BLACK_IMAGE)))
    assert client.refuses(DATA, struct.pack("<H", 5) + bytes(4)) == 6
    assert client.refuses(DATA, struct.pack("<H", 4) + bytes(5)) == 6


def test_data_is_not_answered_unless_that_is_asked_for() -> None:
    rig = Rig()
    rig.client.configure([entry()])
    rig.client.write(BEGIN, struct.pack("<HI", 0, 600))
    rig.client.send(DATA, struct.pack("<H", 504) + bytes(504), flags=0)
    assert rig.device.read_report() is None


@pytest.mark.parametrize(
    ("image", "refused"),
    [
        (make_image(np.zeros((8, 15), np.uint32)), 6),
        (make_image(np.zeros((8, 16), np.uint32), compression=3), 9),
        (make_image(np.zeros((8, 16), np.uint32), b"\x11\0\0\0\0\1\0"), 255),
        (make_image(np.zeros((8, 16), np.uint32), b"\x10\1\1\1"), 255),
    ],
)
def test_images_that_are_wrong_are_told_of_after_the_last_piece(image: bytes, refused: int) -> None:
    rig = Rig()
    rig.client.configure([entry(bit=16)])
    assert rig.client.load(0, image) == refused
    startup = rig.device.memory.startup
    shown = np.array(rig.planes(1)[0])
    if refused == 255 and image[-1]:
        assert shown[0].all() and not shown[1:].any(), "its beginning is there all the same"
    elif refused != 255:
        assert np.array_equal(shown, startup.words & 1), "nothing was loaded"


def test_images_come_from_the_last_one_on() -> None:
    client = Rig().client
    client.configure(entries_of(50))
    for index in (2, 1):
        assert client.load(index, BLACK_IMAGE) == 0
    assert client.refuses(BEGIN, struct.pack("<HI", 2, 1000)) == 17
    assert client.load(1, BLACK_IMAGE) == 0, "the same once more"
    client.configure(entries_of(50))
    assert client.load(2, BLACK_IMAGE) == 0, "anew after a configuration"
    client = Rig(VirtualDmdOptions(any_order=True)).client
    client.configure(entries_of(50))
    for index in (0, 1, 2):
        assert client.load(index, BLACK_IMAGE) == 0


def test_other_entries_need_their_images_again() -> None:
    """By the guide. A unit that keeps them is an option."""
    for keeps, shown in ((False, PLANES[0]), (True, PLANES[5])):
        rig = Rig(VirtualDmdOptions(keeps_images=keeps))
        rig.client.upload(PLANES[:24], [entry(bit=0), entry(index=1, bit=1)], PLANES_BY_TI)
        rig.client.configure([entry(bit=5), entry(index=1, bit=1)])
        assert rig.planes(2) == [shown.astype(int).tolist(), PLANES[1].astype(int).tolist()]
        rig.client.run(STOP)
        image = make_image(pack_words(PLANES[:24], PLANES_BY_TI))
        assert rig.client.load(0, image) == 0
        assert rig.planes(1) == [PLANES[5].astype(int).tolist()]


@pytest.mark.parametrize("keeps", [False, True])
def test_images_before_their_entries_and_fewer_entries(keeps: bool) -> None:
    rig = Rig(VirtualDmdOptions(keeps_images=keeps))
    assert rig.client.load(0, make_image(pack_words(PLANES[:24], PLANES_BY_TI))) == 0
    rig.client.configure(entries_of(3))
    startup = (rig.device.memory.startup.words & 1).tolist()
    wanted = PLANES[:3].astype(int).tolist() if keeps else [startup] * 3
    assert rig.planes(3) == wanted
    rig.client.run(STOP)
    rig.client.upload(PLANES[:24], entries_of(3), PLANES_BY_TI)
    rig.client.configure(entries_of(2))
    assert rig.planes(2) == (PLANES[:2].astype(int).tolist() if keeps else [startup] * 2)


def test_another_mode_and_back_is_forgotten() -> None:
    rig = Rig()
    rig.client.upload(PLANES[:3], entries_of(3), PLANES_BY_TI)
    rig.client.write(MODE, b"\0")
    rig.client.write(MODE, b"\3")
    assert rig.client.refuses(RUN, bytes([START])) == 16
    assert rig.client.refuses(CONFIGURE, struct.pack("<HI", 3, 3)) == 16


def test_replies_to_data_spoil_the_images_of_some_units() -> None:
    words = np.full((8, 16), 0xFFFFFF, np.uint32)
    for spoils, acked in ((False, True), (True, False), (True, True)):
        rig = Rig(VirtualDmdOptions(acks_spoil=spoils))
        rig.client.configure([entry()])
        assert rig.client.load(0, make_image(words), acked=acked) == 0
        shown = np.array(rig.planes(1)[0])
        assert shown[:4].all() and shown[4:].all() is not np.bool_(spoils and acked)
        assert shown.all() == (not (spoils and acked))


def test_copies_fail_on_some_units() -> None:
    words = np.full((8, 16), 0xFFFFFF, np.uint32)
    rig = Rig(VirtualDmdOptions(copies=False))
    rig.client.configure([entry()])
    assert rig.client.load(0, make_image(words)) == 0
    shown = np.array(rig.planes(1)[0])
    assert shown[0].all() and not shown[1:].any()
    plain = b"".join(b"\x10\xff\xff\xff" for _ in range(8)) + b"\0\1\0"
    rig.client.run(STOP)
    assert rig.client.load(0, make_image(words, plain)) == 0
    assert np.array(rig.planes(1)[0]).all()


def test_two_controllers_have_a_half_each() -> None:
    model = VirtualDmdModel("small", 2, SIZE, 480, dual=True)
    rig = Rig(model=model)
    words = pack_words(PLANES[:3], PLANES_BY_TI)
    rig.client.configure(entries_of(3))
    assert rig.client.load(0, make_image(words[:, :8])) == 0
    assert rig.client.load(0, make_image(words[:, 8:]), half=1) == 0
    assert rig.planes(3) == PLANES[:3].astype(int).tolist()
    rig.client.run(STOP)
    assert rig.client.load(0, make_image(words)) == 6, "an image of both"


def test_models_by_size() -> None:
    assert choose_dmd_model((1920, 1080)) is DLP6500 and DLP6500.half_px == (1920, 1080)
    assert choose_dmd_model((2560, 1600)) is DLP9000 and DLP9000.half_px == (1280, 1600)
    assert choose_dmd_model((40, 30)).half_px == (40, 30)
    rig = Rig(model=DLP9000)
    assert rig.client.refuses(DEFINE, entry(image=17, bit=23)) == 0, "480 planes, but 18 images"


def test_another_order_of_entries_keeps_images() -> None:
    rig = Rig()
    rig.client.upload(PLANES[:3], entries_of(3), PLANES_BY_TI)
    rig.client.write(0x1A32, struct.pack("<HI4H", 4, 4, 2, 0, 0, 1))
    assert rig.client.read(CONFIGURE) == struct.pack("<HI", 4, 4)
    assert rig.planes(4) == PLANES[[2, 0, 0, 1]].astype(int).tolist()
    rig.client.run(STOP)
    assert rig.client.refuses(0x1A32, struct.pack("<HIH", 1, 1, 3)) == 15
    rig.client.configure(entries_of(3))
    assert rig.planes(3) == PLANES[:3].astype(int).tolist()


def test_texts_of_errors_are_written_over_those_before() -> None:
    client = Rig().client
    assert client.refuses(DEFINE, entry(exposure_us=50)) == 14
    assert client.error_text() == "an exposure of 50 us"
    assert client.refuses(DEFINE, entry(image=18)) == 17
    assert client.error_text() == "plane 0 of image 18"
    assert client.read(0x0101)[:22] == b"plane 0 of image 18\0\0\0"
