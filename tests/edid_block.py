"""EDID blocks made from the standard's tables, byte by byte, to hold the reader against."""

from __future__ import annotations


def block(
    *,
    vendor: str = "EPS",
    product: int = 0xA1B2,
    number: int = 0x01020304,
    name: str | None = None,
    serial: str | None = None,
) -> bytes:
    """A 128-byte EDID 1.x of a 1600 x 1200 panel; texts None leave their descriptors out."""
    data = bytearray(128)
    data[0:8] = bytes.fromhex("00ffffffffffff00")
    first, second, third = (ord(c) - 64 for c in vendor)
    data[8], data[9] = first << 2 | second >> 3, (second & 7) << 5 | third
    data[10], data[11] = product & 0xFF, product >> 8
    for i in range(4):
        data[12 + i] = number >> 8 * i & 0xFF
    data[16:20] = bytes([1, 30, 1, 4])  # week 1 of 2020
    data[20:25] = bytes([0xA5, 40, 30, 120, 0x06])  # digital 8 bit DisplayPort, 40 x 30 cm, 2.2
    data[25:35] = bytes.fromhex("ee91a3544c99260f5054")  # sRGB primaries
    data[38:54] = b"\x01\x01" * 8
    # Detailed timing 162 MHz, 1600 x 1200, totals 2160 x 1250 (VESA DMT).
    data[54:72] = bytes.fromhex("483f403062b0324040c013009031110000 1e".replace(" ", ""))
    texts = [(0xFF, serial), (0xFC, name), (0xFE, "no text")]
    for at, (tag, text) in zip((72, 90, 108), texts, strict=True):
        if text is None:
            tag, text = 0x10, ""  # a dummy descriptor
            data[at : at + 18] = bytes([0, 0, 0, tag, 0]) + bytes(13)
            continue
        line = text.encode("ascii")
        body = line if len(line) == 13 else (line + b"\n").ljust(13, b" ")
        data[at : at + 18] = bytes([0, 0, 0, tag, 0]) + body
    data[127] = -sum(data) % 256
    return bytes(data)
