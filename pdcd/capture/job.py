"""One job: its order, who hears of its progress, and the messages at its end."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import msgspec
import numpy as np

from pdcd.bench.devices import Clock
from pdcd.bench.tables import Config
from pdcd.capture.rig import Rig
from pdcd.capture.worker.answers import DevelopedRun
from pdcd.errors import Cancelled, PdcdError, to_error_fields, to_typed_error
from pdcd.protocol.events import DecodingProgress, Emit, Event, PlanningProgress, to_log_entry
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, SummaryValue
from pdcd.protocol.views import CameraView, DriverView, OwnerView, RigView
from pdcd.recipes.arrays import Given
from pdcd.runs.folder import RunFolder
from pdcd.runs.ledger import RunLedger, RunStart
from pdcd.runs.provenance import find_git_commit, format_utc_now, list_versions
from pdcd.runs.record import (
    SCHEMA_VERSION,
    FileRecord,
    Manifest,
    MeterRecord,
)
from pdcd.sensor.profile import SensorProfile
from pdcd.watch import Watch

logger = logging.getLogger(__name__)

MAX_NAMED = 8
"""Most missing shots that are listed."""

_Summary = dict[str, SummaryValue]

TOLD = 64
"""Most warnings in a result, which is one line on the socket; the manifest has all of them."""


@dataclass(frozen=True)
class EngineJob:
    """What is wanted, by whom, and two callbacks to whoever waits for it."""

    name: str
    request: CaptureRequest
    owner: OwnerView | None
    emit: Emit
    cancelled: Callable[[], bool]
    given: Given = field(default_factory=dict)
    """The arrays of the request."""
    report: bool = False
    """Whether to make a page of the run at its end, if that is quick."""

    def look_for_cancel(self) -> None:
        """Raise Cancelled when somebody asked for it."""
        if self.cancelled():
            raise Cancelled("the job was cancelled")

    def watch(self) -> Watch:
        """Reports the progress of the pictures to the client, and checks for a cancel."""

        def step(done: float, total: float) -> None:
            self.emit(DecodingProgress(done=done, total=total))

        return Watch(self.look_for_cancel, step)

    def planning(self) -> Watch:
        """The same for planning."""
        return make_planning_watch(self.emit, self.look_for_cancel)


def make_planning_watch(emit: Emit, look_for_cancel: Callable[[], None]) -> Watch:
    """Reports the progress of a plan; `look_for_cancel` may raise to end it."""

    def step(done: float, total: float) -> None:
        emit(PlanningProgress(stage=watch.stage, done=done, total=total))

    watch = Watch(look_for_cancel, step)
    return watch


@dataclass(frozen=True)
class Journal:
    """Reports the progress of a job, and collects what the user must know at its end."""

    job: EngineJob
    folder: RunFolder
    clock: Clock
    warnings: list[str]
    ledger: RunLedger

    def notify(self, event: Event) -> None:
        """Tell the client and log.jsonl; then check whether the job is still wanted."""
        self.folder.log(to_log_entry(event, self.clock.now_ns()))
        self.job.emit(event)
        self.job.look_for_cancel()

    def warn(self, text: str) -> None:
        """Keep a warning for the manifest."""
        self.warnings.append(text)
        if self.folder.where is not None:  # before that, the manifest alone has it
            self.ledger.warn(text)


def list_run_warnings(
    developed: DevelopedRun, config: Config, profile: SensorProfile, *, mock: bool
) -> Iterator[str]:
    """What the user must know of a finished run, in addition to what happened in its shots."""
    for name, blown in developed.saturated.items():
        if blown:
            yield f"shot {name}: {blown} pixels are saturated"
    if developed.dead:
        yield (
            f"{developed.dead} pixels of the camera stay dark beside lit ones, like dead pixels: "
            "nothing is known there (infinite sigma)"
        )
    yield from developed.warnings
    for name, exif in developed.exif.items():
        if doubts := cast("list[str]", exif.get("doubts", [])):
            yield from (f"shot {name}: {doubt}" for doubt in doubts)
            break  # the others are of the same camera
    if developed.blind > 0.0:
        yield (
            f"{100.0 * developed.blind:.2g} % of the cells are blind, without a pixel of a panel "
            "or of the camera: nothing is known there (infinite sigma)"
        )
    if config.camera.responsivity_e is None and not mock:
        yield (
            "camera.responsivity_e is not set: the scale of the pictures and the predicted "
            "errors are those of a nominal camera"
        )
    if profile.estimated:
        yield f"sensor profile {profile.name} is an estimate"


def summarise_run(plan: PlanSummary, developed: DevelopedRun) -> _Summary:
    """The figures of a finished run."""
    record = developed.record
    how = record.how
    parts = max(developed.parts, 1)
    sigma = developed.rms_sigma
    # Two buckets of one exposure are two shots.
    exposures = {(s.open_ns, s.close_ns): s for s in record.shots}.values()
    told: _Summary = {
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
        "refreshes": sum(s.refreshes for s in exposures),
        "exposure_s": sum(s.open_s for s in exposures),
        "missed_refreshes": sum(s.missed for s in exposures),
        "rms_sigma": sigma if np.isfinite(sigma) else None,
        "sigma_kind": developed.sigma_kind,
        "rms_error_quads": developed.rms_errors[0],
        "rms_error_cells": developed.rms_errors[1],
        "sigma_mean": developed.sigma_mean,
        "scale": None if record.scale is None else record.scale.source,
        "scale_sigma": None if record.scale is None else record.scale.sigma,
        "predicted_error": None if plan.prediction is None else plan.prediction.error,
        "quality": developed.quality,
        **developed.transport,
    }
    if developed.blind > 0.0:
        told["blind_share"] = developed.blind
    if developed.decided:
        told["decided"] = "; ".join(developed.decided)
    return told


def make_run_start(
    job: EngineJob, plan: PlanSummary, *, config: Config, mock: bool, rig: RigView, started_utc: str
) -> RunStart:
    """What is known of a run before its first exposure; `rig` describes the bench."""
    return RunStart(
        job=job.name,
        mock=mock,
        owner={} if job.owner is None else msgspec.to_builtins(job.owner),
        started_utc=started_utc,
        request=msgspec.to_builtins(job.request),
        plan=msgspec.to_builtins(plan),
        versions=list_versions(),
        git_commit=find_git_commit(),
        drivers=msgspec.to_builtins(rig),
        config=msgspec.to_builtins(config),
    )


def make_manifest(
    begun: RunStart,
    plan: dict[str, Any],
    developed: DevelopedRun,
    *,
    summary: _Summary,
    warnings: Sequence[str],
    meter: Sequence[MeterRecord],
    files: dict[str, FileRecord],
    missing: Sequence[str] = (),
    not_kept: Mapping[str, FileRecord] = MappingProxyType({}),
) -> Manifest:
    """The manifest of a run that began like that, and of its final plan.

    `files` are all files in its folder; `missing` are planned shots that are not there, which makes
    the run a partial one; `not_kept` are RAW files that are not to be kept.
    """
    return Manifest(
        schema=SCHEMA_VERSION,
        job=begun.job,
        state="partial" if missing else "done",
        mock=begun.mock,
        owner=begun.owner,
        started_utc=begun.started_utc,
        finished_utc=format_utc_now(),
        request=begun.request,
        plan=plan,
        run=developed.record,
        realised={name: msgspec.to_builtins(d) for name, d in developed.deviations.items()},
        summary=summary,
        warnings=tuple(warnings),
        versions=list_versions(),
        git_commit=find_git_commit(),
        exif=developed.exif,
        drivers=begun.drivers,
        config=begun.config,
        meter=tuple(meter),
        files=files,
        missing=tuple(missing),
        not_kept=dict(not_kept) or msgspec.UNSET,
    )


def merge_warnings(warnings: Sequence[str]) -> tuple[str, ...]:
    """Warnings for a result: those of several shots with the same words are merged into one.

    In a run of a thousand shots, each may give the same warning.
    """
    heads: dict[str, list[str]] = {}
    for text in warnings:
        shot, _, rest = text.partition(": ")
        alike = rest if rest and shot.startswith("shot ") else text
        heads.setdefault(alike, []).append(text)
    brief = [
        texts[0] + (f" (and so of {len(texts) - 1} more)" if len(texts) > 1 else "")
        for texts in heads.values()
    ]
    if len(brief) > TOLD:
        brief[TOLD - 1 :] = [f"and {len(brief) - TOLD + 1} more; capture.json has all of them"]
    return tuple(brief)


def describe_shots_taken(taken: int, planned: int, missing: Sequence[str]) -> str:
    """How far a run came: "3 of 5 shots, missing: black, coded.4"."""
    words = f"{taken} of {planned} shots"
    if missing:
        words += f", missing: {', '.join(missing[:MAX_NAMED])}"
    if len(missing) > MAX_NAMED:
        words += f" and {len(missing) - MAX_NAMED} more"
    return words


def _shown(text: str, path: Path, where: Path) -> str:
    """A text in which a path by our descriptor is replaced by the folder's usual name; the work
    process knows that path by our process number."""
    ours = rf"/proc/(?:self|{os.getpid()})/fd/{path.name}(?!\d)"
    return re.sub(ours, lambda _: str(where), text)


def make_failure(
    job: str,
    folder: RunFolder | None,
    now_ns: int,
    error: PdcdError,
    *,
    safe: bool,
    taken: str | None = None,
    warnings: Sequence[str] = (),
    log: bool = True,
) -> CaptureResult:
    """The result of a job that did not finish; its folder keeps its unfinished name.

    `log` : whether to write it into the folder, which must not be complete then.
    `safe` : whether panels are black and the shutter is closed; log.jsonl keeps it. `taken` : which
        of its shots are there, where any is. `warnings` : those given until then.
    """
    cancelled = isinstance(error, Cancelled)
    fields = to_error_fields(error)
    where = None if folder is None else folder.where
    if folder is not None and where is not None:
        # A path through our descriptor is of no use to anyone else.
        for key in ("message", "device"):
            text = fields[key]
            fields[key] = None if text is None else _shown(text, folder.path, where)
        event = "cancelled" if cancelled else "failed"
        shots = {} if taken is None else {"taken": taken}
        line = {"t_mono_ns": now_ns, "event": event, **fields, "safe": safe, **shots}
        try:
            if log:
                folder.log(line)
        except PdcdError as err:
            logger.warning("cannot write log.jsonl error=%s", err)
    return CaptureResult(
        job=job,
        state="cancelled" if cancelled else "failed",
        folder=None if where is None else str(where),
        error=fields,
        files=() if folder is None else folder.files(),
        summary={} if taken is None else {"taken": taken},
        warnings=merge_warnings(warnings),
    )


def mark_unsafe(result: CaptureResult) -> CaptureResult:
    """The result of a job after which the rig could not be made safe."""
    text = "the panels may still be lit, or the shutter open: see the log"
    return msgspec.structs.replace(result, warnings=(*result.warnings, text))


def mark_kept(result: CaptureResult, steps: tuple[str, ...]) -> CaptureResult:
    """The result of a calibration that stopped, with a list of what it found until then."""
    text = f"kept: {', '.join(steps)}; pdcd calibrate goes on from there"
    return msgspec.structs.replace(result, warnings=(*result.warnings, text))


def mark_used(result: CaptureResult, config: Config) -> CaptureResult:
    """The result of a calibration, with a note whether it is in use from now on."""
    used = Path(config.calibration.use).resolve() == Path(str(result.folder)).resolve()
    return msgspec.structs.replace(result, summary={**result.summary, "used": int(used)})


def describe_rig(rig: Rig) -> RigView:
    """The rig as found: drivers, panels, camera, scene. Called by the engine."""
    config, info = rig.config, rig.camera_info
    drivers = {
        "display": config.display.driver,
        "shutter": config.trigger.driver,
        "readout": config.camera.driver,
    }
    camera = None
    if info is not None:
        camera = CameraView(
            model=info.model,
            serial=info.serial,
            profile=info.profile,
            responsivity_e=tuple(info.responsivity_e.tolist()),
            isos=info.isos,
            f_numbers=info.f_numbers,
        )
    return RigView(
        name=config.rig.name,
        mock=rig.mock,
        grid=rig.grid,
        drivers={
            role: DriverView(name=name, maturity=rig.maturity[role])
            for role, name in drivers.items()
        },
        display=rig.display_info,
        shutter=rig.shutter_info,
        camera=camera,
        scene=None if rig.scene is None else rig.scene.name,
    )


def to_job_error(err: BaseException, what: str, job: str) -> PdcdError:
    """The error with which a job ended; a fault of the program is logged. Raises KeyboardInterrupt
    again."""
    if isinstance(err, KeyboardInterrupt):
        raise err
    typed = to_typed_error(err)
    if typed is not err:
        logger.error("%s failed job=%s", what, job, exc_info=err)
    return typed
