"""Identity of panels out of EDID blocks made by hand, and against edid-decode where it is there."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdcd.presenter.edid import Edid, parse_edid
from pdcd.presenter.timings import VideoTiming
from tests.edid_block import block
from tests.tools import needs, program

OWN = VideoTiming(162_000, (1600, 1664, 1856, 2160), (1200, 1201, 1204, 1250))
"""VESA's timing of 1600 x 1200, as the block has it."""
TEXT = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=13)


def test_all_identity_fields_are_read() -> None:
    data = block(name="EPSON PJ", serial="X4K700123")
    assert parse_edid(data) == Edid("EPS", 0xA1B2, 16909060, "EPSON PJ", "X4K700123", (OWN,))


@given(name=TEXT, serial=TEXT, number=st.integers(0, 2**32 - 1), product=st.integers(0, 65535))
def test_texts_of_every_length_survive(name: str, serial: str, number: int, product: int) -> None:
    found = parse_edid(block(name=name, serial=serial, number=number, product=product))
    assert found == Edid("EPS", product, number, name, serial, (OWN,))


def test_a_panel_is_asked_for_by_text_or_number() -> None:
    both = parse_edid(block(serial="X4K700123"))
    assert both is not None and both.serials == ("X4K700123", "16909060")
    number = parse_edid(block())
    assert number is not None and number.serials == ("16909060",)
    nothing = parse_edid(block(number=0))
    assert nothing is not None and nothing.serials == ()
    assert str(nothing) == "EPS-A1B2, serial unknown"
    assert str(both) == "EPS-A1B2, serial X4K700123"


def test_a_number_that_repeats_the_text_counts_once() -> None:
    found = parse_edid(block(serial="77", number=77))
    assert found is not None and found.serials == ("77",)


@pytest.mark.parametrize("at", [0, 7, 9, 60, 127])
def test_a_damaged_block_is_no_identity(at: int) -> None:
    data = bytearray(block(name="EPSON PJ"))
    data[at] ^= 0x10
    assert parse_edid(bytes(data)) is None


def test_a_short_or_missing_block_is_no_identity() -> None:
    assert parse_edid(b"") is None
    assert parse_edid(block()[:-1]) is None


def test_extensions_are_left_alone() -> None:
    assert parse_edid(block(name="a") + bytes(128)) == parse_edid(block(name="a"))


@needs("edid-decode")
def test_edid_decode_reads_the_same(tmp_path: Path) -> None:
    data = block(vendor="SHP", product=0x1234, number=987654321, name="LM201U05", serial="MASK-7")
    file = tmp_path / "edid.bin"
    file.write_bytes(data)
    command = [program("edid-decode"), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20)
    fields = dict(re.findall(r"^\s*([A-Za-z ]+): (.*?)\s*$", done.stdout, re.MULTILINE))
    found = parse_edid(data)
    assert found is not None
    assert fields["Manufacturer"] == found.vendor
    assert int(fields["Model"]) == found.product
    # edid-decode prints both in decimal, the text in quotes.
    assert int(fields["Serial Number"].split()[0]) == found.number
    assert fields["Display Product Serial Number"].strip("'") == found.serial
    assert fields["Display Product Name"].strip("'") == found.name
    (timing,) = found.timings
    modeline = re.search(r"Modeline *(.*)", subprocess.run(
        [command[0], "-X", command[1]], capture_output=True, text=True, timeout=20
    ).stdout)  # fmt: skip
    assert modeline is not None
    assert modeline[1].lower().split()[1:] == timing.to_modeline("own").split()[1:]
