"""The messages between the worker and the owner of the devices, and the figures in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pdcd.bench.devices import CameraInfo, CameraSettings
from pdcd.bench.measured import find_scale
from pdcd.bench.stops import Stop
from pdcd.bench.tables import Config
from pdcd.panels.frames import Frames
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.picture import Picture
from pdcd.pictures.transport import TransportSlice
from pdcd.pictures.truth import compute_true_entries
from pdcd.planning.grey import find_unknown_grey_panels, is_mock_as_configured
from pdcd.planning.plan import Plan
from pdcd.probing.deviation import Deviation
from pdcd.protocol.events import Event
from pdcd.protocol.plan_summary import CaptureScheme, LeakErrors, PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import Quality
from pdcd.recipes.parts import list_parts
from pdcd.runs.record import BorderPhoto, DarkPhoto, MeterRecord, PanelLook, RunRecord, ShotRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile
from pdcd.verdict.assess import assess_run
from pdcd.virtual.scene.scene import Scene


@dataclass(frozen=True)
class RigFacts:
    """What holds for every job of a rig; `scene` is what stands in front of it, where that is
    known."""

    config: Config
    profile: SensorProfile
    grid: tuple[int, int]
    scene: Scene | None
    cells_meet: bool = False
    """Whether panels cannot be misplaced (`pdcd.bench.devices.SharedState`)."""


@dataclass(frozen=True)
class PlannedRun:
    """What is known of a plan before there is a folder.

    iso : None for the camera's lowest. cut : whether any shot opens less than whole cells.
    warnings : what the user of the finished run must know.
    """

    summary: PlanSummary
    iso: int | None
    cut: bool
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class AdoptedPlan:
    """A plan by which the run goes on, whose codes are stored. record : of the run, without its
    shots. shots : names of all that are planned."""

    summary: PlanSummary
    record: RunRecord
    shots: tuple[str, ...]


@dataclass(frozen=True)
class ConvergenceNote:
    """The wanted error is reached: shots that are still planned are not needed."""


OrderNote = Event | MeterRecord | AdoptedPlan | ConvergenceNote | str
"""What to report, and to keep in the run's ledger; text is a warning."""


@dataclass(frozen=True, eq=False)
class PhotoOrder:
    """Take this photo.

    kind : a "shot" is kept with its frames, and taken again where codes got unequal light. A "test"
        exposure is taken again where the display gave up. So are a "dark" photo and a "look" of
        pixels, which a display need not support; the run goes on without these two.
    f_number : as recorded, also of a lens that is not set from here. window : of a shot, as
        recorded.
    even : whether each of its codes must be shown exactly as often as planned.
    beside : names and frames of the shots that the other buckets of the sensor take.
    """

    kind: Literal["shot", "test", "dark", "look"]
    name: str
    frames: Frames
    settings: CameraSettings
    f_number: float
    window: str = ""
    even: bool = False
    beside: tuple[tuple[str, Frames], ...] = ()


@dataclass(frozen=True)
class AuxiliaryPhoto:
    """A test exposure or a dark photo as it came: path below the run folder and SHA-256 of each of
    its planes, and seconds for which the shutter was open."""

    planes: tuple[tuple[str, str], ...]
    seconds: float

    @property
    def raw(self) -> str:
        """Path of its first plane."""
        return self.planes[0][0]


@dataclass(frozen=True)
class SpoiltPhoto:
    """A photo that the run can do without could not be had."""

    message: str


PhotoOutcome = tuple[ShotRecord, ...] | AuxiliaryPhoto | SpoiltPhoto | None
"""The result of an ordered photo; None where none was ordered."""


@dataclass(frozen=True)
class Order:
    """What the owner of the devices does next: report and keep the notes in their order, then take
    the photo. Without a photo it asks again, because the notes should be known before work that
    takes long; or all is `done`."""

    notes: tuple[OrderNote, ...]
    photo: PhotoOrder | None = None
    done: bool = False


@dataclass(frozen=True)
class DevelopedRun:
    """A run whose pictures are written.

    record : of the run, with the map of its cells.
    saturated : number of saturated pixels of each shot; exif : what its RAW file says.
    parts : number of parts that the pictures were made of.
    rms_sigma, sigma_kind, sigma_mean : of the answer; infinite and None where not known.
    rms_errors : against the scene's known truth, over its RMS, of quads and of means over cells;
        None where the truth is not known.
    deviations : of each photo's realised probing matrix from the wanted one.
    quality : the verdict on the run.
    picture : name of the answer. warnings : of the previews.
    decided : decisions made on the way that nobody had asked for, in words.
    transport : figures of entries of T that were photographed, by name; empty without any.
    blind : share of the cells of which nothing is known: without a pixel of a panel, or a quad.
    dead : number of dead pixels of the camera.
    """

    record: RunRecord
    saturated: dict[str, int]
    exif: dict[str, dict[str, object]]
    parts: int
    rms_sigma: float
    sigma_kind: str
    sigma_mean: float | None
    rms_errors: tuple[float | None, float | None]
    deviations: dict[str, Deviation]
    quality: Quality
    picture: str
    warnings: tuple[str, ...] = ()
    transport: dict[str, float | int | None] = field(default_factory=dict)
    decided: tuple[str, ...] = ()
    blind: float = 0.0
    dead: int = 0


