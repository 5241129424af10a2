"""Masked borders, orientation, CR2, and what the making of pictures would do to a measurement."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.sensor import tiff
from pdcd.sensor.raw import read_raw
from pdcd.sensor.tiff import read_tags
from tests.cr2 import LEFT_450D, SIZE_450D, TOP_450D, write_cr2
from tests.dng_file import write_dng
from tests.masked_dng import write_masked_dng
from tests.tools import needs, program

Mosaic = NDArray[np.uint16]
OFFSETS = np.array([[500.25, 510.5], [520.75, 531.0]])
"""Black of each place in the quad of the whole sensor."""


def sensor(height: int, width: int, seed: int = 0) -> Mosaic:
    """Random samples all over."""
    return np.random.default_rng(seed).integers(600, 14000, (height, width)).astype(np.uint16)


def darken(image: Mosaic, area: tuple[int, int, int, int], offsets: NDArray[np.float64]) -> None:
    """Fill an area with black whose mean is exactly that of each place in the quad."""
    top, left, bottom, right = area
    for row in range(2):
        for column in range(2):
            places = np.zeros(image.shape, bool)
            places[row::2, column::2] = True
            inside = np.zeros(image.shape, bool)
            inside[top:bottom, left:right] = True
            count = int((places & inside).sum())
            level = offsets[row, column]
            values = np.full(count, np.floor(level))
            values[: round((level % 1.0) * count)] += 1
            image[places & inside] = values


@pytest.mark.parametrize("begin", [0, 1])
@pytest.mark.parametrize("top", [8, 9])
@pytest.mark.parametrize("left", [20, 21])
def test_black_is_the_mean_of_the_masked_border_per_colour(
    tmp_path: Path, top: int, left: int, begin: int
) -> None:
    """Also where the picture begins in the middle of the sensor's quad."""
    path = tmp_path / "a.dng"
    image = sensor(82, 100)
    # 80 x 16: each place of the quad has 320 samples, a multiple of 4
    area = (begin, begin, 80 + begin, 16 + begin)
    darken(image, area, OFFSETS)
    write_masked_dng(path, image, active=(top, left, 82, 100), masked=area)
    frame = read_raw(path)
    visible = image[top:, left:].astype(np.float64)
    height, width = (side // 2 for side in visible.shape)
    assert frame.masked
    for plane, (row, column) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)]):
        black = OFFSETS[(top + row) % 2, (left + column) % 2]
        assert frame.black[plane] == black
        expected = visible[row::2, column::2][:height, :width] - black
        assert np.array_equal(frame.planes[plane], expected)


@pytest.mark.parametrize("level", [16000, 560])
def test_hot_and_warm_pixels_of_the_border_do_not_move_black(tmp_path: Path, level: int) -> None:
    path = tmp_path / "a.dng"
    image = sensor(80, 100)
    area = (0, 0, 80, 16)
    darken(image, area, OFFSETS)
    image[10:14, 4:8] = level
    write_masked_dng(path, image, active=(0, 16, 80, 100), masked=area)
    assert np.abs(read_raw(path).black - OFFSETS.ravel()).max() < 0.02


def test_several_masked_areas_are_one(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    image = sensor(80, 100)
    for area, level in (((0, 0, 80, 8), 500.0), ((0, 92, 80, 100), 502.0)):
        darken(image, area, np.full((2, 2), level))
    write_masked_dng(path, image, active=(0, 8, 80, 92), masked=(0, 0, 80, 8, 0, 92, 80, 100))
    assert read_raw(path).black.tolist() == [501.0] * 4


@pytest.mark.parametrize(("orientation", "flip"), [(1, 0), (3, 3), (6, 6), (8, 5)])
def test_a_camera_on_its_side_gives_the_same_planes(
    tmp_path: Path, orientation: int, flip: int
) -> None:
    path = tmp_path / "a.dng"
    image = sensor(60, 80)
    write_masked_dng(path, image, active=(0, 0, 60, 80), orientation=orientation)
    frame = read_raw(path)
    assert frame.flip == flip
    assert np.array_equal(frame.planes[0] + 512, image[0::2, 0::2])


# CR2.


@pytest.fixture(scope="module")
def cr2(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Mosaic]:
    """The whole sensor of a 450D, its borders dark."""
    rng = np.random.default_rng(5)
    image = rng.integers(1100, 14605, SIZE_450D).astype(np.uint16)
    dark = rng.normal(1024.0, 6.0, SIZE_450D).round()
    image[:TOP_450D], image[:, :LEFT_450D] = dark[:TOP_450D], dark[:, :LEFT_450D]
    path = tmp_path_factory.mktemp("cr2") / "a.cr2"
    write_cr2(path, image, iso=400, exposure=(512, 10), orientation=6)
    return path, image


@pytest.mark.long
def test_cr2_is_read_like_dng(cr2: tuple[Path, Mosaic]) -> None:
    path, image = cr2
    frame = read_raw(path)
    visible = image[TOP_450D : TOP_450D + 2856, LEFT_450D:].astype(np.float64)
    assert frame.planes.shape == (4, 1428, 2145)
    border = image[TOP_450D : TOP_450D + 2856, 2:20].astype(np.float64)
    for plane, (row, column) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)]):
        dark = border[row::2, column::2]
        # No sample of so many lies beyond five standard deviations by much.
        assert frame.black[plane] == pytest.approx(dark.mean(), abs=0.005)
        expected = visible[row::2, column::2] - frame.black[plane]
        assert np.abs(frame.planes[plane] - expected).max() < 1e-3  # float32
    assert frame.exif() == {
        "model": "Canon EOS 450D",
        "date": "2024:02:29 23:59:58",
        "iso": 400,
        "exposure_s": 51.2,
        "f_number": None,
        "flip": 6,
        "black_dn": frame.black.tolist(),
        "black_from": "masked border",
        "libraw_black_dn": frame.libraw_black.tolist(),
        "white_dn": 14605.0,
    }


