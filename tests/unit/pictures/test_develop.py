"""Pictures and image files, read back by programs other than the one that wrote them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from pdcd.errors import ConfigError, DecodeError, NoSpaceError, PdcdError
from pdcd.pictures.written.develop import blocks, read_tiff, warp, write_png, write_tiff
from tests.tools import needs, program


def test_numbers_become_grey_squares() -> None:
    table = np.array([[0.0, 0.5, 1.0, 0.2], [-5.0, 7.0, np.nan, np.inf]])
    small = blocks(table, min_width_px=1)
    assert small[..., 0].tolist() == [[0, 128, 255, 51], [0, 255, 0, 255]]
    assert (small == small[..., :1]).all() and small.dtype == np.uint8


@pytest.mark.parametrize(
    ("width", "min_width_px", "expected"), [(64, 640, 640), (60, 640, 660), (700, 640, 700)]
)
def test_small_tables_are_enlarged_in_blocks(width: int, min_width_px: int, expected: int) -> None:
    table = np.random.default_rng(0).uniform(0.0, 1.0, (2, width))
    small = blocks(table, min_width_px=1)
    large = blocks(table, min_width_px=min_width_px)
    factor = expected // width
    assert large.shape == (2 * factor, expected, 3)
    for row, column in ((0, 0), (factor - 1, factor - 1)):
        assert np.array_equal(large[row::factor, column::factor], small)


def test_png_can_be_viewed_with_its_colours_in_order(tmp_path: Path) -> None:
    picture = np.random.default_rng(1).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    picture[0, 0] = (255, 128, 0)
    write_png(tmp_path / "a.png", picture)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), picture)


@needs("exiftool")
def test_tiff_holds_plain_rgb_floats(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    image = np.random.default_rng(2).standard_normal((48, 64, 3)).astype(np.float32)
    write_tiff(path, image)
    command = [program("exiftool"), "-j", "-n", str(path)]
    (tags,) = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert (tags["PhotometricInterpretation"], tags["Compression"]) == (2, 1)
    assert str(tags["BitsPerSample"]) == "32 32 32"
    assert set(str(tags["SampleFormat"]).split()) == {"3"}
    offsets = [int(n) for n in str(tags["StripOffsets"]).split()]
    counts = [int(n) for n in str(tags["StripByteCounts"]).split()]
    data = path.read_bytes()
    strips = b"".join(data[o : o + n] for o, n in zip(offsets, counts, strict=True))
    assert np.array_equal(np.frombuffer(strips, "<f4").reshape(48, 64, 3), image)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    value=st.floats(width=32, allow_nan=True, allow_infinity=True),
)
def test_tiff_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, height: int, width: int, value: float
) -> None:
    path = tmp_path_factory.mktemp("tiff") / "a.tiff"
    image = np.random.default_rng(3).standard_normal((height, width, 3)).astype(np.float32)
    image[-1, 0, 2] = value
    write_tiff(path, image)
    back = read_tiff(path)
    assert back.dtype == np.float32
    assert np.array_equal(back, image, equal_nan=True)


@pytest.mark.parametrize(
    "shape",
    [(1, 1), (1, 9), (9, 1), (2, 682), (3, 342), (48, 64), (49, 65), (2, 5461), (2, 5462)],
)
def test_tiff_has_the_bytes_of_libtiff(tmp_path: Path, shape: tuple[int, int]) -> None:
    """One strip, strips of several rows, of one row, and of more bytes than a short number holds:
    runs of earlier versions, which libtiff wrote, are compared with decodings byte by byte."""
    image = np.random.default_rng(6).standard_normal((*shape, 3)).astype(np.float32)
    image[0, 0] = (np.nan, -np.inf, 0.0)
    flags = [cv2.IMWRITE_TIFF_COMPRESSION, 1]
    _, data = cv2.imencode(".tiff", np.ascontiguousarray(image[..., ::-1]), flags)
    write_tiff(tmp_path / "a.tiff", np.asfortranarray(image))
    assert (tmp_path / "a.tiff").read_bytes() == data.tobytes()


@pytest.mark.parametrize("keep", [0, 8, 1000, -1])
def test_truncated_tiff_is_refused(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "a.tiff"
    write_tiff(path, np.ones((48, 64, 3), np.float32))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DecodeError, match=r"a\.tiff"):
        read_tiff(path)


def test_picture_in_place_of_a_tiff_is_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(DecodeError, match="float32"):
        read_tiff(tmp_path / "a.png")


def test_missing_tiff(tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match="cannot read"):
        read_tiff(tmp_path / "none.tiff")


def test_full_disk_is_reported() -> None:
    with pytest.raises(NoSpaceError, match="disk is full"):
        write_png(Path("/dev/full"), np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(NoSpaceError, match="disk is full"):
        write_tiff(Path("/dev/full"), np.zeros((4, 4, 3), np.float32))


def test_unwritable_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(PdcdError, match="cannot write") as told:
        write_png(tmp_path / "none" / "a.png", np.zeros((4, 4, 3), np.uint8))
    assert told.value.kind != "config"  # a disk that refuses is no fault of the configuration


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 4), (0, 4, 3)])
def test_other_shapes_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError, match="shape"):
        write_tiff(tmp_path / "a.tiff", np.zeros(shape, np.float32))


def test_warp_by_whole_pixels_moves_them_exactly() -> None:
    image = np.random.default_rng(4).standard_normal((6, 9, 3))
    assert np.array_equal(warp(image, np.eye(3), (9, 6)), image)
    moved = warp(image, [[1, 0, 2], [0, 1, 1], [0, 0, 1]], (9, 6))
    assert np.array_equal(moved[1:, 2:], image[:-1, :-2])
    assert not moved[0].any()
    assert not moved[:, :2].any()


def test_warp_rotates_and_flips() -> None:
    image = np.random.default_rng(5).standard_normal((6, 9, 3))
    turned = warp(image, [[0, 1, 0], [-1, 0, 8], [0, 0, 1]], (6, 9))
    assert turned == pytest.approx(np.rot90(image), abs=1e-12)
    flipped = warp(image, [[-1, 0, 8], [0, 1, 0], [0, 0, 1]], (9, 6))
    assert flipped == pytest.approx(image[:, ::-1], abs=1e-12)


def test_warp_of_a_plane_by_a_perspective() -> None:
    """A linear brightness ramp follows the homography, up to its steps of 1/32 pixel."""
    matrix = np.array([[1.1, 0.05, 3.0], [0.02, 0.95, 1.0], [2e-4, 1e-4, 1.0]])
    rows, columns = np.mgrid[0:60, 0:80].astype(np.float64)
    warped = warp(columns + 2.0 * rows, matrix, (80, 60))
    for row, column in ((10, 20), (30, 40), (50, 70)):
        x, y, scale = np.linalg.solve(matrix, (column, row, 1.0))
        assert warped[row, column] == pytest.approx(x / scale + 2.0 * y / scale, abs=3 / 32)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.eye(2), np.full((3, 3), np.nan)])
def test_warp_refuses_what_cannot_be_inverted(matrix: NDArray[np.float64]) -> None:
    with pytest.raises(ConfigError, match="invertible"):
        warp(np.zeros((4, 4, 3)), matrix, (4, 4))
