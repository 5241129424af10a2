"""One capture of a sweep as a value that can be sent to another process, its place, and how it
ended."""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pdcd.api.local import LocalBench
from pdcd.bench.choosing import lock_calibration as held_folder
from pdcd.bench.tables import Config
from pdcd.errors import (
    BusyError,
    DecodeError,
    PdcdError,
    RequestError,
    disk_errors,
    to_typed_error,
)
from pdcd.files.opening import ArrayLimits, Sendable, UnsoundFileError
from pdcd.files.reading import hash_file, read_array_file
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, quality_of, read_summary_value
from pdcd.recipes.arrays import MOST_ELEMENTS
from pdcd.runs.manifest import MANIFEST, MAX_MANIFEST_BYTES
from pdcd.runs.verify import read_whole_manifest
from pdcd.version import __version__

logger = logging.getLogger(__name__)

Value = float | int | str | bool | None
TaskRecord = dict[str, Value]
"""One row of the table, by column: the requested values, and how the capture ended."""

_FIGURES = (
    "codes", "parts", "pilot", "family", "passes", "shots", "refreshes", "exposure_s",
    "missed_refreshes", "rms_sigma", "sigma_kind", "rms_error_quads", "rms_error_cells",
    "wall_s",
)  # fmt: skip
"""Figures taken from a run's summary: as the run was taken, not as it was requested."""

ENDING = ("goal", "state", "verdict", *_FIGURES, "job", "folder", "manifest_sha256",
          "error_kind", "error")  # fmt: skip
"""The columns that every row has."""


@dataclass(frozen=True)
class Task:
    """A capture on a bench of its own.

    arrays : the request's arrays, as the content of files or as arrays.
    folder : its place, where the run goes; None: where the configuration says.
    told : the requested values, as the table shows them.
    """

    config: Config
    request: CaptureRequest
    arrays: Mapping[str, Sendable] = field(default_factory=dict)
    folder: Path | None = None
    told: TaskRecord = field(default_factory=dict)


def take_capture(task: Task) -> TaskRecord:
    """Take the photo and return its row; a capture that fails raises no error."""
    try:
        with LocalBench(task.config, task.folder) as bench:
            return make_result_row(task.request, bench.take(task.request, task.arrays))
    except PdcdError as err:
        return make_failed_row(task.request, err)
    except Exception as err:
        logger.exception("a capture of a sweep failed goal=%s", task.request.goal)
        return make_failed_row(task.request, to_typed_error(err))


def make_result_row(request: CaptureRequest, result: CaptureResult) -> TaskRecord:
    """How a capture ended, as a row."""
    row: TaskRecord = dict.fromkeys(ENDING)
    quality, error = quality_of(result.summary), result.error or {}
    row |= {"goal": request.goal, "state": result.state, "job": result.job}
    row |= {"folder": result.folder, "manifest_sha256": result.manifest_sha256}
    if quality is not None:
        row["verdict"] = quality.verdict
    for name in _FIGURES:
        row[name] = read_summary_value(result.summary, name)
    return row | {"error_kind": error.get("kind"), "error": error.get("message")}


def make_failed_row(request: CaptureRequest, error: PdcdError) -> TaskRecord:
    """The row of a capture that never became a job, or whose process died."""
    told: dict[str, str | None] = {"kind": error.kind, "message": str(error)}
    return make_result_row(request, CaptureResult(job="", state="failed", error=told))


@contextmanager
def hold_place(folder: Path | None) -> Iterator[None]:
    """Make a folder, and keep other sweeps out of it. Raises BusyError, NoSpaceError and
    DiskError."""
    if folder is None:
        yield
        return
    with disk_errors(str(folder)):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = held_folder(folder, fcntl.LOCK_EX)
    if descriptor is None:
        raise BusyError(f"another sweep fills {folder}", hint="wait for it, or take another folder")
    try:
        yield
    finally:
        os.close(descriptor)


def find_kept_row(task: Task) -> TaskRecord | None:
    """The row of a finished, unchanged run in the place of a task; None where there is none."""
    with suppress(OSError):
        for run in sorted(task.folder.iterdir() if task.folder else (), reverse=True):
            with suppress(DecodeError, UnsoundFileError, OSError):
                manifest = read_whole_manifest(run, ())
                result = CaptureResult(
                    job=manifest.job,
                    state="done",
                    folder=str(run.readlink() if run.is_symlink() else run),
                    manifest_sha256=hash_file(run / MANIFEST, MAX_MANIFEST_BYTES),
                    summary=manifest.summary,
                )
                return make_result_row(task.request, result)
    return None


def keep_in_place(task: Task, row: TaskRecord) -> None:
    """Put a link into the place of a task whose run is done and lies elsewhere. Raises NoSpaceError
    and DiskError."""
    folder = row["folder"]
    if task.folder is None or row["state"] != "done" or not isinstance(folder, str):
        return
    link = task.folder / Path(folder).name
    with disk_errors(str(link)), suppress(FileExistsError):
        task.folder.mkdir(parents=True, exist_ok=True)
        link.symlink_to(folder)


def load_arrays(arrays: Mapping[str, Sendable]) -> dict[str, Sendable]:
    """The same arrays, with files replaced by their content, as other machines lack the files.

    Raises RequestError.
    """
    found: dict[str, Sendable] = {}
    for name, value in arrays.items():
        if isinstance(value, Path | str):
            try:
                found[name] = read_array_file(value, ArrayLimits(MOST_ELEMENTS))
            except UnsoundFileError as err:
                raise RequestError(f"{name} ({value}): {err.message}", hint=err.hint) from err
        else:
            found[name] = value
    return found


def hash_capture(
    bench: Mapping[str, Any], request: CaptureRequest, arrays: Mapping[str, Sendable], again: int
) -> str:
    """A hash that names a capture of a sweep, hexadecimal: the same bench, request, arrays and
    program version give the same hash. `again` distinguishes equal captures."""
    told = msgspec.to_builtins(msgspec.structs.replace(request, out=None))
    sums = {name: _digest(value) for name, value in arrays.items()}
    whole = [__version__, bench, told, sums, again]
    return hashlib.sha256(msgspec.msgpack.encode(whole, order="deterministic")).hexdigest()


def _digest(content: Sendable) -> str:
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    array = np.ascontiguousarray(content)
    head = f"{array.dtype.str} {array.shape} ".encode()
    return hashlib.sha256(head + array.tobytes()).hexdigest()
