"""Where samples lie in a DNG, and tags of two places that tell of one thing."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.sensor import mosaic
from pdcd.sensor.raw import read_raw
from pdcd.sensor.tiff import read_tags
from tests.form_dng import LONG, RATIONAL, SHORT, UNDEFINED, DngFile, Tag, write_dng_form

SHAPE = 64, 72
BLACK = 256.0
IMAGE = np.random.default_rng(3).integers(300, 4000, SHAPE)
OTHER = np.random.default_rng(4).integers(300, 4000, SHAPE)
STRIPS = DngFile(strip_rows=8)
JPEG = DngFile(packing=7, white=16383)
ORDERS = pytest.mark.parametrize("order", ["<", ">"])
BITS = pytest.mark.parametrize("bits", [12, 14, 16])


def planes(samples: NDArray[np.int64]) -> NDArray[np.float64]:
    """R, G1, G2, B above one black."""
    return np.stack([samples[row::2, column::2] - BLACK for row in (0, 1) for column in (0, 1)])


def list_places(data: bytes) -> list[int]:
    tags = read_tags(data)
    assert tags is not None
    return list(tags.numbers(273))


@ORDERS
@BITS
def test_strips_are_read_from_where_they_lie(tmp_path: Path, bits: int, order: str) -> None:
    """In another order, or with something between them, also after a photo of the same form; LibRaw
    takes them one behind another."""
    path, file = tmp_path / "a.dng", replace(STRIPS, bits=bits, order=order)
    places = list_places(write_dng_form(path, IMAGE, file))
    np.testing.assert_array_equal(read_raw(path).planes, planes(IMAGE))
    turned = [places[n] for n in (3, 1, 0, 2, 7, 6, 5, 4)]
    stored = np.empty_like(IMAGE)
    for number, place in enumerate(turned):
        row = 8 * places.index(place)
        stored[row : row + 8] = IMAGE[8 * number : 8 * number + 8]
    write_dng_form(path, stored, replace(file, more={273: (LONG, turned)}))
    frame = read_raw(path)
    np.testing.assert_array_equal(frame.planes, planes(IMAGE))
    assert (frame.f_number, frame.doubts) == (2.8, ())

    apart = np.full((80, SHAPE[1]), 3000)
    for row in range(0, 64, 8):
        apart[row // 8 * 10 : row // 8 * 10 + 8] = IMAGE[row : row + 8]
    more: dict[int, Tag] = {257: (LONG, [64]), 278: (LONG, [8])}
    write_dng_form(path, apart, replace(file, strip_rows=10, more=more))
    np.testing.assert_array_equal(read_raw(path).planes, planes(IMAGE))


@pytest.mark.parametrize("file", [STRIPS, replace(JPEG, tile=(16, 32))])
def test_a_part_that_lies_over_another_one_is_refused(tmp_path: Path, file: DngFile) -> None:
    """One of them is not in the file."""
    path, offsets, sizes = tmp_path / "a.dng", *((324, 325) if file.tile else (273, 279))
    tags = read_tags(write_dng_form(path, IMAGE, file))
    assert tags is not None
    more: dict[int, Tag] = {}
    for tag in (offsets, sizes):
        numbers = list(tags.numbers(tag))
        numbers[5] = numbers[4]
        more[tag] = LONG, numbers
    write_dng_form(path, IMAGE, replace(file, more=more))
    with pytest.raises(DecodeError, match="lie over each other"):
        read_raw(path)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({258: (SHORT, [12])}, (9216, 6912)),
        ({258: (SHORT, [14])}, (9216, 8064)),
        ({256: (LONG, [70])}, (9216, 8960)),
    ],
)
def test_more_bytes_than_the_samples_take_are_told(
    tmp_path: Path, more: dict[int, Tag], told: tuple[int, int]
) -> None:
    """Samples of 16 bits that are called narrower, and rows with something behind them."""
    write_dng_form(tmp_path / "a.dng", IMAGE, DngFile(more=more, white=65535))
    said = read_raw(tmp_path / "a.dng").doubts
    assert "part 1 of 1 has {} bytes, its samples take {}".format(*told) in said[0]


def test_samples_of_which_no_width_is_told_have_one_bit(tmp_path: Path) -> None:
    """As TIFF has it; nobody's guess is believed."""
    data = write_dng_form(tmp_path / "a.dng", IMAGE, DngFile())
    place = data.index(struct.pack("<HHI", 258, 3, 1))
    (tmp_path / "a.dng").write_bytes(data[:place] + b"\3\1\xff" + data[place + 3 :])
    with pytest.raises(DecodeError, match="1-bit samples"):
        read_raw(tmp_path / "a.dng")


