"""Arrays in anonymous memory, which another process reads through a descriptor.

Once packed, neither side can change them any more, so a reader can trust them without a copy.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterable, Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SEALS = 0x1 | 0x2 | 0x4 | 0x8
"""F_SEAL_SEAL, F_SEAL_SHRINK, F_SEAL_GROW and F_SEAL_WRITE of linux/fcntl.h."""
_ADD_SEALS = 1033
"""F_ADD_SEALS of linux/fcntl.h, which Python knows from 3.8 on and not on every system."""
_ALIGNED = 64
"""Arrays begin at multiples of this many bytes."""
_TYPES = ("<f4", "<f8")
"""Types of numbers that arrays may have."""
_MOST_BYTES = 2**31
"""Most bytes of memory that is read."""

Place = tuple[str, tuple[int, ...], int]
"""Type, shape and first byte of an array."""


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> tuple[int, dict[str, Place]]:
    """A descriptor of memory that holds the arrays, which the caller closes, and their places in
    it. Raises OSError if there is no memory for them."""
    import fcntl  # missing on Windows, where nothing is packed

    places: dict[str, Place] = {}
    size = 0
    for name, array in arrays.items():
        places[name] = array.dtype.newbyteorder("<").str, array.shape, size
        size = -(-(size + array.nbytes) // _ALIGNED) * _ALIGNED
    fd = os.memfd_create("pdcd-arrays", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(fd, max(size, 1))
        for array, (_, _, offset) in zip(arrays.values(), places.values(), strict=True):
            rest = np.ascontiguousarray(array).data.cast("B")
            while rest:
                written = os.pwrite(fd, rest, offset)
                rest, offset = rest[written:], offset + written
        fcntl.fcntl(fd, _ADD_SEALS, _SEALS)
    except BaseException:
        os.close(fd)
        raise
    return fd, places


def unpack_arrays(fd: int, places: Iterable[tuple[str, Place]]) -> dict[str, NDArray[Any]]:
    """Copies of the arrays; the descriptor stays the caller's. Raises ValueError for an array that
    does not lie in that memory."""
    size = os.fstat(fd).st_size
    if size > _MOST_BYTES:
        raise ValueError(f"{size} bytes are too many")
    found = {}
    with mmap.mmap(fd, 0, prot=mmap.PROT_READ) as memory:
        for name, (dtype, shape, offset) in places:
            if dtype not in _TYPES or min(shape, default=0) < 0 or len(shape) > 3:
                raise ValueError(f"{name} is no array of numbers")
            count = prod(shape)
            if not 0 <= offset <= size - count * int(dtype[2:]):
                raise ValueError(f"{name} does not lie in what came with it")
            view = np.frombuffer(memory, dtype, count, offset)
            found[name] = view.reshape(shape).copy()
            del view
    return found
