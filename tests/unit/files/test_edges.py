"""Readers at their limits: what just fits is read, what is one more is refused, and in words."""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.files import arrays as npy
from pdcd.files import arrays as png
from pdcd.files import reading
from pdcd.files.arrays import list_members, read_array, read_npy, read_npz
from pdcd.files.opening import (
    ArrayLimits,
    Asker,
    UnsoundFileError,
    kind_of,
    open_own,
    open_parcels,
)
from pdcd.files.reading import read_contents
from tests.hostile import files

LIMITS = ArrayLimits(1000)


def refused(data: bytes, limits: ArrayLimits = LIMITS) -> UnsoundFileError:
    with pytest.raises(UnsoundFileError) as caught:
        read_array(data, "kernel", limits)
    assert caught.value.hint and str(caught.value) == caught.value.message
    return caught.value


def npz(packing: int = zipfile.ZIP_STORED, **arrays: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("shape", "count", "words"),
    [
        ((), 1, ""),
        ((1000,), 1000, ""),
        ((10, 100), 1000, ""),
        ((1, 1, 1), 1, ""),
        ((1001,), 0, "the shape 1001; at most 1000"),
        ((7, 143), 0, "7 x 143; at most"),
        ((0,), 0, "the shape 0, which holds no number"),
        ((5, 0), 0, "5 x 0, which holds no number"),
        ((10**12 - 1, 2), 0, "999999999999 x 2;"),
        ((10**12, 2), 0, "more than 10^12 x 2;"),
        ((2,) * 8, 256, ""),
        ((2,) * 11, 0, "2 x 2 x 2 x 2 x 2 x 2 x 2 x 2 ...;"),
        ((4,) * 8, 0, "4 x 4 x 4 x 4 x 4 x 4 x 4 x 4;"),
    ],
)
def test_a_shape_has_numbers_and_not_too_many(
    shape: tuple[int, ...], count: int, words: str
) -> None:
    if count:
        assert LIMITS.check(shape) == count
        return
    with pytest.raises(UnsoundFileError) as caught:
        LIMITS.check(shape)
    assert words in caught.value.message


def test_headers_of_both_versions_and_any_order_are_read() -> None:
    numbers = np.arange(6.0).reshape(2, 3)
    flat, turned = numbers.tobytes(), numbers.tobytes("F")
    for version in (1, 2):
        for text, data in (
            ("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }", flat),
            ("{'shape': (2,3), 'descr': '<f8', 'fortran_order': True}", turned),
            ('{"fortran_order":False,"shape":( 2 , 3 ),"descr":"float64"}', flat),
        ):
            made = files.raw_npy(text + "\n", data, version)
            np.testing.assert_array_equal(read_npy(made, LIMITS), numbers)
    line = read_npy(files.npy(np.arange(4, dtype=">i2")), LIMITS)
    assert line.dtype == np.float64 and line.tolist() == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{'descr': '<f8', 'fortran_order': False}", "not that of real numbers"),
        ("{'descr': '<f8', 'descr': '<f8', 'shape': (2, 3)}", "not that of real numbers"),
        ("{'descr': '<c16', 'fortran_order': False, 'shape': (2, 3)}", "complex128, not real"),
        ("{'descr': 'xx', 'fortran_order': False, 'shape': (2, 3)}", "damaged"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3)} 1", "not that of real"),
    ],
)
def test_headers_of_anything_else_are_refused(text: str, words: str) -> None:
    assert words in refused(files.raw_npy(text + "\n", bytes(48))).message


def test_a_header_is_of_so_many_letters_at_most() -> None:
    text = "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1), }"
    fits = text.ljust(2048)
    assert read_array(files.raw_npy(fits, bytes(8)), "x", LIMITS).shape == (1, 1)
    assert "2049 characters" in refused(files.raw_npy(fits + " ", bytes(8), 2)).message
    assert "version 1.0 or 2.0" in refused(b"\x93NUMPY\x01").message


