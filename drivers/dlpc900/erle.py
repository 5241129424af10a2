"""Pictures of 24 bit planes as the bytes that a DLPC900 is sent: header, and pixels that repeat.

A stream of "enhanced run length encoding" is made of pieces that never go beyond their line:

    n          P P P    n times the pixel P
    0 1 n               n pixels as in the line above
    0 1 0               the end

Counts from 128 on take two bytes, ``(n & 127) + 128`` and ``n >> 7``. Lines end by themselves.
"""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np
from numpy.typing import NDArray

CopyAbove = Literal["lines", "parts", "never"]
"""Where a stream refers to the line above: whole lines, any part of one, or nowhere."""
PlaneOrder = Literal["GBR", "BGR", "RGB", "RBG", "GRB", "BRG"]
"""Which byte of a pixel holds planes 0-7, 8-15 and 16-23; R, G and B are the first, second and
third byte that is sent."""

HEADER_B = 48
_RAW, _ERLE = 0, 2
_END = b"\x00\x01\x00"
_COPY = b"\x00\x01"
_TWO_BYTES = 128
"""First count that takes two bytes."""
_Numbers = NDArray[np.int64]
_Words = NDArray[np.uint32]


def encode_picture(words: _Words, order: PlaneOrder, copy_above: CopyAbove) -> bytes:
    """A picture with its header, as 0x1A2A announces it.

    words : (height, width), bit j of each is plane j (`pdcd.driver.draw_plane_words`).
    Pixels are sent uncompressed if compression would not make them shorter.
    """
    height, width = words.shape
    stream, kind = encode_erle(words, order, copy_above), _ERLE
    if len(stream) >= 3 * words.size:
        stream, kind = _order_bytes(words.ravel(), order).tobytes(), _RAW
    head = struct.pack("<4sHHI8sIBBBxxB", b"Spld", width, height, len(stream), b"\xff" * 8, 0,
                       1, kind, 1, 1)  # fmt: skip
    return head.ljust(HEADER_B, b"\x00") + stream


def encode_erle(words: _Words, order: PlaneOrder, copy_above: CopyAbove) -> bytes:
    """The stream of a picture, (height, width); each line takes the fewest bytes possible."""
    above = np.zeros(len(words), dtype=np.bool_)  # lines that equal the line above
    if copy_above != "never":
        above[1:] = (words[1:] == words[:-1]).all(axis=1)
    lines = np.flatnonzero(~above)
    start, copied = _find_pieces(words, lines, parts=copy_above == "parts")
    whole = np.flatnonzero(above) * words.shape[1]
    start, copied = np.append(start, whole), np.append(copied, np.ones(whole.size, np.bool_))
    sorting = np.argsort(start, kind="stable")
    return _write_pieces(words, start[sorting], copied[sorting], order)


def _find_pieces(
    words: _Words, lines: _Numbers, *, parts: bool
) -> tuple[_Numbers, NDArray[np.bool_]]:
    """Where pieces begin in these lines, as pixels of the picture, and which pieces are copies."""
    width = words.shape[1]
    own = words[lines]
    begins = np.ones(own.shape, dtype=np.bool_)
    begins[:, 1:] = own[:, 1:] != own[:, :-1]
    at = np.flatnonzero(begins)
    copied = np.zeros(at.size, dtype=np.bool_)
    if parts and lines.size:
        same = np.zeros(own.shape, dtype=np.bool_)
        later = lines > 0  # there is no line above the first
        same[later] = own[later] == words[lines[later] - 1]
        begins &= ~same
        begins[:, 1:] |= same[:, 1:] != same[:, :-1]
        begins[:, 0] = True
        cut = np.flatnonzero(begins)
        cut_copied = same.ravel()[cut]
        better = _sum_by_line(cut, cut_copied, own.shape) < _sum_by_line(at, copied, own.shape)
        kept, cut_kept = ~better[at // width], better[cut // width]
        at = np.append(at[kept], cut[cut_kept])
        copied = np.append(copied[kept], cut_copied[cut_kept])
    return lines[at // width] * width + at % width, copied


def _sum_by_line(at: _Numbers, copied: NDArray[np.bool_], shape: tuple[int, ...]) -> _Numbers:
    """Bytes of each line that is made of these pieces."""
    long = np.diff(np.append(at, shape[0] * shape[1])) >= _TWO_BYTES
    size = np.where(copied, 3, 4) + long
    return np.bincount(at // shape[1], weights=size, minlength=shape[0]).astype(np.int64)


def _write_pieces(
    words: _Words, start: _Numbers, copied: NDArray[np.bool_], order: PlaneOrder
) -> bytes:
    """The bytes of pieces that follow each other."""
    count = np.diff(np.append(start, words.size))
    long = count >= _TWO_BYTES
    lead, tail = np.where(copied, len(_COPY), 0), np.where(copied, 0, 3)
    place = np.append(0, np.cumsum(lead + 1 + long + tail))
    stream = np.zeros(int(place[-1]), dtype=np.uint8)
    at = place[:-1]
    stream[at[copied] + 1] = _COPY[1]
    low = at + lead
    stream[low] = np.where(long, (count & 127) + 128, count)
    stream[low[long] + 1] = count[long] >> 7
    pixel = (low + 1 + long)[~copied]
    values = _order_bytes(words.ravel()[start[~copied]], order)
    for byte in range(3):
        stream[pixel + byte] = values[:, byte]
    return stream.tobytes() + _END


def _order_bytes(words: _Words, order: PlaneOrder) -> NDArray[np.uint8]:
    """The three bytes that are sent for each pixel, (n, 3)."""
    sent = np.empty((words.size, 3), dtype=np.uint8)
    for group, letter in enumerate(order):
        sent[:, "RGB".index(letter)] = words >> np.uint32(8 * group)
    return sent
