"""Files that somebody else wrote: what is read of them, and what is refused before it costs."""

from __future__ import annotations

import io
import random
import struct
import tracemalloc
import zipfile
import zlib
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.files.arrays import read_array
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from tests.hostile import files

LIMITS = ArrayLimits(1000)
GREY = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def png(pixels: Any) -> bytes:
    done, data = cv2.imencode(".png", pixels)
    assert done
    return data.tobytes()


def refused(data: bytes, limits: ArrayLimits = LIMITS) -> str:
    with pytest.raises(UnsoundFileError) as caught:
        read_array(data, "kernel", limits)
    assert caught.value.hint
    return caught.value.message


@pytest.mark.parametrize("dtype", ["f8", "f4", "f2", ">f8", ">i2", "u8", "i1", "?", "g"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_real_numbers_of_any_type_and_order_are_read(dtype: str, order: Any) -> None:
    array = np.array([[1, 0, 1], [0, 1, 1]], dtype=dtype, order=order)
    for data in (files.npy(array), npz(kernel=array, other=np.ones(2)), npz(only=array)):
        found = read_array(data, "kernel", LIMITS)
        assert found.dtype == np.float64 and found.flags.c_contiguous
        np.testing.assert_array_equal(found, array.astype(float))


@pytest.mark.parametrize("dtype", ["c16", "c8", "O", "S4", "U4", "V8", "M8[s]", "m8[s]", "f4,i4"])
def test_what_is_no_real_number_is_refused(dtype: str) -> None:
    assert "real numbers" in refused(files.npy(np.zeros((3, 4), dtype=dtype)))


def test_a_pickle_is_never_loaded() -> None:
    class Armed:
        def __reduce__(self) -> tuple[Any, ...]:
            return (pytest.fail, ("the pickle was loaded",))

    assert "object" in refused(files.npy(np.array([[Armed()]], dtype=object)))


@pytest.mark.parametrize(
    ("array", "what"),
    [
        (np.float64(1.0), "0 dimensions"),
        (np.ones(12), "1 dimensions"),
        (np.ones((3, 4, 1)), "3 dimensions"),
        (np.zeros((0, 4)), "holds no number"),
        (np.full((3, 4), np.nan), "12 values that are not finite, the first at (0, 0)"),
        (np.array([[0.0, -np.inf]]), "the first at (0, 1)"),
        (np.full((3, 4), np.longdouble("1e4000")), "not finite"),
        (np.ones((1, 1001)), "at most 1000 numbers"),
    ],
)
def test_shapes_and_values_that_mean_nothing_are_refused(array: Any, what: str) -> None:
    assert what in refused(files.npy(array))


@pytest.mark.parametrize("shape", files.SHAPES)
def test_a_shape_that_the_file_does_not_hold_costs_nothing(shape: tuple[int, ...]) -> None:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {files._text(shape)}, }}\n"
    data = files.raw_npy(text, bytes(40))
    tracemalloc.start()
    refused(data, ArrayLimits(2**30))
    assert tracemalloc.get_traced_memory()[1] < 2**21
    tracemalloc.stop()


@pytest.mark.parametrize("header", files.HEADERS)
@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_damaged_header_is_refused(header: str, version: int) -> None:
    refused(files.raw_npy(header + "\n", bytes(96), version))


def test_a_zip_bomb_is_refused_while_it_unpacks() -> None:
    data = files._bomb()
    tracemalloc.start()
    assert "more bytes follow" in refused_as("illumination", data)
    assert tracemalloc.get_traced_memory()[1] < 2**23
    tracemalloc.stop()


def refused_as(name: str, data: bytes) -> str:
    with pytest.raises(UnsoundFileError) as caught:
        read_array(data, name, LIMITS)
    return caught.value.message