@pytest.mark.parametrize("filler", [" ", "1 ,", "1, ", "' ", '"', "''", "(", ": '", "9", "a "])
def test_the_time_of_a_header_grows_as_its_length_does(
    filler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of 600 kB: where it grew as the square, each would take five minutes."""
    monkeypatch.setattr(npy, "_MAX_HEADER", 10**6)
    sound = "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1)"
    for end in (0, 1, 20, 45, 53, len(sound)):
        begun = sound[:end] + filler * (600_000 // len(filler))
        assert "not that of real" in refused(files.raw_npy(begun + "x", bytes(8), 2)).message


def test_an_array_ends_where_its_shape_says() -> None:
    whole = files.npy(np.ones((2, 3)))
    assert "ends after 47 of 48 bytes" in refused(whole[:-1]).message
    assert "more bytes follow" in refused(whole + b"\0").message
    for spoilt, words in ((whole[:-1], "ends after 47"), (whole[:-50], "`a`: ")):
        with pytest.raises(UnsoundFileError, match=words) as caught:
            read_npz(npz(a=spoilt), {"a": LIMITS})
        assert caught.value.message.startswith("`a`: it")


def test_signs_of_life_come_with_every_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npy, "READ_CHUNK_BYTES", 100)
    signs: list[int] = []
    limits = ArrayLimits(1000, lambda: signs.append(1))
    array = np.arange(50.0).reshape(5, 10)
    np.testing.assert_array_equal(read_npy(files.npy(array), limits), array)
    assert len(signs) == 4
    picture = signs.copy()
    read_array(made_png(3, 2, 8), "x", limits)
    assert len(signs) > len(picture)


@pytest.mark.parametrize("packing", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_archives_of_one_to_64_arrays_are_read(packing: int) -> None:
    one = files.npy(np.ones((1, 1)))
    names = [f"a{n}" for n in range(64)]
    data = npz(packing, **dict.fromkeys(names, one))
    assert list_members(data) == tuple(names)
    assert [*read_npz(data, {"a63": LIMITS, "a0": LIMITS})] == ["a63", "a0"]
    with pytest.raises(UnsoundFileError, match="it holds no b and no c") as caught:
        read_npz(data, {"a0": LIMITS, "b": LIMITS, "c": LIMITS})
    assert caught.value.hint == "store a0, b, c with numpy.savez"
    with pytest.raises(UnsoundFileError, match="65 arrays"):
        list_members(npz(packing, **dict.fromkeys([*names, "b"], one)))
    with pytest.raises(UnsoundFileError, match="0 arrays"):
        list_members(npz())


def test_each_array_has_a_limit_of_its_own() -> None:
    data = npz(a=files.npy(np.ones((2, 2))), b=files.npy(np.ones((2, 3))))
    assert len(read_npz(data, {"a": ArrayLimits(4), "b": ArrayLimits(6)})) == 2
    with pytest.raises(UnsoundFileError, match="`b`: it has the shape 2 x 3; at most 5"):
        read_npz(data, {"a": ArrayLimits(4), "b": ArrayLimits(5)})


def test_what_no_archive_of_numpy_has_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    good = npz(a=files.npy(np.ones((1, 1))))
    assert list_members(good) == ("a",)
    for spoilt in (good[:-1] + b"\x01", good + b"\0", good[-21:], b"PK\x03\x04", good[:-22]):
        with pytest.raises(UnsoundFileError, match=r"no \.npz file ends like that"):
            list_members(spoilt)
    directory = int.from_bytes(good[-10:-6], "little")
    monkeypatch.setattr(npy, "MAX_DIRECTORY_BYTES", directory)
    assert list_members(good) == ("a",)
    monkeypatch.setattr(npy, "MAX_DIRECTORY_BYTES", directory - 1)
    with pytest.raises(UnsoundFileError, match="too many files"):
        list_members(good)
    monkeypatch.undo()
    locked = bytearray(good)
    locked[good.index(b"PK\x01\x02") + 8] |= 1
    with pytest.raises(UnsoundFileError, match="packed or locked"):
        list_members(bytes(locked))
    with pytest.raises(UnsoundFileError, match="it is damaged: "):
        list_members(good.replace(b"PK\x01\x02", b"PK\x01\x03"))


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def made_png(
    width: int, height: int, depth: int, colour: int = 0, *, pixels: bytes | None = None,
    packing: int = 0, filters: int = 0, head: bytes = b"", packed: bytes | None = None,
) -> bytes:  # fmt: skip
    """A black picture, or one of given bytes with a filter byte before each row."""
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 1)
    row = 1 + -(-width * samples * depth // 8)
    data = zlib.compress(bytes(row * height) if pixels is None else pixels)
    head = head or struct.pack(">IIBBBBB", width, height, depth, colour, packing, filters, 0)
    palette = chunk(b"PLTE", bytes(range(12))) if colour == 3 else b""
    body = chunk(b"IDAT", data if packed is None else packed)
    return png.PNG_MAGIC + chunk(b"IHDR", head) + palette + body + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("colour", "depths"),
    [(0, (1, 2, 4, 8, 16)), (2, (8, 16)), (3, (1, 2, 4, 8)), (4, (8, 16)), (6, (8, 16))],
)
@pytest.mark.parametrize("width", [1, 4, 7, 8, 9])
def test_pictures_of_every_kind_are_read(colour: int, depths: tuple[int, ...], width: int) -> None:
    for depth in depths:
        assert read_array(made_png(width, 2, depth, colour), "x", LIMITS).shape == (2, width)


def test_grey_of_few_bits_is_a_share_of_full_scale() -> None:
    found = read_array(made_png(9, 1, 1, pixels=b"\0\xaa\x80"), "x", LIMITS)
    assert found.tolist() == [[1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0]]
    found = read_array(made_png(2, 1, 16, pixels=b"\0\xff\xff\x33\x33"), "x", LIMITS)
    assert found.tolist() == [[1.0, pytest.approx(0.2)]]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (made_png(2, 2, 8, 1), "no such PNG"),
        (made_png(2, 2, 8, 5), "no such PNG"),
        (made_png(2, 2, 8, packing=1), "no such PNG"),
        (made_png(2, 2, 8, filters=1), "no such PNG"),
        (made_png(2, 2, 8, head=bytes(12)), "begins otherwise"),
        (made_png(2, 2, 8, head=bytes(14)), "begins otherwise"),
        (png.PNG_MAGIC + chunk(b"IEND", b""), "begins otherwise"),
        (png.PNG_MAGIC + chunk(b"tEXt", b"") + chunk(b"IEND", b""), "begins otherwise"),
        (made_png(2, 2, 8, packed=b"none"), "it is damaged: Error"),
        (made_png(2, 2, 8, packed=b""), "its pixels take 6 bytes, 0"),
        (made_png(2, 2, 8, pixels=b"\x07" * 6), "damaged"),
        (made_png(1001, 1, 8), "1 x 1001; at most 1000"),
        (made_png(2, 2, 8)[:-1], "ends too early"),
        (made_png(2, 2, 8)[:-12], "ends too early"),
        (made_png(2, 2, 8)[:-5], "ends too early"),
        (made_png(2, 2, 8)[:-1] + b"x", "a checksum is wrong"),
    ],
)
def test_pictures_that_are_none_are_refused(data: bytes, words: str) -> None:
    assert words in refused(data).message


def test_no_picture_is_larger_than_any_camera_makes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(png, "MAX_PIXELS", 6)
    assert read_array(made_png(3, 2, 8), "x", LIMITS).shape == (2, 3)
    assert "at most 6" in refused(made_png(7, 1, 8)).message
    assert "at most 5" in refused(made_png(3, 2, 8), ArrayLimits(5)).message


def test_what_follows_the_end_of_a_picture_is_not_looked_at() -> None:
    data = made_png(3, 2, 8) + b"anything"
    assert read_array(data, "x", LIMITS).shape == (2, 3)


@pytest.mark.parametrize("fault", [MemoryError(), KeyboardInterrupt()])
def test_no_fault_of_ours_is_taken_for_damage_of_a_picture(
    fault: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Unpack:
        def decompress(self, *_: Any) -> bytes:
            raise fault

    monkeypatch.setattr(png.zlib, "decompressobj", Unpack)  # type: ignore[attr-defined]
    with pytest.raises(type(fault)):
        read_array(made_png(2, 2, 8), "x", LIMITS)


def test_a_decoder_that_gives_up_is_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    import cv2

    def fails(*_: Any) -> None:
        raise cv2.error("broken")

    monkeypatch.setattr(cv2, "imdecode", fails)
    assert "cannot be decoded" in refused(made_png(2, 2, 8)).message


def test_a_file_is_as_large_as_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "READ_CHUNK_BYTES", 400_000)
    limits, signs = ArrayLimits(2), 0

    def alive() -> None:
        nonlocal signs
        signs += 1

    most = 16 + 2**20  # two numbers, and 1 MiB for what is around
    for size, fits in ((most, True), (most + 1, False), (1, True), (0, False)):
        (tmp_path / "a").write_bytes(os.urandom(size))
        descriptor, signs = open_own(tmp_path / "a"), 0
        try:
            if fits:
                found = read_contents(descriptor, ArrayLimits(2, alive))
                assert found == (tmp_path / "a").read_bytes() and signs == -(-size // 400_000)
            else:
                words = f"it has {most + 1} bytes, more than the {most}" if size else "it is empty"
                with pytest.raises(UnsoundFileError, match=words):
                    read_contents(descriptor, limits)
        finally:
            os.close(descriptor)


@pytest.mark.parametrize(
    ("mode", "right", "asker", "may"),
    [
        (0o400, 4, Asker(1, frozenset()), True),
        (0o100, 1, Asker(1, frozenset()), True),
        (0o300, 4, Asker(1, frozenset()), False),
        (0o077, 4, Asker(1, frozenset({5})), False),  # the owner's bits come first
        (0o040, 4, Asker(2, frozenset({5})), True),
        (0o010, 1, Asker(2, frozenset({5})), True),
        (0o704, 4, Asker(2, frozenset({5})), False),
        (0o004, 4, Asker(2, frozenset({6})), True),
        (0o770, 4, Asker(2, frozenset({6})), False),
        (0o000, 4, Asker(0, frozenset()), True),
    ],
)
def test_rights_are_those_of_owner_group_or_all_others(
    mode: int, right: int, asker: Asker, may: bool
) -> None:
    found = os.stat_result((0o100000 | mode, 0, 0, 1, 1, 5, 0, 0, 0, 0))
    assert asker.may(found, right) is may


def test_things_are_called_by_their_kind() -> None:
    kinds = {0o100644: "file", 0o040755: "folder", 0o010600: "FIFO", 0o120777: "symbolic link",
             0o140600: "socket", 0o020600: "device", 0o060600: "device", 0: "thing"}  # fmt: skip
    assert {mode: kind_of(mode) for mode in kinds} == kinds


def test_the_content_of_a_file_travels_as_it_is() -> None:
    with open_parcels({"prior": b"any bytes", "empty": np.zeros((1, 2), np.uint8)}) as opened:
        assert read_contents(opened["prior"].descriptor, LIMITS) == b"any bytes"
        array = read_array(read_contents(opened["empty"].descriptor, LIMITS), "x", LIMITS)
        assert array.tolist() == [[0.0, 0.0]] and opened["prior"].file is None
    with (
        pytest.raises(RequestError, match=r"warp \(/no/such\.npy\): it cannot be opened") as caught,
        open_parcels({"warp": "/no/such.npy"}),
    ):
        pass
    assert caught.value.hint
