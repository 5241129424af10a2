"""The record that a run keeps of itself so that it can be decoded again, and its manifest."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from pdcd.bench.stops import AbsoluteScale, Stop
from pdcd.bench.tables import NonNegative, PanelConfig
from pdcd.errors import DecodeError
from pdcd.panels.placing import Placing
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.protocol.request import FieldPlace
from pdcd.protocol.result import Quality, SummaryValue, quality_of
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile
from pdcd.words import NormaliseName

SCHEMA_VERSION = 1
"""Schema of the manifest; no other is read."""

RecordCount = Annotated[int, Meta(ge=0, le=2**62)]
Nanoseconds = Annotated[int, Meta(ge=-(2**62), le=2**62)]
RecordPositive = Annotated[float, Meta(gt=0.0)]
Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class FileRecord(msgspec.Struct, frozen=True):
    """A file of a run folder as it was when the run ended."""

    sha256: Sha256
    size_bytes: RecordCount


class ShotRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One exposure as it was taken. Times are ns of the rig's clock."""

    name: str
    window: Annotated[str, Meta(pattern="^(whole|quarter|side-5/8|side-3/4|side-7/8)$")]
    """Window mode of its frames."""
    raw: str
    """Path in the run folder."""
    sha256: Sha256
    size_bytes: RecordCount
    iso: Annotated[int, Meta(ge=1)]
    f_number: RecordPositive
    open_ns: Nanoseconds
    close_ns: Nanoseconds
    end_ns: tuple[Nanoseconds, Nanoseconds]
    """When projector and mask went black after the last refresh."""
    refreshes: RecordCount
    missed: RecordCount
    source: str
    verified: bool
    planned_s: RecordPositive | None = None
    """How long the shutter was meant to be open; None where that was not planned."""
    level: RecordPositive | None = None
    """How often each code was shown over how often it was planned; None where codes differ. The
    shot is divided by it, so that photos made of several shots weigh them as planned."""

    @property
    def open_s(self) -> float:
        """How long the shutter was open."""
        return (self.close_ns - self.open_ns) * 1e-9


class MeterRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A test exposure: one that set an aperture, or a dark photo that looked for leaks."""

    raw: str
    """Path in the run folder."""
    f_number: RecordPositive
    peak: float | None
    """Its brightest sample, as a share of saturation; None for a dark photo."""


class DarkPhoto(msgspec.Struct, frozen=True, kw_only=True):
    """A dark photo as it was taken (`pdcd.planning.look`)."""

    raw: str
    """Path in the run folder."""
    sha256: Sha256
    iso: Annotated[int, Meta(ge=1)]
    f_number: RecordPositive
    exposure_s: RecordPositive
    phase_s: RecordPositive
    """How long it shows each of its two states."""


class BorderPhoto(DarkPhoto, frozen=True, kw_only=True):
    """A photo of the light along the borders of cells alone (`pdcd.planning.border_photo`)."""

    reach: tuple[NonNegative, NonNegative]
    """How far from borders pixels were open, in cells, along x and y."""
    inner: DarkPhoto
    """The same with the pixels lit next to those at borders: indirect light from nearby."""
    dark: DarkPhoto
    """The same with a black projector: what the room adds."""


Six = tuple[float, float, float, float, float, float]
"""An affine map of points (x, y): x' = a x + b y + c, y' = d x + e y + f."""


BENT_PLACES = 9
"""Places along either axis of the field at which a bend of the mask's picture is kept."""
_Pair = tuple[float, float]
BentPixels = Annotated[
    tuple[_Pair, ...], Meta(min_length=BENT_PLACES**2, max_length=BENT_PLACES**2)
]
"""Projector pixels right and down at the middles of 9 x 9 equal parts of the field, row by row."""


