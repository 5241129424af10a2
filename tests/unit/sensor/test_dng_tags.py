"""Every tag of a DNG file, read by a TIFF reader of its own.

Numbers and types are those of TIFF 6.0, of the DNG specification 1.4 and of EXIF 2.3.
"""

from __future__ import annotations

import errno
import hashlib
import json
import struct
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import PhotoFrame, RawFile
from pdcd.errors import DiskError, NoSpaceError
from pdcd.sensor.dng import encode_dng, write_dng, write_photo_frame

SIZES = {
    1: ("B", 1),
    2: ("s", 1),
    3: ("H", 2),
    4: ("I", 4),
    5: ("II", 8),
    7: ("s", 1),
    10: ("ii", 8),
}
NAMES = {1: "byte", 2: "text", 3: "short", 4: "long", 5: "ratio", 7: "raw", 10: "signed ratio"}


def directory(data: bytes, at: int) -> tuple[dict[int, tuple[str, Any]], int]:
    """Tag -> type and value, or values, of one IFD; and where what belongs to it ends."""
    (count,) = struct.unpack_from("<H", data, at)
    found: dict[int, tuple[str, Any]] = {}
    tags: list[int] = []
    end = at + 2 + 12 * count + 4
    for entry in range(count):
        tag, kind, number, offset = struct.unpack_from("<HHII", data, at + 2 + 12 * entry)
        letters, size = SIZES[kind]
        place = at + 2 + 12 * entry + 8 if number * size <= 4 else offset
        if number * size > 4:
            assert place % 2 == 0 and place == end + end % 2  # one behind the other, on even places
            end = place + number * size
        if letters == "s":
            value: Any = data[place : place + number]
        else:
            values = struct.unpack_from(f"<{number * len(letters)}{letters[0]}", data, place)
            value = values[0] if len(values) == 1 else values
        found[tag] = (NAMES[kind], value)
        tags.append(tag)
    assert tags == sorted(set(tags))
    assert struct.unpack_from("<I", data, at + 2 + 12 * count) == (0,)  # there is no other
    return found, end + end % 2


def made(height: int, width: int, **changes: Any) -> tuple[bytes, np.ndarray[Any, Any]]:
    mosaic = np.arange(height * width, dtype=np.uint16).reshape(height, width)
    fields: dict[str, Any] = {
        "black": 512, "white": 16383, "iso": 400, "exposure_s": 25.6, "f_number": 5.6,
        "model": "Virtual 1", "date": datetime(2024, 2, 29, 23, 59, 58),
        "as_shot_neutral": (0.5, 1.0, 0.8),
    }  # fmt: skip
    return encode_dng(mosaic, **(fields | changes)), mosaic


