"""Mosaics as DNG files, for tests of what reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.sensor.dng import dng_bytes


def write_dng(path: Path, mosaic: NDArray[np.uint16], **fields: Any) -> int:
    """Write what `dng_bytes` makes of the same arguments; returns the bytes written."""
    return path.write_bytes(dng_bytes(mosaic, **fields))
