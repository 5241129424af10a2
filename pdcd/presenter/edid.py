"""Identity and modes of a panel: fields of the EDID block that a RandR output has.

Source: VESA E-EDID standard, release A revision 2 (EDID 1.4), section 3: the 128-byte base block.
Colours and extension blocks are not read; the server has done that.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from pdcd.presenter.properties import read_property
from pdcd.presenter.timings import VideoTiming, parse_detailed_timing

_BLOCK = 128
"""Bytes of the base block."""

_HEADER = b"\x00\xff\xff\xff\xff\xff\xff\x00"
_DESCRIPTORS = (54, 72, 90, 108)
_TAG_SERIAL, _TAG_NAME = 0xFF, 0xFC


@dataclass(frozen=True)
class Edid:
    """Identity of a panel.

    vendor : three letters of the maker's PNP id, such as "EPS".
    product : number of the model.
    number : 32-bit serial number; 0 when the maker does not use it.
    name, serial : texts of the display descriptors, "" when there are none.
    timings : detailed ones, the panel's own first.
    """

    vendor: str
    product: int
    number: int
    name: str = ""
    serial: str = ""
    timings: tuple[VideoTiming, ...] = ()

    @property
    def serials(self) -> tuple[str, ...]:
        """The serials by which an output can be named: the text, and the number in decimal."""
        number = str(self.number) if self.number else ""
        return tuple(s for s in dict.fromkeys((self.serial, number)) if s)

    def __str__(self) -> str:
        return f"{self.name or f'{self.vendor}-{self.product:04X}'}, serial {self._serial()}"

    def _serial(self) -> str:
        return self.serials[0] if self.serials else "unknown"


def parse_edid(data: bytes) -> Edid | None:
    """The identity in an EDID (128 bytes or more); None when it is absent or damaged.

    Damaged means: too short, a wrong header, or a sum of the base block that is not 0 modulo 256.
    Cheap adapters answer with damaged blocks, and a wrong name is worse than none.
    """
    if len(data) < _BLOCK or not data.startswith(_HEADER) or sum(data[:_BLOCK]) % 256:
        return None
    # The maker's id is big-endian, three letters of five bits; the rest is little-endian.
    (letters,) = struct.unpack_from(">H", data, 8)
    product, number = struct.unpack_from("<HI", data, 10)
    vendor = "".join(chr(ord("@") + (letters >> shift & 31)) for shift in (10, 5, 0))
    timings = (parse_detailed_timing(data[at : at + 18]) for at in _DESCRIPTORS)
    return Edid(
        vendor,
        product,
        number,
        _text(data, _TAG_NAME),
        _text(data, _TAG_SERIAL),
        tuple(timing for timing in timings if timing is not None),
    )


def read_edid(display: Any, output: int) -> Edid | None:
    """Ask an X server for the identity of the panel at a RandR output; None without a usable EDID.

    Raises what python-xlib raises.
    """
    bits, data = read_property(display, output, "EDID") or (0, b"")
    return parse_edid(data) if bits == 8 else None


def _text(data: bytes, tag: int) -> str:
    """Text of the first display descriptor with a tag; up to 13 characters."""
    for at in _DESCRIPTORS:
        block = data[at : at + 18]
        if block[:3] == b"\0\0\0" and block[3] == tag:
            raw = block[5:18].split(b"\n", 1)[0].decode("cp437")
            return "".join(c for c in raw if c.isprintable()).strip()
    return ""
