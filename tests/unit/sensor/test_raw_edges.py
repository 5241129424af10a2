"""RAW files at their edges: heads, checks before decoding, small borders, squares of quads."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy

from pdcd.errors import ConfigError, DecodeError
from pdcd.sensor.colours import compute_colour_variance, to_colours
from pdcd.sensor.profile import compute_variance_dn2, load_profile
from pdcd.sensor.raw import RawFrame, RawHead, read_raw, read_raw_head, shrink_image
from tests.masked_dng import write_masked_dng

BLACK = np.array([500.0, 510.0, 520.0, 530.0])


def frame(samples: np.ndarray, saturated: np.ndarray | None = None, **fields: Any) -> RawFrame:
    if saturated is None:
        saturated = np.zeros(samples.shape[1:], np.bool_)
    said = {"masked": False, "flip": 0, "side": 1} | fields
    return RawFrame(
        samples=samples, saturated=saturated, black=BLACK, libraw_black=BLACK - 1.0,
        masked=said["masked"], white=15000.0, iso=200, exposure_s=1.5, f_number=5.6, model="m",
        date="d", flip=said["flip"], pattern="RGGB", side=said["side"],
    )  # fmt: skip


def dng(path: Path, shape: tuple[int, int] = (82, 100), **given: Any) -> np.ndarray:
    image = np.random.default_rng(0).integers(600, 14000, shape).astype(np.uint16)
    write_masked_dng(path, image, **{"active": (8, 20, *shape), **given})
    return image


@pytest.mark.parametrize(("masked", "said"), [(True, "masked border"), (False, "LibRaw")])
def test_what_a_manifest_keeps(masked: bool, said: str) -> None:
    assert frame(np.zeros((4, 1, 1), np.uint16), masked=masked, flip=6).exif() == {
        "model": "m", "date": "d", "iso": 200, "exposure_s": 1.5, "f_number": 5.6, "flip": 6,
        "black_dn": [500.0, 510.0, 520.0, 530.0], "black_from": said,
        "libraw_black_dn": [499.0, 509.0, 519.0, 529.0], "white_dn": 15000.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "active", "masked"),
    [
        ((82, 100), (8, 20, 82, 100), (8, 20)),
        ((60, 80), (0, 0, 60, 80), (0, 0)),
        ((60, 80), (2, 0, 58, 76), (4, 4)),
    ],
)
def test_a_head_tells_the_size_of_the_picture(
    tmp_path: Path, shape: tuple[int, int], active: tuple[int, ...], masked: tuple[int, int]
) -> None:
    path = tmp_path / "a.dng"
    dng(path, shape, active=active, orientation=8)
    head = read_raw_head(path)
    rows, cols = active[2] - active[0], active[3] - active[1]
    assert head == RawHead(
        (rows // 2, cols // 2), flip=5, model="test camera", masked=masked, exposure_s=0.6,
        iso=100, f_number=8.0,
    )  # fmt: skip
    raw = read_raw(path)
    assert (raw.frame, raw.iso, raw.f_number) == (head.frame, head.iso, head.f_number)


@pytest.mark.parametrize(("rows", "cols"), [(31, 40), (30, 41), (33, 37)])
def test_the_last_row_or_column_of_an_odd_number_is_left_out(
    tmp_path: Path, rows: int, cols: int
) -> None:
    path = tmp_path / "a.dng"
    image = dng(path, (34, 42), active=(0, 0, rows, cols))
    raw = read_raw(path)
    assert raw.frame == read_raw_head(path).frame == (rows // 2, cols // 2)
    even = image[: rows // 2 * 2, : cols // 2 * 2].astype(np.float64) - 512.0
    np.testing.assert_array_equal(raw.planes[3], even[1::2, 1::2])


@pytest.mark.parametrize("read", [read_raw, read_raw_head])
def test_a_file_is_checked_before_it_is_decoded(tmp_path: Path, read: Any) -> None:
    path = tmp_path / "a.dng"
    dng(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert read(path, sha256=digest).frame == read(path, sha256=digest.upper()).frame
    with pytest.raises(DecodeError) as caught:
        read(path, sha256="0" * 64)
    assert caught.value.message == "a.dng does not have the SHA-256 it was fetched with"
    assert caught.value.hint == "fetch it from the camera again"
    for name in ("none.dng", ""):
        with pytest.raises(DecodeError, match=r"cannot read .*: "):
            read(tmp_path / name)
    (tmp_path / "b.dng").write_bytes(b"no photo at all" * 99)
    with pytest.raises(DecodeError, match=r"cannot decode b\.dng: ") as caught:
        read(tmp_path / "b.dng")
    assert caught.value.hint and "fetch it" in caught.value.hint


@pytest.mark.parametrize(
    ("fault", "words"),
    [(MemoryError(), "MemoryError"), (rawpy.LibRawError(b"Input/output"), "Input/output")],
)
def test_what_the_decoder_raises_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception, words: str
) -> None:
    def fails(*_: Any) -> None:
        raise fault

    dng(tmp_path / "a.dng")
    monkeypatch.setattr(rawpy, "imread", fails)
    with pytest.raises(DecodeError, match=f"cannot decode a.dng: {words}"):
        read_raw(tmp_path / "a.dng")


@pytest.mark.parametrize(("columns", "masked"), [(16, True), (15, False), (14, False)])
def test_black_is_taken_from_64_samples_of_each_colour(
    tmp_path: Path, columns: int, masked: bool
) -> None:
    image = np.random.default_rng(0).integers(600, 14000, (48, 64)).astype(np.uint16)
    image[:16, :columns] = 700
    write_masked_dng(tmp_path / "a.dng", image, active=(0, 16, 48, 64), masked=(0, 0, 16, columns))
    raw = read_raw(tmp_path / "a.dng")
    assert raw.masked is masked
    assert (raw.black is raw.libraw_black) is not masked


def test_white_and_a_lower_level_count_from_black_on(tmp_path: Path) -> None:
    image = np.full((48, 64), 600, np.uint16)
    image[:, :16] = 500
    image[0, 16:22] = [16382, 600, 16383, 600, 1500, 600]
    write_masked_dng(
        tmp_path / "a.dng", image, active=(0, 16, 48, 64), masked=(0, 0, 48, 16), black=512
    )
    assert read_raw(tmp_path / "a.dng").saturated[0, :4].tolist() == [False, True, False, False]
    low = read_raw(tmp_path / "a.dng", saturation_dn=1000.0)
    assert low.saturated[0, :4].tolist() == [True, True, True, False]
    assert low.saturated.sum() == 3
    assert low.white == 16383.0 and low.black.tolist() == [500.0] * 4


def test_colours_are_weighed_one_by_one() -> None:
    planes = np.array([1.0, 2.0, 6.0, 5.0], np.float32).reshape(4, 1, 1) * np.ones((1, 2, 3))
    rgb = to_colours(planes.astype(np.float32), (2.0, 3.0, 0.5))
    assert rgb.shape == (2, 3, 3) and rgb[0, 0].tolist() == [2.0, 12.0, 2.5]
    assert rgb[..., 1].flags.c_contiguous


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_variance_of_a_colour_is_that_of_its_samples(dtype: Any) -> None:
    mark2 = load_profile("mark2")
    signals = (100.0, -3.0, 60.0, 500.0)
    planes = np.array(signals, np.float32).reshape(4, 1, 1) * np.ones((1, 2, 3), np.float32)
    red, green, more, blue = (float(compute_variance_dn2(dn, mark2, 50, 20.0)) for dn in signals)
    found = compute_colour_variance(planes, mark2, 50, 20.0, (2.0, 3.0, 0.5), dtype)
    assert found.dtype == dtype and found.shape == (2, 3, 3)
    wanted = [4.0 * red, 9.0 * (green + more) / 4.0, 0.25 * blue]
    np.testing.assert_allclose(found[1, 2], wanted, rtol=1e-6)
    plain = compute_colour_variance(planes, mark2, 50, 20.0, dtype=dtype)
    np.testing.assert_allclose(plain[0, 0], [red, (green + more) / 4.0, blue], rtol=1e-6)
    with pytest.raises(ConfigError, match="no ISO 51"):
        compute_colour_variance(planes, mark2, 51, 20.0, dtype=dtype)


def test_squares_of_pixels_are_their_means() -> None:
    grey = np.arange(24, dtype=np.float32).reshape(4, 6)
    assert shrink_image(grey, 2).tolist() == [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]]
    three = shrink_image(np.stack([grey, 2 * grey, grey], axis=-1), 2)
    assert three[1, 0].tolist() == [15.5, 31.0, 15.5]
    assert shrink_image(grey, 1).dtype == np.float32


@pytest.mark.parametrize(
    ("columns", "rows", "shown"),
    [(22, 40, (30, 40)), (22, 22, (30, 40)), (21, 40, (20, 10)), (40, 20, (10, 20)),
     (0, 20, (30, 40)), (70, 50, (30, 40))],
)  # fmt: skip
def test_only_a_crop_too_small_for_the_decoder_is_applied(
    tmp_path: Path, columns: int, rows: int, shown: tuple[int, int]
) -> None:
    """Of fewer than 22 samples a side; from the upper left corner."""
    path = tmp_path / "a.dng"
    image = dng(path, (60, 80), active=(0, 0, 60, 80))
    data = bytearray(path.read_bytes())
    entry = data.rfind(struct.pack("<HHI", 50720, 4, 2))
    (place,) = struct.unpack_from("<I", data, entry + 8)
    struct.pack_into("<2I", data, place, columns, rows)
    path.write_bytes(data)
    raw = read_raw(path)
    assert raw.frame == read_raw_head(path).frame == shown
    wanted = image[0 : 2 * shown[0] : 2, 0 : 2 * shown[1] : 2]
    np.testing.assert_array_equal(raw.planes[0] + 512.0, wanted)