def test_a_directory_of_thousands_is_refused_unread() -> None:
    assert "too many" in refused(files._crowd())
    few = npz(**{f"a{n}": np.ones((1, 1)) for n in range(65)})
    assert "65 arrays" in refused(few)


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_packings_that_cannot_be_bounded_are_refused(packing: int) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", packing) as archive:
        archive.writestr("kernel.npy", files.npy(np.ones((3, 3))))
    assert "packed or locked" in refused(stream.getvalue())


def test_a_directory_that_hides_behind_a_larger_one_is_refused() -> None:
    whole = npz(kernel=np.ones((3, 3)))
    locator = b"PK\x06\x07" + bytes(16)
    assert "larger kind" in refused(whole[:-22] + locator + whole[-22:])


def test_of_several_arrays_that_of_the_field_is_taken() -> None:
    data = npz(kernel=np.eye(3), other=np.ones((3, 3)))
    np.testing.assert_array_equal(read_array(data, "kernel", LIMITS), np.eye(3))
    assert "none of which is called warp" in refused_as("warp", data)


@pytest.mark.parametrize("bits", [8, 16])
def test_grey_values_are_shares_of_full_scale(bits: int) -> None:
    full = 2**bits - 1
    pixels = (np.linspace(0.0, 1.0, 12).reshape(3, 4) * full).astype(f"u{bits // 8}")
    found = read_array(png(pixels), "illumination", LIMITS)
    np.testing.assert_array_equal(found, pixels / full)


@pytest.mark.parametrize("channels", [3, 4])
def test_colours_become_grey(channels: int) -> None:
    pixels = np.repeat(GREY[..., None], channels, axis=2)
    np.testing.assert_allclose(read_array(png(pixels), "x", LIMITS), GREY / 255.0, atol=1 / 255)


def chunk(kind: bytes, body: bytes) -> bytes:
    return files._chunk(kind, body)


def made_png(
    width: int, height: int, pixels: bytes, *, depth: int = 8, interlace: int = 0
) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, interlace)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(pixels, 1)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def test_what_is_no_part_of_the_picture_is_left_out() -> None:
    data = png(GREY)
    extra = chunk(b"iCCP", b"\xff" * 50) + chunk(b"acTL", bytes(8)) + chunk(b"eXIf", b"MM\0*")
    found = read_array(data[:33] + extra + data[33:], "x", LIMITS)
    np.testing.assert_array_equal(found, GREY / 255.0)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "neither"),
        (b"\x89PNG\r\n\x1a\n", "ends too early"),
        (png(GREY)[:-20], "ends too early"),
        (png(GREY)[:40] + b"\0" + png(GREY)[41:], "checksum"),
        (made_png(2**31, 2**31, b""), "at most 1000 numbers"),
        (made_png(0, 4, b""), "holds no number"),
        (made_png(4, 3, bytes(10)), "its pixels take 15 bytes, 10"),
        (made_png(4, 3, bytes(10**6)), "its pixels take 15 bytes, 16"),
        (made_png(4, 3, bytes(15), interlace=1), "interlaced"),
        (made_png(4, 3, bytes(15), depth=3), "no such PNG"),
        (b"\xff\xd8\xff\xe0JFIF", "neither"),
        (b"II*\0", "neither"),
    ],
)
def test_unsound_pictures_are_refused(data: bytes, what: str) -> None:
    assert what in refused(data)


def test_a_picture_that_its_header_belittles_is_not_unpacked() -> None:
    data = made_png(4, 3, bytes(10**7))
    tracemalloc.start()
    assert "16 are there" in refused(data)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_whatever_the_bytes_are_an_array_or_a_refusal_comes_back() -> None:
    rng = random.Random(5)
    read = 0
    for _ in range(600):
        data = rng.choice([c for c in files.CONTENTS if c is not files.bomb])(rng, (3, 4))
        try:
            array = read_array(data, "illumination", LIMITS)
        except UnsoundFileError:
            continue
        assert array.ndim == 2 and array.dtype == np.float64 and np.isfinite(array).all()
        read += 1
    assert 50 < read < 500
