"""Numbers of PTP and of Canon's EOS extension to it.

Sources: ISO 15740:2008 (PIMA 15740) clauses 10 to 13 for the standard codes; the Canon codes were
never published and are known from what bodies report and from libgphoto2's tables. Only the codes
that pdcd sends or answers are named. A code that is not named here is no error: cameras have many
more, so parsers keep plain integers and compare them with these.
"""

from __future__ import annotations

from enum import IntEnum


class ContainerType(IntEnum):
    """What a container carries (USB still image class, D.4)."""

    COMMAND = 1
    DATA = 2
    RESPONSE = 3
    EVENT = 4


class Operation(IntEnum):
    """Operation codes; ``EOS_`` are Canon's."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_STORAGE_IDS = 0x1004
    GET_STORAGE_INFO = 0x1005
    GET_NUM_OBJECTS = 0x1006
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    DELETE_OBJECT = 0x100B
    GET_DEVICE_PROP_DESC = 0x1014
    GET_DEVICE_PROP_VALUE = 0x1015
    SET_DEVICE_PROP_VALUE = 0x1016
    GET_PARTIAL_OBJECT = 0x101B
    EOS_GET_STORAGE_IDS = 0x9101
    EOS_GET_STORAGE_INFO = 0x9102
    EOS_GET_OBJECT_INFO = 0x9103
    EOS_GET_OBJECT = 0x9104
    EOS_DELETE_OBJECT = 0x9105
    EOS_GET_PARTIAL_OBJECT = 0x9107
    EOS_GET_DEVICE_INFO_EX = 0x9108
    EOS_GET_OBJECT_INFO_EX = 0x9109
    EOS_REMOTE_RELEASE = 0x910F
    EOS_SET_DEVICE_PROP_VALUE_EX = 0x9110
    EOS_SET_REMOTE_MODE = 0x9114
    EOS_SET_EVENT_MODE = 0x9115
    EOS_GET_EVENT = 0x9116
    EOS_TRANSFER_COMPLETE = 0x9117
    EOS_CANCEL_TRANSFER = 0x9118
    EOS_PC_HDD_CAPACITY = 0x911A
    EOS_SET_UI_LOCK = 0x911B
    EOS_RESET_UI_LOCK = 0x911C
    EOS_KEEP_DEVICE_ON = 0x911D
    EOS_BULB_START = 0x9125
    EOS_BULB_END = 0x9126
    EOS_REQUEST_DEVICE_PROP_VALUE = 0x9127
    EOS_REMOTE_RELEASE_ON = 0x9128
    EOS_REMOTE_RELEASE_OFF = 0x9129
    EOS_GET_VIEW_FINDER_DATA = 0x9153


class ResponseCode(IntEnum):
    """Response codes (ISO 15740 clause 11)."""

    OK = 0x2001
    GENERAL_ERROR = 0x2002
    SESSION_NOT_OPEN = 0x2003
    INVALID_TRANSACTION_ID = 0x2004
    OPERATION_NOT_SUPPORTED = 0x2005
    PARAMETER_NOT_SUPPORTED = 0x2006
    INCOMPLETE_TRANSFER = 0x2007
    INVALID_STORAGE_ID = 0x2008
    INVALID_OBJECT_HANDLE = 0x2009
    DEVICE_PROP_NOT_SUPPORTED = 0x200A
    STORE_FULL = 0x200C
    ACCESS_DENIED = 0x200F
    STORE_NOT_AVAILABLE = 0x2013
    DEVICE_BUSY = 0x2019
    INVALID_DEVICE_PROP_VALUE = 0x201C
    INVALID_PARAMETER = 0x201D
    SESSION_ALREADY_OPEN = 0x201E
    TRANSACTION_CANCELLED = 0x201F
    EOS_NOT_READY = 0xA102


class EosEvent(IntEnum):
    """Record codes inside the data of `Operation.EOS_GET_EVENT`."""

    END = 0
    OBJECT_ADDED_EX = 0xC181
    OBJECT_REMOVED = 0xC182
    REQUEST_OBJECT_TRANSFER = 0xC186
    PROP_VALUE_CHANGED = 0xC189
    AVAIL_LIST_CHANGED = 0xC18A
    CAMERA_STATUS_CHANGED = 0xC18B
    WILL_SOON_SHUT_DOWN = 0xC18D
    SHUTDOWN_TIMER_UPDATED = 0xC18E
    BULB_EXPOSURE_TIME = 0xC194


class Property(IntEnum):
    """EOS device properties; the value is one u32 unless noted otherwise."""

    APERTURE = 0xD101
    SHUTTER_SPEED = 0xD102
    ISO = 0xD103
    EXPOSURE_MODE = 0xD105
    DRIVE_MODE = 0xD106
    FOCUS_MODE = 0xD108
    BATTERY = 0xD111
    AUTO_POWER_OFF = 0xD114
    AVAILABLE_SHOTS = 0xD11B
    CAPTURE_DESTINATION = 0xD11C
    CURRENT_STORAGE = 0xD11E
    IMAGE_FORMAT = 0xD120
    """In a packed form of its own, see `drivers.ptp.events.AvailList`."""
    FINDER_OUTPUT = 0xD1B0
    """Where live view goes: bits for its own screen and for the computer."""
    FINDER_MODE = 0xD1B1
    """Whether live view is allowed at all."""
    CUSTOM_FUNCTIONS = 0xD1A0
    """In a packed form of its own, see `drivers.ptp.datasets.parse_custom_functions`."""


class ObjectFormat(IntEnum):
    """Format codes of objects."""

    ASSOCIATION = 0x3001
    JPEG = 0x3801
    CANON_CRW = 0xB101
    CANON_CR2 = 0xB103


class ClassRequest(IntEnum):
    """Control requests of the USB still image class (bmRequestType 0x21 out, 0xA1 in)."""

    CANCEL = 0x64
    GET_EXTENDED_EVENT = 0x65
    DEVICE_RESET = 0x66
    GET_DEVICE_STATUS = 0x67


class ExposureMode(IntEnum):
    """Values of `Property.EXPOSURE_MODE`; on a 450D they follow the dial."""

    PROGRAM = 0
    SHUTTER_PRIORITY = 1
    APERTURE_PRIORITY = 2
    MANUAL = 3
    BULB = 4


class FocusMode(IntEnum):
    """Values of `Property.FOCUS_MODE`; they follow the switch on the lens."""

    ONE_SHOT = 0
    AI_SERVO = 1
    AI_FOCUS = 2
    MANUAL = 3


CUSTOM_LONG_EXPOSURE_NR = 0x0201
"""Custom function of long-exposure noise reduction: 0 off, 1 auto, 2 on. The number is that of
Canon's own table for EOS bodies; not seen on a 450D by us."""

