"""Numbers of PTP and of Canon's extension against tables of their own: a wrong one is another order
to a real camera, and the virtual camera, which shares them, would not mind.

Standard numbers are those of ISO 15740, Canon's are those that libgphoto2 knows. ISO and aperture
codes are checked by the rule that makes them: eight to a stop.
"""

from __future__ import annotations

import math
from enum import IntEnum

import pytest

from drivers.ptp import codes

STANDARD_OPERATIONS = """
1001 GET_DEVICE_INFO  1002 OPEN_SESSION  1003 CLOSE_SESSION  1004 GET_STORAGE_IDS
1005 GET_STORAGE_INFO  1006 GET_NUM_OBJECTS  1007 GET_OBJECT_HANDLES  1008 GET_OBJECT_INFO
1009 GET_OBJECT  100B DELETE_OBJECT  1014 GET_DEVICE_PROP_DESC  1015 GET_DEVICE_PROP_VALUE
1016 SET_DEVICE_PROP_VALUE  101B GET_PARTIAL_OBJECT
"""
CANON_OPERATIONS = """
9101 EOS_GET_STORAGE_IDS  9102 EOS_GET_STORAGE_INFO  9103 EOS_GET_OBJECT_INFO
9104 EOS_GET_OBJECT  9105 EOS_DELETE_OBJECT  9107 EOS_GET_PARTIAL_OBJECT
9108 EOS_GET_DEVICE_INFO_EX  9109 EOS_GET_OBJECT_INFO_EX  910F EOS_REMOTE_RELEASE
9110 EOS_SET_DEVICE_PROP_VALUE_EX  9114 EOS_SET_REMOTE_MODE  9115 EOS_SET_EVENT_MODE
9116 EOS_GET_EVENT  9117 EOS_TRANSFER_COMPLETE  9118 EOS_CANCEL_TRANSFER
911A EOS_PC_HDD_CAPACITY  911B EOS_SET_UI_LOCK  911C EOS_RESET_UI_LOCK  911D EOS_KEEP_DEVICE_ON
9125 EOS_BULB_START  9126 EOS_BULB_END  9127 EOS_REQUEST_DEVICE_PROP_VALUE
9128 EOS_REMOTE_RELEASE_ON  9129 EOS_REMOTE_RELEASE_OFF  9153 EOS_GET_VIEW_FINDER_DATA
"""
RESPONSES = """
2001 OK  2002 GENERAL_ERROR  2003 SESSION_NOT_OPEN  2004 INVALID_TRANSACTION_ID
2005 OPERATION_NOT_SUPPORTED  2006 PARAMETER_NOT_SUPPORTED  2007 INCOMPLETE_TRANSFER
2008 INVALID_STORAGE_ID  2009 INVALID_OBJECT_HANDLE  200A DEVICE_PROP_NOT_SUPPORTED
200C STORE_FULL  200F ACCESS_DENIED  2013 STORE_NOT_AVAILABLE  2019 DEVICE_BUSY
201C INVALID_DEVICE_PROP_VALUE  201D INVALID_PARAMETER  201E SESSION_ALREADY_OPEN
201F TRANSACTION_CANCELLED  A102 EOS_NOT_READY
"""
EOS_EVENTS = """
0000 END  C181 OBJECT_ADDED_EX  C182 OBJECT_REMOVED  C186 REQUEST_OBJECT_TRANSFER
C189 PROP_VALUE_CHANGED  C18A AVAIL_LIST_CHANGED  C18B CAMERA_STATUS_CHANGED
C18D WILL_SOON_SHUT_DOWN  C18E SHUTDOWN_TIMER_UPDATED  C194 BULB_EXPOSURE_TIME
"""
PROPERTIES = """
D101 APERTURE  D102 SHUTTER_SPEED  D103 ISO  D105 EXPOSURE_MODE  D106 DRIVE_MODE  D108 FOCUS_MODE
D111 BATTERY  D114 AUTO_POWER_OFF  D11B AVAILABLE_SHOTS  D11C CAPTURE_DESTINATION
D11E CURRENT_STORAGE  D120 IMAGE_FORMAT  D1A0 CUSTOM_FUNCTIONS  D1B0 FINDER_OUTPUT
D1B1 FINDER_MODE
"""
FORMATS = "3001 ASSOCIATION  3801 JPEG  B101 CANON_CRW  B103 CANON_CR2"
REQUESTS = "0064 CANCEL  0065 GET_EXTENDED_EVENT  0066 DEVICE_RESET  0067 GET_DEVICE_STATUS"


