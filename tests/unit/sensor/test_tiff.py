"""Tags of files built on TIFF, byte by byte: both orders, every type, and where a file ends."""

from __future__ import annotations

import struct

import pytest

from pdcd.sensor.tiff import TiffTags, read_tags

Entry = tuple[int, int, int, bytes | int]
"""Tag, type, count, and the four bytes of a value or the place of a longer one."""
MODEL, EXIF, SUB, DATE_TAKEN, MASKED_AREAS = 272, 34665, 330, 36867, 50830
"""By TIFF 6.0, EXIF 2.3 and DNG 1.4."""
BYTE, ASCII, SHORT, LONG, RATIONAL, SBYTE, IFD = 1, 2, 3, 4, 5, 6, 13
ORDERS = pytest.mark.parametrize("order", ["<", ">"])


def head(order: str, first: int = 8) -> bytes:
    return (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", first)


def directory(order: str, *entries: Entry, after: int = 0) -> bytes:
    made = struct.pack(f"{order}H", len(entries))
    for tag, kind, count, value in entries:
        said = struct.pack(f"{order}I", value) if isinstance(value, int) else value.ljust(4, b"\0")
        made += struct.pack(f"{order}HHI", tag, kind, count) + said
    return made + struct.pack(f"{order}I", after)


def tags_of(data: bytes) -> TiffTags:
    found = read_tags(data)
    assert found is not None
    return found


@pytest.mark.parametrize("start", [b"", b"II", b"II*", b"II\0*", b"MM*\0", b"IM*\0", b"PK\3\4"])
def test_what_does_not_begin_like_tiff_has_no_tags(start: bytes) -> None:
    assert read_tags(start + bytes(20) if len(start) == 4 else start) is None


@ORDERS
def test_numbers_of_every_type(order: str) -> None:
    shorts, longs = struct.pack(f"{order}2H", 258, 3), struct.pack(f"{order}I", 70000)
    for kind, count, value, numbers in (
        (BYTE, 3, bytes([1, 2, 250]), (1, 2, 250)),
        (SHORT, 2, shorts, (258, 3)),
        (LONG, 1, longs, (70000,)),
        (IFD, 1, longs, (70000,)),
    ):
        tags = tags_of(head(order) + directory(order, (MASKED_AREAS, kind, count, value)))
        assert tags.numbers(MASKED_AREAS) == numbers and not tags.canon
        assert tags.text(MASKED_AREAS) == ""


@ORDERS
@pytest.mark.parametrize("kind", [SBYTE, 8, 9, 10, 11, 12, 99])
def test_types_that_no_kept_tag_has_are_left_out(order: str, kind: int) -> None:
    tags = tags_of(head(order) + directory(order, (MODEL, kind, 1, bytes(4))) + bytes(100))
    assert tags.directories == ({},)
    assert tags.numbers(MODEL) == () and tags.text(MODEL) == ""


@ORDERS
def test_values_of_more_than_four_bytes_lie_elsewhere(order: str) -> None:
    at = 8 + 2 + 2 * 12 + 4
    text, areas = b"Mk II \0rest", struct.pack(f"{order}4I", 1, 2, 3, 4)
    data = head(order) + directory(
        order, (MODEL, ASCII, len(text), at), (MASKED_AREAS, LONG, 4, at + len(text))
    )
    tags = tags_of(data + text + areas)
    assert tags.text(MODEL) == "Mk II"  # up to the first zero, without spaces around
    assert tags.numbers(MASKED_AREAS) == (1, 2, 3, 4)
    assert tags.needs_bytes == len(data) + len(text) + len(areas)
    cut = tags_of((data + text + areas)[:-1])  # the text is whole, the numbers are not
    assert cut.text(MODEL) == "Mk II" and cut.numbers(MASKED_AREAS) == ()
    assert cut.needs_bytes == tags.needs_bytes


@ORDERS
def test_four_bytes_are_the_value_and_five_a_place(order: str) -> None:
    tags = tags_of(head(order) + directory(order, (MODEL, ASCII, 4, b"abcd")))
    assert tags.text(MODEL) == "abcd" and tags.needs_bytes == 26
    tags = tags_of(head(order) + directory(order, (MODEL, ASCII, 5, 26)) + b"abcdeX")
    assert tags.text(MODEL) == "abcde" and tags.needs_bytes == 31


@ORDERS
def test_directories_are_found_by_chain_exif_and_sub(order: str) -> None:
    """The first that has a tag tells it, in the order in which they are read."""
    size = len(directory(order, (MODEL, ASCII, 2, b"a")))
    second, exif, sub, third = (8 + 2 + 3 * 12 + 4 + size * n for n in range(4))
    data = head(order) + directory(
        order, (MODEL, ASCII, 2, b"1"), (EXIF, LONG, 1, exif), (SUB, LONG, 1, sub), after=second
    )
    data += directory(order, (DATE_TAKEN, ASCII, 2, b"2"), after=third)
    data += directory(order, (DATE_TAKEN, ASCII, 2, b"E"))
    data += directory(order, (DATE_TAKEN, ASCII, 2, b"S"))
    data += directory(order, (MODEL, ASCII, 2, b"3"))
    tags = tags_of(data)
    dates = [found.get(DATE_TAKEN) for found in tags.directories]
    assert dates == [None, "E", "S", "2", None]
    assert tags.text(MODEL) == "1" and tags.text(DATE_TAKEN) == "E"
    assert tags.needs_bytes == len(data)


@ORDERS
def test_several_directories_under_one_tag(order: str) -> None:
    places = 8 + 2 + 12 + 4
    subs = places + 8
    size = len(directory(order, (MODEL, ASCII, 2, b"a")))
    data = head(order) + directory(order, (SUB, LONG, 2, places))
    data += struct.pack(f"{order}2I", subs, subs + size)
    data += directory(order, (MODEL, ASCII, 2, b"a")) + directory(order, (MODEL, ASCII, 2, b"b"))
    assert [found.get(MODEL) for found in tags_of(data).directories] == [None, "a", "b"]


def test_a_chain_that_bites_its_tail_ends() -> None:
    data = head("<") + directory("<", (EXIF, LONG, 1, 8), (MODEL, ASCII, 2, b"a"), after=8)
    assert len(tags_of(data).directories) == 1


def test_a_chain_is_followed_64_directories_far() -> None:
    size = len(directory("<"))
    data = head("<") + b"".join(directory("<", after=8 + size * (n + 1)) for n in range(70))
    assert len(tags_of(data).directories) == 64


def test_the_second_number_of_a_canon_file_leads_to_its_picture() -> None:
    first = directory("<", (MODEL, ASCII, 2, b"1"))
    second = directory("<", (273, LONG, 1, 1000), (279, LONG, 1, 234))
    begin = b"II*\0" + struct.pack("<I2sBBI", 16, b"CR", 2, 0, 16 + len(first))
    tags = tags_of(begin + first + second)
    assert tags.canon and tags.needs_bytes == 1234
    assert tags.directories == ({MODEL: "1"}, {273: (1000,), 279: (234,)})
    other = tags_of(begin.replace(b"CR", b"CS") + first + second)
    assert not other.canon and other.directories == ({MODEL: "1"},)


@ORDERS
@pytest.mark.parametrize(("places", "lengths"), [(273, 279), (324, 325), (513, 514)])
def test_a_file_needs_the_data_that_its_directories_speak_of(
    order: str, places: int, lengths: int
) -> None:
    data = head(order) + directory(order, (places, LONG, 1, 500), (lengths, LONG, 1, 41))
    assert tags_of(data).needs_bytes == 541
    behind = 8 + 2 + 24 + 4
    strips = struct.pack(f"{order}6I", 100, 900, 200, 50, 30, 60)
    data = head(order) + directory(
        order, (places, LONG, 3, behind), (lengths, LONG, 3, behind + 12)
    )
    assert tags_of(data + strips).needs_bytes == 930
    alone = head(order) + directory(order, (places, LONG, 1, 500))
    assert tags_of(alone).needs_bytes == len(alone)


@ORDERS
def test_a_tag_that_is_not_kept_counts_for_the_end(order: str) -> None:
    data = head(order) + directory(order, (700, BYTE, 100, 300))
    assert tags_of(data).needs_bytes == 400 and tags_of(data).directories == ({},)
    eights = [(5, 8), (12, 8), (10, 8), (4, 4), (9, 4), (11, 4), (13, 4), (3, 2), (8, 2), (1, 1),
              (2, 1), (6, 1), (7, 1), (99, 0)]  # fmt: skip
    for kind, size in eights:
        data = head(order) + directory(order, (700, kind, 10, 300))
        assert tags_of(data).needs_bytes == max(300 + 10 * size if size else 0, len(data))


@ORDERS
def test_a_directory_behind_the_end_needs_more_than_there_is(order: str) -> None:
    for first in (9, 10, 1000):
        data = head(order, first) + b"\0"
        assert tags_of(data).needs_bytes == len(data) + 1
        assert tags_of(data).directories == ({},)
    cut = head(order) + directory(order, (MODEL, ASCII, 2, b"a"))
    for length in range(10, len(cut)):
        tags = tags_of(cut[:length])
        assert tags.needs_bytes == len(cut) and tags.directories == ({},)
    assert tags_of(cut).text(MODEL) == "a"
    assert tags_of(cut).needs_bytes == len(cut)


def test_a_head_without_its_number_has_no_directory() -> None:
    assert tags_of(b"II*\0\x08\0\0") == TiffTags((), 8, canon=False)