def test_bytes_that_fill_up_a_strip_are_no_rows(tmp_path: Path) -> None:
    write_dng_form(tmp_path / "a.dng", IMAGE, DngFile(more={279: (LONG, [64 * 72 * 2 - 72])}))
    with pytest.raises(DecodeError, match="9144 bytes, 9216 are needed"):
        read_raw(tmp_path / "a.dng")
    stored = np.vstack([IMAGE, IMAGE[:1]])
    more: dict[int, Tag] = {257: (LONG, [64]), 278: (LONG, [64]), 279: (LONG, [64 * 72 * 2 + 63])}
    write_dng_form(tmp_path / "a.dng", stored, DngFile(strip_rows=65, more=more))
    frame = read_raw(tmp_path / "a.dng")
    assert frame.doubts == () and np.array_equal(frame.planes, planes(IMAGE))


def test_rows_of_a_lossless_jpeg_are_as_wide_as_their_place(tmp_path: Path) -> None:
    """Wider ones would be laid one behind another, all askew; more of them are left out."""
    for tag, fits in ((256, False), (257, True)):
        stored = np.pad(IMAGE, ((0, 2), (0, 0)) if fits else ((0, 0), (0, 2)), mode="edge")
        more: dict[int, Tag] = {tag: (LONG, [SHAPE[0] if fits else SHAPE[1]])}
        write_dng_form(tmp_path / "a.dng", stored, replace(JPEG, more=more))
        if fits:
            np.testing.assert_array_equal(read_raw(tmp_path / "a.dng").planes, planes(IMAGE))
            continue
        with pytest.raises(DecodeError, match="rows of 74 samples, not 72"):
            read_raw(tmp_path / "a.dng")