@needs("dcraw")
def test_dcraw_decodes_the_same_samples_of_the_cr2(cr2: tuple[Path, Mosaic]) -> None:
    path, image = cr2
    command = [program("dcraw"), "-4", "-D", "-t", "0", "-c", str(path)]
    pgm = subprocess.run(command, capture_output=True, check=True).stdout
    _, size, _, samples = pgm.split(b"\n", 3)
    assert size == b"4290 2856"
    visible = image[TOP_450D : TOP_450D + 2856, LEFT_450D:]
    assert np.array_equal(np.frombuffer(samples, ">u2").reshape(visible.shape), visible)


@pytest.fixture
def small_cr2(tmp_path: Path) -> Path:
    path = tmp_path / "a.cr2"
    write_cr2(path, sensor(64, 96))
    return path


def test_a_cr2_without_its_end_is_noticed_by_its_directory(small_cr2: Path) -> None:
    data = small_cr2.read_bytes()
    tags = read_tags(data)
    assert tags is not None and tags.needs_bytes == len(data)
    short = read_tags(data[:-1])
    assert short is not None and short.needs_bytes == len(data)


# Damaged headers.


@pytest.mark.long
@settings(max_examples=150)
@given(
    canon=st.booleans(),
    changes=st.lists(st.tuples(st.integers(0, 700), st.integers(0, 255)), min_size=1, max_size=8),
)
def test_damaged_headers_give_typed_errors_only(
    tmp_path_factory: pytest.TempPathFactory, canon: bool, changes: list[tuple[int, int]]
) -> None:
    path = tmp_path_factory.mktemp("raw") / "a.raw"
    image = sensor(48, 64)
    if canon:
        write_cr2(path, image)
    else:
        write_masked_dng(path, image, active=(2, 16, 48, 64), masked=(0, 0, 48, 16))
    data = bytearray(path.read_bytes())
    for place, value in changes:
        data[place] = value
    path.write_bytes(data)
    try:
        frame = read_raw(path)
    except DecodeError:
        return
    assert frame.planes.ndim == 3 and np.isfinite(frame.planes).all()


@settings(max_examples=150)
@given(order=st.sampled_from([b"II*\0", b"MM\0*"]), rest=st.binary(max_size=300))
def test_tags_of_any_bytes_are_read_without_an_exception(order: bytes, rest: bytes) -> None:
    tags = read_tags(order + rest)
    assert tags is not None and tags.needs_bytes >= 8


@pytest.mark.parametrize("words_at", [0, 1])
def test_places_and_sizes_that_are_words_say_nothing_of_the_end(words_at: int) -> None:
    """Of each pair of tags one is a number and one a word, as in a damaged file."""
    for pair in tiff._DATA:
        entries = [
            struct.pack("<HHI4s", tag, 2, 4, b"abc\0")
            if place == words_at
            else struct.pack("<HHII", tag, 4, 1, 10**6)
            for place, tag in enumerate(pair)
        ]
        data = b"II*\0" + struct.pack("<IH", 8, 2) + b"".join(entries) + bytes(4)
        tags = read_tags(data)
        assert tags is not None and tags.needs_bytes == len(data)


# What making a picture would do: the reasons why LibRaw's postprocess has no part in measuring.

LINEAR = {
    "gamma": (1, 1),
    "no_auto_bright": True,
    "output_bps": 16,
    "user_wb": [1.0, 1.0, 1.0, 1.0],
    "output_color": rawpy.ColorSpace.raw,
    "half_size": True,
}


def developed(path: Path, **settings: object) -> NDArray[np.uint16]:
    with rawpy.imread(str(path)) as raw:
        return np.asarray(raw.postprocess(**{**LINEAR, **settings}))  # type: ignore[arg-type]


def test_samples_agree_with_libraws_own_where_it_does_no_harm(tmp_path: Path) -> None:
    """Levels well above black, nothing scaled: another route to the same numbers."""
    image = sensor(64, 96)
    write_dng(tmp_path / "a.dng", image)
    red, green1, green2, blue = read_raw(tmp_path / "a.dng").planes
    theirs = developed(tmp_path / "a.dng", no_auto_scale=True, adjust_maximum_thr=0.0)
    assert np.array_equal(theirs[..., 0], red)
    assert np.array_equal(theirs[..., 2], blue)
    assert np.abs(theirs[..., 1] - (green1 + green2) / 2.0).max() <= 1.0
