"""Commands of the DLPC900, each byte by hand from the tables of TI DLPU018."""

from __future__ import annotations

import pytest

from drivers.dlpc900.commands import make_refusal, pack_command, pack_entry, pack_table
from pdcd.errors import ConfigError, DeviceLost


def test_a_command_is_flags_sequence_length_and_number() -> None:
    assert pack_command(0xC0, 0x11, 0x1A0C, b"").hex() == "c01102000c1a"
    assert pack_command(0x40, 0xFF, 0x1A24, b"\x02").hex() == "40ff0300241a02"
    # Two bytes of count and 504 of a picture: 512 in all.
    whole = pack_command(0, 1, 0x1A2B, bytes(506))
    assert len(whole) == 512 and whole[:6].hex() == "0001fc012b1a"


def test_entries_of_a_table() -> None:
    """Index; exposure, 3 bytes; clear + depth 1 + LED 1 + wait; dark, 3 bytes; trigger; place."""
    assert pack_entry(0, (105, 0), (0, 0), (1, 1, 1)).hex() == "000069000091000000010000"
    assert pack_entry(7, (210, 105), (2, 13), (0, 1, 1)).hex() == ("0700d2000011690000010268")
    # The last of all, the longest, every LED, the quiet trigger: 17 + 23 * 2048 = 0xb811.
    assert pack_entry(399, (2**24 - 1, 2**24 - 1), (17, 23), (0, 7, 0)).hex() == (
        "8f01ffffff71ffffff0011b8"
    )


def test_a_table_is_entries_and_how_many_of_them_are_shown() -> None:
    assert pack_table(257, 257).hex() == "010101010000"
    assert pack_table(1, 0).hex() == "010000000000"


@pytest.mark.parametrize(
    ("code", "kind", "word"),
    [
        (12, ConfigError, "dark time"), (14, ConfigError, "exposure"),
        (15, ConfigError, "so many entries"), (17, ConfigError, "memory"),
        (5, DeviceLost, "another mode"), (6, DeviceLost, "parameter"), (99, DeviceLost, "code 99"),
        (None, DeviceLost, "no code"),
    ],
)  # fmt: skip
def test_codes_are_errors_with_something_to_do(
    code: int | None, kind: type[Exception], word: str
) -> None:
    error = make_refusal("mask", 0x1A34, code, "out of range")
    assert type(error) is kind and error.device == "mask" and error.hint
    assert word in error.message and "0x1a34" in error.message and "out of range" in error.message
