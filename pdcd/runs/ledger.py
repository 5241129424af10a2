"""ledger.jsonl: what is needed to decode a run, written before and after every exposure.

The manifest comes last, so a run that was interrupted has none. Its ledger has the record of the
run before the first exposure, and each shot as soon as its RAW file and its rows of frames.csv are
there. Every line holds a digest of itself and of the one before: a line that was half written when
the power failed is noticed, and none in between can be lost, changed or moved.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Mapping
from typing import Any

import msgspec

from pdcd.errors import DecodeError, disk_errors
from pdcd.files.inside import open_inner_file, read_inner_file
from pdcd.files.reading import hash_open_file
from pdcd.files.system import system
from pdcd.files.text import encode_json
from pdcd.runs.folder import RunFolder
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.record import FileRecord, MeterRecord, RecordCount, RunRecord, Sha256, ShotRecord

LEDGER_FILE = "ledger.jsonl"
MAX_LEDGER_BYTES = 2**26
"""Longest ledger that is read; a shot takes about 500 bytes."""
MAX_FIRST_BYTES = 2**20
"""Longest first line that is read where only that is needed."""
_SYNC_S = 1.0
"""Least time between two waits for the disk: shorter runs are made durable at their end, and a
power failure costs no more than that time."""


class RunStart(msgspec.Struct, frozen=True, kw_only=True, tag_field="entry", tag="begun"):
    """What was known before the first exposure; the fields are those of the manifest."""

    job: str
    mock: bool
    owner: dict[str, Any]
    started_utc: str
    request: dict[str, Any]
    plan: dict[str, Any]
    versions: dict[str, str]
    git_commit: str | None
    drivers: dict[str, Any]
    config: dict[str, Any]


class _Planned(msgspec.Struct, frozen=True, kw_only=True, tag_field="entry", tag="planned"):
    """The record of the run, without its shots, and its codes: at first, and again whenever the
    plan changed."""

    plan: dict[str, Any]
    run: RunRecord
    codes: FileRecord


class MeterEntry(msgspec.Struct, frozen=True, kw_only=True, tag_field="entry", tag="metered"):
    """A test exposure."""

    meter: MeterRecord
    file: FileRecord


class ShotEntry(msgspec.Struct, frozen=True, kw_only=True, tag_field="entry", tag="taken"):
    """A shot, and the part of frames.csv that was written since the one before."""

    shot: ShotRecord
    frames: FileRecord


class WarningEntry(msgspec.Struct, frozen=True, kw_only=True, tag_field="entry", tag="warned"):
    """A warning, as the manifest has it."""

    text: str


class ConvergenceEntry(msgspec.Struct, frozen=True, kw_only=True, tag_field="entry", tag="enough"):
    """The wanted error is reached: shots that are still planned are not needed."""


LedgerEntry = RunStart | _Planned | MeterEntry | ShotEntry | WarningEntry | ConvergenceEntry


class _Line(msgspec.Struct, frozen=True):
    said: msgspec.Raw
    sha256: Sha256
    """SHA-256 of the previous digest, as text, and the bytes of `said`."""


class RunLedger:
    """Writes the ledger of a run in progress. Every method raises NoSpaceError and DiskError."""

    def __init__(self, folder: RunFolder, held: Mapping[str, FileRecord] | None = None) -> None:
        """held : RAW files that are only in memory, as they come."""
        self._folder = folder
        self._held = {} if held is None else held
        self._digest = ""
        self._frames_bytes: RecordCount = 0
        self._synced_s = time.monotonic()
        self._unsynced: set[str] = set()

    def begin(self, begun: RunStart) -> None:
        """Write the first line."""
        self._write(begun)

    def plan(self, plan: dict[str, Any], run: RunRecord) -> None:
        """Record a plan by which the run goes on; its codes are stored."""
        self._unsynced.add(CODES)
        self._write(_Planned(plan=plan, run=run, codes=self._record(CODES)))

    def meter(self, meter: MeterRecord) -> None:
        """Record a test exposure that was taken and evaluated."""
        held = self._held.get(meter.raw)
        if held is None:
            self._unsynced.add(meter.raw)
        self._write(MeterEntry(meter=meter, file=held or self._record(meter.raw)))

    def take(self, shot: ShotRecord) -> None:
        """Record a shot that was taken: its RAW file and its rows of frames.csv are there."""
        self._unsynced.update({shot.raw, FRAMES} - self._held.keys())
        self._write(ShotEntry(shot=shot, frames=self._piece()))

    def warn(self, text: str) -> None:
        """Record a warning for the manifest."""
        self._write(WarningEntry(text=text))

    def enough(self) -> None:
        """Record that no more shots are needed."""
        self._write(ConvergenceEntry())

    def _write(self, entry: LedgerEntry) -> None:
        said = encode_json(entry)
        self._digest = _digest(self._digest, said)
        line = msgspec.json.encode(_Line(msgspec.Raw(said), self._digest)) + b"\n"
        with disk_errors(str(self._folder.where)):
            with (self._folder.path / LEDGER_FILE).open("ab") as file:
                file.write(line)
            self._sync_now_and_then()

    def _sync_now_and_then(self) -> None:
        """Make the files that the lines name durable before the lines."""
        if time.monotonic() - self._synced_s < _SYNC_S:
            return
        for name in (*sorted(self._unsynced), LEDGER_FILE):
            with open_inner_file(self._folder.fd, name) as descriptor:
                os.fsync(descriptor)
        self._unsynced.clear()
        self._synced_s = time.monotonic()

    def _record(self, name: str) -> FileRecord:
        with open_inner_file(self._folder.fd, name) as descriptor:
            return FileRecord(*hash_open_file(descriptor))

    def _piece(self) -> FileRecord:
        """The part that was appended to frames.csv since the last shot."""
        with open_inner_file(self._folder.fd, FRAMES) as descriptor:
            os.lseek(descriptor, self._frames_bytes, os.SEEK_SET)
            piece = FileRecord(*hash_open_file(descriptor))
        self._frames_bytes += piece.size_bytes
        return piece


class LedgerContents(msgspec.Struct, frozen=True, kw_only=True):
    """A ledger as it was read."""

    begun: RunStart
    planned: _Planned | None = None
    """The last one; None where the run ended before its codes were stored."""
    taken: tuple[ShotEntry, ...] = ()
    metered: tuple[MeterEntry, ...] = ()
    warnings: tuple[str, ...] = ()
    enough: bool = False

    @property
    def run(self) -> RunRecord | None:
        """The record of the run with the shots that were taken."""
        if self.planned is None:
            return None
        shots = tuple(entry.shot for entry in self.taken)
        return msgspec.structs.replace(self.planned.run, shots=shots)


def read_ledger(folder: int) -> LedgerContents:
    """The ledger of a run folder, given by its descriptor.

    An incomplete last line is left out. Raises DecodeError when there is no ledger, or when any
    other line is damaged.
    """
    try:
        data = read_inner_file(folder, LEDGER_FILE, MAX_LEDGER_BYTES)
    except (OSError, DecodeError) as err:
        words = err.message if isinstance(err, DecodeError) else err.strerror
        raise DecodeError(
            f"the run has no readable {LEDGER_FILE}: {words}",
            hint="it may have ended before its first exposure; RAW files, if any, are in raw/",
        ) from err
    entries = _entries(data.split(b"\n"))
    if not entries or not isinstance(entries[0], RunStart):
        raise _damaged("it does not begin with the run")
    kept = LedgerContents(begun=entries[0])
    for entry in entries[1:]:
        kept = _with(kept, entry)
    return kept


def read_run_start(folder: int) -> tuple[RunStart, int]:
    """The first entry of a run folder's ledger, and the bytes that were read for it.

    Raises DecodeError when there is no such line within `MAX_FIRST_BYTES`, and OSError.
    """
    with open_inner_file(folder, LEDGER_FILE) as descriptor:
        data = system.pread(descriptor, MAX_FIRST_BYTES, 0)
    line, newline, _ = data.partition(b"\n")
    found = _entries([line, b""]) if newline else []
    if not found or not isinstance(found[0], RunStart):
        raise _damaged("it does not begin with the run")
    return found[0], len(data)


def _entries(lines: list[bytes]) -> list[LedgerEntry]:
    digest, found = "", []
    # After the last newline there is nothing, or an incomplete line.
    for number, line in enumerate(lines[:-1]):
        try:
            read = msgspec.json.decode(line, type=_Line)
            digest = _digest(digest, bytes(read.said))
            if digest != read.sha256:
                raise _damaged(f"line {number + 1} does not follow on the one before")
            found.append(msgspec.json.decode(read.said, type=LedgerEntry))
        except (msgspec.MsgspecError, ValueError, RecursionError) as err:
            raise _damaged(f"line {number + 1}: {err}") from err
    return found


def _with(kept: LedgerContents, entry: LedgerEntry) -> LedgerContents:
    replace = msgspec.structs.replace
    match entry:
        case _Planned():
            return replace(kept, planned=entry)
        case ShotEntry():
            return replace(kept, taken=(*kept.taken, entry))
        case MeterEntry():
            return replace(kept, metered=(*kept.metered, entry))
        case WarningEntry():
            return replace(kept, warnings=(*kept.warnings, entry.text))
        case ConvergenceEntry():
            return replace(kept, enough=True)
        case RunStart():
            raise _damaged("it begins twice")


def _digest(before: str, said: bytes) -> str:
    return hashlib.sha256(before.encode() + said).hexdigest()


def _damaged(why: str) -> DecodeError:
    return DecodeError(f"{LEDGER_FILE} is damaged: {why}", hint="restore it from a copy")
