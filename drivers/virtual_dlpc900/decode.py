"""Images as the virtual DLPC900 takes them: a header, then pixels as they are, RLE or ERLE.

A word is a pixel of 24 bits, the first byte of the stream uppermost; the device decides which
planes these are. A fault of the stream is reported, and the pixels before it are kept: from there
on the image stays black.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STORED_HEADER_LENGTH = 48
_SIGNATURE = b"Spld"
_ALIGNED = 4
"""Lines of RLE begin at multiples of this in the stream; streams may be padded to one."""
_COMPRESSIONS = (0, 1, 2)
"""None, RLE, ERLE."""

DecodedWords = NDArray[np.uint32]


class BadHeaderError(Exception):
    """A header that is refused; `compression` says whether its compression is the reason."""

    def __init__(self, found: str, compression: bool = False) -> None:
        super().__init__(found)
        self.compression = compression


@dataclass(frozen=True, eq=False)
class DecodedImage:
    """Pixels of an image or of half of one, (height, width) uint32, and the fault of its stream;
    "" if there was none."""

    words: DecodedWords
    fault: str = ""


class _StreamError(Exception):
    """The stream cannot be followed any further."""


def decode_image(data: bytes, size_px: tuple[int, int], copies: bool = True) -> DecodedImage:
    """Decode an image of (width, height), header included.

    copies : whether pixels can be copied from the line above; if not, those pixels stay black.

    Raises BadHeaderError for another size, signature, number of bytes or compression.
    """
    compression = _read_header(data, size_px)
    stream = data[STORED_HEADER_LENGTH:]
    width, height = size_px
    if compression == 0:
        return _decode_raw(stream, width, height)
    words = np.zeros((height, width), dtype=np.uint32)
    decoder = _LineDecoder(stream, words, copies)
    try:
        decoder.run(_read_count if compression == 2 else _read_byte, enhanced=compression == 2)
    except _StreamError as fault:
        return DecodedImage(words, str(fault))
    return DecodedImage(words)


def _read_header(data: bytes, size_px: tuple[int, int]) -> int:
    """Check the header, and return its compression."""
    if len(data) < STORED_HEADER_LENGTH or data[:4] != _SIGNATURE:
        raise BadHeaderError("no header")
    width, height, stated = struct.unpack_from("<HHI", data, 4)
    if (width, height) != size_px:
        raise BadHeaderError(
            f"an image of {width} x {height} for {size_px[0]} x {size_px[1]} mirrors"
        )
    # Programs count with the header and without, and with what fills up the last four bytes.
    missing = (len(data) - stated, len(data) - STORED_HEADER_LENGTH - stated)
    if not any(0 <= count < _ALIGNED for count in missing):
        raise BadHeaderError(f"{stated} bytes stated of {len(data)}")
    if data[25] not in _COMPRESSIONS:
        raise BadHeaderError(f"compression {data[25]}", compression=True)
    return data[25]


def _decode_raw(stream: bytes, width: int, height: int) -> DecodedImage:
    whole = 3 * width * height
    fault = "" if whole <= len(stream) < whole + _ALIGNED else f"{len(stream)} bytes of {whole}"
    taken = np.frombuffer(stream[:whole].ljust(whole, b"\0"), np.uint8).reshape(height, width, 3)
    return DecodedImage(_to_words(taken), fault)


def _to_words(pixels: NDArray[np.uint8]) -> DecodedWords:
    """Bytes (..., 3) in the order of the stream -> words (...)."""
    wide = pixels.astype(np.uint32)
    return np.asarray(wide[..., 0] << 16 | wide[..., 1] << 8 | wide[..., 2], dtype=np.uint32)


def _read_byte(stream: bytes, at: int) -> tuple[int, int]:
    """A count of one byte, and where the stream goes on."""
    if at >= len(stream):
        raise _StreamError("the stream ends before the image")
    return stream[at], at + 1


def _read_count(stream: bytes, at: int) -> tuple[int, int]:
    """A count, in one byte if below 128, otherwise in two, lower seven bits first."""
    low, at = _read_byte(stream, at)
    if low < 128:
        return low, at
    high, at = _read_byte(stream, at)
    return (low & 0x7F) + (high << 7), at


class _LineDecoder:
    """Fills an image line by line. No run continues past the end of a line."""

    def __init__(self, stream: bytes, words: DecodedWords, copies: bool) -> None:
        self._stream, self._words, self._copies = stream, words, copies
        self._height, self._width = words.shape
        self._row = self._column = 0

    def run(self, read: Callable[[bytes, int], tuple[int, int]], *, enhanced: bool) -> None:
        """Decode to the end of the image. Raises _StreamError where it cannot be followed."""
        stream, at = self._stream, 0
        while True:
            count, at = read(stream, at)
            if count:
                at = self._repeat(count, at)
                continue
            code, at = read(stream, at)
            if code == 0:
                self._end_line()
                at += 0 if enhanced else -at % _ALIGNED
            elif code > 1:
                at = self._take(code, at)
            else:
                copied, at = read(stream, at) if enhanced else (0, at)
                if not copied:
                    return self._end()
                self._copy(copied)

    def _place(self, count: int) -> slice:
        """Where the next pixels of a line go; after a full line the next one begins."""
        if self._column == self._width:
            self._row, self._column = self._row + 1, 0
        if self._row >= self._height:
            raise _StreamError(f"more than {self._height} lines")
        if self._column + count > self._width:
            raise _StreamError(f"line {self._row} is longer than {self._width} pixels")
        place = slice(self._column, self._column + count)
        self._column += count
        return place

    def _pixels(self, count: int, at: int) -> NDArray[np.uint8]:
        taken = self._stream[at : at + 3 * count]
        if len(taken) < 3 * count:
            raise _StreamError("the stream ends before the image")
        return np.frombuffer(taken, np.uint8).reshape(count, 3)

    def _repeat(self, count: int, at: int) -> int:
        word = _to_words(self._pixels(1, at))
        place = self._place(count)
        self._words[self._row, place] = word
        return at + 3

    def _take(self, count: int, at: int) -> int:
        words = _to_words(self._pixels(count, at))
        place = self._place(count)
        self._words[self._row, place] = words
        return at + 3 * count

    def _copy(self, count: int) -> None:
        place = self._place(count)
        if self._row == 0:
            raise _StreamError("there is no line above the first one")
        if self._copies:
            self._words[self._row, place] = self._words[self._row - 1, place]

    def _end_line(self) -> None:
        """End the line, full or not; the rest of it stays black."""
        if self._row >= self._height:
            raise _StreamError(f"more than {self._height} lines")
        self._row, self._column = self._row + 1, 0

    def _end(self) -> None:
        done = self._row + (self._column == self._width)
        if done < self._height:
            raise _StreamError(f"the image ends in line {self._row} of {self._height}")
