"""What is said of a job when it has ended: its record, summary, warnings and manifest."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.capture.convergence import rms_sigma
from pdcd.capture.job import Job
from pdcd.errors import Cancelled, PdcdError
from pdcd.pictures.darkroom import Decoded
from pdcd.planning.guided import summary as plan_summary
from pdcd.planning.plan import Plan
from pdcd.planning.truth import answer
from pdcd.probing.deviation import Deviation
from pdcd.recipes.parts import part_numbers
from pdcd.request import CaptureRequest, CaptureResult
from pdcd.runs.folder import RunFolder
from pdcd.runs.provenance import git_commit, utc_now, versions
from pdcd.runs.record import (
    SCHEMA_VERSION,
    FileRecord,
    Manifest,
    MeterRecord,
    RunRecord,
    ShotRecord,
)
from pdcd.runs.views import RigView
from pdcd.scene.scene import Scene
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile

logger = logging.getLogger(__name__)

Summary = dict[str, float | int | str | None]


def record_of(
    plan: Plan,
    request: CaptureRequest,
    config: Config,
    camera: CameraInfo,
    profile: SensorProfile,
    shots: Sequence[ShotRecord] = (),
    cells: CellMap | None = None,
) -> RunRecord:
    """What a run by this plan has to remember of itself, with the shots taken so far."""
    red, green, blue = (float(r) for r in camera.responsivity_e)
    return RunRecord(
        goal=plan.recipe.target.goal,
        how=plan.how,
        smooth=plan.smooth,
        normalise=request.normalise or config.schedule.normalise,
        grid=plan.grid,
        cells=cells,
        projector=config.projector,
        mask=config.mask,
        responsivity_e=(red, green, blue),
        profile=profile,
        shots=tuple(shots),
        homography=config.camera.homography,
    )


def warnings_of(
    decoded: Decoded, config: Config, profile: SensorProfile, *, mock: bool
) -> Iterator[str]:
    """What the user must know of a finished run beside what happened in its shots."""
    for name, shot in decoded.shots.items():
        blown = int(shot.saturated.sum())
        if blown:
            yield f"shot {name}: {blown} pixels are saturated"
    if config.camera.responsivity_e is None and not mock:
        yield (
            "camera.responsivity_e is not set: the scale of the pictures, and what errors were "
            "foreseen, are those of a nominal camera"
        )
    if profile.estimated:
        yield f"sensor profile {profile.name} is an estimate"


def summary_of(plan: Plan, record: RunRecord, decoded: Decoded, scene: Scene | None) -> Summary:
    """A finished run in figures; `scene` is what stood there, where that is known."""
    picture, how = decoded.answer, plan.how
    sigma = rms_sigma(picture)
    known = picture.sigma[np.isfinite(picture.sigma)]
    parts = max(len(part_numbers(decoded.recipe)), 1)
    return {
        "goal": record.goal.name,
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
        "sigma_kind": picture.kind,
        "rms_error": _rms_error(plan, record, picture.image, scene),
        "sigma_mean": float(known.mean()) if known.size else None,
        "predicted_error": None if plan.prediction is None else plan.prediction.error,
    }


def _rms_error(
    plan: Plan, record: RunRecord, image: NDArray[np.float64], scene: Scene | None
) -> float | None:
    """RMS error of an image over the RMS of the truth; None where that is not known.

    A picture that was warped has no cell left to compare with.
    """
    if scene is None or record.homography is not None or record.cells is None:
        return None
    truth = record.cells.spread(answer(scene, plan.recipe))
    scale = float(np.sqrt(np.mean(truth**2)))
    return float(np.sqrt(np.mean((image - truth) ** 2))) / scale if scale else None


def manifest_of(
    job: Job,
    plan: Plan,
    record: RunRecord,
    decoded: Decoded,
    deviations: Mapping[str, Deviation],
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
        plan=msgspec.to_builtins(plan_summary(plan, config.limits.max_exposure_s)),
        run=record,
        realised={name: msgspec.to_builtins(d) for name, d in deviations.items()},
        summary=summary,
        warnings=tuple(warnings),
        versions=versions(),
        git_commit=git_commit(),
        exif={name: shot.exif for name, shot in decoded.shots.items()},
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