class PanelLook(msgspec.Struct, frozen=True, kw_only=True):
    """Where photos of random blocks showed both panels (`pdcd.pictures.misplaced`), in projector
    pixels of the field; None where they do not show it."""

    mask: Six | None
    """From where the mask is drawn to where it lies, in the projector's picture; `offset_px` of the
    mask is subtracted."""
    camera: Six | None
    """From where the camera is believed to look to where it does, in the projector's picture."""
    bent_px: BentPixels | None = None
    """By how much further right and down the mask's picture lies than by `mask`; None where it is
    not bent."""
    rest_px: NonNegative
    """Standard deviation of the residuals of this map at places of the mask, bend and noise taken
    out."""
    sigma_px: NonNegative = 0.0
    """Standard deviation of the mask's measured place, where it is least certain, estimated from
    patches of the photos."""
    blur_px: NonNegative = 0.0
    """Standard deviation of the blur of light on its way to the mask; 0 where the photos do not
    distinguish it from `blur_px` of the mask."""
    border_px: NonNegative = 0.0
    """Standard deviation of a blur, in addition to the known one, that would explain the lines
    along borders of cells in photos of codes (`pdcd.pictures.border_lines`); 0 where there are
    none."""
    direct: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Approximate share of direct light in the scene's light; 0 where the projector's blocks are
    not seen."""
    mask_seen: bool
    """Whether the mask's blocks were seen at all."""
    why: str = ""
    """Why the panels could not be checked, in words; empty where photos were taken."""

    @property
    def upright(self) -> bool:
        """Whether both panels were seen neither mirrored nor turned over."""
        return self.mask is not None and all(
            six is not None and six[0] > 0.0 and six[4] > 0.0 for six in (self.mask, self.camera)
        )


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that the answer depends on, in addition to the RAW files, codes and frame log."""

    goal: Goal
    how: CaptureScheme
    """As planned; a run that met its target earlier has fewer parts among its shots."""
    smooth: bool
    normalise: NormaliseName
    grid: tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]]
    cells: CellMap | None = None
    """Which cell each of the camera's quads sees; None where no photo was taken yet."""
    camera_place: Placing
    """Where the camera's frame lies on the field, for `cells`."""
    blur_quads: NonNegative = 0.0
    """Blur of the camera, for `cells`."""
    projector: PanelConfig
    mask: PanelConfig
    responsivity_e: Annotated[tuple[RecordPositive, ...], Meta(min_length=1, max_length=3)]
    """One number for each colour of the camera, 3 or 1; pictures have as many."""
    profile: SensorProfile
    shots: tuple[ShotRecord, ...]
    stops: tuple[Stop, ...] = ()
    """Stops of its photos: the run's own one, and those whose light was compared with it on the
    scene; sigma is that of the comparison. Without any, the engraved number stands for 2^(k/6)."""
    scale: AbsoluteScale | None = None
    """Basis of the absolute scale of its pictures."""
    white_patch: FieldPlace | None = None
    """For the previews; see `CaptureRequest`."""
    dark: DarkPhoto | None = None
    """The photo whose ambient light is subtracted from the photos of a pilot, which have no black
    exposures. None on a dark bench."""
    room: DarkPhoto | None = None
    """A photo before all shots. Its ambient light, and what a black projector leaks, are subtracted
    from all photos without black exposures; None where it was not taken."""
    panels: PanelLook | None = None
    """Where the panels were seen to lie; None where they were not checked."""
    borders: BorderPhoto | None = None
    """The photo that measures direct light along the borders of whole cells; None where there is no
    such light, or the photo could not be taken."""
    leak: NonNegative = 0.0
    """RMS error of the answer, relative to its RMS, by ambient light and leaks that a dark photo
    showed and that were not subtracted."""
    leaks_unseen: Literal["no", "declined", "missing"] = "no"
    """Whether there may be such light that nothing showed: black exposures without a dark photo
    were asked for ("declined"), or the dark photo could not be taken, or not yet ("missing")."""
    room_changed: NonNegative = 0.0
    """The same RMS error by the change of the room's light between dark photos before and after the
    shots."""
    grey_unknown: tuple[str, ...] = ()
    """Panels that showed grey levels whose light is not known."""
    times_known: bool = False
    """Whether a calibration measured when the panels switch, or a mock bench has them switch as
    configured."""


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """`capture.json`: written last, so its presence means that the run is whole."""

    schema: int
    job: str
    state: str
    mock: bool
    owner: dict[str, Any]
    started_utc: str
    finished_utc: str
    request: dict[str, Any]
    plan: dict[str, Any]
    run: RunRecord
    realised: dict[str, dict[str, float]]
    """Deviation of each photo's realised probing matrix from the wanted one."""
    summary: dict[str, SummaryValue]
    warnings: tuple[str, ...]
    versions: dict[str, str]
    git_commit: str | None
    exif: dict[str, dict[str, Any]]
    """What each shot's RAW file says."""
    drivers: dict[str, Any]
    config: dict[str, Any]
    meter: tuple[MeterRecord, ...]
    """Test exposures that set the aperture, and dark photos that looked for leaks."""
    files: dict[str, FileRecord]
    """Every other file of the folder, except the manifest's digest."""
    missing: tuple[str, ...] = ()
    """Shots that were planned and are not there, in a run whose `state` is "partial"."""
    not_kept: dict[str, FileRecord] | msgspec.UnsetType = msgspec.UNSET
    """RAW files that were not to be kept (`camera.keep`); unset where all were."""

    @property
    def unkept(self) -> dict[str, FileRecord]:
        """The same, empty where all were kept."""
        return {} if self.not_kept is msgspec.UNSET else self.not_kept

    def require_photos(self) -> None:
        """To be called before RAW files are read. Raises DecodeError where they were not kept."""
        if self.unkept:
            raise DecodeError(
                f"{len(self.unkept)} RAW files of this run were not kept",
                hint='capture again with --keep-raw all, or set camera.keep = "all"',
            )

    @property
    def quality(self) -> Quality:
        """The verdict on the run. Raises DecodeError where `summary` has none."""
        found = quality_of(self.summary)
        if found is None:
            raise DecodeError("the manifest has no verdict", hint="restore it from a copy")
        return found