def read(table: str) -> dict[str, int]:
    words = table.split()
    return {name: int(number, 16) for number, name in zip(words[::2], words[1::2], strict=True)}


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        (codes.Operation, STANDARD_OPERATIONS + CANON_OPERATIONS),
        (codes.ResponseCode, RESPONSES),
        (codes.EosEvent, EOS_EVENTS),
        (codes.Property, PROPERTIES),
        (codes.ObjectFormat, FORMATS),
        (codes.ClassRequest, REQUESTS),
    ],
)
def test_numbers_are_those_that_cameras_know(kind: type[IntEnum], table: str) -> None:
    assert {member.name: member.value for member in kind} == read(table)


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (codes.ContainerType, ". COMMAND DATA RESPONSE EVENT"),
        (codes.ExposureMode, "PROGRAM SHUTTER_PRIORITY APERTURE_PRIORITY MANUAL BULB"),
        (codes.FocusMode, "ONE_SHOT AI_SERVO AI_FOCUS MANUAL"),
    ],
)
def test_what_is_counted_is_counted_in_order(kind: type[IntEnum], names: str) -> None:
    counted = {name: place for place, name in enumerate(names.split()) if name != "."}
    assert {member.name: member.value for member in kind} == counted


def test_values_that_are_sent_as_they_are() -> None:
    assert codes.CUSTOM_LONG_EXPOSURE_NR == 0x0201
    assert codes.DESTINATION_RAM == 4
    assert codes.SHUTTER_BULB == (0x0C, 0x04)
    free_clusters, bytes_a_cluster, reset = codes.PC_HDD_ROOM
    assert free_clusters == 2**28 - 1  # the most that does not overflow with clusters of 4 KiB
    assert (bytes_a_cluster, reset) == (4096, 1)


NOMINAL_ISOS = (
    50, 100, 125, 160, 200, 250, 320, 400, 500, 640, 800, 1000, 1250, 1600, 3200, 6400,
)  # fmt: skip


def test_iso_codes_are_eight_to_a_stop_from_100_at_48() -> None:
    table = dict(codes.ISO_CODES)
    assert table.pop(0x00) == 0  # automatic
    assert tuple(table.values()) == NOMINAL_ISOS
    for code, iso in table.items():
        assert code % 8 in (0, 3, 5)  # whole stops and thirds
        exact = 8.0 * math.log2(iso / 100.0) + 0x48
        assert abs(code - exact) < 0.5, iso


def test_aperture_codes_are_eight_to_a_stop_from_f1_at_08() -> None:
    table = codes.APERTURE_CODES
    every = {code for code in range(0x08, 0x61) if code % 8 in (0, 3, 4, 5)}
    assert set(table) == every
    for code, f_number in table.items():
        exact = 2.0 ** ((code - 8) / 16.0)
        assert abs(f_number / exact - 1.0) < 0.075, hex(code)  # as engraved, not as it is
    whole = [table[code] for code in range(0x08, 0x61, 8)]
    assert whole == [1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0, 45.0]
    assert sorted(table.values()) == list(table.values())


def test_a_code_is_named_among_those_of_its_kind() -> None:
    assert codes.format_code(0x2019, codes.ResponseCode) == "0x2019 DEVICE_BUSY"
    assert codes.format_code(0x1002) == "0x1002 OPEN_SESSION"
    assert codes.format_code(0x1002, codes.ResponseCode) == "0x1002"
    assert codes.format_code(0x7, codes.ResponseCode) == "0x0007"
