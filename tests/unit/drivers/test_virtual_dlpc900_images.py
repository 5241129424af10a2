"""Images of the virtual DLPC900: streams by hand, what is wrong with others, and whole pictures."""

from __future__ import annotations

import itertools
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.virtual_dlpc900 import BadHeaderError, decode_image
from tests.dmd_client import Words, count_bytes, encode_erle, make_header, make_image, word_bytes

A, B = 0x112233, 0xC0FFEE
PIXEL_A, PIXEL_B = b"\x11\x22\x33", b"\xc0\xff\xee"


def decoded(
    stream: bytes, width: int, height: int, compression: int = 2, copies: bool = True
) -> tuple[list[list[int]], str]:
    data = make_header(width, height, len(stream), compression) + stream
    image = decode_image(data, (width, height), copies)
    return image.words.tolist(), image.fault


def encode_rle(words: Words) -> bytes:
    """Counts of one byte, and each line filled up to four bytes after its end."""
    found = bytearray()
    for line in words:
        for word, run in itertools.groupby(line.tolist()):
            left = len(list(run))
            while left:
                found += bytes([min(left, 255)]) + word_bytes(word)
                left -= min(left, 255)
        found += b"\0\0"
        found += bytes(-len(found) % 4)
    return bytes(found + b"\0\1")


# The streams of the reference, and what they are


def test_the_streams_of_the_reference() -> None:
    black = bytes.fromhex("14000000000114000114000100")
    assert decoded(black, 20, 3) == ([[0] * 20] * 3, "")
    cells = bytes.fromhex(
        "05cfbec20515ed1a052defd3053c9f9d000114000114052e6dec05cd205205de860705950892"
        "000114000114000100"
    )
    above = np.repeat([13614786, 1436954, 3010515, 3973021], 5).tolist()
    below = np.repeat([3042796, 13443154, 14583303, 9767058], 5).tolist()
    assert decoded(cells, 20, 6) == ([above] * 3 + [below] * 3, "")
    runs = bytes.fromhex("96010000009601ffffff0001ac02000100")
    assert decoded(runs, 300, 2) == ([[0] * 150 + [0xFFFFFF] * 150] * 2, "")


@pytest.mark.parametrize(
    ("stream", "lines"),
    [
        (b"\3" + PIXEL_A + b"\0\1\0", [[A, A, A]]),
        (b"\1" + PIXEL_A + b"\2" + PIXEL_B + b"\0\1\0", [[A, B, B]]),
        (b"\0\3" + PIXEL_A + PIXEL_B + PIXEL_A + b"\0\1\0", [[A, B, A]]),
        (b"\3" + PIXEL_A + b"\0\1\3\0\1\0", [[A, A, A]] * 2),
        (b"\3" + PIXEL_A + b"\1" + PIXEL_B + b"\0\1\2\0\1\0", [[A, A, A], [B, A, A]]),
        # ends of lines: after a full one, in one that is not full, of an empty one
        (b"\3" + PIXEL_A + b"\0\0\3" + PIXEL_B + b"\0\0\0\1\0", [[A] * 3, [B] * 3]),
        (b"\1" + PIXEL_A + b"\0\0\3" + PIXEL_B + b"\0\1\0", [[A, 0, 0], [B] * 3]),
        (b"\3" + PIXEL_A + b"\0\0\0\0\3" + PIXEL_B + b"\0\1\0", [[A] * 3, [0] * 3, [B] * 3]),
        # what fills up the last four bytes
        (b"\3" + PIXEL_A + b"\0\1\0\0", [[A, A, A]]),
    ],
)
def test_each_control_byte(stream: bytes, lines: list[list[int]]) -> None:
    assert decoded(stream, 3, len(lines)) == (lines, "")


@pytest.mark.parametrize("count", [1, 2, 127, 128, 129, 255, 256, 300, 1920, 2560])
def test_counts_of_one_byte_and_of_two(count: int) -> None:
    low, high = count % 128, count // 128
    of_count = bytes([count]) if count < 128 else bytes([128 + low, high])
    assert of_count == count_bytes(count)
    run = of_count + PIXEL_A + b"\0\1" + of_count + b"\0\1\0"
    assert decoded(run, count, 2) == ([[A] * count] * 2, "")
    if count > 1:
        plain = b"\0" + of_count + PIXEL_B * count + b"\0\1\0"
        assert decoded(plain, count, 1) == ([[B] * count], "")


@pytest.mark.parametrize(
    ("stream", "lines", "fault"),
    [
        (b"\2" + PIXEL_A + b"\2" + PIXEL_B + b"\0\1\0", [[A, A, 0], [0] * 3], "line 0 is longer"),
        (b"\4" + PIXEL_A + b"\2" + PIXEL_B + b"\0\1\0", [[0] * 3] * 2, "line 0 is longer"),
        (b"\0\4" + PIXEL_A * 4 + b"\0\1\0", [[0] * 3] * 2, "line 0 is longer"),
        (b"\3" + PIXEL_A + b"\0\1\4\0\1\0", [[A] * 3, [0] * 3], "line 1 is longer"),
        (b"\0\1\3\0\1\0", [[0] * 3] * 2, "no line above"),
        (b"\3" + PIXEL_A + b"\0\1\0", [[A] * 3, [0] * 3], "ends in line 0 of 2"),
        (b"\3" + PIXEL_A + b"\2" + PIXEL_B + b"\0\1\0", [[A] * 3, [B, B, 0]], "ends in line 1"),
        ((b"\3" + PIXEL_A) * 3 + b"\0\1\0", [[A] * 3] * 2, "more than 2 lines"),
        ((b"\3" + PIXEL_A + b"\0\0") * 3 + b"\0\1\0", [[A] * 3] * 2, "more than 2 lines"),
        ((b"\3" + PIXEL_A) * 2, [[A] * 3] * 2, "ends before the image"),
        ((b"\3" + PIXEL_A) * 2 + b"\0\1", [[A] * 3] * 2, "ends before the image"),
        (b"\3" + PIXEL_A + b"\3" + PIXEL_B[:2], [[A] * 3, [0] * 3], "ends before the image"),
        (b"\3" + PIXEL_A + b"\0\3" + PIXEL_B * 2, [[A] * 3, [0] * 3], "ends before the image"),
        (b"\x83", [[0] * 3] * 2, "ends before the image"),
    ],
)
def test_what_is_wrong_is_told_and_what_came_before_is_kept(
    stream: bytes, lines: list[list[int]], fault: str
) -> None:
    words, found = decoded(stream, 3, 2)
    assert words == lines and fault in found


