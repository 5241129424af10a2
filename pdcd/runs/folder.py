"""The run folder: made beside its final name, finished by one rename, manifest last.

::

    <job>/capture.json    manifest; written last, so no manifest means unfinished
    <job>/capture.json.sha256    its digest
    <job>/raw/            camera files, byte for byte, read-only
    <job>/codes.npz       what both panels showed: packed bits or levels, seed, generator
    <job>/frames.csv      one row per refresh of every shot: what was asked, what was shown, when
    <job>/linear/         float32 TIFF, linear, before any tone map
    <job>/probe.npz       image and sigma, float64 (h, w, C), in scene units
    <job>/preview/        8-bit PNG, for humans only
    <job>/log.jsonl       what happened
    <job>/ledger.jsonl    what decoding needs, as it came to be (`pdcd.runs.ledger`)

While it is being filled the folder is called ``<job>.partial``; it is never deleted. Everything is
written through descriptors (`pdcd.runs.place`): whatever happens to the names in the meantime, it
goes into this folder.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.calibration import format_digest_line
from pdcd.errors import DecodeError, DiskError, NoSpaceError, PdcdError, disk_errors
from pdcd.files.inside import open_folder, open_inner_file, read_inner_file
from pdcd.files.put import read_final_name
from pdcd.files.reading import hash_open_file
from pdcd.files.system import locks, path_of
from pdcd.files.text import encode_json
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import Patterns
from pdcd.printable import to_one_line
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.frame_table import append_frames
from pdcd.runs.manifest import (
    MANIFEST,
    MANIFEST_DIGEST,
    MAX_MANIFEST_BYTES,
    encode_manifest,
    parse_manifest,
)
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.place import UNFINISHED, HeldFolder
from pdcd.runs.record import FileRecord, Manifest
from pdcd.version import __version__

logger = logging.getLogger(__name__)

LOG = "log.jsonl"
"""What happened in a run, one line per event."""
REPORT_FILE = "report.html"
"""Everything of the run on one page. It is made after the run has ended, as are pictures of rows of
its matrix: they are only to be looked at, and nothing depends on them. No other files may be added
to a run's folder later."""
_LATER = re.compile(r"report\.html|row-[A-Za-z0-9._-]{1,64}-\d{1,6}-\d{1,6}\.png", re.ASCII)

_KEPT = "all RAW files are in it: run pdcd decode --partial on it"


