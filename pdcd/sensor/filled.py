"""Whether all samples of a RAW file are there yet.

Windows, network shares and download tools make a file of its full length first, and fill it later:
until then there are zeros in the place of samples.
"""

from __future__ import annotations

import numpy as np

from pdcd.sensor.tiff import read_tags

_STRIPS = ((273, 279), (324, 325))
"""Tags of where strips and tiles begin, and how long they are."""
_BLOCK_BYTES, _END_BYTES = 2**16, 2**12
"""So many zeros amid a strip, or at its end, are samples that are still to come: real ones have
noise, and packed ones end with a mark."""


def find_gap(data: bytes) -> str:
    """What of a file is not there yet, in words; "" where all may be.

    For drivers that find files which something else writes. A file of a form that is not built on
    TIFF is looked at as a whole.
    """
    if not data:
        return "it is empty"
    tags = read_tags(data)
    if tags is None:
        return _find_zeros(data, end_bytes=0)
    if tags.needs_bytes > len(data):
        return f"it has {len(data)} bytes and speaks of {tags.needs_bytes}"
    for directory in tags.directories:
        for starts, sizes in _STRIPS:
            places = zip(directory.get(starts, ()), directory.get(sizes, ()), strict=False)
            for start, size in places:
                if isinstance(start, int) and isinstance(size, int):
                    if why := _find_zeros(data[start : start + size], _END_BYTES):
                        return why
    return ""


def _find_zeros(strip: bytes, end_bytes: int) -> str:
    """Where a strip is still zeros, in words."""
    if end_bytes and strip and not np.frombuffer(strip[-end_bytes:], np.uint8).any():
        return "its samples end with zeros, as of a file that is still being filled"
    blocks = len(strip) // _BLOCK_BYTES
    filled = np.frombuffer(strip[: blocks * _BLOCK_BYTES], np.uint8).reshape(blocks, _BLOCK_BYTES)
    if filled.any(axis=1).all():
        return ""
    return "there are only zeros amid its samples, as of a file that is still being filled"
