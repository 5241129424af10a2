"""Reads what one run folder says of itself, for a list of runs: only a little, and within limits.

Whether a run is undamaged is not checked: that needs all of it to be read (`pdcd.runs.verify`).
"""

from __future__ import annotations

import os
from typing import Any, Literal

import msgspec

from pdcd.errors import DecodeError, make_error
from pdcd.files.inside import open_inner_file, read_inner_file
from pdcd.files.system import locks, system
from pdcd.protocol.entry import RunEntry
from pdcd.protocol.labels import MOST_TAGS
from pdcd.runs.folder import LOG
from pdcd.runs.ledger import RunStart, read_run_start
from pdcd.runs.manifest import MANIFEST, OtherSchemaError, check_schema
from pdcd.runs.place import UNFINISHED
from pdcd.runs.walk import REMOVED, RunSpot
from pdcd.words import VerdictName

MOST_LISTED_BYTES = 16 * 2**20
"""Longest manifest that is read."""
_TAIL_BYTES = 2**16
"""Bytes that are read at the end of log.jsonl, whose last line says why a run failed."""
_LETTERS = {"note": 4096, "reason": 600, "taken": 600}
"""Most characters of texts in a list, 80 for others: those of forged manifests may be of any
length."""


class _Asked(msgspec.Struct):
    goal: str
    codes: int | None = None
    name: str | None = None
    tags: tuple[str, ...] = ()
    note: str = ""


class _Planned(msgspec.Struct):
    codes: int | None = None


class _User(msgspec.Struct):
    user: str | None = None


class _Verdict(msgspec.Struct):
    verdict: VerdictName | None = None


class _Summary(msgspec.Struct):
    method: str | None = None
    codes: int | None = None
    exposure_s: float | None = None
    rms_error_quads: float | None = None
    rms_error_cells: float | None = None
    rms_sigma: float | None = None
    taken: str | None = None
    quality: _Verdict | None = None


class _Head(msgspec.Struct):
    """The part of a manifest that is read."""

    job: str
    schema: int
    state: Literal["done", "partial", "failed", "cancelled"]
    request: _Asked
    owner: _User
    started_utc: str
    finished_utc: str | None = None
    mock: bool | None = None
    plan: _Planned = msgspec.field(default_factory=_Planned)
    summary: _Summary = msgspec.field(default_factory=_Summary)


class _Last(msgspec.Struct):
    """The last line of log.jsonl, if it says how the run ended."""

    event: str
    kind: str | None = None
    message: str | None = None
    device: str | None = None
    hint: str | None = None
    taken: str | None = None


def read_run_entry(folder: int, spot: RunSpot, path: str) -> tuple[RunEntry, int]:
    """The entry of a run in an open folder, and the bytes that were read for it.

    `path` is the folder's path for people. Faults are in the entry, never raised.
    """
    bare = make_bare_entry(spot, path)
    if spot.ending.endswith(REMOVED):
        return _with(bare, state="unfinished", reason="its removal was not finished"), 0
    if spot.ending.endswith(UNFINISHED):
        return _unfinished(folder, bare, decoding="decoded" in spot.ending)
    try:
        data = read_inner_file(folder, MANIFEST, MOST_LISTED_BYTES)
    except FileNotFoundError:
        return _with(bare, state="unfinished", reason="it has no manifest"), 0
    except (OSError, DecodeError) as err:
        return make_damaged_entry(bare, err), 0
    try:
        head = msgspec.json.decode(data, type=_Head)
        check_schema(head.schema)
    # Also for a name of invalid bytes.
    except (ValueError, RecursionError, OtherSchemaError) as err:
        return make_damaged_entry(bare, err), len(data)
    if head.job != spot.job:
        return make_damaged_entry(bare, DecodeError("its manifest is of another run")), len(data)
    return _finished(bare, head), len(data)


def make_bare_entry(spot: RunSpot, path: str) -> RunEntry:
    """The entry as far as the folder's name gives it."""
    kind: Literal["capture", "preview"] = "preview" if spot.preview else "capture"
    if spot.foreign:
        why = "it belongs to somebody else than the folder of runs, and was not looked into"
        return RunEntry(job=spot.job, state="foreign", folder=path, kind=kind, reason=why)
    return RunEntry(job=spot.job, state="unfinished", folder=path, kind=kind)


