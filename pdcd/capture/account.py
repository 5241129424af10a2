"""What is said of a job when it has ended: its summary, warnings and manifest."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from pdcd.bench.tables import Config
from pdcd.capture.job import Job
from pdcd.errors import Cancelled, PdcdError
from pdcd.offload.answers import Developed
from pdcd.planning.plan import Plan
from pdcd.request import CaptureResult, PlanSummary
from pdcd.runs.folder import RunFolder
from pdcd.runs.provenance import git_commit, utc_now, versions
from pdcd.runs.record import (
    SCHEMA_VERSION,
    FileRecord,
    Manifest,
    MeterRecord,
)
from pdcd.runs.views import RigView
from pdcd.sensor.profile import SensorProfile

logger = logging.getLogger(__name__)

Summary = dict[str, float | int | str | None]


def warnings_of(
    developed: Developed, config: Config, profile: SensorProfile, *, mock: bool
) -> Iterator[str]:
    """What the user must know of a finished run beside what happened in its shots."""
    for name, blown in developed.saturated.items():
        if blown:
            yield f"shot {name}: {blown} pixels are saturated"
    yield from developed.warnings
    if config.camera.responsivity_e is None and not mock:
        yield (
            "camera.responsivity_e is not set: the scale of the pictures, and what errors were "
            "foreseen, are those of a nominal camera"
        )
    if profile.estimated:
        yield f"sensor profile {profile.name} is an estimate"


def summary_of(plan: Plan, developed: Developed) -> Summary:
    """A finished run in figures."""
    how, record = plan.how, developed.record
    parts = max(developed.parts, 1)
    sigma = developed.rms_sigma
    return {
        "goal": record.goal.name,
        "picture": developed.picture,
        "method": how.method,
        "family": plan.family,
        "codes": how.coded * parts // how.parts + how.pilot,
        "parts": parts,
        "pilot": how.pilot,
        "passes": plan.passes,
        "repeat": how.repeat,
        "shots": len(record.shots),
        "refreshes": sum(s.refreshes for s in record.shots),
        "exposure_s": sum((s.close_ns - s.open_ns) * 1e-9 for s in record.shots),
        "missed_refreshes": sum(s.missed for s in record.shots),
        "rms_sigma": sigma if np.isfinite(sigma) else None,
        "sigma_kind": developed.sigma_kind,
        "rms_error": developed.rms_error,
        "sigma_mean": developed.sigma_mean,
        "predicted_error": None if plan.prediction is None else plan.prediction.error,
    }


def manifest_of(
    job: Job,
    plan: PlanSummary,
    developed: Developed,
    *,
    config: Config,
    mock: bool,
    rig: RigView,
    started_utc: str,
    summary: Summary,
    warnings: Sequence[str],
    meter: Sequence[MeterRecord],
    files: dict[str, FileRecord],
) -> Manifest:
    """The manifest of a finished run; `files` is all that lies in its folder."""
    return Manifest(
        schema=SCHEMA_VERSION,
        job=job.name,
        state="done",
        mock=mock,
        owner={} if job.owner is None else msgspec.to_builtins(job.owner),
        started_utc=started_utc,
        finished_utc=utc_now(),
        request=msgspec.to_builtins(job.request),
        plan=msgspec.to_builtins(plan),
        run=developed.record,
        realised={name: msgspec.to_builtins(d) for name, d in developed.deviations.items()},
        summary=summary,
        warnings=tuple(warnings),
        versions=versions(),
        git_commit=git_commit(),
        exif=developed.exif,
        drivers=msgspec.to_builtins(rig),
        config=msgspec.to_builtins(config),
        meter=tuple(meter),
        files=files,
    )


def failure_of(
    job: Job, folder: RunFolder | None, now_ns: int, error: PdcdError, *, safe: bool
) -> CaptureResult:
    """The result of a job that did not finish; its folder keeps the name that says so.

    `safe` is whether panels are black and the shutter is closed; log.jsonl keeps it.
    """
    cancelled = isinstance(error, Cancelled)
    fields = {
        "kind": error.kind,
        "message": error.message,
        "device": error.device,
        "hint": error.hint,
    }
    where = None if folder is None else folder.where
    if folder is not None and where is not None:
        # Nobody else could follow the path through our descriptor.
        for key in ("message", "device"):
            text = fields[key]
            fields[key] = None if text is None else text.replace(str(folder.path), str(where))
        try:
            event = "cancelled" if cancelled else "failed"
            folder.log({"t_mono_ns": now_ns, "event": event, **fields, "safe": safe})
        except PdcdError as err:
            logger.warning("cannot write log.jsonl error=%s", err)
    return CaptureResult(
        job=job.name,
        state="cancelled" if cancelled else "failed",
        folder=None if where is None else str(where),
        error=fields,
        files=() if folder is None else folder.files(),
    )