DESTINATION_RAM = 4
"""`Property.CAPTURE_DESTINATION` of the computer; the list's other value is the card."""

FINDER_OFF, FINDER_SCREEN, FINDER_PC = 0, 1, 2
"""`Property.FINDER_OUTPUT` values."""

FINDER_WHOLE = 0x00100000
"""Parameter of `Operation.EOS_GET_VIEW_FINDER_DATA`, as libgphoto2 saw it in traces."""

FINDER_JPEG = frozenset({1, 9, 11})
"""Types of data blocks that hold a JPEG; others hold focus and exposure."""

SHUTTER_BULB = (0x0C, 0x04)
"""`Property.SHUTTER_SPEED` values that mean bulb; the 450D lists the first."""

PC_HDD_ROOM = (0x0FFFFFFF, 0x1000, 1)
"""Parameters of `Operation.EOS_PC_HDD_CAPACITY` that tell the camera the computer has room."""

ISO_CODES = {
    0x00: 0, 0x40: 50, 0x48: 100, 0x4B: 125, 0x4D: 160, 0x50: 200, 0x53: 250, 0x55: 320,
    0x58: 400, 0x5B: 500, 0x5D: 640, 0x60: 800, 0x63: 1000, 0x65: 1250, 0x68: 1600,
    0x70: 3200, 0x78: 6400,
}  # fmt: skip
"""`Property.ISO` value -> ISO; 0 stands for automatic. Eight steps make a stop."""

APERTURE_CODES = {
    0x08: 1.0, 0x0B: 1.1, 0x0C: 1.2, 0x0D: 1.2, 0x10: 1.4, 0x13: 1.6, 0x14: 1.8, 0x15: 1.8,
    0x18: 2.0, 0x1B: 2.2, 0x1C: 2.5, 0x1D: 2.5, 0x20: 2.8, 0x23: 3.2, 0x24: 3.5, 0x25: 3.5,
    0x28: 4.0, 0x2B: 4.5, 0x2C: 4.5, 0x2D: 5.0, 0x30: 5.6, 0x33: 6.3, 0x34: 6.7, 0x35: 7.1,
    0x38: 8.0, 0x3B: 9.0, 0x3C: 9.5, 0x3D: 10.0, 0x40: 11.0, 0x43: 13.0, 0x44: 13.0, 0x45: 14.0,
    0x48: 16.0, 0x4B: 18.0, 0x4C: 19.0, 0x4D: 20.0, 0x50: 22.0, 0x53: 25.0, 0x54: 27.0, 0x55: 29.0,
    0x58: 32.0, 0x5B: 36.0, 0x5C: 38.0, 0x5D: 40.0, 0x60: 45.0,
}  # fmt: skip
"""`Property.APERTURE` value -> f-number as engraved. Eight steps make a stop; x3 and x5 are thirds,
x4 is the half."""


def format_code(code: int, kind: type[IntEnum] = Operation) -> str:
    """Return "0x9125 EOS_BULB_START", or the number alone where `kind` does not name it."""
    try:
        return f"0x{code:04X} {kind(code).name}"
    except ValueError:
        return f"0x{code:04X}"