def test_a_unit_that_cannot_copy_leaves_such_pixels_black() -> None:
    stream = b"\3" + PIXEL_A + b"\0\1\3\0\1\0"
    assert decoded(stream, 3, 2, copies=False) == ([[A] * 3, [0] * 3], "")


def test_pixels_without_compression() -> None:
    pixels = (PIXEL_A + PIXEL_B) * 3
    assert decoded(pixels, 3, 2, 0) == ([[A, B, A], [B, A, B]], "")
    assert decoded(pixels + b"\0", 3, 2, 0) == ([[A, B, A], [B, A, B]], "")
    assert decoded(pixels[:-3], 3, 2, 0) == ([[A, B, A], [B, A, 0]], "15 bytes of 18")
    assert "22 bytes of 18" in decoded(pixels + bytes(4), 3, 2, 0)[1]


def test_lines_of_rle_begin_at_fours() -> None:
    # 2 + 1 pixels are 8 bytes, the end of the line 2 more: two to be filled up.
    line = b"\2" + PIXEL_A + b"\1" + PIXEL_B + b"\0\0"
    assert decoded(line + b"\xee\xee" + line + b"\xee\xee\0\1", 3, 2, 1) == ([[A, A, B]] * 2, "")
    assert "longer" in decoded(line + line + b"\0\1", 3, 2, 1)[1], "what is not filled up is wrong"
    # A count of 200 is one byte; 0 1 is the end, whatever follows.
    long = b"\xc8" + PIXEL_A + b"\0\0\0\0\0\1"
    assert decoded(long, 200, 1, 1) == ([[A] * 200], "")
    assert decoded(b"\0\3" + PIXEL_A * 3 + b"\0\0" + bytes(3) + b"\0\1", 3, 1, 1) == ([[A] * 3], "")


@pytest.mark.parametrize(
    ("change", "compression"),
    [
        ({0: ord("s")}, False),
        ({4: 21}, False),
        ({6: 4}, False),
        ({8: 9}, False),
        ({8: 14 + 48}, False),
        ({25: 3}, True),
    ],
)
def test_headers_that_are_refused(change: dict[int, int], compression: bool) -> None:
    data = bytearray(make_image(np.zeros((3, 20), np.uint32)))
    assert data[8] == 13, "bytes of the stream"
    for place, value in change.items():
        data[place] = value
    with pytest.raises(BadHeaderError) as caught:
        decode_image(bytes(data), (20, 3))
    assert caught.value.compression is compression
    with pytest.raises(BadHeaderError):
        decode_image(bytes(data[:47]), (20, 3))


@pytest.mark.parametrize("counted", [13, 13 + 48, 13 + 48 + 3])
def test_the_count_of_bytes_may_be_with_the_header_and_with_what_fills_up(counted: int) -> None:
    stream = encode_erle(np.zeros((3, 20), np.uint32))
    data = make_header(20, 3, counted, 2) + stream + bytes(3)
    # Others have a zero where the kind of pixels is told, and at its end.
    data = data[:24] + b"\0\2\1" + bytes(21) + data[48:]
    assert struct.unpack_from("<I", data, 8) == (counted,)
    assert decode_image(data, (20, 3)).fault == ""


COLOURS = np.array([0, A, B, 0xFFFFFF], np.uint32)
pictures = st.integers(1, 5).flatmap(
    lambda height: st.binary(min_size=9 * height, max_size=9 * height)
)


@given(pictures, st.integers(1, 60), st.booleans())
def test_pictures_come_back(pixels: bytes, scale: int, line_ends: bool) -> None:
    lines = COLOURS[np.frombuffer(pixels, np.uint8).reshape(-1, 9) % 4]
    words = np.repeat(lines, scale, axis=1)
    size = words.shape[1], words.shape[0]
    image = decode_image(make_image(words, encode_erle(words, line_ends)), size)
    assert image.fault == "" and np.array_equal(image.words, words)
    image = decode_image(make_image(words, encode_rle(words), 1), size)
    assert image.fault == "" and np.array_equal(image.words, words)
    plain = b"".join(word_bytes(word) for word in words.ravel().tolist())
    image = decode_image(make_image(words, plain, 0), size)
    assert image.fault == "" and np.array_equal(image.words, words)


@given(st.binary(max_size=60), st.sampled_from([0, 1, 2]))
def test_nonsense_is_a_picture_all_the_same(stream: bytes, compression: int) -> None:
    data = make_header(5, 4, len(stream), compression) + stream
    image = decode_image(data, (5, 4))
    assert image.words.shape == (4, 5) and (image.words < 2**24).all()
