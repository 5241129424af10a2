"""The end of a job: its verdict, its figures, its name."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from datetime import UTC, datetime

import msgspec
from msgspec import UNSET, UnsetType

from pdcd.words import JobState, VerdictName


class Quality(msgspec.Struct, frozen=True, kw_only=True):
    """The verdict on a run (docs/quality.md): each of `reasons` is a plain sentence with its
    figure, its limit and what to do. A good run has none; `remarks` leave it good."""

    verdict: VerdictName
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


SummaryValue = float | int | str | Quality | None
"""The types of values in the summary of a run."""


def quality_of(summary: Mapping[str, SummaryValue]) -> Quality | None:
    """The verdict in the summary of a run; None where the run made no picture."""
    found = summary.get("quality")
    return found if isinstance(found, Quality) else None


def read_summary_value(summary: Mapping[str, SummaryValue], name: str) -> float | int | str | None:
    """A number or a word in the summary of a run; None where it is unknown, or is the verdict."""
    found = summary.get(name)
    return None if isinstance(found, Quality) else found


class CaptureResult(msgspec.Struct, frozen=True, kw_only=True):
    """The end of a job: what `capture.wait` returns and `pdcd capture --json` prints last.

    state : how it ended. folder : the run, finished or not; None where nothing was begun.
    manifest_sha256 : digest of its `capture.json`, to be kept elsewhere.
    """

    job: str
    state: JobState
    folder: str | None = None
    manifest_sha256: str | None = None
    error: dict[str, str | None] | None = None
    """`kind`, `message`, `device`, `hint` of the failure, when `state` is failed or cancelled."""
    files: tuple[str, ...] = ()
    """Paths of the files that were kept, relative to `folder` (to the unfinished folder when the
    job did not finish)."""
    summary: dict[str, SummaryValue] = {}
    """codes, refreshes, exposure_s, missed_refreshes, rms_error_quads, rms_error_cells ... for the
    table; and `quality`, the verdict."""
    warnings: tuple[str, ...] = ()
    """What the user must know about the run, one line each; the manifest has all of them."""
    passed: bool | UnsetType = UNSET
    """For a calibration: whether it came to its end with nothing bad, so that it is in use."""


def make_job_id() -> str:
    """Name of a new job: UTC time to the second and four random hex digits."""
    return f"{format_job_time(datetime.now(UTC))}-{secrets.token_hex(2)}"


def format_job_time(moment: datetime) -> str:
    """The beginning of the names of jobs of that moment; such names sort by time."""
    return f"{moment.astimezone(UTC):%Y%m%dT%H%M%SZ}"
