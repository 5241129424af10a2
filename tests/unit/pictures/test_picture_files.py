"""Pictures and image files, read back by programs other than the one that wrote them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import ConfigError, DecodeError, NoSpaceError, PdcdError
from pdcd.pictures.written.picture_files import draw_value_table, read_tiff, write_png, write_tiff


def test_numbers_become_grey_squares() -> None:
    table = np.array([[0.0, 0.5, 1.0, 0.2], [-5.0, 7.0, np.nan, np.inf]])
    small = draw_value_table(table, min_width_px=1)
    assert small[..., 0].tolist() == [[0, 128, 255, 51], [0, 255, 0, 255]]
    assert (small == small[..., :1]).all() and small.dtype == np.uint8


@settings(max_examples=25)
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
    """One strip, strips of several rows and of one row, and more bytes than a short number has."""
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
