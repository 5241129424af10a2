"""What a user asks for and what comes back: the types that every floor speaks.

They are plain values, so that the socket, the command line, the run folder and
Python callers share one definition and one JSON Schema.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Literal, TypeGuard, get_args

import msgspec
from msgspec import UNSET, Meta, UnsetType

from pdcd.protocol.labels import MOST_TAGS, Label, Note, Tag
from pdcd.words import (
    BlackLevel,
    BlackLevelName,
    FamilyName,
    GoalName,
    GuardsName,
    JobState,
    KeepName,
    MarksName,
    MethodName,
    NormaliseName,
    StepName,
    SubjectName,
    VerdictName,
    WindowName,
)

Name = Annotated[str, Meta(max_length=4096)]


class Sent(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """An array that comes as the content of a file: by descriptor, or within the line.

    A client gives `fd` or `npy`, and may give `file`. In the manifest, `file` and `sha256` say what
    was given.
    """

    fd: Annotated[int, Meta(ge=0, le=63)] | None = None
    """Which of the descriptors that came with the line, from 0."""
    npy: str | None = None
    """Base64 of a .npy, .npz or PNG file."""
    file: Annotated[str, Meta(max_length=255)] | None = None
    """What the client calls the file, for people: nothing is opened by it."""
    sha256: str | None = None
    """Of the content; written by whoever has read it."""


Rows = tuple[tuple[float, ...], ...]
Table = Name | Sent | Rows
"""Rows of numbers; the content of a file; or a name below the daemon's folder of arrays."""

ARRAYS = (
    "illumination", "warp", "warp_b", "region_a", "region_b", "disparities", "kernel", "matrix",
)  # fmt: skip
"""Fields of a request that are arrays; `prior` may be one."""


def in_words(prior: object) -> TypeGuard[str]:
    """Whether a prior is said in words, and is no array or name of a file."""
    return isinstance(prior, str) and prior.startswith(("scene:", "decay:"))


MOST_CELLS = 65536
"""No panel has more pixels along a side; what the rig's own grid allows is less
(`pdcd.recipes.bounds`)."""
Step = Annotated[int, Meta(ge=-MOST_CELLS, le=MOST_CELLS)]
Weight = Annotated[float, Meta(ge=-1e6, le=1e6)]
Unit = Annotated[float, Meta(ge=0.0, le=1.0)]
Entry = Annotated[float, Meta(ge=-1e6, le=1e6)]
Plane = tuple[Entry, Entry, Entry, Entry, Entry, Entry, Entry, Entry, Entry]
Place = tuple[Unit, Unit]
"""(x, y) on the field, from its upper left corner (`pdcd.panels.map`)."""


class CaptureRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One wanted photo, as `capture.start` and `pdcd capture` take it.

    `goal` names what to keep of the light transport; the fields from `p` to `matrix` are the
    parameters of goals, each of which takes its own (see `pdcd.recipes.goals`). `codes` is the
    number of independent primal/dual pairs. `exposure_s` asks for a total coded time; the codes are
    then shown in as many whole passes as fit. Fields left out (None) take the value of the rig's
    configuration.
    """

    goal: GoalName
    codes: Annotated[int, Meta(ge=1, le=65536)] | None = None
    family: FamilyName | None = None
    p: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None
    shift: tuple[Step, Step] | None = None
    """Cells down and right from each camera cell to its projector cell."""
    equal_brightness: bool = False
    """Take as many times more codes as p is smaller than 1/2, so that light of the matched cell is
    as bright in photos of any p (Fig. 8 of the paper)."""
    radius: Annotated[int, Meta(ge=0, le=MOST_CELLS)] | None = None
    mix: tuple[Weight, Weight] | None = None
    """Weights of `warp` and `warp_b`."""
    period: Annotated[int, Meta(ge=4, le=MOST_CELLS, multiple_of=4)] | None = None
    """Cells from one stripe of the goal "split" to the next."""
    disparity: tuple[Step, Step] | None = None
    """Off-axis benches: lowest and highest disparity of the goals "keyed" and "stereo", in cells to
    the right from where the camera sees a point to the projector cell that lights it; None: 0."""
    plane: Plane | None = None
    """Off-axis benches: homography from the camera's field to the projector's, row by row, of the
    plane that disparities count from; None: the rig's."""
    keep: KeepName | None = None
    """Of the goal "epipolar": paths within rows of cells ("in", the default), or all others."""
    rows: tuple[Step, Step] | None = None
    """Of the goal "transport": row of projector cells, and row of camera cells; None: all."""
    masked: bool | None = None
    """Of the goal "transport": the mask opens the row of camera cells only, instead of all."""
    illumination: Table | None = None
    disparities: Table | None = None
    """Off-axis benches: disparity of each camera cell, from which those of `disparity` count."""
    warp: Table | None = None
    warp_b: Table | None = None
    region_a: Table | None = None
    region_b: Table | None = None
    kernel: Table | None = None
    matrix: Table | None = None
    method: MethodName = "coded"
    """How: one coded photo; a pair of them, with the mask's codes and with their complement; many
    photos through an open mask, masked in software; or the separation by shifted checkers (Nayar et
    al. 2006). The last two are there to compare with."""
    pilot: Annotated[int, Meta(ge=0, le=4096)] | Literal["auto"] | None = None
    """Of the `codes`, how many to spend first on single photos through an open mask, to learn
    which far cells are linked: 8, 12 or 16 for the map of a mirror, or a power of two from 32 for
    single paths. Each is one more RAW file. Where the first few see no sharp paths the pilot stops,
    and the coded photo gets its other codes. All `codes`: no coded photo, the answer is theirs.
    "auto": a short one where its first photos are worth their files. None: "auto" where nothing is
    asked for that says how codes are to be spent (`pdcd.planning.unasked`), else 0."""
    parts: Annotated[int, Meta(ge=1, le=64)] | Literal["auto"] | None = None
    """Exposures to split a coded photo into, each with codes of its own: K / parts codes each.
    From 4 parts on their spread measures the error of the codes. "auto": as many as are worth their
    RAW files. None: "auto" for goals of coded photos where nothing is asked for that says how
    codes are to be spent (`pdcd.planning.unasked`), else 1."""
    until_error: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None
    """Take no more parts when RMS sigma over RMS image is as low as that."""
    repeat: Annotated[int, Meta(ge=1, le=1024)] = 1
    """Equal exposures to add up for the answer: less sensor noise, the same error of the codes."""
    error: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None
    """Wanted RMS error relative to the RMS of the picture; codes and exposures then follow."""
    confidence: Annotated[float, Meta(ge=0.5, lt=1.0)] | None = None
    """With which probability `error` is to be kept; None: 0.95."""
    seconds: Annotated[float, Meta(gt=0.0, le=86400.0)] | None = None
    """Total time of all exposures, from which codes and exposures follow instead; at most a day."""
    prior: Name | Sent | None = None
    """What the scene is like, to guide the codes and foresee errors by: "scene:" and the name of a
    preset, "decay:" and a distance in cells, or a transport matrix, given as other arrays are."""
    smooth: bool | None = None
    """Correct photos of indirect and of far light for what their codes get wrong of smoothly spread
    light, by a model that the photo itself gives. None: with the family hadamard; others show what
    they are."""
    grey_masks: bool | None = None
    """Let masks of far light have grey levels, which count it more evenly, for less light. None:
    where the panel can show them and it is known what light they give."""
    seed: Annotated[int, Meta(ge=0, lt=2**53)] = 0
    exposure_s: Annotated[float, Meta(gt=0.0, le=3600.0)] | None = None
    window: WindowName | None = None
    guards: bool | GuardsName | None = None
    """Which black refreshes keep a code apart from the next; "auto" by the measured lag."""
    black_level: BlackLevelName | None = None
    """Black exposures to take and subtract; "auto": those that a dark photo calls for."""
    normalise: NormaliseName | None = None
    """What a photo is divided by: one number, a weight for each cell, or as it needs."""
    white: bool = True
    """Take a white shot beside an indirect one, so that the run shows white, direct, indirect."""
    white_patch: Place | None = None
    """Where on the field something white lies, to balance the previews by; None: by what is bright
    and nearly neutral in the white photo."""
    out: str | None = None
    """Folder the run folder is made in; below the state folder when asked for over the socket."""
    name: Label | None = None
    """What people call the run; it needs not be unique."""
    tags: Annotated[tuple[Tag, ...], Meta(max_length=MOST_TAGS)] = ()
    """Words to find the run by."""
    note: Note = ""


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """What to keep of the light transport: a name and its numbers; arrays are kept beside it.

    The fields are those of `CaptureRequest` with the same names. `pdcd.recipes.goals` says which
    goal takes which.
    """

    name: GoalName
    p: float | None = None
    shift: tuple[int, int] | None = None
    radius: int | None = None
    mix: tuple[float, float] | None = None
    period: int | None = None
    disparity: tuple[int, int] | None = None
    plane: Plane | None = None
    keep: KeepName | None = None
    rows: tuple[int, int] | None = None
    masked: bool | None = None


