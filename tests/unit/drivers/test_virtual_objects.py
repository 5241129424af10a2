"""What can be read of the virtual camera's card, byte by byte, by a client of its own.

Layouts are those of PIMA 15740, and for Canon's own operations those that libgphoto2 parses.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from tests.virtual_eos import BULB, Client, virtual_usb

STORAGE, FOLDER = 0x20001, 0x3001
OK, BAD_HANDLE, BAD_STORAGE, BAD_PARAMETER, BAD_PROPERTY = 0x2001, 0x2009, 0x2008, 0x201D, 0x200A


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client(virtual_usb())
    client.start()
    client.set(*BULB)
    client.events()
    yield client
    client.close()


@pytest.fixture
def photo(client: Client) -> int:
    """A photo on the card; its handle."""
    client.ok(0x9125)
    client.wait(1.0)
    client.ok(0x9126)
    client.wait(0.2)
    ((handle, size, _),) = client.files()
    client.ok(0x9117, handle)
    assert size == 3000
    return handle


def u32s(data: bytes) -> list[int]:
    (count,) = struct.unpack_from("<I", data)
    assert len(data) == 4 + 4 * count
    return list(struct.unpack_from(f"<{count}I", data, 4))


def text(data: bytes, at: int = 0) -> tuple[str, int]:
    """A PTP string, and where it ends."""
    end = at + 1 + 2 * data[at]
    return data[at + 1 : end].decode("utf-16-le").rstrip("\0"), end


def test_there_is_one_card(client: Client) -> None:
    for code in (0x1004, 0x9101):
        assert u32s(client.ok(code)) == [STORAGE]
    for code in (0x1005, 0x9102):
        data = client.ok(code, STORAGE)
        kind, system, access, size_b, free_b, photos = struct.unpack_from("<HHHQQI", data)
        assert (kind, system, access) == (4, 3, 0)  # removable RAM, DCF, read and write
        assert size_b > free_b > 1 << 30 and photos == 0xFFFFFFFF
        assert text(data, 26) == ("SD", len(data) - 1)
        assert client.call(code, STORAGE + 1)[0] == BAD_STORAGE


def test_files_are_listed_by_folder_and_by_format(client: Client, photo: int) -> None:
    every = u32s(client.ok(0x1007, STORAGE, 0, 0))
    assert photo in every and len(every) == 3
    folders = u32s(client.ok(0x1007, STORAGE, FOLDER, 0))
    assert sorted([*folders, photo]) == sorted(every)
    assert u32s(client.ok(0x1007, STORAGE, 0xFFFFFFFF, 0)) == every
    raw = struct.unpack_from("<IH", client.ok(0x1008, photo))[1]
    assert u32s(client.ok(0x1007, STORAGE, raw, 0)) == [photo]
    assert u32s(client.ok(0x1007, STORAGE, 0x3802, 0)) == []
    (parent,) = struct.unpack_from("<I", client.ok(0x1008, photo), 38)
    assert parent in folders
    assert u32s(client.ok(0x1007, STORAGE, 0, parent)) == [photo]
    for parameters in ((STORAGE, 0, 0), (STORAGE, FOLDER, 0), (STORAGE, 0, parent)):
        count = len(u32s(client.ok(0x1007, *parameters)))
        assert client.call(0x1006, *parameters)[:2] == (OK, (count,))


def test_a_file_is_described_the_same_in_both_ways(client: Client, photo: int) -> None:
    data = client.ok(0x1008, photo)
    storage, kind, _, size_b = struct.unpack_from("<IHHI", data)
    (parent,) = struct.unpack_from("<I", data, 38)
    name, _ = text(data, 52)
    assert (storage, size_b) == (STORAGE, 3000) and name.endswith(".CR2")
    listed = client.ok(0x9109, STORAGE, parent, 0x200000)
    (count,) = struct.unpack_from("<I", listed)
    assert count == 1 and len(listed) == 4 + 56
    found = struct.unpack("<IIIHHIIIII16sI", listed[4:])
    assert found[:4] == (56, photo, STORAGE, kind)
    assert (found[7], found[8]) == (3000, parent)
    assert found[10].rstrip(b"\0").decode() == name
    assert client.call(0x1008, photo + 77)[0] == BAD_HANDLE
    assert client.ok(0x9109, STORAGE, photo + 77, 0x200000) == bytes(4)


@pytest.mark.parametrize(
    ("start", "size", "count"),
    [(0, 3000, 3000), (0, 1, 1), (10, 100, 100), (2999, 5, 1), (3000, 5, 0), (0, 9999, 3000)],
)
def test_a_file_is_read_in_pieces(
    client: Client, photo: int, start: int, size: int, count: int
) -> None:
    whole = client.ok(0x1009, photo)
    assert client.ok(0x9104, photo) == whole
    for code in (0x101B, 0x9107):
        response, parameters, piece = client.call(code, photo, start, size)
        assert (response, parameters) == (OK, (count,))
        assert piece == whole[start : start + count]


def test_what_is_not_there_is_not_read(client: Client, photo: int) -> None:
    for code in (0x1009, 0x9104, 0x101B, 0x9107):
        assert client.call(code, photo + 77, 0, 5)[0] == BAD_HANDLE
    for code in (0x101B, 0x9107):
        assert client.call(code, photo, 3001, 5)[0] == BAD_PARAMETER


def test_the_body_lists_its_events_and_settings_behind_their_length(client: Client) -> None:
    data = client.ok(0x9108)
    (length,) = struct.unpack_from("<I", data)
    assert length == len(data)
    at, lists = 4, []
    for _ in range(3):
        (count,) = struct.unpack_from("<I", data, at)
        lists.append(list(struct.unpack_from(f"<{count}I", data, at + 4)))
        at += 4 + 4 * count
    assert at == length
    events, settings, none = lists
    assert {0xC101, 0xC181, 0xC189} <= set(events) and 0 not in events
    assert settings == sorted(settings) and {0xD101, 0xD102, 0xD103} <= set(settings)
    assert none == []


def test_standard_properties_have_a_name_and_a_value(client: Client) -> None:
    for prop, said, writable in ((0xD402, "Canon EOS 450D", 0), (0xD406, "Unknown Initiator", 1)):
        data = client.ok(0x1014, prop)
        assert struct.unpack_from("<HHB", data) == (prop, 0xFFFF, writable)  # a string
        first, at = text(data, 5)
        second, end = text(data, at)
        assert (first, second, data[end:]) == (said, said, b"\0")
        assert text(client.ok(0x1015, prop)) == (said, len(client.ok(0x1015, prop)))
    assert struct.unpack("<HHBIIB", client.ok(0x1014, 0xD407)) == (0xD407, 6, 0, 1, 1, 0)
    assert client.ok(0x1015, 0xD407) == struct.pack("<I", 1)
    for code in (0x1014, 0x1015):
        assert client.call(code, 0x5001)[0] == BAD_PROPERTY
    assert client.ok(0x9801, 0x3000) == bytes(4)
