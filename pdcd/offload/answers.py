"""What comes back from the desk, and the figures it is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.pictures.combine import Picture
from pdcd.planning.plan import Plan
from pdcd.planning.truth import answer
from pdcd.probing.deviation import Deviation
from pdcd.request import CaptureRequest, PlanSummary
from pdcd.runs.record import RunRecord, ShotRecord
from pdcd.scene.scene import Scene
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile


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
    picture : name of the answer. warnings : of the previews.
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
    picture: str
    warnings: tuple[str, ...] = ()


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
        white_patch=request.white_patch,
    )


def rms_sigma(picture: Picture) -> float:
    """RMS sigma over RMS image, where sigma is finite; infinite where that is nowhere or dark."""
    known = np.isfinite(picture.sigma)
    light = float(np.sum(picture.image[known] ** 2))
    return float(np.sqrt(np.sum(picture.sigma[known] ** 2) / light)) if light > 0.0 else np.inf


def rms_error(
    plan: Plan,
    record: RunRecord,
    image: NDArray[np.float64],
    scene: Scene | None,
    alive: Callable[[], None],
) -> float | None:
    """RMS error of an image over the RMS of the truth; None where that is not known.

    A picture that was warped has no cell left to compare with.
    """
    if scene is None or record.homography is not None or record.cells is None:
        return None
    truth = record.cells.spread(answer(scene, plan.recipe, alive))
    scale = float(np.sqrt(np.mean(truth**2)))
    return float(np.sqrt(np.mean((image - truth) ** 2))) / scale if scale else None
