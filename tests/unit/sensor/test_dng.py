"""The mock's DNG files as LibRaw, dcraw and exiftool read them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from tests.dng_file import write_dng
from tests.tools import needs, program


def random_mosaic(height: int, width: int, seed: int = 0) -> NDArray[np.uint16]:
    """14-bit samples; the corners hold the lowest and the highest value."""
    mosaic = np.random.default_rng(seed).integers(0, 16384, (height, width)).astype(np.uint16)
    mosaic[0, 0], mosaic[-1, -1] = 16383, 0
    return mosaic


def test_libraw_reads_levels_pattern_and_exposure(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    write_dng(path, random_mosaic(48, 64), as_shot_neutral=(0.5, 1.0, 0.8))
    with rawpy.imread(str(path)) as raw:
        assert raw.black_level_per_channel == [512] * 4
        assert raw.white_level == 16383
        assert raw.raw_pattern is not None
        assert "".join("RGBG"[index] for index in raw.raw_pattern.ravel()) == "RGGB"
        assert raw.other.shutter_speed == pytest.approx(25.6, rel=1e-6)
        assert raw.other.iso_speed == 100
        assert raw.other.aperture == pytest.approx(8.0, rel=1e-6)
        assert raw.sizes.flip == 0
        assert raw.camera_whitebalance[:3] == pytest.approx([2.0, 1.0, 1.25])


@needs("dcraw")
@pytest.mark.parametrize(("height", "width"), [(48, 64), (22, 30), (100, 24)])
def test_dcraw_reads_the_same_mosaic(tmp_path: Path, height: int, width: int) -> None:
    path = tmp_path / "a.dng"
    mosaic = random_mosaic(height, width)
    write_dng(path, mosaic)
    command = [program("dcraw"), "-4", "-D", "-c", str(path)]
    pgm = subprocess.run(command, capture_output=True, check=True).stdout
    magic, size, _, samples = pgm.split(b"\n", 3)
    assert magic == b"P5"
    assert size.split() == [str(width).encode(), str(height).encode()]
    assert np.array_equal(np.frombuffer(samples, ">u2").reshape(height, width), mosaic)


@needs("exiftool")
def test_exiftool_reads_the_tags_and_finds_no_fault(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    write_dng(path, random_mosaic(48, 64), exposure_s=30 / 512, model="Caméra 1")
    command = [program("exiftool"), "-j", "-n", "-validate", "-warning", "-a", str(path)]
    (verdict,) = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert verdict["Validate"] in ("0 0 0", "OK"), verdict
    command = [program("exiftool"), "-j", "-n", str(path)]
    (tags,) = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    expected = {
        "ImageWidth": 64,
        "ImageHeight": 48,
        "BlackLevel": "512 512 512 512",
        "WhiteLevel": 16383,
        "CFAPattern": "2 2 0 1 1 2",
        "ExposureTime": 30 / 512,
        "ISO": 100,
        "FNumber": 8,
        "Model": "Cam?ra 1",
        "DateTimeOriginal": "2024:01:02 03:04:05",
        "DefaultCropSize": "64 48",
    }
    assert {name: tags.get(name) for name in expected} == expected


@pytest.mark.parametrize(
    "mosaic",
    [
        np.zeros((3, 4), np.uint16),
        np.zeros((4, 5), np.uint16),
        np.zeros((0, 4), np.uint16),
        np.zeros((4, 4, 1), np.uint16),
        np.zeros((4, 4), np.float64),
    ],
)
def test_other_than_whole_quads_are_refused(tmp_path: Path, mosaic: NDArray[Any]) -> None:
    with pytest.raises(ConfigError, match="mosaic"):
        write_dng(tmp_path / "a.dng", mosaic)
    assert not (tmp_path / "a.dng").exists()


@pytest.mark.parametrize(
    "changes",
    [
        {"exposure_s": value} for value in (float("nan"), float("inf"), -1.0, None, "1")
    ] + [{"f_number": value} for value in (float("nan"), -8.0, 0.0, "8")] + [
        {"iso": value} for value in (100.0, None, -1, 70000)
    ] + [{"white": value} for value in (-3, 0, 512, 15000.5, 2**33, float("nan"))] + [
        {"black": value} for value in (2048.5, -1, 16383, 70000, None, (1, 2), np.array([0.5] * 4))
    ] + [{"cfa": "RGBW"}, {"cfa": None, "black": [1, 2, 3, 4]}],
    ids=repr,
)  # fmt: skip
def test_what_no_photo_was_taken_with_is_refused_for_the_camera(
    changes: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as told:
        write_dng(tmp_path / "a.dng", random_mosaic(24, 32), **changes)
    assert told.value.device == "camera" and told.value.hint
    assert not (tmp_path / "a.dng").exists()


def test_numbers_of_other_kinds_are_numbers(tmp_path: Path) -> None:
    plain = tmp_path / "plain.dng"
    write_dng(plain, random_mosaic(24, 32), exposure_s=1.5, iso=100, white=16383, black=(512,) * 4)
    numpys = tmp_path / "numpys.dng"
    write_dng(
        numpys, random_mosaic(24, 32), exposure_s=np.float32(1.5), iso=np.int64(100),
        white=np.uint16(16383), black=np.array([512] * 4),
    )  # fmt: skip
    assert numpys.read_bytes() == plain.read_bytes()
