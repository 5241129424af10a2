"""What a Canon EOS 450D reports of itself, and two other kinds of EOS body a client must know.

The lists of operations, events and formats are those that a real 450D with firmware 1.0.4 gave, as
recorded by the libgphoto2 project. The lists of settings are those of Canon's manual in the codes
of `drivers.ptp.codes`; the lens is a kit zoom at its long end.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

from ..ptp.codes import DESTINATION_RAM, SHUTTER_BULB, ObjectFormat, Operation
from ..ptp.datasets import DeviceInfo

DESTINATION_CARD = 2
STORAGE = 0x00020001
USB_ID = (0x04A9, 0x3145)

RAW_FORMAT = struct.pack("<5I", 1, 0x10, 6, 0, 4)
RAW_AND_JPEG = struct.pack("<9I", 2, 0x10, 6, 0, 4, 0x10, 1, 0, 3)
LARGE_FINE_JPEG = struct.pack("<5I", 1, 0x10, 1, 0, 3)

THIRD_STOPS = (0, 3, 5)
"""Last octal digits of codes in third stops (the half stop is 4)."""

EOS_450D = DeviceInfo(
    manufacturer="Canon Inc.",
    model="Canon EOS 450D",
    device_version="3-1.0.4",
    serial="0123456789abcdef0123456789abcdef",
    operations=(
        0x1014, 0x1015, 0x1016, 0x1001, 0x1002, 0x1003, 0x1006, 0x1004, 0x9101, 0x1005, 0x9102,
        0x1007, 0x1008, 0x9103, 0x1009, 0x9104, 0x100A, 0x101B, 0x9107, 0x100C, 0x100D, 0x100B,
        0x9105, 0x100F, 0x9106, 0x9110, 0x9127, 0x910B, 0x9108, 0x9109, 0x910C, 0x910E, 0x910F,
        0x9125, 0x9126, 0x9115, 0x9114, 0x9113, 0x9116, 0x9117, 0x9120, 0x91F0, 0x9118, 0x9121,
        0x91F1, 0x911D, 0x910A, 0x911B, 0x911C, 0x911E, 0x911A, 0x9153, 0x9154, 0x9155, 0x9157,
        0x9158, 0x9159, 0x911F, 0x91FE, 0x91FF, 0x9801, 0x9802, 0x9803, 0x9804, 0x9805,
    ),
    events=(0x4009, 0x4004, 0x4005, 0x4003, 0x4002, 0x4007, 0xC101),
    properties=(0xD402, 0xD407, 0xD406),
    capture_formats=(ObjectFormat.JPEG,),
    image_formats=(
        0x3001, 0x3002, 0x3006, 0x300A, 0x3008, 0x3801, 0xB101, 0xB103, 0xBF02, 0x3800,
    ),
    vendor_extension_id=0x0B,
    vendor_extension_version=200,
)  # fmt: skip


@dataclass(frozen=True)
class CameraModel:
    """One kind of body: what it reports of itself and which settings it offers (codes)."""

    info: DeviceInfo
    isos: tuple[int, ...] = (0x00, 0x48, 0x50, 0x58, 0x60, 0x68)  # auto, 100 to 1600: no 50
    shutter_speeds: tuple[int, ...] = (
        SHUTTER_BULB[0],
        *(0x10 + 8 * stop + third for stop in range(18) for third in THIRD_STOPS
          if 8 * stop + third <= 0x88),
    )  # fmt: skip
    """Bulb, then 30 s (0x10) to 1/4000 s (0x98)."""
    apertures: tuple[int, ...] = (
        *(0x30 + 8 * stop + third for stop in range(5) for third in THIRD_STOPS),
        0x58,
    )
    """f/5.6 to f/32; empty for a lens without contacts."""
    drive_modes: tuple[int, ...] = (0x00, 0x01, 0x10)
    destinations: tuple[int, ...] = (DESTINATION_CARD, DESTINATION_RAM)
    image_formats: tuple[bytes, ...] = (LARGE_FINE_JPEG, RAW_AND_JPEG, RAW_FORMAT)
    ram_shots: int = 5
    """Photos that the camera's memory holds until they are fetched."""


BULB_BODY = CameraModel(EOS_450D)
"""The 450D: BulbStart and BulbEnd."""


def _with(model: str, drop: set[int], add: tuple[int, ...] = ()) -> CameraModel:
    kept = tuple(code for code in EOS_450D.operations if code not in drop)
    return CameraModel(replace(EOS_450D, model=model, operations=kept + add))


_BULB = {Operation.EOS_BULB_START.value, Operation.EOS_BULB_END.value}

RELEASE_BODY = _with(
    "Virtual EOS (release on/off)",
    _BULB,
    (Operation.EOS_REMOTE_RELEASE_ON.value, Operation.EOS_REMOTE_RELEASE_OFF.value),
)
"""Like newer bodies: RemoteReleaseOn and Off, no BulbStart. The name is our own."""

CABLE_BODY = _with("Virtual EOS (cable only)", _BULB)
"""Like the oldest EOS bodies with remote control: bulb by its cable socket alone."""
