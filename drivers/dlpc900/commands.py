"""Commands of the DLPC900, their bytes, and its status (TI DLPU018).

Pure functions. A command is a header (flags, sequence number, length of what follows, command) and
its data, all numbers little endian, in reports of 64 bytes.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence

from pdcd.driver import ConfigError, DeviceLost, PdcdError

REPORT_B = 64
REPLY_HEAD_B = 4
"""Bytes of a reply's header; replies do not repeat the command."""
PICTURE_PART_B = 504
"""Most bytes of a picture in a command of 512."""
READ, ANSWER, REFUSED = 0x80, 0x40, 0x20
"""Flags: the command is a read; an answer is wanted; in an answer: the command was refused."""
MOST_US = 2**24 - 1
"""Longest exposure, and dark time, of an entry."""
MOST_DELAY_US = 2**16 - 1
PICTURE_SLOTS = 18
"""Pictures of 24 planes that can be loaded."""


class Command(enum.IntEnum):
    """The commands that are used."""

    ERROR_CODE = 0x0100
    ERROR_TEXT = 0x0101
    POWER = 0x0200
    IDLE = 0x0201
    VERSION = 0x0205
    KIND = 0x0206
    HARDWARE = 0x1A0A
    MAIN = 0x1A0C
    MODE = 0x1A1B
    TRIGGER_OUT_1 = 0x1A1D
    RUN = 0x1A24
    PICTURE_BEGIN = 0x1A2A
    PICTURE_DATA = 0x1A2B
    SECOND_BEGIN = 0x1A2C
    SECOND_DATA = 0x1A2D
    TABLE = 0x1A31
    ORDER = 0x1A32
    ENTRY = 0x1A34
    TRIGGER_IN_1 = 0x1A35
    LEAST_EXPOSURE = 0x1A42


VIDEO, VIDEO_PATTERN, ON_THE_FLY = 0, 2, 3
"""Modes: a video signal as pictures, bit by bit; pictures that come over USB."""
STOP, START = 0, 2
NORMAL, STANDBY = 0, 1


class Hardware(enum.IntFlag):
    """Status 0x1A0A."""

    READY = 1
    INCOMPATIBLE = 2
    RESET_FAULT = 4
    FORCED_SWAP = 8
    SECONDARY = 16
    ABORTED = 64
    SEQUENCE_FAULT = 128


class Main(enum.IntFlag):
    """Status 0x1A0C."""

    PARKED = 1
    RUNNING = 2
    LOCKED = 8


DMD_KINDS: dict[int, tuple[str, tuple[int, int], int, int]] = {
    1: ("DLP6500", (1920, 1080), 400, 400),
    2: ("DLP9000", (2560, 1600), 400, 480),
    3: ("DLP670S", (2716, 1600), 400, 400),
    4: ("DLP500YX", (2048, 1200), 400, 800),
    5: ("DLP5500", (1024, 768), 960, 1024),
}
"""First byte of 0x0206: name, mirrors, entries of a table, planes that can be loaded."""

_ERRORS: dict[int, tuple[type[PdcdError], str, str]] = {
    5: (DeviceLost, "is in another mode", "end the program that changed it, and try again"),
    6: (DeviceLost, "does not take a parameter", "update its firmware"),
    12: (ConfigError, "does not take the dark time", "take a longer one, or none"),
    14: (ConfigError, "does not take the exposure", "lower refresh_hz: rows are too short"),
    15: (ConfigError, "does not take so many entries", "take fewer codes"),
    16: (ConfigError, "does not take an entry", "update its firmware"),
    17: (ConfigError, "has not enough memory", "take fewer codes"),
}
"""Codes of 0x0100."""


def pack_command(flags: int, sequence: int, command: int, data: bytes) -> bytes:
    """A command, not yet cut into reports."""
    return struct.pack("<BBHH", flags, sequence, 2 + len(data), command) + data


def pack_entry(
    index: int, times_us: tuple[int, int], place: tuple[int, int], options: tuple[int, int, int]
) -> bytes:
    """0x1A34: one entry of a table, a plane of one bit that is cleared after its exposure.

    times_us : exposure, and dark time after it. place : picture and bit of it. options : whether it
        waits for TRIG_IN_1, its LEDs, its trigger bit.
    """
    (exposure_us, dark_us), (picture, bit), (waits, led, trigger) = times_us, place, options
    return struct.pack(
        "<H3sB3sBH",
        index,
        exposure_us.to_bytes(3, "little"),
        1 | led << 4 | waits << 7,
        dark_us.to_bytes(3, "little"),
        trigger,
        picture | bit << 11,
    )


def pack_table(entries: int, shown: int) -> bytes:
    """0x1A31: number of entries, and number of entries to show in all; 0 is for ever."""
    return struct.pack("<HI", entries, shown)


def pack_order(entries: Sequence[int], shown: int) -> bytes:
    """0x1A32: show these entries of the valid table, in this order."""
    return struct.pack(f"<HI{len(entries)}H", len(entries), shown, *entries)


def make_refusal(role: str, command: int, code: int | None, text: str) -> PdcdError:
    """The error for a refused command, by its code (None: the device gave none)."""
    kind, what, hint = _ERRORS.get(
        -1 if code is None else code,
        (DeviceLost, "refused a command", "switch it off and on, and update its firmware"),
    )
    said = f": {text}" if text else ""
    number = "no code" if code is None else f"code {code}"
    return kind(f"{what} ({number} after {command:#06x}{said})", device=role, hint=hint)