def write_two(path: Path, file: DngFile, kinds: tuple[int, int], subfile: int) -> None:
    """Two images of one size in two directories: of these kinds of pixels, and the second one of
    that kind of file."""
    stored = np.vstack([IMAGE, OTHER])
    halves: dict[int, Tag] = {257: (LONG, [64]), 278: (LONG, [64])}
    if file.packing == 7:  # the second one is made apart
        second = write_dng_form(path, OTHER, file)
        (place,) = list_places(second)
        data = bytearray(write_dng_form(path, IMAGE, file))
        there, behind = len(data), second[place:]
    else:
        data = bytearray(write_dng_form(path, stored, replace(file, more=halves)))
        there, behind = list_places(bytes(data))[0] + 64 * 72 * file.bits // 8, b""
    data += behind
    data += bytes(len(data) % 2)
    (count,) = struct.unpack_from(file.order + "H", data, 8)
    size = 2 + 12 * count + 4
    struct.pack_into(file.order + "I", data, 8 + size - 4, len(data))
    data += data[8 : 8 + size]
    for at, kind, kept in ((8, kinds[0], None), (len(data) - size, kinds[1], there)):
        struct.pack_into(file.order + "I", data, at + size - 4, 0 if kept else len(data) - size)
        for entry in range(at + 2, at + size - 4, 12):
            (tag,) = struct.unpack_from(file.order + "H", data, entry)
            if tag == 262:
                struct.pack_into(file.order + "H", data, entry + 8, kind)
            if tag == 254:
                struct.pack_into(file.order + "I", data, entry + 8, subfile if kept else 0)
            if tag == 273 and kept:
                struct.pack_into(file.order + "I", data, entry + 8, kept)
            if tag == 279 and file.packing == 7:
                held = len(behind) if kept else there - list_places(bytes(data))[0]
                struct.pack_into(file.order + "I", data, entry + 8, held)
            elif tag == 279:
                struct.pack_into(file.order + "I", data, entry + 8, 64 * 72 * file.bits // 8)
    path.write_bytes(bytes(data))


@ORDERS
@pytest.mark.parametrize("file", [DngFile(), DngFile(bits=12), JPEG], ids=["16", "12", "JPEG"])
@pytest.mark.parametrize("kinds", [(32803, 32803), (34892, 32803), (32803, 34892)])
def test_nobody_can_tell_which_of_two_images_is_the_photo(
    tmp_path: Path, kinds: tuple[int, int], file: DngFile, order: str
) -> None:
    """Of a plane of grey before the mosaic LibRaw gives the plane."""
    write_two(tmp_path / "a.dng", replace(file, order=order), kinds, 0)
    with pytest.raises(DecodeError, match="several full-size images"):
        read_raw(tmp_path / "a.dng")


@ORDERS
@pytest.mark.parametrize("file", [DngFile(), DngFile(bits=12), JPEG], ids=["16", "12", "JPEG"])
@pytest.mark.parametrize("subfile", [1, 16])
def test_a_preview_that_is_as_large_is_none(
    tmp_path: Path, file: DngFile, order: str, subfile: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mosaic, "_proven", {})
    write_two(tmp_path / "a.dng", replace(file, order=order), (32803, 32803), subfile)
    np.testing.assert_array_equal(read_raw(tmp_path / "a.dng").planes, planes(IMAGE))


@ORDERS
def test_levels_keep_the_pattern_of_their_own_directory(tmp_path: Path, order: str) -> None:
    """Some writers put both into the first one, and the mosaic below it."""
    file = DngFile(order=order, black=((200.0, 210.0), (220.0, 230.0)))
    data = bytearray(write_dng_form(tmp_path / "a.dng", IMAGE, file))
    (count,) = struct.unpack_from(order + "H", data, 8)
    size = 2 + 12 * count + 4
    below = len(data)
    data += data[8 : 8 + size]
    for at, moved in ((8, (254, 262)), (below, (50713, 50714))):
        for entry in range(at + 2, at + size - 4, 12):
            (tag,) = struct.unpack_from(order + "H", data, entry)
            if tag in moved and at == below:
                struct.pack_into(order + "H", data, entry, 65000 + moved.index(tag))
            elif tag == 254 and at == 8:
                struct.pack_into(order + "I", data, entry + 8, 1)
    struct.pack_into(order + "I", data, 8 + size - 4, below)
    (tmp_path / "a.dng").write_bytes(bytes(data))
    assert read_raw(tmp_path / "a.dng").black.tolist() == [200.0, 210.0, 220.0, 230.0]


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_samples_that_end_at_fewer_bits_than_told_are_saturated(tmp_path: Path, bits: int) -> None:
    """Of 16 bits, and a white level as of these, or of none."""
    top = 2**bits - 1
    lit = np.random.default_rng(5).normal(top, top / 20, SHAPE).round().clip(300, top)
    write_dng_form(tmp_path / "a.dng", lit.astype(int), DngFile(white=65535))
    frame = read_raw(tmp_path / "a.dng")
    wanted = (planes(lit) == top - BLACK).any(axis=0)
    assert 500 < wanted.sum() and np.array_equal(frame.saturated, wanted)
    assert frame.doubts == (f"samples end at {top}, below white 65535: these count as saturated",)


@pytest.mark.parametrize("ratio", [(3, 5), (1, 0), (0, 0), (0, 1)])
def test_an_exposure_time_or_a_stop_that_is_no_number_is_none(
    tmp_path: Path, ratio: tuple[int, int]
) -> None:
    file = DngFile(more={33434: (RATIONAL, ratio), 33437: (RATIONAL, ratio)})
    write_dng_form(tmp_path / "a.dng", IMAGE, file)
    frame, sound = read_raw(tmp_path / "a.dng"), ratio == (3, 5)
    assert (frame.exposure_s, frame.f_number) == ((0.6, 0.6) if sound else (0.0, None))


def list_opcodes(*opcodes: tuple[int, bytes]) -> bytes:
    """By DNG 1.4, chapter 6: number, version, flags (here: optional), length; always big-endian."""
    each = [struct.pack(">IIII", n, 0x01030000, 1, len(said)) + said for n, said in opcodes]
    return struct.pack(">I", len(opcodes)) + b"".join(each)


BAD_POINT = 5, struct.pack(">5I", 1, 1, 0, 20, 30)
WARP = 1, struct.pack(">I8d", 1, 1.0, *[0.0] * 5, 0.5, 0.5)


@ORDERS
def test_what_a_file_asks_to_be_done_to_its_samples_is_told(tmp_path: Path, order: str) -> None:
    """And is not done: bad pixels are seen by pdcd itself. Warps leave samples as they are."""
    for opcodes, told in (
        ((BAD_POINT, WARP, (99, b""), BAD_POINT), "FixBadPixelsList, opcode 99"),
        ((WARP, (4, struct.pack(">II", 0, 1))), "FixBadPixelsConstant"),
        ((WARP,), None),
        ((), None),
    ):
        file = DngFile(order=order, more={51008: (UNDEFINED, list_opcodes(*opcodes))})
        write_dng_form(tmp_path / "a.dng", IMAGE, file)
        frame = read_raw(tmp_path / "a.dng")
        np.testing.assert_array_equal(frame.planes, planes(IMAGE))
        said = f"the file asks for {told} (OpcodeList1), which is not done: samples are as stored"
        assert frame.doubts == ((said,) if told else ())


@pytest.mark.parametrize(
    "said",
    [
        b"\xff" * 4,
        b"\xff" * 40,
        list_opcodes(BAD_POINT)[:-30],
        list_opcodes((9, bytes(2**21))),  # longer than all other tags may be
        struct.pack(">I", 2**31) + 2**16 * struct.pack(">IIII", 9, 0, 0, 0),
    ],
)
def test_a_list_of_opcodes_hinders_no_reading(tmp_path: Path, said: bytes) -> None:
    write_dng_form(tmp_path / "a.dng", IMAGE, DngFile(more={51008: (UNDEFINED, said)}))
    np.testing.assert_array_equal(read_raw(tmp_path / "a.dng").planes, planes(IMAGE))
