"""Files that are small, or no larger than a photo, and would be read for hours or into gigabytes.

What takes too long is seen by the time that a test has.
"""

from __future__ import annotations

import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.sensor.raw import read_raw, read_raw_head
from pdcd.sensor.tiff import read_tags
from pdcd.sensor.whole import find_gap
from tests.form_dng import LONG, DngFile, write_dng_form

pytestmark = pytest.mark.timeout(60)
LARGE = 30 * 2**20
"""Bytes of a photo."""
BIG_TIFF = "packed with places of 64 bits"


def directory(*entries: tuple[int, int, int, int], after: int = 0, times: int = 1) -> bytes:
    """Of tags, types, counts and values."""
    packed = b"".join(struct.pack("<HHII", *entry) for entry in entries) * times
    return struct.pack("<H", len(entries) * times) + packed + struct.pack("<I", after)


def chained(*entries: tuple[int, int, int, int], times: int) -> bytes:
    """A hundred directories, one behind the other."""
    size = len(directory(*entries, times=times))
    parts = [directory(*entries, after=8 + (n + 1) * size, times=times) for n in range(100)]
    return b"II*\0\x08\0\0\0" + b"".join(parts) + bytes(2**18)


def of_tags(*entries: tuple[int, int, int, int]) -> bytes:
    return (b"II*\0\x08\0\0\0" + directory(*entries)).ljust(LARGE, b"\1")


def of_boxes(box: bytes) -> bytes:
    return struct.pack(">I4s4sI8s", 24, b"ftyp", b"crx ", 1, b"crx isom") + box * (LARGE // 8)


BOMBS = {
    "places without end": of_tags((273, 4, 7_000_000, 100), (279, 4, 7_000_000, 200)),
    "levels without end": of_tags((50714, 4, 7_000_000, 100)),
    "a name without end": of_tags((272, 2, LARGE - 200, 100)),
    "directories below without end": of_tags((330, 4, 7_000_000, 100)),
    "directories below, all one": of_tags((330, 4, 1_000_000, 100)),
    "directories of many tags": chained((256, 3, 1, 8), times=65_535),
    "tags of the same numbers": chained((273, 4, 65_000, 8), times=1_000),
    "boxes without end": of_boxes(struct.pack(">I4s", 8, b"free")),
    "data without end": of_boxes(struct.pack(">I4s", 8, b"mdat")),
}


@pytest.mark.whole
@pytest.mark.parametrize("name", BOMBS)
def test_headers_without_end_are_not_followed(tmp_path: Path, name: str) -> None:
    data = BOMBS[name]
    tracemalloc.start()
    try:
        read_tags(data)
        assert find_gap(data)
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()
    (tmp_path / "a.dng").write_bytes(data)
    for read in (read_raw, read_raw_head):
        with pytest.raises(DecodeError, match=r"cannot decode a\.dng: it is not whole"):
            read(tmp_path / "a.dng")


@pytest.mark.parametrize("parts", [10_000, 250_000])
def test_strips_that_lie_over_each_other(tmp_path: Path, parts: int) -> None:
    """20,000 rows of 40 kB, all the same ones."""
    more = {256: (LONG, [20_000]), 257: (LONG, [parts]), 278: (LONG, [1]),
            273: (LONG, [5_000_000] * parts), 279: (LONG, [40_000] * parts)}  # fmt: skip
    row = np.full((1, 20_000), 700, np.uint16)
    data = write_dng_form(tmp_path / "a.dng", row, DngFile(more=more)).ljust(6_000_000, b"\1")
    (tmp_path / "a.dng").write_bytes(data)
    for read in (read_raw, read_raw_head):
        with pytest.raises(DecodeError, match="lie over each other"):
            read(tmp_path / "a.dng")
    assert "lie over each other" in find_gap(data)


@pytest.mark.parametrize("start", [b"\xff\xe0\x00\x02", b"\xff\xff"])
def test_a_jpeg_that_never_comes_to_its_samples(
    tmp_path: Path, start: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    jpeg = b"\xff\xd8" + start * (LARGE // len(start)) + b"\xff\xda\xff\xd9"
    monkeypatch.setattr("tests.form_dng.lossless_jpeg", lambda _: jpeg)
    write_dng_form(tmp_path / "a.dng", np.zeros((8, 8), np.uint16), DngFile(packing=7))
    with pytest.raises(DecodeError, match="is no lossless JPEG of 64 samples"):
        read_raw(tmp_path / "a.dng")


def test_more_samples_than_the_sensor_has_are_not_unpacked(tmp_path: Path) -> None:
    real = DngFile(bits=32, floating=True, packing=8, white=1, black=((0.0,),))
    write_dng_form(tmp_path / "a.dng", np.full((64, 64), 0.5), real)
    assert read_raw(tmp_path / "a.dng", most_samples=64 * 64).frame == (32, 32)
    huge = replace(real, more={256: (LONG, [60_000]), 257: (LONG, [60_000]), 278: (LONG, [60_000])})
    write_dng_form(tmp_path / "b.dng", np.full((64, 64), 0.5), huge)
    with pytest.raises(DecodeError, match="60000 x 60000 samples, more than the 4096 allowed"):
        read_raw(tmp_path / "b.dng", most_samples=64 * 64)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_big_tiff_is_called_what_it_is(tmp_path: Path, order: str) -> None:
    head = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HHHQ", 43, 8, 0, 16)
    (tmp_path / "a.dng").write_bytes(head + bytes(5000))
    with pytest.raises(DecodeError, match=BIG_TIFF) as caught:
        read_raw(tmp_path / "a.dng")
    assert "fetch it" not in str(caught.value.hint)
