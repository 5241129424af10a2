"""Samples out of frames, against plain loops over bits and against programs of others; and what
samples themselves say of black, white, alignment and byte order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.genicam.levels import SampleLevels, find_byte_order, measure_black
from drivers.genicam.pixels import (
    BY_CODE,
    BY_NAME,
    choose_pixel_format,
    pack_samples,
    unpack_samples,
)

Samples = NDArray[np.uint16]
SHAPES = ((2, 4), (3, 5), (1, 1), (6, 7))


def unpack_slowly(data: bytes, name: str, count: int) -> list[int]:
    """Samples bit by bit, as the standard's drawings have them."""
    bits = int("".join(filter(str.isdigit, name)))
    if name.endswith("Packed"):  # GigE Vision: two samples in three bytes, their low bits amid
        found: list[int] = []
        for first in range(0, len(data), 3):
            high_a, low, *high_b = data[first : first + 3]
            spare = bits - 8
            a = b = 0
            for bit in range(8):
                a |= (high_a >> bit & 1) << bit + spare
                b |= ((high_b or [0])[0] >> bit & 1) << bit + spare
            for bit in range(spare):
                a |= (low >> bit & 1) << bit
                b |= (low >> bit + 4 & 1) << bit
            found += [a, b]
        return found[:count]
    step = bits if name.endswith("p") else 8 * (1 + (bits > 8))
    stream = [byte >> bit & 1 for byte in data for bit in range(8)]
    return [sum(stream[step * n + bit] << bit for bit in range(bits)) for n in range(count)]


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_every_format_is_unpacked_as_bit_by_bit(name: str) -> None:
    rng, known = np.random.default_rng(len(name)), BY_NAME[name]
    for rows, columns in SHAPES:
        samples = rng.integers(0, 1 << known.bits, (rows, columns)).astype(np.uint16)
        data = pack_samples(samples, known)
        assert len(data) == known.count_bytes(samples.size)
        assert unpack_slowly(data, name, samples.size) == samples.ravel().tolist()
        assert np.array_equal(unpack_samples(data + b"\xff", known, rows, columns), samples)
        with pytest.raises(ValueError, match=name):
            unpack_samples(data[:-1], known, rows, columns)


def test_names_say_colours_and_codes_say_bits() -> None:
    orders = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}
    assert len(BY_NAME) == len(BY_CODE)
    for name, known in BY_NAME.items():
        assert known.cfa == (orders[name[5:7]] if name.startswith("Bayer") else None)
        stored = {"bytes": 8, "words": 16, "triples": 12, "stream": known.bits}
        assert known.code >> 16 & 0xFF == stored[known.layout]


@pytest.mark.parametrize(
    ("offered", "chosen"),
    [
        (("Mono8", "Mono12", "Mono12p", "Mono16"), "Mono12p"),
        (("Mono8", "BayerRG8", "BayerRG12Packed", "RGB8"), "BayerRG12Packed"),
        (("Mono8", "Mono16"), "Mono16"),
        (("Mono12p", "BayerGB8"), "BayerGB8"),  # a colour camera would have to compute the grey
        (("RGB8", "YUV422_8"), None),
    ],
)
def test_the_best_format_is_taken(offered: tuple[str, ...], chosen: str | None) -> None:
    assert choose_pixel_format(offered) == chosen


@pytest.mark.parametrize("name", ["Mono10p", "Mono12p", "BayerRG12p", "BayerGB10p"])
def test_one_maker_of_cameras_unpacks_them_alike(name: str) -> None:
    ipl: Any = pytest.importorskip("ids_peak_ipl.ids_peak_ipl", exc_type=ImportError)
    known, rng = BY_NAME[name], np.random.default_rng(7)
    samples = rng.integers(0, 1 << known.bits, (6, 8)).astype(np.uint16)
    data = bytearray(pack_samples(samples, known))  # which the image does not keep
    code = getattr(ipl, f"PixelFormatName_{name}")
    image = ipl.Image.CreateFromSizeAndPythonBuffer(code, data, 8, 6)
    plain = f"{name.removesuffix(known.depth)}{known.bits}"
    theirs = image.ConvertTo(getattr(ipl, f"PixelFormatName_{plain}"))
    found = np.array(theirs.get_numpy_2D_16())
    assert np.array_equal(found, unpack_samples(bytes(data), known, 6, 8))


