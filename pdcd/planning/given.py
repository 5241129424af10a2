"""From files that came with a request to its arrays: read, checked, and noted in the request.

Whoever takes a request says where each file's content comes from: descriptors, text, or names below
the operator's folder. All are read by the same rules, before any device or thread of the engine is
involved.
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
from pdcd.files.opening import ArrayLimits, Asker, UnsoundFileError, open_beneath
from pdcd.files.reading import read_contents
from pdcd.planning.own_codes import OWN_CODES, read_own_codes
from pdcd.protocol.fields import ARRAY_FIELDS, list_request_fields
from pdcd.protocol.request import CaptureRequest, SentArray
from pdcd.recipes.arrays import Given, convert_rows, count_most_elements
from pdcd.virtual.scene.matrix import read_transport

KEPT_NUMBERS = 4096
"""Most numbers in rows that are kept as they came; more become an array at once, 8 bytes each."""


@dataclass(frozen=True)
class FileSource:
    """Where the content of one file comes from, and its name; None if it has none."""

    content: Callable[[ArrayLimits], bytes]
    file: str | None = None


def make_descriptor_source(descriptor: int, file: str | None = None) -> FileSource:
    """The source for an open file, which the caller closes."""
    return FileSource(lambda limits: read_contents(descriptor, limits), file)


def make_folder_source(folder: Path, name: str, asker: Asker) -> FileSource:
    """The source for a file by its name below a folder, if the asker could read it as well."""
    return FileSource(lambda limits: _closed_after(open_beneath(folder, name, asker), limits), name)


def make_text_source(text: str, file: str | None = None) -> FileSource:
    """The source for a file sent as base64."""

    def decoded(limits: ArrayLimits) -> bytes:
        try:
            return base64.b64decode(text, validate=True)
        except (binascii.Error, ValueError) as err:
            raise UnsoundFileError(
                "it is not base64", "encode the whole of a .npy or PNG file"
            ) from err

    return FileSource(decoded, file)


def list_file_fields(request: CaptureRequest) -> dict[str, str | SentArray]:
    """The fields of a request that come as files, by descriptor, text or name."""
    return {
        name: value
        for name, field in list_request_fields().items()
        if isinstance(value := getattr(request, name), str | SentArray) and field.is_file(value)
    }


def find_long_fields(request: CaptureRequest) -> dict[str, int]:
    """The fields with more than `KEPT_NUMBERS` numbers in rows, and how many."""
    rows = {
        name: value
        for name in ARRAY_FIELDS
        if isinstance(value := getattr(request, name), tuple | list)
    }
    counts = {name: sum(map(len, value)) for name, value in rows.items()}
    return {name: count for name, count in counts.items() if count > KEPT_NUMBERS}


def read_request_arrays(
    request: CaptureRequest,
    sources: Mapping[str, FileSource],
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
    request : the same, with names and SHA-256 of files in place of their content.
    given : the arrays.

    Raises RequestError.
    """
    given: dict[str, NDArray[np.float64]] = {}
    noted: dict[str, SentArray] = {}
    for name in find_long_fields(request):
        given[name] = convert_rows(name, getattr(request, name))
        noted[name] = SentArray(sha256=hashlib.sha256(given[name].tobytes()).hexdigest())
    for name, source in sources.items():
        limits = ArrayLimits(count_most_elements(name, grid), alive)
        try:
            data = source.content(limits)
            if name == "prior":
                from pdcd.planning.prior import PRIOR_GRID  # few requests have one

                given[name], own = read_transport(data, limits)
                given[PRIOR_GRID] = np.array([own], dtype=np.float64)
            elif name == OWN_CODES:
                given |= read_own_codes(data, limits)
            else:
                given[name] = read_array(data, name, limits)
        except UnsoundFileError as err:
            called = f"{name} ({source.file})" if source.file else name
            raise RequestError(f"{called}: {err.message}", hint=err.hint) from err
        noted[name] = SentArray(file=source.file, sha256=hashlib.sha256(data).hexdigest())
    return msgspec.structs.replace(request, **noted), given


def _closed_after(descriptor: int, limits: ArrayLimits) -> bytes:
    try:
        return read_contents(descriptor, limits)
    finally:
        os.close(descriptor)
