"""Decoding: the mosaic comes back signed and in order, and a bad file never passes for a photo."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import DecodeError
from pdcd.sensor.profile import expose_sensor, load_profile
from pdcd.sensor.raw import RawFrame, read_raw
from tests.dng_file import write_dng

BLACK, WHITE = 512, 16383
SIDES = st.integers(1, 30).map(lambda quads: 2 * quads)


@pytest.fixture
def dng(tmp_path: Path) -> Path:
    path = tmp_path / "a.dng"
    mosaic = np.random.default_rng(0).integers(0, WHITE + 1, (48, 64)).astype(np.uint16)
    write_dng(path, mosaic)
    return path


@settings(max_examples=50)
@given(height=SIDES, width=SIDES, seed=st.integers(0, 1000))
def test_planes_are_the_mosaic_minus_black(
    tmp_path_factory: pytest.TempPathFactory, height: int, width: int, seed: int
) -> None:
    path = tmp_path_factory.mktemp("raw") / "a.dng"
    rng = np.random.default_rng(seed)
    mosaic = rng.integers(0, WHITE + 1, (height, width)).astype(np.uint16)
    frame = read_raw(path, size_bytes=write_dng(path, mosaic))
    back = np.empty((height, width))
    back[0::2, 0::2], back[0::2, 1::2], back[1::2, 0::2], back[1::2, 1::2] = frame.planes
    assert frame.planes.dtype == np.float32
    assert np.array_equal(back + BLACK, mosaic)
    assert frame.doubts == ()  # LibRaw reads the same


def test_metadata_comes_from_the_file(dng: Path) -> None:
    frame = read_raw(dng)
    assert (frame.iso, frame.exposure_s, frame.f_number) == (100, 25.6, 8.0)
    assert (frame.model, frame.pattern, frame.white) == ("test camera", "RGGB", WHITE)
    assert frame.black.tolist() == [BLACK] * 4


def patched(path: Path, old: bytes, new: bytes) -> Path:
    data = path.read_bytes()
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))
    return path


def cfa_entry(*colours: int) -> bytes:
    """The directory entry of the tag CFAPattern."""
    return struct.pack("<HHI4B", 33422, 1, 4, *colours)


@pytest.mark.parametrize(
    ("pattern", "cfa", "positions"),
    [
        ("RGGB", (0, 1, 1, 2), [(0, 0), (0, 1), (1, 0), (1, 1)]),
        ("BGGR", (2, 1, 1, 0), [(1, 1), (1, 0), (0, 1), (0, 0)]),
        ("GRBG", (1, 0, 2, 1), [(0, 1), (0, 0), (1, 1), (1, 0)]),
        ("GBRG", (1, 2, 0, 1), [(1, 0), (1, 1), (0, 0), (0, 1)]),
    ],
)
def test_every_bayer_order_gives_r_g1_g2_b(
    tmp_path: Path, pattern: str, cfa: tuple[int, ...], positions: list[tuple[int, int]]
) -> None:
    path = tmp_path / "a.dng"
    mosaic = np.random.default_rng(1).integers(0, 16384, (24, 30)).astype(np.uint16)
    write_dng(path, mosaic)
    frame = read_raw(patched(path, cfa_entry(0, 1, 1, 2), cfa_entry(*cfa)))
    assert frame.pattern == pattern
    for plane, (row, column) in zip(frame.planes, positions, strict=True):
        assert np.array_equal(plane + BLACK, mosaic[row::2, column::2])


def test_other_colours_than_bayer_are_refused(dng: Path) -> None:
    with pytest.raises(DecodeError, match="Bayer"):
        read_raw(patched(dng, cfa_entry(0, 1, 1, 2), cfa_entry(0, 1, 2, 1)))


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_one_saturated_sample_marks_its_quad(tmp_path: Path, row: int, column: int) -> None:
    path = tmp_path / "a.dng"
    mosaic = np.full((24, 24), WHITE - 1, np.uint16)
    mosaic[6 + row, 10 + column] = WHITE
    write_dng(path, mosaic)
    expected = np.zeros((12, 12), bool)
    expected[3, 5] = True
    assert np.array_equal(read_raw(path).saturated, expected)


def test_noise_below_black_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    mark2 = load_profile("mark2")
    write_dng(
        path, expose_sensor(np.zeros((400, 400)), mark2, 1600, 30.0, np.random.default_rng(4))
    )
    planes = read_raw(path).planes.astype(np.float64)
    assert 0.45 < np.mean(planes < 0.0) < 0.55
    assert abs(planes.mean()) < 4 * planes.std() / np.sqrt(planes.size)


def test_one_lost_byte_is_noticed_by_the_announced_size(dng: Path) -> None:
    data = dng.read_bytes()
    dng.write_bytes(data[:-1])
    with pytest.raises(DecodeError, match=f"{len(data) - 1} bytes, not {len(data)}"):
        read_raw(dng, size_bytes=len(data))


def test_squares_of_quads_are_means_without_dead_ones_and_unknown_with_a_full_one() -> None:
    rng = np.random.default_rng(8)
    samples = rng.integers(900, 4000, (4, 6, 8)).astype(np.uint16)
    saturated = np.zeros((6, 8), np.bool_)
    saturated[0, 1] = True  # one of four
    saturated[2:4, 2] = True  # two of four
    saturated[4, 4] = saturated[5, 4] = saturated[5, 5] = True  # three of four
    dead = saturated.copy()
    saturated[0, 6] = True  # one of four, and by light
    samples[:, saturated] = 16000
    black = np.array([1000.25, 1001.0, 1002.5, 999.0])
    frame = RawFrame(
        samples, saturated, black, black, True, 15000.0, 100, 1.0, 8.0, "", "", 0, "RGGB"
    )
    coarse = frame.binned(2, dead)
    assert coarse.frame == (3, 4) and coarse.side == 2
    wanted = np.zeros((3, 4), np.bool_)
    wanted[2, 2] = wanted[0, 3] = True
    np.testing.assert_array_equal(coarse.saturated, wanted)
    wanted[0, 0] = wanted[1, 1] = True
    np.testing.assert_array_equal(frame.binned(2).saturated, wanted)
    light = np.where(saturated, np.nan, frame.planes.astype(np.float64))
    light = np.nanmean(light.reshape(4, 3, 2, 4, 2), axis=(2, 4))
    np.testing.assert_allclose(coarse.planes, light, rtol=1e-5)
    assert frame.side == 1 and frame.frame == (6, 8)
