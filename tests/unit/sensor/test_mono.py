"""Photos of sensors without colours: one plane, written here and by others."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
from msgspec import structs

from pdcd.bench.tables import CameraConfig
from pdcd.sensor.colours import compute_colour_variance, to_colours
from pdcd.sensor.dng import write_dng
from pdcd.sensor.profile import (
    NOMINAL_RESPONSIVITY_E,
    compute_variance_dn2,
    load_profile,
    responsivity_e,
    weigh_colours,
)
from pdcd.sensor.raw import read_raw, read_raw_head
from tests.form_dng import BYTE, SHORT, DngFile, write_dng_form
from tests.tools import needs, program

SHAPE = (46, 66)
RNG = np.random.default_rng(7)
SAMPLES = RNG.integers(70, 3900, SHAPE, np.uint16)
LINEAR = {262: (SHORT, [34892])}
PLAIN = DngFile(bits=16, more=LINEAR)


def own(path: Path, samples: Any = SAMPLES) -> Path:
    write_dng(path, samples, cfa=None, black=64, white=4095, iso=200, exposure_s=0.5, model="Grey")
    return path


@pytest.mark.parametrize("shape", [SHAPE, (22, 22), (5, 7), (1, 1)])
def test_what_is_written_comes_back_sample_by_sample(tmp_path: Path, shape: Any) -> None:
    samples = SAMPLES[: shape[0], : shape[1]]
    frame = read_raw(own(tmp_path / "a.dng", samples))
    assert np.array_equal(frame.samples, samples[None]) and frame.samples.dtype == np.uint16
    assert (frame.colours, frame.pattern, frame.frame) == (1, "", shape)
    assert (frame.black.tolist(), frame.white, frame.iso, frame.doubts) == ([64.0], 4095.0, 200, ())
    head = read_raw_head(tmp_path / "a.dng")
    assert (head.frame, head.colours) == (shape, 1)


def test_other_programs_read_the_same(tmp_path: Path) -> None:
    path = own(tmp_path / "a.dng")
    with rawpy.imread(str(path)) as raw:
        assert raw.num_colors == 1 and np.array_equal(raw.raw_image, SAMPLES)
        assert (raw.white_level, raw.black_level_per_channel) == (4095, [64] * 4)
    tifffile = pytest.importorskip("tifffile")
    assert np.array_equal(tifffile.imread(path), SAMPLES)


@needs("dcraw")
def test_dcraw_reads_the_same(tmp_path: Path) -> None:
    dcraw = program("dcraw")
    path = own(tmp_path / "a.dng")
    told = subprocess.run([dcraw, "-D", "-4", "-c", path], capture_output=True, check=True).stdout
    magic, width, height, most = told.split(maxsplit=4)[:4]
    assert (magic, int(width), int(height), int(most)) == (b"P5", *SHAPE[::-1], 65535)
    found = np.frombuffer(told[-2 * SAMPLES.size :], ">u2").reshape(SHAPE)
    assert np.array_equal(found, SAMPLES)


@pytest.mark.parametrize(
    "file",
    [
        PLAIN,
        replace(PLAIN, bits=12),
        replace(PLAIN, packing=7),
        replace(PLAIN, order=">", strip_rows=9),
        replace(PLAIN, packing=7, tile=(16, 32)),
        replace(PLAIN, bits=32, floating=True, packing=8, predictor=3),
    ],
)
@pytest.mark.parametrize("active", [None, (3, 5, 43, 64)])
def test_files_of_others_are_read(tmp_path: Path, file: DngFile, active: Any) -> None:
    """In any packing, and from any sample on: an odd row or column begins no other colour."""
    write_dng_form(tmp_path / "a.dng", SAMPLES, replace(file, active=active))
    frame = read_raw(tmp_path / "a.dng")
    top, left, bottom, right = active or (0, 0, *SHAPE)
    assert np.array_equal(frame.samples, SAMPLES[None, top:bottom, left:right])
    assert (frame.colours, frame.black.tolist(), frame.white) == (1, [256.0], 4095.0)


def test_black_differs_from_sample_to_sample(tmp_path: Path) -> None:
    """The specification's sum, in plain numbers: a pattern, and a number for each row."""
    down = [0.25 * (row % 5) for row in range(SHAPE[0])]
    file = replace(PLAIN, black=((250.0, 254.0), (258.0, 262.5)), down=down)
    write_dng_form(tmp_path / "a.dng", SAMPLES, file)
    frame = read_raw(tmp_path / "a.dng")
    black = np.empty(SHAPE)
    for row in range(SHAPE[0]):
        for column in range(SHAPE[1]):
            black[row, column] = file.black[row % 2][column % 2] + down[row]
    np.testing.assert_allclose(frame.planes[0], SAMPLES - black, atol=1e-3)
    assert frame.black == pytest.approx([black.mean()])


