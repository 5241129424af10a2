"""What USB reports tell a DLPC900 to show, read byte by byte from the tables of its guide.

It knows neither the driver nor the virtual device, and is slow on purpose: one run at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

REPORT = 64
HEADER = 48
PLANES_OF_BYTE: Mapping[str, tuple[int, int, int]] = {
    "TI": (16, 0, 8),
    "others": (16, 8, 0),
}
"""First plane that bytes 0, 1 and 2 of a pixel of the stream hold."""
_BEGINS = {0x1A2A: 0, 0x1A2C: 1}
_DATA = {0x1A2B: 0, 0x1A2D: 1}


@dataclass(frozen=True)
class Command:
    """One command as it crossed the wire."""

    flags: int
    sequence: int
    number: int
    data: bytes

    @property
    def reads(self) -> bool:
        return bool(self.flags & 0x80)


@dataclass(frozen=True)
class Entry:
    """One line of the table of planes, times in microseconds."""

    exposure_us: int
    dark_us: int
    waits: bool
    clears: bool
    depth: int
    led: int
    last_byte: int
    image: int
    bit: int


@dataclass(frozen=True)
class Start:
    """What stood when a sequence was started: lines of the table in the order they are shown, how
    many are shown in all (0: no end), and pictures by half and number."""

    entries: tuple[Entry, ...]
    shown: int
    pictures: Mapping[tuple[int, int], bytes]


def join_reports(reports: Iterable[bytes]) -> Iterator[Command]:
    """The commands of reports of 64 bytes, in order; the first of each tells how long it is."""
    waiting = iter(reports)
    for first in waiting:
        assert len(first) == REPORT, len(first)
        length = first[2] | first[3] << 8
        assert 2 <= length <= 508, length
        body = first[4:]
        while len(body) < length:
            body += next(waiting)
        yield Command(first[0], first[1], body[0] | body[1] << 8, body[2:length])


def read_starts(reports: Iterable[bytes]) -> list[Start]:
    """What each start of a sequence shows; commands that only ask are passed over."""
    defined: dict[int, Entry] = {}
    order: tuple[int, ...] = ()
    shown = 0
    loading: dict[int, tuple[int, int]] = {}
    pictures: dict[tuple[int, int], bytes] = {}
    starts = []
    for command in join_reports(reports):
        data = command.data
        if command.reads:
            continue
        match command.number:
            case 0x1A24 if data[0] == 2:
                lines = tuple(defined[n] for n in order)
                starts.append(Start(lines, shown, dict(pictures)))
            case 0x1A34:
                defined[data[0] | data[1] << 8] = read_entry(data)
            case 0x1A31:
                order = tuple(range(data[0] | data[1] << 8))
                shown = int.from_bytes(data[2:6], "little")
            case 0x1A32:
                order = tuple(data[n] | data[n + 1] << 8 for n in range(6, len(data), 2))
                assert len(order) == data[0] | data[1] << 8
                shown = int.from_bytes(data[2:6], "little")
            case 0x1A2A | 0x1A2C:
                half = _BEGINS[command.number]
                loading[half] = data[0] | data[1] << 8, int.from_bytes(data[2:6], "little")
                pictures[half, loading[half][0]] = b""
            case 0x1A2B | 0x1A2D:
                half = _DATA[command.number]
                count = data[0] | data[1] << 8
                assert count == len(data) - 2, (count, len(data))
                index, total = loading[half]
                pictures[half, index] += data[2:]
                assert len(pictures[half, index]) <= total
            case _:
                pass
    return starts


def read_entry(data: bytes) -> Entry:
    """A line of the table from its twelve bytes."""
    assert len(data) == 12, len(data)
    place = data[10] | data[11] << 8
    return Entry(
        exposure_us=int.from_bytes(data[2:5], "little"),
        dark_us=int.from_bytes(data[6:9], "little"),
        waits=bool(data[5] & 0x80),
        clears=bool(data[5] & 1),
        depth=(data[5] >> 1 & 7) + 1,
        led=data[5] >> 4 & 7,
        last_byte=data[9],
        image=place & 0x7FF,
        bit=place >> 11,
    )


@lru_cache(maxsize=64)
def read_picture(stream: bytes) -> NDArray[np.uint8]:
    """The bytes (H, W, 3) of a stored picture, its header checked."""
    header, body = stream[:HEADER], stream[HEADER:]
    assert header[:4] == b"Spld"
    width, height = header[4] | header[5] << 8, header[6] | header[7] << 8
    assert int.from_bytes(header[8:12], "little") == len(body)
    assert header[12:20] == b"\xff" * 8 and header[20:24] == bytes(4)
    form, packed, order = header[24:27]
    assert (form, order, header[29]) == (1, 1, 1)
    if packed == 0:
        return np.frombuffer(body, np.uint8).reshape(height, width, 3)
    assert packed == 2, "runs without the line above: nobody sends them"
    return read_runs(body, width, height)


def read_runs(body: bytes, width: int, height: int) -> NDArray[np.uint8]:
    """Runs, raw pixels and copies from the line above, up to the mark of the end."""
    out = np.zeros((height * width, 3), np.uint8)
    at, place = 0, 0

    def count() -> int:
        nonlocal at
        n = body[at]
        at += 1
        if n >= 0x80:
            n = (n & 0x7F) + 0x80 * body[at]
            at += 1
        return n

    while True:
        n = count()
        if n:
            out[place : place + n] = np.frombuffer(body[at : at + 3], np.uint8)
            at += 3
        else:
            n = count()
            if n == 0:  # the end of a line
                place = -(-place // width) * width
                continue
            if n == 1:
                n = count()
                if n == 0:
                    assert place == len(out) and at == len(body), (place, len(out))
                    return out.reshape(height, width, 3)
                assert width <= place and n <= width, (place, n)
                out[place : place + n] = out[place - width : place - width + n]
            else:
                raw = np.frombuffer(body[at : at + 3 * n], np.uint8)
                out[place : place + n] = raw.reshape(n, 3)
                at += 3 * n
        assert place // width == (place + n - 1) // width, "a piece goes beyond its line"
        place += n
        assert (place - 1) // width == (place - n) // width, "a piece goes beyond its line"
        assert place <= len(out), "beyond the last line"


def read_plane(start: Start, line: int, order: str) -> NDArray[np.bool_]:
    """What a line of the table shows (H, W), True where light is let through; halves that two
    controllers were sent lie side by side."""
    entry = start.entries[line]
    first = PLANES_OF_BYTE[order]
    byte = next(j for j in range(3) if first[j] <= entry.bit < first[j] + 8)
    halves = [read_picture(stream) for (_, number), stream in sorted(start.pictures.items())
              if number == entry.image]  # fmt: skip
    pixels = np.concatenate(halves, axis=1)[..., byte]
    return np.asarray(pixels >> (entry.bit - first[byte]) & 1, dtype=np.bool_)