def make_run_record(
    plan: Plan,
    request: CaptureRequest,
    config: Config,
    camera: CameraInfo,
    profile: SensorProfile,
    shots: Sequence[ShotRecord] = (),
    cells: CellMap | None = None,
    stops: Sequence[Stop] = (),
    panels: PanelLook | None = None,
    borders: BorderPhoto | None = None,
    room: DarkPhoto | None = None,
) -> RunRecord:
    """The record of a run by this plan, with the shots taken so far."""
    return RunRecord(
        goal=plan.recipe.target.goal,
        how=plan.how,
        smooth=plan.smooth,
        normalise=request.normalise or config.schedule.normalise,
        grid=plan.recipe.target.grid,
        cells=cells,
        projector=config.projector,
        mask=config.mask,
        responsivity_e=tuple(float(light) for light in camera.responsivity_e),
        profile=profile,
        shots=tuple(shots),
        stops=tuple(stops),
        scale=find_scale(config, stops[0].f_number if stops else None),
        camera_place=config.camera.place,
        blur_quads=config.camera.blur_quads,
        white_patch=request.white_patch,
        dark=plan.dark,
        room=room,
        panels=panels,
        borders=borders,
        leak=_left(plan.leaks, plan.how),
        leaks_unseen=_find_unseen_leaks(plan),
        room_changed=0.0 if plan.leaks is None else plan.leaks.changed,
        grey_unknown=find_unknown_grey_panels(plan.patterns.values(), config),
        times_known="mask.skew_s" in config.calibration.typed or is_mock_as_configured(config),
    )


def make_developed_run(
    record: RunRecord,
    decoded: DecodedRun,
    errors: tuple[float | None, float | None],
    warnings: tuple[str, ...],
    alive: Callable[[], None],
    scene: Scene | None = None,
) -> DevelopedRun:
    """The figures of a decoded run; `errors` are those of its answer against a known truth,
    `scene`, `warnings` those of its pictures."""
    picture = decoded.answer
    known = picture.sigma[np.isfinite(picture.sigma)]
    deviations = decoded.deviations(alive)
    dead = np.zeros((), np.bool_) if decoded.dead is None else decoded.dead
    return DevelopedRun(
        record=record,
        saturated={name: int((s.saturated & ~dead).sum()) for name, s in decoded.shots.items()},
        dead=int(dead.sum()),
        exif={name: shot.exif for name, shot in decoded.shots.items()},
        parts=len(list_parts(decoded.recipe)),
        rms_sigma=compute_rms_sigma(picture),
        sigma_kind=picture.kind,
        sigma_mean=float(known.mean(dtype=np.float64)) if known.size else None,
        rms_errors=errors,
        deviations=deviations,
        quality=assess_run(record, decoded, deviations),
        picture=decoded.recipe.answer_name,
        warnings=warnings,
        transport=compute_transport_figures(
            decoded.transport,
            # Entries are of code cells, and a scene's of cells of the whole picture.
            scene if record.projector.field_px is None else None,
            record.grid,
            pixels=decoded.cells.frame != record.grid,
        ),
        blind=1.0 - float(decoded.cells.seen().mean()),
    )


def compute_transport_figures(
    found: TransportSlice | None, scene: Scene | None, grid: tuple[int, int], *, pixels: bool
) -> dict[str, float | int | None]:
    """Number of photos, sigma and, where the scene with these cells is known, error of entries of
    T, both over the RMS of the entries; empty where none were photographed. pixels : on a bench of
    pixels."""
    if found is None:
        return {}
    error = None
    # On a bench of pixels, texture is finer than cells: entries of cells are not what is seen
    # there.
    if scene is not None and scene.grid == grid and not (pixels and scene.textures):
        error = found.rms_error(
            compute_true_entries(scene, found.seen, found.lit, colours=found.entries.shape[2])
        )
    sigma = found.rms_sigma if np.isfinite(found.rms_sigma) else None
    return {
        "transport_photos": found.photos,
        "transport_sigma": sigma,
        "transport_error": error if error is not None and np.isfinite(error) else None,
    }


def _left(leaks: LeakErrors | None, how: CaptureScheme) -> float:
    """RMS error of the answer by leaks that were measured and are not corrected."""
    if leaks is None or leaks.both <= leaks.limit or how.black_level != "none":
        return 0.0
    return leaks.both


def _find_unseen_leaks(plan: Plan) -> Literal["no", "declined", "missing"]:
    """Whether nothing shows if ambient light or leaks are in the answer. A transport matrix has an
    unknown for them."""
    both = plan.how.black_level == "both"
    if plan.leaks is not None or both or plan.recipe.target.goal.name == "transport":
        return "no"
    return "declined" if plan.look is None else "missing"


def compute_rms_sigma(picture: Picture) -> float:
    """RMS sigma over RMS image, where sigma is finite; infinite where sigma is finite nowhere, or
    all is dark there."""
    known = np.isfinite(picture.sigma)
    light = float(np.sum(picture.image**2, where=known))
    error = float(np.sum(picture.sigma**2, where=known, dtype=np.float64))
    return float(np.sqrt(error / light)) if light > 0.0 else np.inf
