"""Samples that are not in a file."""

from __future__ import annotations

import struct
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.sensor import mosaic, proof
from pdcd.sensor.raw import read_raw, read_raw_head
from pdcd.sensor.tiff import read_tags
from pdcd.sensor.whole import check_whole, find_gap
from tests.form_dng import LONG, RATIONAL, SHORT, DngFile, Tag, write_dng_form

SHAPE = 128, 192
RNG = np.random.default_rng(7)
NOISE = RNG.normal(1500.0, 30.0, SHAPE).round().astype(np.uint16)
PLAIN, JPEG = DngFile(), DngFile(packing=7, white=16383)
TILES = replace(JPEG, tile=(32, 64))
AGAIN = "fetch it from the camera again"


def parts_of(data: bytes | bytearray) -> list[tuple[int, int]]:
    tags = read_tags(bytes(data))
    assert tags is not None
    places = tags.numbers(324) or tags.numbers(273)
    return list(zip(places, tags.numbers(325) or tags.numbers(279), strict=True))


def refused(path: Path, data: bytes, *, reads: Any = (read_raw,)) -> str:
    """What reading such a file says."""
    path.write_bytes(data)
    said = ""
    for read in reads:
        with pytest.raises(DecodeError, match=f"cannot decode {path.name}: ") as caught:
            read(path)
        said = caught.value.message
        assert caught.value.hint == AGAIN
    return said


@pytest.mark.parametrize("file", [JPEG, TILES])
@pytest.mark.parametrize(("first", "filling"), [(0, b"\0"), (0, b"\xa5"), (2, b"\0")])
def test_lossless_jpeg_that_is_not_there(
    tmp_path: Path, file: DngFile, first: int, filling: bytes
) -> None:
    """Of the last part: all of it, or all but its first bytes."""
    data = bytearray(write_dng_form(tmp_path / "a.dng", NOISE, file))
    assert read_raw(tmp_path / "a.dng").frame == (64, 96)
    offset, size = parts_of(data)[-1]
    data[offset + first : offset + size] = filling * (size - first)
    said = refused(tmp_path / "a.dng", bytes(data), reads=(read_raw, read_raw_head))
    assert "no lossless JPEG" in said


def test_a_jpeg_of_fewer_samples_than_its_tile(tmp_path: Path) -> None:
    """The rest would be what lay in memory."""
    data = bytearray(write_dng_form(tmp_path / "a.dng", NOISE, JPEG))
    offset, _ = parts_of(data)[0]
    frame = data.index(b"\xff\xc3", offset)
    data[frame + 5 : frame + 7] = struct.pack(">H", 60)
    assert "no lossless JPEG of 24576 samples" in refused(tmp_path / "a.dng", bytes(data))


@pytest.mark.parametrize("file", [JPEG, TILES])
@pytest.mark.parametrize(
    ("mark", "at", "harm"), [(b"\xff\xda", 2, b"\xff\xff"), (b"\xff\xc3", 4, b"\x28")]
)
def test_a_jpeg_that_the_decoder_does_not_begin_holds_nothing_of_the_photo_before(
    tmp_path: Path, file: DngFile, mark: bytes, at: int, harm: bytes
) -> None:
    """Of a form that was decoded twice already: its samples would be what lay in memory."""
    data = write_dng_form(tmp_path / "a.dng", NOISE, file)
    assert read_raw(tmp_path / "a.dng").frame == (64, 96)
    place = data.rfind(mark) + at
    data = data[:place] + harm + data[place + len(harm) :]
    assert "some come from memory" in refused(tmp_path / "a.dng", data)


def test_photos_are_decoded_beside_each_other_and_fresh_memory_is_filled_with_one_thing() -> None:
    together, waits = threading.Barrier(2, timeout=30.0), threading.Event()
    seen: list[set[int]] = []

    def decode(filling: int, barrier: threading.Barrier | None) -> None:
        waits.set()
        with proof._fresh_memory(filling):
            if barrier:
                barrier.wait()
            seen.append({*proof._users})

    with proof._fresh_memory(1):
        first = threading.Thread(target=decode, args=(1, together))
        first.start()
        waits.wait()
        other = threading.Thread(target=decode, args=(2, None))
        other.start()
        together.wait()
        first.join()
        assert seen == [{1}]
    other.join()
    assert seen == [{1}, {2}] and not proof._users


def test_memory_of_zeros_is_zero_beside_photos_that_are_decoded() -> None:
    """Its filling never ends: the C library would otherwise leave the byte in zeros that another
    thread takes just then, once in some thousand times."""
    over, kinds = threading.Event(), np.random.default_rng(1)

    def decode() -> None:
        while not over.is_set():
            with proof._fresh_memory(0x5A):
                pass

    threads = [threading.Thread(target=decode) for _ in range(2)]
    often_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for _ in range(150):
            taken = [np.zeros(size, np.uint8) for size in kinds.integers(50_000, 2_000_000, 20)]
            assert not any(one.any() for one in taken)
    finally:
        over.set()
        sys.setswitchinterval(often_s)
        for thread in threads:
            thread.join()