class RunFolder:
    """One run's folder while it is being filled, in a place that stays open at least as long."""

    def __init__(
        self,
        parent: HeldFolder,
        job: str,
        *,
        unfinished: str | None = None,
        below: tuple[str, ...] = ("raw", "linear", "preview"),
    ) -> None:
        """`unfinished`: its name while it is being filled, where that is not the usual one.
        `below`: folders in it."""
        self._parent = parent
        self._below = below
        self._job = job
        self._unfinished = unfinished or job + UNFINISHED
        self._fd: int | None = None

    def create(self, *, min_free_bytes: int) -> None:
        """Make the folder.

        Raises NoSpaceError when less than that would be left, RequestError when the place is gone,
        was moved out of its bounds or into a run, and DiskError when the disk fails.
        """
        parent, name = self._parent, self._unfinished
        with disk_errors(str(parent.real)):
            parent.check()
            free = shutil.disk_usage(parent.fd).free
            if free < min_free_bytes:
                raise NoSpaceError(
                    f"only {free} bytes are free, {min_free_bytes} are kept in reserve",
                    device=str(parent.real),
                    hint="free some space, or lower limits.min_free_bytes",
                )
            # Locked before it gets the name that others look for: nobody sees it without its lock.
            hidden = f".{name}.new"
            os.mkdir(hidden, dir_fd=parent.fd)
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
            self._fd = os.open(hidden, flags, dir_fd=parent.fd)
            with suppress(OSError):  # on a disk without locks nobody sees that the run goes on
                locks.flock(self._fd, locks.LOCK_EX | locks.LOCK_NB)
            self._take(name, hidden)
            for below in self._below:
                (self.path / below).mkdir()

    def _take(self, name: str, hidden: str) -> None:
        """Give the new folder its name, unless that is taken. Raises OSError."""
        at = self._parent.fd
        try:
            with suppress(FileNotFoundError):
                os.stat(name, dir_fd=at, follow_symlinks=False)
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
            os.rename(hidden, name, src_dir_fd=at, dst_dir_fd=at)
        except OSError:
            os.rmdir(hidden, dir_fd=at)
            self.close()
            raise

    @property
    def fd(self) -> int:
        """Descriptor of the folder, to be passed to a process that works on it."""
        if self._fd is None:
            raise PdcdError("the run folder is not open")
        return self._fd

    @property
    def path(self) -> Path:
        """Path to the folder for use in this process; for people there is `where`."""
        return path_of(self.fd)

    @property
    def where(self) -> Path | None:
        """Where the folder is now; None while there is none."""
        if self._fd is None or not os.fstat(self._fd).st_nlink:
            return None
        return self.path.readlink()

    def put_own_path(self, words: str) -> str:
        """The same text, with the folder's current place instead of its descriptor's path."""
        return words.replace(str(self.path), str(self.where))

    def close(self) -> None:
        """Close the folder. Idempotent."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def log(self, event: Mapping[str, Any]) -> None:
        """Append one line to log.jsonl: `t_mono_ns`, `event` (its type) and its fields."""
        line = msgspec.json.format(encode_json(event), indent=0) + b"\n"
        with disk_errors(self._shown), (self.path / LOG).open("ab") as file:
            file.write(line)

    def files(self) -> tuple[str, ...]:
        """Relative paths of all files so far, sorted."""
        if self._fd is None:
            return ()
        found = (p for p in self.path.rglob("*") if p.is_file())
        return tuple(sorted(str(p.relative_to(self.path)) for p in found))

    def write_frames(self, shot: str, frames: Frames, log: FrameLog) -> None:
        """Append the refreshes of a shot to frames.csv."""
        with disk_errors(self._shown):
            append_frames(self.path / FRAMES, shot, frames, log)

    def set_aside(self, shot: str, number: int) -> str:
        """Rename the RAW file of an exposure that is to be taken again; returns its new stem."""
        name = f"{shot}-discarded-{number}"
        with disk_errors(self._shown):
            for raw in (self.path / "raw").glob(f"{shot}.*"):
                raw.rename(raw.with_name(f"{name}{raw.suffix}"))
        return name

    def write_raw(self, path: str, data: bytes) -> None:
        """Store a photo that was only in memory. Raises NoSpaceError and DiskError."""
        with disk_errors(self._shown), (self.path / path).open("xb") as file:
            file.write(data)

    def drop(self, names: Iterable[str]) -> None:
        """Remove RAW files that a finished run does not keep. One that cannot be removed stays,
        which is no fault of the run: its manifest knows it."""
        for name in names:
            try:
                (self.path / name).unlink(missing_ok=True)
            except OSError as err:
                logger.warning("not removed file=%s error=%s", name, err.strerror)

    def finish(self, manifest: Manifest, alive: Callable[[], object] = lambda: None) -> str:
        """Write the manifest, make everything durable, give the folder its final name.

        `alive` is called for each file: a disk may take long. Returns the SHA-256 of the manifest.
        Raises what `create` raises; the folder then has no manifest.
        """
        data = encode_manifest(manifest)
        return self.finish_with(
            data, MANIFEST, format_digest_line(data, MANIFEST), MANIFEST_DIGEST, alive
        )

    def finish_with(
        self,
        data: bytes,
        record: str,
        line: bytes,
        digest: str,
        alive: Callable[[], object] = lambda: None,
    ) -> str:
        """The same, with these bytes as what completes the folder: the file `record`, and the file
        `digest` that vouches for it by `line`."""
        with disk_errors(self._shown):
            (self.path / digest).write_bytes(line)
            for name in self.files():
                if name.startswith("raw/"):
                    (self.path / name).chmod(0o440)
                write_through(self.path / name)
                alive()
            temporary = self.path / f"{record}.new"
            temporary.write_bytes(data)
            write_through(temporary)
            temporary.rename(self.path / record)
            try:
                for folder in (*self.path.iterdir(), self.path):
                    if folder.is_dir():
                        write_through(folder)
                self._name()
            except BaseException:
                # A folder that did not get its name must not look finished from inside either.
                for name in (record, digest):
                    (self.path / name).unlink(missing_ok=True)
                self._unname()
                raise
        return hashlib.sha256(data).hexdigest()

    def _name(self) -> None:
        """Give the folder its final name, durably, and check that it is this folder that has it."""
        at, unfinished, final = self._parent.fd, self._unfinished, self._job
        self._parent.check()
        if not self._is(unfinished):
            raise self._moved()
        with suppress(FileNotFoundError):
            os.stat(final, dir_fd=at, follow_symlinks=False)
            raise DiskError("its name is taken", device=self._shown, hint=_KEPT)
        os.rename(unfinished, final, src_dir_fd=at, dst_dir_fd=at)
        os.fsync(at)
        self._parent.check()
        if not self._is(final):
            raise self._moved()

    def _moved(self) -> DiskError:
        return DiskError("the run folder was moved", device=self._shown, hint=_KEPT)

    def _unname(self) -> None:
        """Take the final name back if the folder has it already."""
        at = self._parent.fd
        with suppress(OSError):
            if self._is(self._job):
                os.rename(self._job, self._unfinished, src_dir_fd=at, dst_dir_fd=at)

    def _is(self, name: str) -> bool:
        """Whether that name in its place belongs to this folder."""
        try:
            found = os.stat(name, dir_fd=self._parent.fd, follow_symlinks=False)
        except FileNotFoundError:
            return False
        return os.path.samestat(found, os.fstat(self.fd))

    @property
    def _shown(self) -> str:
        return str(self.where or self._job)

    def hashes(
        self, alive: Callable[[], object] = lambda: None, *, skip: tuple[str, ...] = ()
    ) -> dict[str, FileRecord]:
        """SHA-256 and size of every file so far, except those whose paths begin with one of `skip`.

        `alive` is called now and then, and may raise to end the work.
        """
        found: dict[str, FileRecord] = {}
        for name in self.files():
            if name.startswith(skip):
                continue
            with open_inner_file(self.fd, name) as descriptor:
                found[name] = FileRecord(*hash_open_file(descriptor, alive))
        return found


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a finished run.

    Raises DecodeError when there is none, when it is damaged, or of another schema. Whether it and
    the files are unchanged is checked by `pdcd.runs.verify`.
    """
    try:
        with open_folder(folder) as descriptor:
            data = read_inner_file(descriptor, MANIFEST, MAX_MANIFEST_BYTES)
    except (OSError, ValueError, DecodeError) as err:
        why = f": {err.message}" if isinstance(err, DecodeError) else ""
        raise DecodeError(
            f"{to_one_line(str(folder))} has no readable {MANIFEST}{why}",
            hint=f"give the folder of a finished run; one that ends in {UNFINISHED} is not",
        ) from err
    return parse_manifest(data)


def write_patterns(
    folder: Path,
    patterns: Mapping[str, tuple[Patterns, Patterns]],
    given: Mapping[str, NDArray[np.float64]],
    *,
    family: str,
    codes: int,
    seed: int,
) -> None:
    """Write codes.npz: what both panels show by each program, what generated it, and the arrays of
    the request. Raises NoSpaceError, or DiskError for any other refusal of the disk."""
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
    # Written completely or not at all: shots that were taken already are decoded with this file.
    made = folder / f"{CODES}.new"
    with disk_errors(str(folder.resolve())):
        with made.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        made.replace(folder / CODES)


def write_through(path: Path) -> None:
    """Write a file or a folder through to the disk. Raises OSError."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def name_row_file(photo: str, cell: tuple[int, int]) -> str:
    """Name of the file for the row of a probing matrix that belongs to a cell."""
    return f"row-{photo}-{cell[0]}-{cell[1]}.png"


def is_made_later(name: str) -> bool:
    """Whether a file of that name, relative to the run's folder, may have been made later, or was
    left unfinished when a program was killed that made it."""
    return _LATER.fullmatch(read_final_name(name)) is not None