class How(msgspec.Struct, frozen=True, kw_only=True):
    """How a goal is photographed: with the goal, all that its shots and sums depend on.

    `family` is None where no codes are shown. The other fields are those of `CaptureRequest` with
    the same names, after the configuration and the planner have filled in what was left open.
    """

    codes: int = 128
    """All codes, the pilot's among them."""
    pilot: int = 0
    parts: int = 1
    repeat: int = 1
    method: MethodName = "coded"
    family: FamilyName | None = "hadamard"
    black_level: BlackLevel = "none"
    white: bool = True
    buckets: int = 1
    """Planes of one exposure that are used: of a pair, 2 where the sensor has two buckets."""
    grey_masks: bool = False
    """Whether masks of far light may have grey levels (`pdcd.codes.greyed`)."""
    woven: bool = False
    """Whether codes of far light may have them, too, and are chosen together with the masks
    (`pdcd.codes.woven`)."""
    late: bool = False
    """Whether codes had been shown before the pilot went on: the shots of codes that count have
    names of their own (`pdcd.recipes.parts`)."""

    @property
    def coded(self) -> int:
        """Codes that are left for the coded photo."""
        return self.codes - self.pilot


class ShotSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One exposure of a plan, or `exposures` equal ones that differ in their code only."""

    name: str
    exposures: int = 1
    codes: int
    refreshes: int
    exposure_s: float
    light_share: float
    """Mean share of a floodlit exposure's light that an off-diagonal path keeps, 0..1."""


class Prediction(msgspec.Struct, frozen=True, kw_only=True):
    """RMS errors to be expected of a plan's answer, relative to the RMS of the true picture.

    `code` and `sensor` add up in squares to `error`; `bound` is kept with the probability
    `confidence`. `prior` says what the scene was taken to be.
    """

    error: float
    code: float
    sensor: float
    bound: float
    confidence: float
    iso: int
    prior: str


class PilotCost(msgspec.Struct, frozen=True, kw_only=True):
    """What the photos of a pilot cost, and what is saved if its first ones see no sharp paths.

    After `scouts` photos it may stop; the coded photo then gets `stopped_codes` codes, and the
    whole capture has `stopped_raw_files` files and takes `stopped_seconds`. The seconds are those
    of exposures.
    """

    raw_files: int
    seconds: float
    scouts: int
    stopped_codes: int
    stopped_raw_files: int
    stopped_seconds: float


class Leaks(msgspec.Struct, frozen=True, kw_only=True):
    """What a dark photo showed, as RMS errors of the answer relative to its RMS (docs/leaks.md).

    `ambient`: light that is not the projector's, and what a black projector lets out; `mask`: what
    a closed mask lets through; `both` together. A part that was not told from the other is None.
    """

    ambient: float | None
    mask: float | None
    both: float
    floor: float
    """The least error that would have been told from the sensor's noise; below it they are 0."""
    limit: float
    """Beyond it black exposures are added."""
    raw: tuple[str, ...]
    """The dark photos, in the run folder."""
    noise: float | None = None
    """RMS noise of the finished picture, relative to its RMS, that was foreseen with its black
    exposures; None where nobody looked."""
    times: int = 1
    """How often everything is shown because of that noise; `noise` is what is left then."""


class PlanSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a capture would do, without doing it (`pdcd plan`, `capture.plan`)."""

    goal: str
    family: str
    codes: int
    p: float
    grid: tuple[int, int]
    window: str
    guards: bool
    """Whether there are black refreshes between codes; `schedule` says which."""
    schedule: str = "full"
    """"none", "both", "lag", "lead", "tail" or "full": 1, 2, 2, 2, 3 or 3 refreshes a code."""
    passes: int
    parts: int = 1
    """Exposures of each coded photo; with `until_error`, at most."""
    shots: tuple[ShotSummary, ...]
    refreshes: int
    seconds: float
    light_share: float
    raw_files: int
    memory_bytes: int = 0
    """Foreseen peak of planning, taking and decoding, beside the program itself and the scene."""
    pilot: int = 0
    pilot_cost: PilotCost | None = None
    prediction: Prediction | None = None
    prior: str | None = None
    """What guided the codes, in words."""
    reasons: tuple[str, ...] = ()
    """Why cells, window and schedule are what they are, a line each, on a bench that was measured;
    what black exposures go by; and parts where they were left to the program."""
    split: tuple[str, ...] = ()
    """How the matrix of the goal "relit" is taken apart: a line a part, with its share of the
    squared weights and how it is photographed."""
    black_level: BlackLevelName = "none"
    """Black exposures; "auto": decided once a dark photo was taken."""
    leaks: Leaks | None = None
    """What that photo showed."""


class Quality(msgspec.Struct, frozen=True, kw_only=True):
    """The verdict on a run (docs/quality.md): each reason is a plain sentence with its figure, its
    limit and what to do. A good run has none; `remarks` leave it good."""

    verdict: VerdictName
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


Figure = float | int | str | Quality | None
"""What the summary of a run holds."""


def quality_of(summary: Mapping[str, Figure]) -> Quality | None:
    """The verdict in the summary of a run; None where it came to no picture."""
    found = summary.get("quality")
    return found if isinstance(found, Quality) else None


def figure_of(summary: Mapping[str, Figure], name: str) -> float | int | str | None:
    """A number or a word of the summary of a run; None for what is not known, and the verdict."""
    found = summary.get(name)
    return None if isinstance(found, Quality) else found


class CaptureResult(msgspec.Struct, frozen=True, kw_only=True):
    """The end of a job: what `capture.wait` returns and `pdcd capture --json` prints last."""

    job: str
    state: JobState
    folder: str | None = None
    manifest_sha256: str | None = None
    error: dict[str, str | None] | None = None
    """`kind`, `message`, `device`, `hint` of the failure, when `state` is failed or cancelled."""
    files: tuple[str, ...] = ()
    """Paths kept, relative to `folder` (of the unfinished folder when the job did not finish)."""
    summary: dict[str, Figure] = {}
    """codes, refreshes, exposure_s, missed_refreshes, rms_error, wall_s ... for the table; and
    `quality`, the verdict."""
    warnings: tuple[str, ...] = ()
    """What the user must know of the run, one line each; the manifest has all of them."""
    passed: bool | UnsetType = UNSET
    """Of a calibration: whether it came to its end and nothing is bad, so that it is in use."""


class CalibrateRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a bench is to measure of itself.

    steps : none is all of a whole calibration. attended : whether somebody is there to put a card
        before the camera and say so; else it begins at once. subject : what is before the camera.
        marks : what the geometry shows; "auto" is dots on a card, and on a scene stripes.
    """

    # Everybody is told them for as long as the job is known, so they are no more than there are.
    steps: Annotated[tuple[StepName, ...], Meta(max_length=len(get_args(StepName)))] = ()
    attended: bool = False
    subject: SubjectName = "card"
    marks: MarksName = "auto"


def new_job_id() -> str:
    """Name of a new job: UTC time to the second and four random hex digits."""
    return f"{job_time(datetime.now(UTC))}-{secrets.token_hex(2)}"


def job_time(moment: datetime) -> str:
    """What the names of jobs of a moment begin with; they sort by time."""
    return f"{moment.astimezone(UTC):%Y%m%dT%H%M%SZ}"
