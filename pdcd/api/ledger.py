"""What a sweep has done so far, a line a capture, so that it goes on where it was ended."""

from __future__ import annotations

import fcntl
import hashlib
import os
from pathlib import Path

import msgspec

from pdcd.api.task import Record
from pdcd.errors import BusyError, DecodeError, disk_errors
from pdcd.files.inside import opened, read_file
from pdcd.runs.manifest import MANIFEST, MAX_MANIFEST_BYTES

NAME = "sweep.jsonl"


class _Line(msgspec.Struct):
    key: str
    row: Record


class Ledger:
    """The file `sweep.jsonl` of a folder, held by one sweep at a time.

    Raises BusyError where another one holds it, NoSpaceError and DiskError.
    """

    def __init__(self, folder: Path) -> None:
        path = folder / NAME
        with disk_errors(str(path)):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as err:
            self._file.close()
            raise BusyError(
                f"another sweep fills {folder}", hint="wait for it, or take another folder"
            ) from err
        self._path = path
        self.known = self._read()
        """The rows of captures that are done, and whose runs are still there, by key."""

    def add(self, key: str, row: Record) -> None:
        """Note how a capture ended, for good."""
        with disk_errors(str(self._path)):
            self._file.write(msgspec.json.encode(_Line(key, row)) + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Let another sweep have the folder."""
        self._file.close()

    def _read(self) -> dict[str, Record]:
        found = {}
        self._file.seek(0)
        data = self._file.read()
        for text in data.split(b"\n"):
            try:
                line = msgspec.json.decode(text, type=_Line)
            except msgspec.MsgspecError:  # half a line, of a sweep that was killed
                continue
            if line.row.get("state") == "done" and _there(line.row):
                found[line.key] = line.row
        if data and not data.endswith(b"\n"):
            self._file.write(b"\n")  # so that the next line is one of its own
        return found


def _there(row: Record) -> bool:
    """Whether the run of a row has the manifest that it ended with."""
    try:
        with opened(Path(str(row.get("folder")))) as folder:
            data = read_file(folder, MANIFEST, MAX_MANIFEST_BYTES)
    except (OSError, ValueError, DecodeError):
        return False
    return hashlib.sha256(data).hexdigest() == row.get("manifest_sha256")