def test_black_is_that_of_a_masked_border(tmp_path: Path) -> None:
    image = SAMPLES.copy()
    image[:, :9] = 301 + (np.arange(SHAPE[0] * 9).reshape(-1, 9) % 3)
    file = replace(PLAIN, active=(0, 9, *SHAPE), masked=(0, 0, SHAPE[0], 9), black=((300.0,),))
    write_dng_form(tmp_path / "a.dng", image, file)
    frame = read_raw(tmp_path / "a.dng")
    assert frame.masked and frame.black == pytest.approx([302.0], abs=0.01)


def test_three_planes_of_colours_that_are_made_are_none(tmp_path: Path) -> None:
    file = replace(PLAIN, more=LINEAR | {277: (SHORT, [3]), 33422: (BYTE, [0, 1, 1, 2])})
    write_dng_form(tmp_path / "a.dng", SAMPLES, file)
    with pytest.raises(Exception, match="a linear DNG, whose colours are made already"):
        read_raw(tmp_path / "a.dng")


def test_grey_is_one_number_with_the_noise_of_one_sample() -> None:
    body = load_profile("mono")
    planes = RNG.uniform(0.0, 3000.0, (1, 4, 5)).astype(np.float32)
    light = to_colours(planes, (2.0,))
    assert light.shape == (4, 5, 1)
    np.testing.assert_allclose(light[..., 0], 2.0 * planes[0])
    wanted = 4.0 * compute_variance_dn2(planes[0], body, 100, 0.5)
    for dtype in (np.float64, np.float32):
        found = compute_colour_variance(planes, body, 100, 0.5, (2.0,), dtype)
        np.testing.assert_allclose(found[..., 0], wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("end", "count", "ends"), [(4080, 40, True), (4080, 15, False), (3600, 40, False)]
)
def test_samples_that_end_below_white_are_saturated(
    tmp_path: Path, end: int, count: int, ends: bool
) -> None:
    samples = SAMPLES // 2
    samples.ravel()[: 7 * count : 7] = end
    frame = read_raw(own(tmp_path / "a.dng", samples))
    assert np.array_equal(frame.saturated, (samples == end) & ends)
    said = ("samples end at 4080, below white 4095: these count as saturated",)
    assert frame.doubts == said * ends and frame.white == 4095.0


def test_a_sensor_without_colours_sees_their_mean_by_what_filters_let_through() -> None:
    body, camera = load_profile("mono"), CameraConfig()
    assert body.colours == 1 and load_profile("modern").colours == 3
    assert responsivity_e(camera, 1).tolist() == [sum(NOMINAL_RESPONSIVITY_E)]
    light = RNG.random((2, 3, 3))
    electrons = (light * responsivity_e(camera)).sum(axis=-1)
    np.testing.assert_allclose(
        weigh_colours(light, 1)[..., 0] * responsivity_e(camera, 1), electrons
    )
    assert weigh_colours(light, 3) is light
    np.testing.assert_allclose(weigh_colours(np.ones((1, 3)), 1), [[1.0]])  # white is white


def test_a_file_is_bounded_by_samples_and_not_by_quads_of_four() -> None:
    grey = structs.replace(load_profile("mono"), frame_quads=(4096, 3000))
    colour = structs.replace(grey, mono=False)
    pixels, picture_bytes = 4096 * 3000, 64 << 20
    assert grey.largest_photo_bytes == 4 * pixels + picture_bytes  # twice what is not packed
    assert colour.largest_photo_bytes == 16 * pixels + picture_bytes