def test_every_tag_of_the_image() -> None:
    data, mosaic = made(48, 64)
    image, end = directory(data, 8)
    kind, exif = image.pop(34665)
    assert (kind, exif) == ("long", end)  # the EXIF directory follows
    _, behind = directory(data, exif)
    assert image.pop(273) == ("long", behind)  # and then the samples
    assert data[behind:] == mosaic.astype("<u2").tobytes()
    xyz_to_srgb = image.pop(50721)
    assert image == {
        254: ("long", 0),
        256: ("long", 64),
        257: ("long", 48),
        258: ("short", 16),
        259: ("short", 1),  # not compressed
        262: ("short", 32803),  # colour filter array
        271: ("text", b"pdcd\0"),
        272: ("text", b"Virtual 1\0"),
        274: ("short", 1),
        277: ("short", 1),
        278: ("long", 48),
        279: ("long", 48 * 64 * 2),
        284: ("short", 1),
        306: ("text", b"2024:02:29 23:59:58\0"),
        33421: ("short", (2, 2)),
        33422: ("byte", (0, 1, 1, 2)),  # red, green; green, blue
        50706: ("byte", (1, 4, 0, 0)),
        50707: ("byte", (1, 1, 0, 0)),
        50708: ("text", b"Virtual 1\0"),
        50711: ("short", 1),
        50713: ("short", (2, 2)),
        50714: ("long", (512,) * 4),
        50717: ("long", 16383),
        50719: ("long", (0, 0)),
        50720: ("long", (64, 48)),
        50728: ("ratio", (1, 2, 1, 1, 4, 5)),
        50778: ("short", 21),  # D65
    }
    kind, values = xyz_to_srgb
    matrix = np.array(values[::2]).reshape(3, 3) / np.array(values[1::2]).reshape(3, 3)
    iec_61966 = [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    assert kind == "signed ratio" and set(values[1::2]) == {10000}
    np.testing.assert_allclose(matrix, iec_61966, atol=1e-12)


def test_every_tag_of_the_exposure() -> None:
    data, _ = made(48, 64)
    exif, _ = directory(data, directory(data, 8)[0][34665][1])
    assert exif == {
        33434: ("ratio", (128, 5)),
        33437: ("ratio", (28, 5)),
        34855: ("short", 400),
        36864: ("raw", b"0230"),
        36867: ("text", b"2024:02:29 23:59:58\0"),
        36868: ("text", b"2024:02:29 23:59:58\0"),
    }
    data, _ = made(48, 64, f_number=None)
    exif, _ = directory(data, directory(data, 8)[0][34665][1])
    assert 33437 not in exif and len(exif) == 5


@pytest.mark.parametrize(
    ("seconds", "ratio"),
    [
        (0.5, (1, 2)),
        (1.0 / 3.0, (1, 3)),
        (1.0 / 1_000_001.0, (1, 1_000_000)),  # the finest there is
        (4000.0, (4000, 1)),
        (0.0, (0, 1)),
    ],
)
def test_times_are_the_closest_fraction_that_fits(seconds: float, ratio: tuple[int, int]) -> None:
    data, _ = made(48, 64, exposure_s=seconds)
    exif, _ = directory(data, directory(data, 8)[0][34665][1])
    assert exif[33434] == ("ratio", ratio)


@pytest.mark.parametrize(
    ("size", "frame"),
    [
        ((22, 24), (22, 24)),  # what LibRaw 0.22 and dcraw 9.28 take
        ((20, 22), (22, 24)),  # a border on both sides where one is needed
        ((22, 20), (24, 22)),
        ((4, 30), (22, 32)),
        ((30, 4), (32, 22)),
        ((2, 2), (22, 22)),
    ],
)
def test_a_small_mosaic_lies_in_the_corner_of_a_black_frame(
    size: tuple[int, int], frame: tuple[int, int]
) -> None:
    data, mosaic = made(*size)
    image, _ = directory(data, 8)
    assert (image[257][1], image[256][1]) == frame
    assert image[278][1] == frame[0] and image[279][1] == 2 * frame[0] * frame[1]
    assert image[50720] == ("long", (size[1], size[0]))
    samples = np.frombuffer(data, "<u2", offset=image[273][1]).reshape(frame).copy()
    corner = samples[: size[0], : size[1]].copy()
    np.testing.assert_array_equal(corner, mosaic)
    samples[: size[0], : size[1]] = 512
    assert (samples == 512).all()


@pytest.mark.parametrize(
    ("cfa", "numbers"),
    [
        ("RGGB", (0, 1, 1, 2)),
        ("BGGR", (2, 1, 1, 0)),
        ("GRBG", (1, 0, 2, 1)),
        ("GBRG", (1, 2, 0, 1)),
    ],
)
def test_the_colours_of_the_quad(cfa: str, numbers: tuple[int, ...]) -> None:
    image, _ = directory(made(48, 64, cfa=cfa)[0], 8)
    assert image[33422] == ("byte", numbers)
    assert image[262] == ("short", 32803)


def test_a_grey_plane_has_no_colours() -> None:
    data, samples = made(47, 63, cfa=None)
    image, _ = directory(data, 8)
    assert image[262] == ("short", 34892)
    assert image[50713] == ("short", (1, 1)) and image[50714] == ("long", 512)
    assert not {33421, 33422, 50711, 50721, 50728, 50778} & set(image)
    stored = np.frombuffer(data, "<u2", offset=image[273][1]).reshape(47, 63)
    np.testing.assert_array_equal(stored, samples)


def test_each_place_of_the_quad_may_have_its_own_black() -> None:
    data, _ = made(2, 2, black=[510, 511, 512, 513])
    image, _ = directory(data, 8)
    assert image[50714] == ("long", (510, 511, 512, 513))
    border = np.frombuffer(data, "<u2", offset=image[273][1]).reshape(22, 22)[10:12, 10:12]
    assert border.tolist() == [[510, 511], [512, 513]]


def test_what_the_device_said_of_itself() -> None:
    said = {"PixelFormat": "BayerRG12p", "Temperature": "41 °C"}
    image, _ = directory(made(22, 22, make="Acme", serial="0815", record=said)[0], 8)
    assert image[271] == ("text", b"Acme\0") and image[50735] == ("text", b"0815\0")
    assert json.loads(image[270][1].rstrip(b"\0")) == said


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    samples = np.full((24, 24), 700, np.uint16)
    written: dict[str, Any] = {
        "black": 64, "white": 4095, "iso": 200, "exposure_s": 0.5, "model": "M"
    }  # fmt: skip
    raw = write_dng(tmp_path / "a.dng", samples, **written, date=datetime(2024, 1, 1))
    data = (tmp_path / "a.dng").read_bytes()
    assert raw == RawFile(tmp_path / "a.dng", len(data), hashlib.sha256(data).hexdigest())
    assert data == encode_dng(samples, **written, f_number=None, date=datetime(2024, 1, 1))
    with pytest.raises(DiskError):
        write_dng(tmp_path / "nowhere" / "a.dng", samples, **written)


def test_half_a_file_does_not_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(path: Path, data: bytes) -> None:
        with path.open("wb") as file:
            file.write(data[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill)
    with pytest.raises(NoSpaceError):
        write_dng(
            tmp_path / "a.dng", np.zeros((24, 24), np.uint16), black=0, white=1, iso=100,
            exposure_s=1.0, model="M",
        )  # fmt: skip
    assert not list(tmp_path.iterdir())


def test_a_photo_of_two_buckets_becomes_two_files(tmp_path: Path) -> None:
    first, second = (
        PhotoFrame(np.full((24, 24), level, np.uint16), 64, 4095, 100, 0.5, cfa="BGGR")
        for level in (700, 800)
    )
    raw = write_photo_frame(replace(first, second=second), tmp_path / "coded.dng", "M", "7")
    assert raw.second is not None and raw.second.second is None
    for file, name, level in ((raw, "coded.dng", 700), (raw.second, "coded-second.dng", 800)):
        assert file.path == tmp_path / name
        data = file.path.read_bytes()
        image, _ = directory(data, 8)
        assert image[33422] == ("byte", (2, 1, 1, 0)) and image[50735] == ("text", b"7\0")
        assert (np.frombuffer(data, "<u2", offset=image[273][1]) == level).all()
