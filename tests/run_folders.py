"""Folders that look like runs, as far as a list of runs looks: written by hand, without a photo."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import msgspec

from pdcd.protocol.entry import MOST_RUNS, RunEntry, RunQuery
from pdcd.runs.index import iterate_run_pages
from pdcd.runs.ledger import RunStart

HEAD: dict[str, Any] = {
    "schema": 1,
    "state": "done",
    "mock": True,
    "request": {"goal": "indirect", "codes": 8, "name": None, "tags": [], "note": ""},
    "owner": {"uid": 1, "pid": 2, "user": "ada"},
    "started_utc": "2026-01-01T00:00:00Z",
    "finished_utc": "2026-01-01T00:00:09Z",
    "plan": {"codes": 8},
    "summary": {
        "method": "coded", "codes": 8, "exposure_s": 0.5, "rms_error_quads": 0.0321,
        "rms_sigma": 0.02, "quality": {"verdict": "good"},
    },
}  # fmt: skip


def job(second: int, day: int = 1) -> str:
    return f"202601{day:02d}T0000{second:02d}Z-00ff"


def finished(folder: Path, name: str, ending: str = "", /, **changes: Any) -> Path:
    """A run with a manifest; what is in `changes` and a table is laid over the usual one."""
    place = folder / (name + ending)
    place.mkdir(parents=True)
    told: dict[str, Any] = {**HEAD, "job": name}
    for key, value in changes.items():
        told[key] = {**told[key], **value} if isinstance(value, dict) else value
    (place / "capture.json").write_text(json.dumps(told))
    return place


def cut(folder: Path, job: str, /, *log: dict[str, Any], **asked: Any) -> Path:
    """A run without a manifest: its ledger, and the lines of its log."""
    place = folder / f"{job}.partial"
    place.mkdir(parents=True)
    begun = RunStart(
        job=job,
        mock=True,
        owner=HEAD["owner"],
        started_utc=HEAD["started_utc"],
        request={**HEAD["request"], **asked},
        plan=HEAD["plan"],
        versions={},
        git_commit=None,
        drivers={},
        config={},
    )
    (place / "ledger.jsonl").write_bytes(first_line(msgspec.json.encode(begun)))
    (place / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in log))
    return place


def first_line(said: bytes) -> bytes:
    """A ledger of one line, with its digest (`pdcd.runs.ledger`)."""
    digest = hashlib.sha256(said).hexdigest()
    return b'{"said":' + said + b',"sha256":"' + digest.encode() + b'"}\n'


def find_runs(state: Path, **wanted: Any) -> list[RunEntry]:
    """All runs below a state folder that match, newest first."""
    query = RunQuery(newest=MOST_RUNS, **wanted)
    return [run for page in iterate_run_pages(state, query) for run in page.runs]
