"""Mosaics as DNG files, for tests of what reads them."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.sensor.dng import encode_dng

_USUAL: dict[str, Any] = {
    "black": 512, "white": 16383, "iso": 100, "exposure_s": 25.6, "f_number": 8.0,
    "model": "test camera", "date": datetime(2024, 1, 2, 3, 4, 5),
}  # fmt: skip


def write_dng(path: Path, mosaic: NDArray[np.uint16], **fields: Any) -> int:
    """Write what `encode_dng` makes of these and of usual arguments; returns the bytes written."""
    return path.write_bytes(encode_dng(mosaic, **_USUAL | fields))
