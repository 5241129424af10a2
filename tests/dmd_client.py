"""A client of DLPC900s as other people's programs are: commands in reports of 64 bytes by pyusb.

Its encoder is a plain one, line by line; what it leaves to options is how planes lie in a pixel.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import usb.core
import usb.util
from numpy.typing import NDArray

VENDOR, PRODUCT = 0x0451, 0xC900
STOP, PAUSE, START = 0, 1, 2
MODE, RUN, DEFINE, CONFIGURE, BEGIN, DATA = 0x1A1B, 0x1A24, 0x1A34, 0x1A31, 0x1A2A, 0x1A2B

Words = NDArray[np.uint32]


class CommandError(Exception):
    """The reply has its error bit set."""


def count_bytes(count: int) -> bytes:
    """A count of ERLE."""
    return bytes([count]) if count < 128 else bytes([0x80 | count & 0x7F, count >> 7])


def word_bytes(word: int) -> bytes:
    return int(word).to_bytes(3, "big")


def encode_erle(words: Words, line_ends: bool = False) -> bytes:
    """Runs, and lines like the one above; `line_ends`: 0 0 after each line, as some write it."""
    found = bytearray()
    for row, line in enumerate(words):
        if row and np.array_equal(line, words[row - 1]):
            found += b"\0\1" + count_bytes(line.size)
        else:
            for word, run in itertools.groupby(line.tolist()):
                found += count_bytes(len(list(run))) + word_bytes(word)
        if line_ends:
            found += b"\0\0"
    return bytes(found + b"\0\1\0")


def make_header(width: int, height: int, length: int, compression: int) -> bytes:
    """The 48 bytes before an image."""
    head = b"Spld" + struct.pack("<HHI", width, height, length) + b"\xff" * 8 + bytes(4)
    return (head + bytes([1, compression, 1, 0, 0, 1])).ljust(48, b"\0")


def make_image(words: Words, stream: bytes | None = None, compression: int = 2) -> bytes:
    stream = encode_erle(words) if stream is None else stream
    return make_header(words.shape[1], words.shape[0], len(stream), compression) + stream


def pack_words(planes: NDArray[np.bool_], order: Sequence[int]) -> Words:
    """(24 or fewer, H, W) planes -> words; byte n of the stream holds planes 8 * order[n] on."""
    words = np.zeros(planes.shape[1:], dtype=np.uint32)
    for number, plane in enumerate(planes):
        byte = list(order).index(number // 8)
        words |= plane.astype(np.uint32) << np.uint32(8 * (2 - byte) + number % 8)
    return words


def entry_bytes(
    index: int,
    exposure_us: int,
    dark_us: int = 0,
    image: int = 0,
    bit: int = 0,
    *,
    wait: bool = False,
    clear: bool = True,
    kind: int = 0x10,
    extra: int = 0,
) -> bytes:
    """The twelve bytes of an entry."""
    head = struct.pack("<H", index) + exposure_us.to_bytes(3, "little")
    head += bytes([kind | wait << 7 | clear]) + dark_us.to_bytes(3, "little") + bytes([extra])
    return head + struct.pack("<H", image | bit << 11)


class DmdClient:
    """One device, opened by pyusb. product : of a DLPC350, which has no error codes: -1 is all."""

    def __init__(
        self, backend: Any, serial: str | None = None, detach: bool = True, product: int = PRODUCT
    ) -> None:
        self.product = product
        found = usb.core.find(find_all=True, backend=backend, idVendor=VENDOR, idProduct=product)
        self.device = next(
            device for device in found if serial is None or device.serial_number == serial
        )
        if detach and self.device.is_kernel_driver_active(0):
            self.device.detach_kernel_driver(0)
        self.sequence = 0

    def send(self, code: int, data: bytes = b"", *, flags: int, sequence: int | None = None) -> int:
        """A command in as many reports as it takes; its sequence byte."""
        self.sequence = (self.sequence + 1) % 256 if sequence is None else sequence
        whole = struct.pack("<BBHH", flags, self.sequence, 2 + len(data), code) + data
        for at in range(0, len(whole), 64):
            self.device.write(1, whole[at : at + 64].ljust(64, b"\0"))
        return self.sequence

    def fetch(self, timeout_ms: int = 1000) -> tuple[int, int, bytes]:
        """Flags, sequence byte and data of a reply."""
        reply = bytes(self.device.read(0x81, 64, timeout_ms))
        assert len(reply) == 64
        flags, sequence, length = struct.unpack_from("<BBH", reply)
        return flags, sequence, reply[4 : 4 + length]

    def write(self, code: int, data: bytes) -> None:
        """A command that is answered. Raises CommandError."""
        sent = self.send(code, data, flags=0x40)
        flags, sequence, _ = self.fetch()
        assert sequence == sent
        if flags & 0x20:
            raise CommandError(self.error())

    def read(self, code: int, data: bytes = b"") -> bytes:
        sent = self.send(code, data, flags=0xC0)
        flags, sequence, found = self.fetch()
        assert sequence == sent
        if flags & 0x20:
            raise CommandError(self.error())
        return found

    def error(self) -> int:
        """The code of the last error."""
        if self.product != PRODUCT:
            return -1
        self.send(0x0100, flags=0xC0)
        return self.fetch()[2][0]

    def error_text(self) -> str:
        return self.read(0x0101).split(b"\0")[0].decode()

    def refuses(self, code: int, data: bytes) -> int:
        """The error of a command; 0 where there is none."""
        try:
            self.write(code, data)
        except CommandError as err:
            return int(err.args[0])
        return 0

    def run(self, action: int) -> None:
        self.write(RUN, bytes([action]))

    def begin(self, mode: int = 3) -> None:
        """Stop, change the mode, stop again."""
        self.run(STOP)
        self.write(MODE, bytes([mode]))
        self.run(STOP)

    def configure(self, entries: Sequence[bytes], most: int | None = None) -> None:
        """Define entries, then configure them; shown once where nothing else is said."""
        for entry in entries:
            self.write(DEFINE, entry)
        count = len(entries)
        self.write(CONFIGURE, struct.pack("<HI", count, count if most is None else most))

    def load(self, index: int, image: bytes, *, acked: bool = False, half: int = 0) -> int:
        """One image; the error that was left."""
        self.write(BEGIN + 2 * half, struct.pack("<HI", index, len(image)))
        for at in range(0, len(image), 504):
            piece = image[at : at + 504]
            data = struct.pack("<H", len(piece)) + piece
            self.send(DATA + 2 * half, data, flags=0x40 if acked else 0)
            if acked:
                self.fetch()
        return self.error()

    def upload(
        self,
        planes: NDArray[np.bool_],
        entries: Sequence[bytes],
        order: Sequence[int],
        most: int | None = None,
    ) -> None:
        """Entries of all planes and the images they lie in, the last image first."""
        self.begin()
        self.configure(entries, most)
        for index in reversed(range(-(-len(planes) // 24))):
            words = pack_words(planes[24 * index : 24 * index + 24], order)
            assert self.load(index, make_image(words)) == 0
