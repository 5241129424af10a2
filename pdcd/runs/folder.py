"""The run folder: made beside its final name, finished by one rename, manifest last.

::

    <job>/capture.json    manifest; written last, so no manifest means unfinished
    <job>/raw/            camera files, byte for byte, read-only
    <job>/codes.npz       what both panels showed: packed bits or levels, seed, generator
    <job>/frames.csv      one row per refresh of every shot: what was asked, what was shown, when
    <job>/linear/         float32 TIFF, linear, before any tone map
    <job>/probe.npz       image and sigma, float64 (h, w, 3), in scene units
    <job>/preview/        8-bit PNG, for humans only
    <job>/log.jsonl       what happened

While it is being filled the folder is called ``<job>.partial``; it is never deleted.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd import __version__
from pdcd.errors import DecodeError, NoSpaceError, disk_errors
from pdcd.frames.frames import FrameLog, Frames
from pdcd.frames.patterns import Patterns
from pdcd.runs.frame_table import NAME as FRAMES
from pdcd.runs.frame_table import append_frames
from pdcd.runs.older import upgraded
from pdcd.runs.record import Manifest

MANIFEST = "capture.json"


class RunFolder:
    """One run's folder while it is being filled."""

    def __init__(self, parent: Path, job: str) -> None:
        self.final = parent / job
        self.path = parent / f"{job}.partial"

    def create(self, *, min_free_bytes: int) -> None:
        """Make the folder. Raises NoSpaceError when less than that would be left."""
        with disk_errors(str(self.path.parent)):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(self.path.parent).free
            if free < min_free_bytes:
                raise NoSpaceError(
                    f"only {free} bytes are free, {min_free_bytes} are kept in reserve",
                    device=str(self.path.parent),
                    hint="free some space, or lower limits.min_free_bytes",
                )
            self.path.mkdir()
            for name in ("raw", "linear", "preview"):
                (self.path / name).mkdir()

    def log(self, event: Mapping[str, Any]) -> None:
        """Append one line to log.jsonl: `t_mono_ns`, `event` (its type) and what it says."""
        line = json.dumps(event)
        with disk_errors(str(self.path)), (self.path / "log.jsonl").open("a") as file:
            file.write(line + "\n")

    def files(self) -> tuple[str, ...]:
        """Relative paths of all files so far, sorted."""
        if not self.path.is_dir():
            return ()
        found = (p for p in self.path.rglob("*") if p.is_file())
        return tuple(sorted(str(p.relative_to(self.path)) for p in found))

    def write_frames(self, shot: str, frames: Frames, log: FrameLog) -> None:
        """Append the refreshes of a shot to frames.csv."""
        with disk_errors(str(self.path)):
            append_frames(self.path / FRAMES, shot, frames, log)

    def set_aside(self, shot: str, number: int) -> str:
        """Rename the RAW file of an exposure that is to be taken again; returns its new stem."""
        name = f"{shot}-discarded-{number}"
        with disk_errors(str(self.path)):
            for raw in (self.path / "raw").glob(f"{shot}.*"):
                raw.rename(raw.with_name(f"{name}{raw.suffix}"))
        return name

    def finish(self, manifest: Manifest) -> str:
        """Write the manifest, make everything durable, give the folder its final name.

        Returns the SHA-256 of the manifest.
        """
        with disk_errors(str(self.path)):
            for name in self.files():
                if name.startswith("raw/"):
                    (self.path / name).chmod(0o440)
                _sync(self.path / name)
            data = msgspec.json.format(msgspec.json.encode(manifest), indent=1)
            temporary = self.path / f"{MANIFEST}.new"
            temporary.write_bytes(data)
            _sync(temporary)
            temporary.rename(self.path / MANIFEST)
            try:
                for folder in (*self.path.iterdir(), self.path):
                    if folder.is_dir():
                        _sync(folder)
                self.path.rename(self.final)
            except OSError:
                # A folder that did not get its name must not look finished from inside either.
                (self.path / MANIFEST).unlink(missing_ok=True)
                raise
            _sync(self.final.parent)
        return hashlib.sha256(data).hexdigest()

    def hashes(self) -> dict[str, str]:
        """SHA-256 of every file so far."""
        return {name: sha256_of(self.path / name) for name in self.files()}


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a finished run, one of an earlier schema in the words of the present one.

    Raises DecodeError when there is none, when it is damaged, or of a schema not known here.
    """
    path = folder / MANIFEST
    try:
        told = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        return msgspec.convert(upgraded(told), Manifest)
    except OSError as err:
        raise DecodeError(
            f"{folder} has no readable {MANIFEST}",
            hint="give the folder of a finished run; one that ends in .partial is not",
        ) from err
    except (msgspec.DecodeError, TypeError) as err:
        raise DecodeError(f"{path} is damaged: {err}", hint="restore it from a copy") from err


def write_patterns(
    folder: Path,
    patterns: Mapping[str, tuple[Patterns, Patterns]],
    given: Mapping[str, NDArray[np.float64]],
    *,
    family: str,
    codes: int,
    seed: int,
) -> None:
    """Write codes.npz: what both panels are to show by each program, what made it, and what was
    given. Raises NoSpaceError, or PdcdError for any other refusal of the disk."""
    arrays: dict[str, NDArray[Any]] = {
        "family": np.array(family),
        "codes": np.array(codes),
        "seed": np.array(seed),
        "generator": np.array(f"pdcd {__version__}, numpy {np.__version__} PCG64"),
    }
    for name, (primal, dual) in patterns.items():
        arrays[f"{name}.primal"], arrays[f"{name}.dual"] = primal, dual
    for name, array in given.items():
        arrays[f"goal.{name}"] = array
    with disk_errors(str(folder)), (folder / "codes.npz").open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read_patterns(folder: Path) -> dict[str, NDArray[Any]]:
    """The arrays of codes.npz, as `write_patterns` stored them."""
    path = folder / "codes.npz"
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, KeyError, ValueError, EOFError, BadZipFile, zlib.error) as err:
        raise DecodeError(f"cannot read {path}: {err}", hint="restore it from a copy") from err


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
