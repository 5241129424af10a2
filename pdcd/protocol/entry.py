"""Entries of runs on disk, and queries for them: values only, without the code that reads runs."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from pdcd.protocol.labels import Label, Tag
from pdcd.words import GoalName, VerdictName

MOST_RUNS = 1000
"""Most runs of one page."""

_State = Literal[
    "done", "partial", "failed", "cancelled", "unfinished", "running", "damaged", "foreign"
]


class RunEntry(msgspec.Struct, frozen=True, kw_only=True):
    """A run on disk.

    `state`: "done"; "partial", made of a run that was cut; "failed" and "cancelled", which left
    what they had; "running"; "unfinished", which ended without saying why; "damaged", whose
    manifest cannot be read; "foreign", the folder of somebody else, into which nobody looked. What
    nobody can tell is null.
    """

    job: str
    state: _State
    folder: str
    kind: Literal["capture", "preview"] = "capture"
    name: str | None = None
    tags: tuple[str, ...] = ()
    note: str = ""
    goal: str | None = None
    method: str | None = None
    codes: int | None = None
    """Pairs of patterns; as planned for a run without a manifest."""
    exposure_s: float | None = None
    rms_error_quads: float | None = None
    """Measured against a known truth, relative to the RMS of the picture."""
    rms_error_cells: float | None = None
    """The same for means over the cells."""
    rms_sigma: float | None = None
    """The error estimated from the photo itself, relative to the RMS of the picture, too."""
    verdict: VerdictName | None = None
    mock: bool | None = None
    user: str | None = None
    started_utc: str | None = None
    finished_utc: str | None = None
    taken: str | None = None
    """For a run that was cut: a text such as "3 of 5 shots, missing: black, coded-4"."""
    reason: str | None = None
    """Why there is no finished run, in words."""

    @property
    def failed(self) -> bool:
        """Whether it has ended without a complete run."""
        return self.state not in ("done", "running")


class RunQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which runs are wanted, of the newest ones; what is left out does not matter.

    `before` is `more` of the page before: what follows is older.
    """

    newest: Annotated[int, Meta(ge=1, le=MOST_RUNS)] = 50
    before: Annotated[str, Meta(max_length=4096)] | None = None
    since: Annotated[datetime, Meta(tz=True)] | None = None
    """Started at that time or later."""
    goal: GoalName | None = None
    name: Label | None = None
    job: Annotated[str, Meta(max_length=64)] | None = None
    tags: Annotated[tuple[Tag, ...], Meta(max_length=16)] = ()
    """Runs that have all of these."""
    failed: bool = False
    """Only runs that ended without being complete."""
    previews: bool = False
    """Previews, too."""


class Page(msgspec.Struct, frozen=True, kw_only=True):
    """Runs that were found, newest first, and where it goes on."""

    state_folder: str
    runs: list[RunEntry]
    more: str | None = None
    """Give it as `before` for the runs that follow; null where there are none."""
    closed: tuple[str, ...] = ()
    """Folders below the state folder that could not be read, up to ten of them."""
    cut: bool = False
    """Whether the state folder holds more names than are read."""