def make_damaged_entry(bare: RunEntry, err: Exception) -> RunEntry:
    """The entry of a run that cannot be read."""
    words = err.message if isinstance(err, DecodeError) else getattr(err, "strerror", None)
    return _with(bare, state="damaged", reason=f"{MANIFEST}: {words or err}")


def is_being_filled(folder: int) -> bool | None:
    """Whether a run goes on in an open folder (see `RunFolder.create`); None where that is
    unknown."""
    try:
        locks.flock(folder, locks.LOCK_SH | locks.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a disk without locks
        return None
    locks.flock(folder, locks.LOCK_UN)
    return False


def _finished(bare: RunEntry, head: _Head) -> RunEntry:
    summary, asked = head.summary, head.request
    codes = summary.codes if summary.codes is not None else head.plan.codes
    partial = head.state == "partial"
    return _with(
        bare,
        state=head.state,
        **_labels(asked),
        method=summary.method,
        codes=asked.codes if codes is None else codes,
        exposure_s=summary.exposure_s,
        rms_error_quads=summary.rms_error_quads,
        rms_error_cells=summary.rms_error_cells,
        rms_sigma=summary.rms_sigma,
        verdict=None if summary.quality is None else summary.quality.verdict,
        mock=head.mock,
        user=head.owner.user,
        started_utc=head.started_utc,
        finished_utc=head.finished_utc,
        taken=summary.taken,
        reason=f"made of {summary.taken or 'some of its shots'}" if partial else None,
    )


def _unfinished(folder: int, bare: RunEntry, *, decoding: bool) -> tuple[RunEntry, int]:
    """A run without a manifest: the beginning of its ledger, and the end of its log."""
    size = 0
    try:
        begun, size = read_run_start(folder)
        bare = _with(bare, **_begun(begun))
    except (OSError, DecodeError, msgspec.ValidationError):
        pass  # it may have ended before the first line
    if is_being_filled(folder):
        return _with(bare, state="running"), size
    if decoding:
        return _with(bare, reason="a decoding that was not finished"), size
    last, more = _last_line(folder)
    if last is None or last.event not in ("failed", "cancelled"):
        why = "it ended without a word, as when it is killed or the power goes"
        return _with(bare, reason=why), size + more
    why = str(make_error(last.kind, last.message, last.device, last.hint))
    ended: dict[str, Any] = {
        "state": last.event,
        "taken": last.taken,
        "reason": why or "it does not say why",
    }
    return _with(bare, **ended), size + more


def _begun(begun: RunStart) -> dict[str, Any]:
    """Fields of an entry from the first line of a ledger. Raises ValidationError."""
    asked = msgspec.convert(begun.request, _Asked)
    planned = msgspec.convert(begun.plan, _Planned)
    return {
        **_labels(asked),
        "codes": asked.codes if planned.codes is None else planned.codes,
        "mock": begun.mock,
        "user": msgspec.convert(begun.owner, _User).user,
        "started_utc": begun.started_utc,
    }


def _labels(asked: _Asked) -> dict[str, Any]:
    return {
        "goal": asked.goal,
        "name": asked.name,
        "tags": tuple(_cut(tag) for tag in asked.tags[:MOST_TAGS]),
        "note": asked.note,
    }


def _last_line(folder: int) -> tuple[_Last | None, int]:
    """The last complete line of log.jsonl, and the bytes that were read; None where there is
    none."""
    try:
        with open_inner_file(folder, LOG) as descriptor:
            size = os.fstat(descriptor).st_size
            data = system.pread(descriptor, _TAIL_BYTES, max(0, size - _TAIL_BYTES))
        lines = data.rsplit(b"\n", 2)
        return msgspec.json.decode(lines[-2], type=_Last), len(data)
    except (OSError, DecodeError, ValueError, RecursionError, IndexError):
        return None, _TAIL_BYTES


def _cut(text: str, letters: int = 80) -> str:
    return text if len(text) <= letters else text[: letters - 3] + "..."


def _with(entry: RunEntry, **changes: Any) -> RunEntry:
    for key, value in changes.items():
        if isinstance(value, str):
            changes[key] = _cut(value, _LETTERS.get(key, 80))
    return msgspec.structs.replace(entry, **changes)
