"""PNG files that somebody else wrote: grey values of sound ones, refusals before they cost."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.files.arrays import PNG_MAGIC, read_array
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from tests.hostile.files import _chunk as chunk

LIMITS = ArrayLimits(1000)
GREY = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20


def refused(data: bytes, limits: ArrayLimits = LIMITS) -> str:
    with pytest.raises(UnsoundFileError) as caught:
        read_array(data, "kernel", limits)
    assert caught.value.hint
    return caught.value.message


def png(pixels: Any) -> bytes:
    done, data = cv2.imencode(".png", pixels)
    assert done
    return data.tobytes()


def made_png(
    width: int, height: int, depth: int, colour: int = 0, *, pixels: bytes | None = None,
    packing: int = 0, filters: int = 0, interlace: int = 0, head: bytes = b"",
    packed: bytes | None = None,
) -> bytes:  # fmt: skip
    """A black picture, or one of given bytes with a filter byte before each row."""
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 1)
    row = 1 + -(-width * samples * depth // 8)
    if packed is None:
        packed = zlib.compress(bytes(row * height) if pixels is None else pixels, 1)
    sides = struct.pack(">II", width, height)
    head = head or sides + bytes((depth, colour, packing, filters, interlace))
    palette = chunk(b"PLTE", bytes(range(12))) if colour == 3 else b""
    return PNG_MAGIC + chunk(b"IHDR", head) + palette + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("colour", "depths"),
    [(0, (1, 2, 4, 8, 16)), (2, (8, 16)), (3, (1, 2, 4, 8)), (4, (8, 16)), (6, (8, 16))],
)
@pytest.mark.parametrize("width", [1, 4, 7, 8, 9])
def test_pictures_of_every_kind_are_read(colour: int, depths: tuple[int, ...], width: int) -> None:
    for depth in depths:
        assert read_array(made_png(width, 2, depth, colour), "x", LIMITS).shape == (2, width)


@pytest.mark.parametrize("bits", [8, 16])
def test_grey_values_are_shares_of_full_scale(bits: int) -> None:
    full = 2**bits - 1
    pixels = (np.linspace(0.0, 1.0, 12).reshape(3, 4) * full).astype(f"u{bits // 8}")
    found = read_array(png(pixels), "illumination", LIMITS)
    np.testing.assert_array_equal(found, pixels / full)


def test_grey_of_few_bits_is_a_share_of_full_scale() -> None:
    found = read_array(made_png(9, 1, 1, pixels=b"\0\xaa\x80"), "x", LIMITS)
    assert found.tolist() == [[1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0]]


@pytest.mark.parametrize("channels", [3, 4])
def test_colours_become_grey(channels: int) -> None:
    pixels = np.repeat(GREY[..., None], channels, axis=2)
    np.testing.assert_allclose(read_array(png(pixels), "x", LIMITS), GREY / 255.0, atol=1 / 255)


def test_what_is_no_part_of_the_picture_is_left_out() -> None:
    data = png(GREY)
    extra = chunk(b"iCCP", b"\xff" * 50) + chunk(b"acTL", bytes(8)) + chunk(b"eXIf", b"MM\0*")
    found = read_array(data[:33] + extra + data[33:] + b"anything", "x", LIMITS)
    np.testing.assert_array_equal(found, GREY / 255.0)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (made_png(2, 2, 8, 1), "no such PNG"),
        (made_png(2, 2, 8, 5), "no such PNG"),
        (made_png(2, 2, 3), "no such PNG"),
        (made_png(2, 2, 8, packing=1), "no such PNG"),
        (made_png(2, 2, 8, filters=1), "no such PNG"),
        (made_png(2, 2, 8, interlace=1), "interlaced"),
        (made_png(2, 2, 8, head=bytes(12)), "begins otherwise"),
        (made_png(2, 2, 8, head=bytes(14)), "begins otherwise"),
        (PNG_MAGIC + chunk(b"IEND", b""), "begins otherwise"),
        (PNG_MAGIC + chunk(b"tEXt", b"") + chunk(b"IEND", b""), "begins otherwise"),
        (made_png(2, 2, 8, packed=b"none"), "it is damaged: Error"),
        (made_png(2, 2, 8, packed=b""), "its pixels take 6 bytes, 0"),
        (made_png(4, 3, 8, pixels=bytes(10)), "its pixels take 15 bytes, 10"),
        (made_png(4, 3, 8, pixels=bytes(10**6)), "its pixels take 15 bytes, 16"),
        (made_png(2, 2, 8, pixels=b"\x07" * 6), "damaged"),
        (made_png(1001, 1, 8), "1 x 1001; at most 1000"),
        (made_png(2**31, 2**31, 8, pixels=b""), "at most 1000 numbers"),
        (made_png(0, 4, 8), "holds no number"),
        (PNG_MAGIC, "ends too early"),
        (made_png(2, 2, 8)[:-1], "ends too early"),
        (made_png(2, 2, 8)[:-12], "ends too early"),
        (made_png(2, 2, 8)[:-5], "ends too early"),
        (made_png(2, 2, 8)[:-1] + b"x", "a checksum is wrong"),
        (png(GREY)[:40] + b"\0" + png(GREY)[41:], "a checksum is wrong"),
        (b"\xff\xd8\xff\xe0JFIF", "neither"),
        (b"II*\0", "neither"),
        (b"", "neither"),
    ],
)
def test_pictures_that_are_none_are_refused(data: bytes, what: str) -> None:
    assert what in refused(data)


def test_no_picture_is_larger_than_any_camera_makes() -> None:
    data = made_png(2**12, 2**12, 8, packed=b"")
    assert "its pixels take" in refused(data, ArrayLimits(2**30))
    data = made_png(2**13, 2**12, 8, packed=b"")
    assert "4096 x 8192; at most 16777216 numbers" in refused(data, ArrayLimits(2**30))


def test_a_picture_that_its_header_belittles_is_not_unpacked() -> None:
    data = made_png(4, 3, 8, pixels=bytes(10**7))
    tracemalloc.start()
    assert "16 are there" in refused(data)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_a_decoder_that_gives_up_is_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> None:
        raise cv2.error("broken")

    monkeypatch.setattr(cv2, "imdecode", fails)
    assert "cannot be decoded" in refused(made_png(2, 2, 8))
