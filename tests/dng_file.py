"""Mosaics as DNG files, for tests of what reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.sensor.dng import encode_dng


def write_dng(path: Path, mosaic: NDArray[np.uint16], **fields: Any) -> int:
    """Write what `encode_dng` makes of the same arguments; returns the bytes written."""
    return path.write_bytes(encode_dng(mosaic, **fields))
