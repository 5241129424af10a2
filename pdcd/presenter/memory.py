"""Arrays that two processes share: anonymous memory, handed over as a file descriptor.

A memfd has no name, so nothing is left behind however either process ends.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

ALIGN_BYTES = 64
"""Each array starts on a cache line."""


class Slot(msgspec.Struct, frozen=True):
    """Where one array lies in the memory."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    offset: int


def layout(arrays: Mapping[str, NDArray[Any]]) -> tuple[list[Slot], int]:
    """Places of the arrays, one after the other, and the bytes of them all."""
    slots, offset = [], 0
    for name, array in arrays.items():
        slots.append(Slot(name, array.dtype.str, array.shape, offset))
        offset += -(-array.nbytes // ALIGN_BYTES) * ALIGN_BYTES
    return slots, max(offset, ALIGN_BYTES)


def share(arrays: Mapping[str, NDArray[Any]]) -> tuple[int, list[Slot], dict[str, NDArray[Any]]]:
    """Copy arrays into new shared memory; returns its descriptor, their places and the copies.

    The caller closes the descriptor; the copies stay valid.
    """
    slots, size = layout(arrays)
    fd = os.memfd_create("pdcd", os.MFD_CLOEXEC)
    os.ftruncate(fd, size)
    views = attach(fd, slots)
    for name, array in arrays.items():
        views[name][...] = array
    return fd, slots, views


def attach(fd: int, slots: list[Slot]) -> dict[str, NDArray[Any]]:
    """Map the arrays behind a descriptor, writable; the descriptor may be closed afterwards."""
    memory = mmap.mmap(fd, os.fstat(fd).st_size)
    found = {}
    for slot in slots:
        count = int(np.prod(slot.shape, dtype=np.int64))
        flat = np.frombuffer(memory, dtype=np.dtype(slot.dtype), count=count, offset=slot.offset)
        found[slot.name] = flat.reshape(slot.shape)
    return found
