"""What the virtual 450D says of itself, on the USB and over PTP, against the specifications."""

from __future__ import annotations

import struct
from typing import Any

import pytest
import usb.core
import usb.util

from drivers.ptp.events import is_raw_only
from drivers.virtual_camera.model import (
    BULB_BODY,
    EOS_450D,
    LARGE_FINE_JPEG,
    RAW_AND_JPEG,
    RAW_FORMAT,
)
from tests.virtual_eos import virtual_usb

OPERATIONS_450D = """
1001 1002 1003 1004 1005 1006 1007 1008 1009 100a 100b 100c 100d 100f 1014 1015 1016 101b
9101 9102 9103 9104 9105 9106 9107 9108 9109 910a 910b 910c 910e 910f 9110 9113 9114 9115 9116
9117 9118 911a 911b 911c 911d 911e 911f 9120 9121 9125 9126 9127 9153 9154 9155 9157 9158 9159
91f0 91f1 91fe 91ff 9801 9802 9803 9804 9805
"""
"""In the order of their numbers, of a body with firmware 1.0.4."""


@pytest.fixture
def device() -> Any:
    return usb.core.find(backend=virtual_usb(), idVendor=0x04A9)


def test_the_450d_lists_what_a_real_one_does() -> None:
    listed = [int(number, 16) for number in OPERATIONS_450D.split()]
    assert sorted(EOS_450D.operations) == listed
    assert len(set(EOS_450D.operations)) == len(listed)
    assert sorted(EOS_450D.events) == [*range(0x4002, 0x4006), 0x4007, 0x4009, 0xC101]
    assert sorted(EOS_450D.properties) == [0xD402, 0xD406, 0xD407]
    assert EOS_450D.capture_formats == (0x3801,)
    assert sorted(EOS_450D.image_formats) == [
        0x3001, 0x3002, 0x3006, 0x3008, 0x300A, 0x3800, 0x3801, 0xB101, 0xB103, 0xBF02,
    ]  # fmt: skip
    assert (EOS_450D.standard_version, EOS_450D.functional_mode) == (100, 0)
    assert (EOS_450D.vendor_extension_id, EOS_450D.vendor_extension_version) == (11, 200)
    assert EOS_450D.vendor_extension == ""
    assert len(EOS_450D.serial) == 32  # which libgphoto2 reads as 128 bits


def test_picture_formats_are_as_the_camera_packs_them() -> None:
    """A count, then for each file 16 bytes: their length, type, size and compression."""
    raw, jpeg = struct.pack("<4I", 16, 6, 0, 4), struct.pack("<4I", 16, 1, 0, 3)
    assert RAW_FORMAT == b"\1\0\0\0" + raw
    assert RAW_AND_JPEG == b"\2\0\0\0" + raw + jpeg
    assert LARGE_FINE_JPEG == b"\1\0\0\0" + jpeg
    assert set(BULB_BODY.image_formats) == {RAW_FORMAT, RAW_AND_JPEG, LARGE_FINE_JPEG}
    assert [is_raw_only(packed) for packed in BULB_BODY.image_formats].count(True) == 1


# On the USB.


def test_it_tells_its_names_in_english(device: Any) -> None:
    assert usb.util.get_langids(device) == (0x0409,)
    names = [usb.util.get_string(device, index) for index in (1, 2, 3)]
    assert names == ["Canon Inc.", "Canon EOS 450D", EOS_450D.serial]
    for index in (4, 9):
        with pytest.raises(usb.core.USBError) as caught:
            usb.util.get_string(device, index, 0x0409)
        assert caught.value.backend_error_code == -9
    head = device.ctrl_transfer(0x80, 6, 0x0300, 0, 255).tobytes()
    assert head == bytes.fromhex("04 03 0904")
    cut = device.ctrl_transfer(0x80, 6, 0x0302, 0x0409, 6).tobytes()
    assert cut == bytes([2 + 2 * len("Canon EOS 450D"), 3]) + "Ca".encode("utf-16-le")
