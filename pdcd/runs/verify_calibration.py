"""Is a calibration folder complete and unchanged? It is checked as `pdcd.runs.verify` checks
runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec

from pdcd.bench.calibration import CALIBRATION_DIGEST, MAX_RECORD_BYTES, RECORD, Calibration
from pdcd.files.inside import find_name_fault
from pdcd.printable import to_one_line
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.record import FileRecord
from pdcd.runs.verify import FolderCheck, VerifyReport


def verify_calibration(folder: Path, *, manifest_sha256: str | None = None) -> VerifyReport:
    """Check all of a calibration folder. Faults are in the report, never raised.

    `manifest_sha256` is the expected digest of its record, where that is known from elsewhere.
    """
    check = _CalibrationCheck()
    check.look(folder, manifest_sha256, None)
    record = check.record
    return VerifyReport(
        folder=to_one_line(str(folder)),
        whole=not check.found,
        job=None if record is None else record.name,
        schema=None if record is None else record.schema,
        manifest_sha256=check.sha256,
        files=check.sound,
        size_bytes=check.size_bytes,
        findings=tuple(check.found),
    )


class _CalibrationCheck(FolderCheck):
    """One check of one calibration folder."""

    own = (RECORD, CALIBRATION_DIGEST)
    most_bytes = MAX_RECORD_BYTES
    folders = frozenset({"raw", "preview"})
    none = "this is no finished calibration"
    record: Calibration | None = None

    @property
    def listed(self) -> Mapping[str, FileRecord] | None:
        """See `FolderCheck`."""
        if self.record is None:
            return None
        return {n: FileRecord(f.sha256, f.size_bytes) for n, f in self.record.files.items()}

    def may_come_later(self, name: str) -> bool:
        """See `FolderCheck`: none."""
        return False

    def understand(self, data: bytes, *, vouched: bool) -> None:
        """See `FolderCheck`."""
        if not vouched:
            self.find(CALIBRATION_DIGEST, "missing", "nothing vouches for the record")
        try:
            self.record = msgspec.json.decode(data, type=Calibration)
        except (msgspec.MsgspecError, ValueError, RecursionError) as err:
            self.find(RECORD, "manifest", str(err))
            return
        for what in _contradictions(self.record):
            self.find(RECORD, "manifest", what)


def _contradictions(record: Calibration) -> Iterator[str]:
    """Contradictions in the record, in words."""
    for name in record.files:
        fault = (
            "it vouches for itself"
            if name in (RECORD, CALIBRATION_DIGEST)
            else find_name_fault(name)
        )
        if fault is not None:
            yield f"file {to_one_line(name)!r}: {fault}"
    photos = [photo for step in record.steps for photo in step.photos]
    if photos and FRAMES not in record.files:
        yield f"it does not list {FRAMES!r}"
    if len({photo.name for photo in photos}) != len(photos):
        yield "it has two photos of one name"
    for photo in photos:
        if photo.raw not in record.files or record.files[photo.raw].sha256 != photo.sha256:
            yield f"photo {to_one_line(photo.name)!r} and the list of files name another RAW file"
        if not photo.open_ns < photo.close_ns:
            yield f"photo {to_one_line(photo.name)!r} closed before it opened"
