"""Exported files, read by the programs that they are for."""

from __future__ import annotations

import io
import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import PIL.Image
import pytest
import tifffile
from numpy.typing import NDArray

from pdcd.pictures.written.export import exr_bytes, png_bytes, tiff_bytes
from tests.tools import needs, program

TOLD = {"job": "20260101T000000Z-beef", "units": "scene units: white is 1", "scale": "1"}
SIZES = [(1, 1), (3, 2), (17, 31)]


def floats(size: tuple[int, int]) -> NDArray[np.float32]:
    """Smooth light with noise, and values that only floats can hold."""
    height, width = size
    ramp = np.linspace(0.0, 2.0, height * width * 3).reshape(height, width, 3)
    made = (ramp + 1e-3 * np.random.default_rng(0).standard_normal(ramp.shape)).astype(np.float32)
    if made.size > 12:
        made.ravel()[:6] = (-1.5, np.nan, np.inf, -np.inf, 1e-42, 3e38)
    return made


def words(size: tuple[int, int]) -> NDArray[np.uint16]:
    made = np.random.default_rng(1).integers(0, 65536, (*size, 3)).astype(np.uint16)
    made[0, 0] = (65535, 1, 0)
    return made


@pytest.mark.parametrize("size", SIZES)
def test_openexr_reads_every_value_back(size: tuple[int, int], tmp_path: Path) -> None:
    image = floats(size)
    path = tmp_path / "a.exr"
    path.write_bytes(exr_bytes(image, TOLD))
    with OpenEXR.File(str(path)) as file:
        found = file.channels()["RGB"].pixels
        head = dict(file.header())
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found.view(np.uint32), image.view(np.uint32))
    assert {name: head[name] for name in TOLD} == TOLD
    assert head["compression"] == OpenEXR.ZIP_COMPRESSION


@pytest.mark.parametrize("size", SIZES)
def test_tifffile_pillow_and_opencv_read_the_tiff(size: tuple[int, int]) -> None:
    image = words(size)
    data = tiff_bytes(image, TOLD, "pdcd 9")
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        page = file.pages.first
        assert len(file.pages) == 1
        assert np.array_equal(page.asarray(), image)
        assert page.description.splitlines() == [f"{name}: {text}" for name, text in TOLD.items()]
        assert page.software == "pdcd 9"
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert seen is not None and seen.dtype == np.uint16
    assert np.array_equal(seen[..., ::-1], image)
    with PIL.Image.open(io.BytesIO(data)) as picture:  # which knows 8 bits of a colour only
        assert picture.mode == "RGB"
        assert np.array_equal(np.asarray(picture), image >> 8)


@pytest.mark.parametrize("size", SIZES)
def test_opencv_and_pillow_read_the_png(size: tuple[int, int]) -> None:
    image = words(size)
    data = png_bytes(image, TOLD, "pdcd 9")
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert seen is not None and seen.dtype == np.uint16
    assert np.array_equal(seen[..., ::-1], image)
    with PIL.Image.open(io.BytesIO(data)) as picture:
        picture.load()
        assert picture.size == size[::-1]
        assert picture.info == {**TOLD, "Software": "pdcd 9", "gamma": 1.0}


def test_text_that_is_not_ascii_is_escaped() -> None:
    told = {"goal": "größe"}
    for data in (tiff_bytes(words((2, 2)), told, "p"), png_bytes(words((2, 2)), told, "p")):
        assert b"gr\\xf6\\xdfe" in data


@needs("exiftool")
def test_exiftool_finds_nothing_wrong(tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_bytes(exr_bytes(floats((17, 31)), TOLD))
    (tmp_path / "a.tiff").write_bytes(tiff_bytes(words((17, 31)), TOLD, "pdcd 9"))
    (tmp_path / "a.png").write_bytes(png_bytes(words((17, 31)), TOLD, "pdcd 9"))
    files = sorted(map(str, tmp_path.iterdir()))
    command = [program("exiftool"), "-j", "-validate", "-warning", "-all", *files]
    told = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert [one["FileType"] for one in told] == ["EXR", "PNG", "TIFF"]
    for one in told:
        assert one["ImageSize"] == "31x17" and one.get("Software", "pdcd 9") == "pdcd 9"
        assert "Error" not in one and str(one["Validate"]) in ("OK", "0 0 0"), one
    assert told[0]["Job"] == told[1]["Job"] == TOLD["job"]
    assert TOLD["units"] in told[2]["ImageDescription"]
