"""Arrays on their way to the daemon: each as an open file of the sender, whatever it was."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError
from pdcd.files.limits import Unsound
from pdcd.files.opening import open_own

Sendable = Path | str | bytes | NDArray[Any]
"""A path of the sender, the content of a file, or an array of real numbers."""


@dataclass(frozen=True)
class Parcel:
    """One array as an open descriptor, and the name of its file where it has one."""

    descriptor: int
    file: str | None


@contextmanager
def parcels(arrays: Mapping[str, Sendable]) -> Iterator[dict[str, Parcel]]:
    """Open files and put arrays into memory files, by field; all are closed in the end.

    Raises RequestError for a file that cannot be opened, and for what is no array of numbers.
    """
    with ExitStack() as stack:
        opened = {}
        for name, value in arrays.items():
            if isinstance(value, np.ndarray | bytes):
                parcel = Parcel(_in_memory(name, value), None)
            else:
                parcel = _opened(name, Path(value))
            stack.callback(os.close, parcel.descriptor)
            opened[name] = parcel
        yield opened


def _opened(name: str, path: Path) -> Parcel:
    try:
        return Parcel(open_own(path), path.name)
    except Unsound as err:
        raise RequestError(f"{name} ({path}): {err.message}", hint=err.hint) from err


def _in_memory(name: str, content: NDArray[Any] | bytes) -> int:
    descriptor = os.memfd_create(f"pdcd-{name}", os.MFD_CLOEXEC)
    try:
        with os.fdopen(os.dup(descriptor), "wb") as stream:
            if isinstance(content, bytes):
                stream.write(content)
            else:
                np.save(stream, content, allow_pickle=False)
    except BaseException as err:
        os.close(descriptor)
        if isinstance(err, ValueError):
            raise RequestError(f"{name} is no array of numbers: {err}") from err
        raise
    return descriptor