@pytest.mark.parametrize("name", ["Mono10p", "Mono12p", "Mono12Packed"])
def test_another_maker_unpacks_them_alike(name: str) -> None:
    pylon: Any = pytest.importorskip("pypylon.pylon", exc_type=ImportError)
    known, rng = BY_NAME[name], np.random.default_rng(8)
    data = pack_samples(rng.integers(0, 1 << known.bits, (6, 8)).astype(np.uint16), known)
    code = getattr(pylon, f"PixelType_{name.replace('Packed', 'packed')}")
    assert code & 0xFFFFFFFF == known.code
    image = pylon.PylonImage()
    image.AttachBytesObject(data, code, 8, 6, 0)
    converter = pylon.ImageFormatConverter()
    converter.OutputPixelFormat = pylon.PixelType_Mono16
    converter.OutputBitAlignment.Value = "LsbAligned"
    found = converter.Convert(image).GetArray()
    assert np.array_equal(found, unpack_samples(data, known, 6, 8))


def picture(bits: int, seed: int = 0) -> Samples:
    """Light with noise, of a converter of so many bits."""
    rng = np.random.default_rng(seed)
    across = np.linspace(0.05, 0.8, 40) * (1 << bits)
    return np.asarray(np.rint(across + rng.normal(0.0, 3.0, (60, 40))), np.uint16)


def darkness(bits: int) -> Samples:
    """A dark frame of such a converter."""
    return np.random.default_rng(3).integers(28, 45, (60, 40)).astype(np.uint16)


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("swapped", [True, False])
@pytest.mark.parametrize("seen", [picture, darkness])
def test_alignment_and_byte_order_show_in_a_picture(
    bits: int, left: bool, swapped: bool, seen: Callable[[int], Samples]
) -> None:
    samples = np.left_shift(seen(bits), np.uint16(16 - bits if left else 0))
    levels = SampleLevels(BY_NAME["Mono16"])
    found = levels.read(samples.byteswap() if swapped else samples)
    assert np.array_equal(found, samples)
    assert levels.swapped is swapped
    assert levels.white_dn == ((1 << bits) - 1 << 16 - bits if left else 65535)
    assert ("Alignment" in levels.words) is left and ("ByteOrder" in levels.words) is swapped


def test_the_white_level_of_a_right_aligned_converter_shows_once_it_saturates() -> None:
    levels = SampleLevels(BY_NAME["Mono16"])
    levels.read(picture(12))
    assert levels.white_dn == 65535
    burnt = picture(12)
    burnt[:, -5:] = 4095
    levels.read(burnt)
    levels.read(picture(12))
    assert levels.white_dn == 4095
    levels = SampleLevels(BY_NAME["Mono16"])
    levels.read(picture(14))  # 4095 is then a value like any other
    levels.read(burnt)
    assert levels.white_dn == 65535
    assert SampleLevels(BY_NAME["Mono16"], white=4000).white_dn == 4000


def test_what_cannot_show_is_not_guessed() -> None:
    flat = np.full((8, 8), 300, np.uint16)
    assert find_byte_order(flat, 16) is None
    assert find_byte_order(flat.byteswap(), 12) is True  # beyond 12 bits as it is
    assert find_byte_order(flat, 12) is False
    noise = np.random.default_rng(1).integers(0, 65536, (20, 20)).astype(np.uint16)
    assert find_byte_order(noise, 16) is None


def test_black_is_the_middle_of_each_place_of_the_quad() -> None:
    dark = np.tile(np.array([[60, 64], [66, 70]], np.uint16), (20, 20))
    dark[3, 5] = 4095  # a hot one
    assert measure_black(dark, "RGGB") == [60, 64, 66, 70]
    assert measure_black(np.full((9, 9), 33, np.uint16), None) == 33
