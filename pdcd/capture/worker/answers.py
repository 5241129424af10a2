"""What comes back from the desk, and the figures it is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.pictures.darkroom import Decoded
from pdcd.pictures.picture import Picture
from pdcd.pictures.transport import Sliced
from pdcd.pictures.truth import entries
from pdcd.planning.plan import Plan
from pdcd.probing.deviation import Deviation
from pdcd.protocol.request import CaptureRequest, Leaks, PlanSummary, Quality
from pdcd.recipes.parts import part_numbers
from pdcd.runs.record import RunRecord, ShotRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile
from pdcd.verdict.assess import assess
from pdcd.virtual.scene.scene import Scene


@dataclass(frozen=True)
class Planned:
    """A plan as those need it who show its shots (`Plan.outline`), and all of it in figures."""

    plan: Plan
    summary: PlanSummary


@dataclass(frozen=True)
class Metered:
    """A test exposure: its brightest sample, and that of the real exposure at the same aperture,
    as shares of saturation."""

    peak: float
    expected: float


@dataclass(frozen=True)
class Learnt:
    """What follows from the photos of a pilot.

    "go on": nothing yet. "stopped": its scouts see no sharp paths, and the rest of its codes go to
    the coded photo. "guided": the codes that follow keep linked cells apart. "no use": they cannot.
    `planned` is the plan from here on, where it is another one.
    """

    outcome: Literal["go on", "stopped", "guided", "no use"]
    planned: Planned | None
    told: str = ""
    """What was decided, and what that cost, where nobody asked for the pilot."""


@dataclass(frozen=True)
class Stray:
    """What follows from dark photos.

    "quiet": nothing gets in that matters. "unsure": another one is wanted, with both panels black
    in its second half. "added": black exposures are, by a new plan. "warn": they are needed, and
    `why` they cannot be had. `told` is what else the user must know, and `decided` what was done
    about the noise of ambient light, in words.
    """

    outcome: Literal["quiet", "unsure", "added", "warn"]
    leaks: Leaks
    planned: Planned
    why: str = ""
    told: tuple[str, ...] = ()
    decided: str = ""


@dataclass(frozen=True)
class Seen:
    """Pictures of the parts taken so far: how many there are, RMS sigma over RMS image (infinite
    where that is not known), and what sigma covers."""

    parts: int
    rms_sigma: float
    sigma_kind: str


@dataclass(frozen=True)
class Developed:
    """A run whose pictures are written.

    record : of the run, with the map of its cells.
    saturated : saturated pixels of each shot; exif : what its RAW file says of itself.
    parts : that the pictures were made of.
    rms_sigma, sigma_kind, sigma_mean : of the answer; infinite and None where it is not known.
    rms_error : against the scene's known truth, over the RMS of that; None where nobody knows it.
    deviations : of each photo's realised probing matrix from the wanted one.
    quality : the verdict on it.
    picture : name of the answer. warnings : of the previews.
    transport : figures of entries of T that were photographed, by name; none else.
    """

    record: RunRecord
    saturated: dict[str, int]
    exif: dict[str, dict[str, object]]
    parts: int
    rms_sigma: float
    sigma_kind: str
    sigma_mean: float | None
    rms_error: float | None
    deviations: dict[str, Deviation]
    quality: Quality
    picture: str
    warnings: tuple[str, ...] = ()
    transport: dict[str, float | int | None] = field(default_factory=dict)


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
        camera_place=config.camera.place,
        blur_quads=config.camera.blur_quads,
        white_patch=request.white_patch,
        dark=plan.dark,
        leak=_left(plan),
    )


def developed_of(
    record: RunRecord,
    decoded: Decoded,
    error: float | None,
    warnings: tuple[str, ...],
    alive: Callable[[], None],
    scene: Scene | None = None,
) -> Developed:
    """What is told of a decoded run; `error` is that of its answer against a known truth, `scene`,
    `warnings` are those of its pictures."""
    picture = decoded.answer
    known = picture.sigma[np.isfinite(picture.sigma)]
    deviations = decoded.deviations(alive)
    return Developed(
        record=record,
        saturated={name: int(s.saturated.sum()) for name, s in decoded.shots.items()},
        exif={name: shot.exif for name, shot in decoded.shots.items()},
        parts=len(part_numbers(decoded.recipe)),
        rms_sigma=rms_sigma(picture),
        sigma_kind=picture.kind,
        sigma_mean=float(known.mean(dtype=np.float64)) if known.size else None,
        rms_error=error,
        deviations=deviations,
        quality=assess(record, decoded, deviations),
        picture=decoded.recipe.answer_name,
        warnings=warnings,
        transport=transport_figures(
            decoded.transport,
            scene,
            record.grid,
            pixels=decoded.cells.frame != record.grid,
        ),
    )


def transport_figures(
    found: Sliced | None, scene: Scene | None, grid: tuple[int, int], *, pixels: bool
) -> dict[str, float | int | None]:
    """Photos, sigma and, of a scene of these cells that is known, error of entries of T, both over
    the RMS of the entries; nothing where none were photographed. pixels : on a bench of pixels."""
    if found is None:
        return {}
    error = None
    # On a bench of pixels detail is no matter of cells: their entries are not what is seen there.
    if scene is not None and scene.grid == grid and not (pixels and scene.textures):
        error = found.rms_error(entries(scene, found.seen, found.lit))
    sigma = found.rms_sigma if np.isfinite(found.rms_sigma) else None
    return {
        "transport_photos": found.photos,
        "transport_sigma": sigma,
        "transport_error": error if error is not None and np.isfinite(error) else None,
    }


def _left(plan: Plan) -> float:
    """RMS error of the answer by leaks that a look found and nothing takes off."""
    leaks = plan.leaks
    if leaks is None or leaks.both <= leaks.limit or plan.how.black_level != "none":
        return 0.0
    return leaks.both


def rms_sigma(picture: Picture) -> float:
    """RMS sigma over RMS image, where sigma is finite; infinite where that is nowhere or dark."""
    known = np.isfinite(picture.sigma)
    light = float(np.sum(picture.image**2, where=known))
    error = float(np.sum(picture.sigma**2, where=known, dtype=np.float64))
    return float(np.sqrt(error / light)) if light > 0.0 else np.inf
