"""The virtual DLPC900: images, entries and the order of both, from other programs, too."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from drivers.virtual_dlpc900 import (
    PLANES_BY_OTHERS,
    PLANES_BY_TI,
    VirtualDmdModel,
    VirtualDmdOptions,
)
from tests.dmd_client import (
    BEGIN,
    CONFIGURE,
    DATA,
    DEFINE,
    MODE,
    RUN,
    STOP,
    encode_erle,
    make_image,
    pack_words,
)
from tests.virtual_dmd_rig import BLACK_IMAGE, SIZE, VirtualDmdRig, entry

PLANES = np.random.default_rng(3).random((50, 8, 16)) < 0.5


def entries_of(count: int, **changes: int) -> list[bytes]:
    return [entry(index=n, image=n // 24, bit=n % 24, **changes) for n in range(count)]


@pytest.mark.parametrize("order", [PLANES_BY_TI, PLANES_BY_OTHERS, (0, 1, 2)])
def test_every_plane_is_shown_where_the_order_of_bytes_is_right(
    order: tuple[int, int, int],
) -> None:
    rig = VirtualDmdRig(VirtualDmdOptions(plane_bytes=order))
    rig.client.upload(PLANES, entries_of(50), order)
    assert rig.planes(50) == PLANES.astype(int).tolist()


def test_the_wrong_order_of_bytes_shows_other_planes() -> None:
    rig = VirtualDmdRig(VirtualDmdOptions(plane_bytes=PLANES_BY_OTHERS))
    rig.client.upload(PLANES[:24], entries_of(24), PLANES_BY_TI)
    exchanged = [*range(8, 16), *range(8), *range(16, 24)]
    assert rig.planes(24) == PLANES[exchanged].astype(int).tolist()


def test_planes_by_hand() -> None:
    """Plane 0 is the lowest bit of the second byte by TI, of the third by others."""
    for order, word in ((PLANES_BY_TI, 0x000100), (PLANES_BY_OTHERS, 0x000001)):
        rig = VirtualDmdRig(VirtualDmdOptions(plane_bytes=order))
        rig.client.configure([entry(bit=0), entry(index=1, bit=16)])
        words = np.full((8, 16), word, np.uint32)
        assert rig.client.load(0, make_image(words)) == 0
        assert rig.planes(2) == [np.ones((8, 16)).tolist(), np.zeros((8, 16)).tolist()]


def test_a_program_that_asks_for_every_reply_and_looks_for_errors_after_each() -> None:
    """As one much used program does: stop, mode, entries, configuration, images from the last on;
    ends of lines, sizes with the header, a last piece that may be empty."""
    rig = VirtualDmdRig(VirtualDmdOptions(plane_bytes=PLANES_BY_OTHERS), begun=False)
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
    rig = VirtualDmdRig()
    rig.client.configure([entry(bit=16)])
    assert rig.client.load(0, image) == refused
    startup = rig.device.memory.startup
    shown = np.array(rig.planes(1)[0])
    if refused == 255 and image[-1]:
        assert shown[0].all() and not shown[1:].any(), "its beginning is there all the same"
    elif refused != 255:
        assert np.array_equal(shown, startup.words & 1), "nothing was loaded"


def test_images_come_from_the_last_one_on() -> None:
    client = VirtualDmdRig().client
    client.configure(entries_of(50))
    for index in (2, 1):
        assert client.load(index, BLACK_IMAGE) == 0
    assert client.refuses(BEGIN, struct.pack("<HI", 2, 1000)) == 17
    assert client.load(1, BLACK_IMAGE) == 0, "the same once more"
    client.configure(entries_of(50))
    assert client.load(2, BLACK_IMAGE) == 0, "anew after a configuration"
    client = VirtualDmdRig(VirtualDmdOptions(any_order=True)).client
    client.configure(entries_of(50))
    for index in (0, 1, 2):
        assert client.load(index, BLACK_IMAGE) == 0


def test_other_entries_need_their_images_again() -> None:
    """By the guide. A unit that keeps them is an option."""
    for keeps, shown in ((False, PLANES[0]), (True, PLANES[5])):
        rig = VirtualDmdRig(VirtualDmdOptions(keeps_images=keeps))
        rig.client.upload(PLANES[:24], [entry(bit=0), entry(index=1, bit=1)], PLANES_BY_TI)
        rig.client.configure([entry(bit=5), entry(index=1, bit=1)])
        assert rig.planes(2) == [shown.astype(int).tolist(), PLANES[1].astype(int).tolist()]
        rig.client.run(STOP)
        image = make_image(pack_words(PLANES[:24], PLANES_BY_TI))
        assert rig.client.load(0, image) == 0
        assert rig.planes(1) == [PLANES[5].astype(int).tolist()]


def test_replies_to_data_spoil_the_images_of_some_units() -> None:
    words = np.full((8, 16), 0xFFFFFF, np.uint32)
    for spoils, acked in ((False, True), (True, False), (True, True)):
        rig = VirtualDmdRig(VirtualDmdOptions(acks_spoil=spoils))
        rig.client.configure([entry()])
        assert rig.client.load(0, make_image(words), acked=acked) == 0
        shown = np.array(rig.planes(1)[0])
        assert shown[:4].all() and shown[4:].all() is not np.bool_(spoils and acked)
        assert shown.all() == (not (spoils and acked))


def test_copies_fail_on_some_units() -> None:
    words = np.full((8, 16), 0xFFFFFF, np.uint32)
    rig = VirtualDmdRig(VirtualDmdOptions(copies=False))
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
    rig = VirtualDmdRig(model=model)
    words = pack_words(PLANES[:3], PLANES_BY_TI)
    rig.client.configure(entries_of(3))
    assert rig.client.load(0, make_image(words[:, :8])) == 0
    assert rig.client.load(0, make_image(words[:, 8:]), half=1) == 0
    assert rig.planes(3) == PLANES[:3].astype(int).tolist()
    rig.client.run(STOP)
    assert rig.client.load(0, make_image(words)) == 6, "an image of both"


def test_another_order_of_entries_keeps_images() -> None:
    rig = VirtualDmdRig()
    rig.client.upload(PLANES[:3], entries_of(3), PLANES_BY_TI)
    rig.client.write(0x1A32, struct.pack("<HI4H", 4, 4, 2, 0, 0, 1))
    assert rig.client.read(CONFIGURE) == struct.pack("<HI", 4, 4)
    assert rig.planes(4) == PLANES[[2, 0, 0, 1]].astype(int).tolist()
    rig.client.run(STOP)
    assert rig.client.refuses(0x1A32, struct.pack("<HIH", 1, 1, 3)) == 15
    rig.client.configure(entries_of(3))
    assert rig.planes(3) == PLANES[:3].astype(int).tolist()
