"""From files that came with a request to its arrays: read, checked, and noted in the request.

Who takes a request says where each file's content comes from: descriptors, text, or names below the
operator's folder. All are read by the same rules, before any device or thread of the engine is
bothered.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError
from pdcd.files.arrays import read_array
from pdcd.files.opening import Asker, Limits, Unsound, contents, open_beneath
from pdcd.protocol.fields import ARRAYS
from pdcd.protocol.request import CaptureRequest, Sent, in_words
from pdcd.recipes.arrays import Given, most_elements, of_rows
from pdcd.virtual.scene.matrix import read_transport

KEPT_NUMBERS = 4096
"""Numbers in rows that are kept as they came; more become an array at once, 8 bytes each."""


@dataclass(frozen=True)
class Source:
    """Where the content of one file comes from, and what it is called; None: it has no name."""

    content: Callable[[Limits], bytes]
    file: str | None = None


def from_descriptor(descriptor: int, file: str | None = None) -> Source:
    """Of an open file, which the caller closes."""
    return Source(lambda limits: contents(descriptor, limits), file)


def from_folder(folder: Path, name: str, asker: Asker) -> Source:
    """Of a file by its name below a folder, if the asker could read it as well."""
    return Source(lambda limits: _closed_after(open_beneath(folder, name, asker), limits), name)


def from_text(text: str, file: str | None = None) -> Source:
    """Of its base64."""

    def decoded(limits: Limits) -> bytes:
        try:
            return base64.b64decode(text, validate=True)
        except (binascii.Error, ValueError) as err:
            raise Unsound("it is not base64", "encode the whole of a .npy or PNG file") from err

    return Source(decoded, file)


def file_fields(request: CaptureRequest) -> dict[str, str | Sent]:
    """The fields of a request that come as files, by descriptor, text or name."""
    found = {
        name: value for name in ARRAYS if isinstance(value := getattr(request, name), str | Sent)
    }
    prior = request.prior
    if prior is not None and not in_words(prior):
        found["prior"] = prior
    return found


def long_rows(request: CaptureRequest) -> dict[str, int]:
    """The fields with more than `KEPT_NUMBERS` numbers in rows, and how many."""
    rows = {
        name: value for name in ARRAYS if isinstance(value := getattr(request, name), tuple | list)
    }
    counts = {name: sum(map(len, value)) for name, value in rows.items()}
    return {name: count for name, count in counts.items() if count > KEPT_NUMBERS}


def read_given(
    request: CaptureRequest,
    sources: Mapping[str, Source],
    grid: tuple[int, int],
    alive: Callable[[], None] = lambda: None,
) -> tuple[CaptureRequest, Given]:
    """Read what came as files, for a rig of that grid.

    Parameters
    ----------
    sources : by field of the request.
    alive : called at least once for each MiB, and may raise to end the work.

    Returns
    -------
    request : the same, with the names of files and their SHA-256 in the place of their content.
    given : the arrays.

    Raises RequestError.
    """
    given: dict[str, NDArray[np.float64]] = {}
    noted: dict[str, Sent] = {}
    for name in long_rows(request):
        given[name] = of_rows(name, getattr(request, name))
        noted[name] = Sent(sha256=hashlib.sha256(given[name].tobytes()).hexdigest())
    for name, source in sources.items():
        limits = Limits(most_elements(name, grid), alive)
        try:
            data = source.content(limits)
            if name == "prior":
                from pdcd.planning.prior import GRID  # few requests have one

                given[name], own = read_transport(data, limits)
                given[GRID] = np.array([own], dtype=np.float64)
            else:
                given[name] = read_array(data, name, limits)
        except Unsound as err:
            called = f"{name} ({source.file})" if source.file else name
            raise RequestError(f"{called}: {err.message}", hint=err.hint) from err
        noted[name] = Sent(file=source.file, sha256=hashlib.sha256(data).hexdigest())
    return msgspec.structs.replace(request, **noted), given


def _closed_after(descriptor: int, limits: Limits) -> bytes:
    try:
        return contents(descriptor, limits)
    finally:
        os.close(descriptor)
