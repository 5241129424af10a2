"""The mock's DNG with a masked border: tags that its writer has no use for."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.dng_file import write_dng

ORIENTATION, ACTIVE_AREA, MASKED_AREAS, CFA_PATTERN = 274, 50829, 50830, 33422
_LONG, _SHORT, _BYTE = 4, 3, 1


def write_masked_dng(
    path: Path,
    sensor: NDArray[np.uint16],
    *,
    active: tuple[int, int, int, int],
    masked: Sequence[int] = (),
    orientation: int = 1,
    cfa: tuple[int, int, int, int] = (0, 1, 1, 2),
    black: int = 512,
) -> int:
    """Write all samples of a sensor; returns the bytes written.

    active, masked : top, left, bottom, right of the picture and of each masked area.
    cfa : colours of the quad in the picture's corner (0 red, 1 green, 2 blue).
    """
    write_dng(path, sensor, black=black, exposure_s=0.6)
    rows, columns = active[2] - active[0], active[3] - active[1]
    tags = {
        ORIENTATION: struct.pack(
            "<HHI4s", ORIENTATION, _SHORT, 1, struct.pack("<Hxx", orientation)
        ),
        CFA_PATTERN: struct.pack("<HHI4B", CFA_PATTERN, _BYTE, 4, *cfa),
        50720: struct.pack("<HHI", 50720, _LONG, 2),  # DefaultCropSize, within the active area
        ACTIVE_AREA: struct.pack("<HHI", ACTIVE_AREA, _LONG, 4),
    }
    values = {50720: struct.pack("<2I", columns, rows), ACTIVE_AREA: struct.pack("<4I", *active)}
    if masked:
        tags[MASKED_AREAS] = struct.pack("<HHI", MASKED_AREAS, _LONG, len(masked))
        values[MASKED_AREAS] = struct.pack(f"<{len(masked)}I", *masked)
    data = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        (tag,) = struct.unpack_from("<H", data, entry)
        tags.setdefault(tag, bytes(data[entry : entry + 12]))
    # The directory anew, behind everything; what the old entries point at stays where it is.
    behind = len(data) + 2 + 12 * len(tags) + 4
    head, tail = struct.pack("<H", len(tags)), b""
    for tag, entry_bytes in sorted(tags.items()):
        if tag in values:
            head += entry_bytes + struct.pack("<I", behind + len(tail))
            tail += values[tag]
        else:
            head += entry_bytes
    struct.pack_into("<I", data, 4, len(data))
    return path.write_bytes(bytes(data) + head + bytes(4) + tail)
