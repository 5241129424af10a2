"""Pixel formats: what their names and codes mean, and samples out of the bytes of a frame.

Numbers, names and layouts are those of the GenICam Pixel Format Naming Convention (PFNC 2.4); the
packed formats of GigE Vision are those of its version 1.2, appendix on pixel layouts. A code says
in bits 16 to 23 how many bits a pixel takes.

`p` formats are one stream of bits, the least significant first, that runs on from line to line.
The older packed ones give two pixels three bytes: the high bits of the first, the low bits of both,
the high bits of the second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.uint16]
Layout = Literal["bytes", "words", "stream", "triples"]
"""One byte a sample; two, little-endian; a stream of bits; two samples in three bytes."""


@dataclass(frozen=True)
class PixelFormat:
    """One format: its name and code, bits of a sample, how they lie, and the colours of the quad at
    the upper left corner, row by row; None for a sensor without colours."""

    name: str
    code: int
    bits: int
    layout: Layout
    cfa: str | None

    @property
    def depth(self) -> str:
        """The name without the colours: "12p"."""
        return self.name.removeprefix("Mono") if self.cfa is None else self.name[len("BayerRG") :]

    def count_bytes(self, pixels: int) -> int:
        """Number of bytes that `pixels` pixels take."""
        per_pixel = self.code >> 16 & 0xFF
        return (pixels * per_pixel + 7) // 8


_GROUPS = {10: (4, 5), 12: (2, 3)}
"""For streams, by bits of a sample: how many samples fill how many bytes."""
_CFAS = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}

# Of the four orders in the sequence that PFNC has them in: code of the first, and the step.
_GR_RG_GB_BG = ("GR", "RG", "GB", "BG")
_BG_GB_GR_RG = ("BG", "GB", "GR", "RG")


def _bayer(
    suffix: str, bits: int, layout: Layout, first: int, order: tuple[str, ...], step: int
) -> list[PixelFormat]:
    return [
        PixelFormat(f"Bayer{name}{suffix}", first + step * place, bits, layout, _CFAS[name])
        for place, name in enumerate(order)
    ]


_ALL: tuple[PixelFormat, ...] = (
    PixelFormat("Mono8", 0x01080001, 8, "bytes", None),
    PixelFormat("Mono10", 0x01100003, 10, "words", None),
    PixelFormat("Mono12", 0x01100005, 12, "words", None),
    PixelFormat("Mono14", 0x01100025, 14, "words", None),
    PixelFormat("Mono16", 0x01100007, 16, "words", None),
    PixelFormat("Mono10p", 0x010A0046, 10, "stream", None),
    PixelFormat("Mono12p", 0x010C0047, 12, "stream", None),
    PixelFormat("Mono10Packed", 0x010C0004, 10, "triples", None),
    PixelFormat("Mono12Packed", 0x010C0006, 12, "triples", None),
    *_bayer("8", 8, "bytes", 0x01080008, _GR_RG_GB_BG, 1),
    *_bayer("10", 10, "words", 0x0110000C, _GR_RG_GB_BG, 1),
    *_bayer("12", 12, "words", 0x01100010, _GR_RG_GB_BG, 1),
    *_bayer("16", 16, "words", 0x0110002E, _GR_RG_GB_BG, 1),
    *_bayer("10p", 10, "stream", 0x010A0052, _BG_GB_GR_RG, 2),
    *_bayer("12p", 12, "stream", 0x010C0053, _BG_GB_GR_RG, 2),
    *_bayer("10Packed", 10, "triples", 0x010C0026, _GR_RG_GB_BG, 1),
    *_bayer("12Packed", 12, "triples", 0x010C002A, _GR_RG_GB_BG, 1),
)
BY_CODE = {pixel_format.code: pixel_format for pixel_format in _ALL}
BY_NAME = {pixel_format.name: pixel_format for pixel_format in _ALL}

_PREFERRED = ("12p", "12Packed", "12", "14", "16", "10p", "10Packed", "10", "8")
"""Order of preference among a camera's formats: as many bits as its converter has, so that their
number gives the white level, in as few bytes as possible."""


def choose_pixel_format(offered: tuple[str, ...]) -> str | None:
    """The best of the formats that a camera offers; None if none of them can be read here.

    A mosaic goes before grey, which a colour camera would have to compute."""
    known = [BY_NAME[name] for name in offered if name in BY_NAME]
    known.sort(key=lambda found: (found.cfa is None, _PREFERRED.index(found.depth)))
    return known[0].name if known else None


def unpack_samples(data: bytes, pixel_format: PixelFormat, height: int, width: int) -> Samples:
    """Samples of a frame, (height, width) uint16, each in the lowest bits as in the format.

    Bytes beyond those of the pixels are ignored. Raises ValueError if there are too few.
    """
    count = height * width
    size = pixel_format.count_bytes(count)
    if len(data) < size:
        raise ValueError(f"{len(data)} bytes for {width} x {height} pixels of {pixel_format.name}")
    found = np.frombuffer(data, np.uint8, size)
    if pixel_format.layout == "bytes":
        samples = found.astype(np.uint16)
    elif pixel_format.layout == "words":
        samples = found.view("<u2").astype(np.uint16)
    elif pixel_format.layout == "stream":
        samples = _unpack_stream(found, pixel_format.bits, count)
    else:
        samples = _unpack_triples(found, pixel_format.bits, count)
    return samples.reshape(height, width)


def pack_samples(samples: Samples, pixel_format: PixelFormat) -> bytes:
    """The bytes of a frame of these samples: what a virtual camera sends."""
    flat = samples.ravel()
    if pixel_format.layout == "bytes":
        return flat.astype(np.uint8).tobytes()
    if pixel_format.layout == "words":
        return flat.astype("<u2").tobytes()
    bits = pixel_format.bits
    if pixel_format.layout == "stream":
        per_group, group_bytes = _GROUPS[bits]
        groups = np.pad(flat, (0, -flat.size % per_group)).reshape(-1, per_group)
        words = np.zeros(len(groups), "<u8")
        for place in range(per_group):
            words |= groups[:, place].astype("<u8") << np.uint64(place * bits)
        packed = words.view(np.uint8).reshape(-1, 8)[:, :group_bytes]
        return packed.tobytes()[: pixel_format.count_bytes(flat.size)]
    pairs = np.pad(flat, (0, flat.size % 2)).reshape(-1, 2)
    low = (1 << bits - 8) - 1
    triples = np.empty((len(pairs), 3), np.uint8)
    triples[:, 0] = pairs[:, 0] >> bits - 8
    triples[:, 1] = pairs[:, 0] & low | (pairs[:, 1] & low) << 4
    triples[:, 2] = pairs[:, 1] >> bits - 8
    return triples.tobytes()[: pixel_format.count_bytes(flat.size)]


def _grouped(found: NDArray[np.uint8], size: int) -> Samples:
    """The bytes in groups of `size`, (groups, size), zeros behind the last."""
    whole = np.pad(found, (0, -len(found) % size)) if len(found) % size else found
    return whole.reshape(-1, size).astype(np.uint16)


def _unpack_stream(found: NDArray[np.uint8], bits: int, count: int) -> Samples:
    """Samples of 10 bits, four in five bytes, or of 12, two in three."""
    per_group, group_bytes = _GROUPS[bits]
    groups = _grouped(found, group_bytes)
    samples = np.empty((len(groups), per_group), np.uint16)
    for place in range(per_group):
        byte, shift = divmod(place * bits, 8)
        samples[:, place] = groups[:, byte] >> shift | groups[:, byte + 1] << 8 - shift
    samples &= np.uint16((1 << bits) - 1)
    return samples.ravel()[:count]


def _unpack_triples(found: NDArray[np.uint8], bits: int, count: int) -> Samples:
    groups, low = _grouped(found, 3), (1 << bits - 8) - 1
    samples = np.empty((len(groups), 2), np.uint16)
    samples[:, 0] = groups[:, 0] << bits - 8 | groups[:, 1] & low
    samples[:, 1] = groups[:, 2] << bits - 8 | groups[:, 1] >> 4 & low
    return samples.ravel()[:count]