def test_samples_that_look_like_fresh_memory_are_samples(tmp_path: Path) -> None:
    like = NOISE.copy()
    like[40:] = 0xA5A5
    file = replace(PLAIN, white=65535)
    for _ in range(2):
        write_dng_form(tmp_path / "a.dng", like, file)
        assert (read_raw(tmp_path / "a.dng").planes[:, 20:] == 0xA5A5 - 256).all()


BRIGHT = RNG.integers(13800, 14000, SHAPE).astype(np.uint16)
"""A hole keeps on one number, which is no white one, however high it is."""


@pytest.mark.parametrize("file", [JPEG, TILES])
@pytest.mark.parametrize("image", [NOISE, BRIGHT], ids=["noise", "bright"])
def test_a_hole_in_the_middle_of_compressed_samples(
    tmp_path: Path, file: DngFile, image: NDArray[np.uint16]
) -> None:
    data = bytearray(write_dng_form(tmp_path / "a.dng", image, file))
    offset, size = parts_of(data)[0]
    start = -(-(offset + size // 3) // 1024) * 1024
    data[start : start + size // 2] = bytes(size // 2)
    refused(tmp_path / "a.dng", bytes(data))


def test_dark_rows_are_samples(tmp_path: Path) -> None:
    """Black itself, noise around it, and zeros where black is zero."""
    dark = NOISE.copy()
    dark[40:] = RNG.normal(256.0, 8.0, dark[40:].shape).round()
    write_dng_form(tmp_path / "a.dng", dark, PLAIN)
    assert read_raw(tmp_path / "a.dng").planes[:, 30:].mean() < 1.0
    dark[40:] = 0
    write_dng_form(tmp_path / "a.dng", dark, replace(PLAIN, black=((0.0,),)))
    frame = read_raw(tmp_path / "a.dng")
    assert not frame.planes[:, 30:].any()
    assert frame.doubts == (
        f"{44 * 96 // 32} times 32 of a colour are zero, from row 40 on: black, or not in the file",
    )
    dark[:] = 1000  # a flat picture without noise
    for file in (PLAIN, JPEG):
        write_dng_form(tmp_path / "a.dng", dark, file)
        assert (read_raw(tmp_path / "a.dng").planes == 744.0).all()


def test_a_white_picture_may_be_packed_into_zeros(tmp_path: Path) -> None:
    lit = np.full((256, 512), 16383, np.uint16)
    data = write_dng_form(tmp_path / "a.dng", lit, JPEG)
    assert bytes(8192) in data
    assert read_raw(tmp_path / "a.dng").saturated.all()


def test_rows_of_one_number_come_from_a_decoder_that_lost_its_way(tmp_path: Path) -> None:
    odd = NOISE.copy()
    odd[60:110] = 900
    write_dng_form(tmp_path / "a.dng", odd, JPEG)
    with pytest.raises(DecodeError, match="are one number, from row 60 on"):
        read_raw(tmp_path / "a.dng")
    write_dng_form(tmp_path / "a.dng", odd, PLAIN)  # there they stand; the user is told
    said = ("2400 samples of a colour are one number, from row 60 on",)
    assert read_raw(tmp_path / "a.dng").doubts == said


def test_rows_of_zeros_where_black_is_zero(tmp_path: Path) -> None:
    """Of a file in pieces some may be missing; noise that reaches zero leaves them."""
    file = replace(PLAIN, black=((0.0,),), strip_rows=16)
    late = NOISE.copy()
    late[80:] = 0
    data = write_dng_form(tmp_path / "a.dng", late, file)
    assert "part 6 of 8 holds zeros only" in refused(tmp_path / "a.dng", data)
    late[78:80] = late[-2:] = 0
    late[-1, -1] = 1500
    late[80::16, 0] = 1
    data = write_dng_form(tmp_path / "a.dng", late, file)
    assert "times 32 of a colour are zero, from row 78 on" in refused(tmp_path / "a.dng", data)
    dim = RNG.normal(1.0, 2.0, SHAPE).clip(0).round().astype(np.uint16)
    dim[82:110] = 0
    write_dng_form(tmp_path / "a.dng", dim, file)
    assert not read_raw(tmp_path / "a.dng").planes[:, 41:55].any()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({279: (LONG, [100])}, "part 1 of 1 has 100 bytes, 49152 are needed"),
        ({279: (LONG, [10**6])}, "it is not whole"),
        ({273: (LONG, [10**6])}, "it is not whole"),
        ({278: (LONG, [16])}, "1 places and 1 lengths of 8 strips or tiles"),
        ({50713: (SHORT, [2, 2]), 50714: (LONG, [1, 2, 3])}, "3 black levels for 2 x 2 places"),
        ({50716: (SHORT, [1] * 5)}, "5 differences of black for 128 rows or columns"),
        ({50714: (RATIONAL, [1, 0])}, "a level that is no number"),
        ({50717: (LONG, [200])}, "black at 256 DN and white at 200 DN"),
        ({256: (LONG, [0])}, "an image of 0 x 128 samples"),
        ({273: (LONG, [0])}, "samples at the place of its header"),
        ({50717: (RATIONAL, [4095, 0])}, "a level that is no number"),
        ({50713: (SHORT, [0, 0])}, "1 black levels for 0 x 0 places"),
    ],
)
def test_numbers_that_contradict_each_other(
    tmp_path: Path, more: dict[int, Tag], words: str
) -> None:
    data = write_dng_form(tmp_path / "a.dng", NOISE, replace(PLAIN, more=more))
    assert words in refused(tmp_path / "a.dng", data)


# What is not built on TIFF, or begins otherwise.


def rw2(samples: bytes, bits: int, width: int = 560, height: int = 200, way: int = 5) -> bytes:
    """A file that LibRaw takes for one of a Panasonic."""
    begin = 1024
    texts = b"Panasonic\0DMC-GH3\0"
    entries: list[tuple[int, int, int, int]] = [
        (1, 7, 4, 0x30353330), (2, 3, 1, width), (3, 3, 1, height), (4, 3, 1, 0), (5, 3, 1, 0),
        (6, 3, 1, height), (7, 3, 1, width), (9, 3, 1, 1), (10, 3, 1, bits), (11, 3, 1, 34316),
        (45, 3, 1, way), (271, 2, 10, 900), (272, 2, 8, 910), (273, 4, 1, 0xFFFFFFFF),
        (279, 4, 1, 0), (280, 4, 1, begin),
    ]  # fmt: skip
    head = b"IIU\0" + struct.pack("<IH", 8, len(entries))
    head += b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    return head.ljust(900, b"\0") + texts.ljust(begin - 900, b"\0") + samples


@pytest.mark.parametrize("bits", [12, 14])
def test_an_rw2_is_as_long_as_its_samples(tmp_path: Path, bits: int) -> None:
    path = tmp_path / "a.rw2"
    whole = RNG.integers(0, 256, 13 * 0x4000, np.uint8).tobytes()
    path.write_bytes(rw2(whole, bits))
    assert read_raw(path).frame == (100, 280)
    needs = 200 * -(-560 // (10 if bits == 12 else 9)) * 16
    for size in (12_000, needs // 2, needs - 1):
        assert "it is not whole" in refused(path, rw2(whole[:size], bits))
    # Up to the block that its bytes are turned in nothing but the decoder itself tells.
    assert "come from memory" in refused(path, rw2(whole[:needs], bits))


def test_what_is_still_to_come_of_a_file_without_lengths() -> None:
    """Padding at the end is none of it."""
    whole = RNG.integers(1, 256, 11 * 0x4000, np.uint8).tobytes()
    assert find_gap(rw2(whole + bytes(0x2000), 12)) == ""
    assert "only zeros amid" in find_gap(rw2(whole[:0x8000] + bytes(len(whole) - 0x8000), 12))
    assert "speaks of" in find_gap(rw2(whole[:0x8000], 12))
    assert find_gap(b"\xa5" * 2**18) == "" and "only zeros" in find_gap(b"x" + bytes(2**18))
    assert find_gap(b"") == "it is empty"


def raf(samples: int) -> bytes:
    head = b"FUJIFILMCCD-RAW 0201FF393101X-T1".ljust(84, b"\0")
    return head + struct.pack(">6I", 200, 300, 500, 80, 600, samples) + bytes(492 + samples)


def cr3(samples: int) -> bytes:
    def box(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I4s", 8 + len(body), kind) + body

    large = struct.pack(">I4sQ", 1, b"mdat", 16 + samples) + bytes(samples)
    return box(b"ftyp", b"crx \0\0\0\1crx isom") + box(b"moov", bytes(500)) + large


def orf(samples: int) -> bytes:
    entries = [(256, 4, 1, 100), (257, 4, 1, 100), (273, 4, 1, 300), (279, 4, 1, samples)]
    head = b"IIRO" + struct.pack("<IH", 8, len(entries))
    head += b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    return head.ljust(300, b"\0") + bytes(samples)


@pytest.mark.parametrize("made", [raf, cr3, orf])
def test_other_containers_are_as_long_as_they_say(made: Any) -> None:
    data = made(20_000)
    found = check_whole(data, read_tags(data), "a")
    assert found.sure and sum(size for _, size in found.parts) in (20_000, 20_016)
    for size in range(40, len(data), len(data) // 20):
        with pytest.raises(DecodeError, match=f"a: it is not whole, {size} bytes of "):
            check_whole(data[:size], read_tags(data[:size]), "a")


def test_what_lies_in_the_file_counts_where_the_decoder_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_dng_form(tmp_path / "a.dng", NOISE, PLAIN)
    other = NOISE.copy()
    other[5, 6] += 1
    monkeypatch.setattr(mosaic, "_proven", {})
    monkeypatch.setattr(mosaic, "_unpack", lambda raw: other)
    monkeypatch.setattr(mosaic, "_unpack_again", lambda raw, shape: other)
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.planes[0], NOISE[::2, ::2].astype(np.float32) - 256)
    assert np.array_equal(frame.planes[2], NOISE[1::2, ::2].astype(np.float32) - 256)
    assert frame.doubts[0].startswith("LibRaw's samples differ")
