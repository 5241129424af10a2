"""What has been decided about a request: all that its shots depend on (`Goal`, `CaptureScheme`),
and the summary of its plan."""

from __future__ import annotations

import msgspec

from pdcd.protocol.request import Plane
from pdcd.words import BlackLevel, BlackLevelName, GoalName, KeepName, MethodName, ShownFamilyName


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


class CaptureScheme(msgspec.Struct, frozen=True, kw_only=True):
    """How a goal is photographed: with the goal, all that its shots and sums depend on.

    `family` is None where no codes are shown. The other fields are those of `CaptureRequest` with
    the same names, after the configuration and the planner have filled in what was left open.
    """

    codes: int = 128
    """All codes, including those of the pilot."""
    pilot: int = 0
    parts: int = 1
    repeat: int = 1
    method: MethodName = "coded"
    family: ShownFamilyName | None = "hadamard"
    black_level: BlackLevel = "none"
    white: bool = True
    buckets: int = 1
    """Planes of one exposure that are used: 2 for a pair where the sensor has two buckets."""
    grey_masks: bool = False
    """Whether masks of far light may have grey levels (`pdcd.codes.greyed`)."""
    late: bool = False
    """Whether codes had been shown before the pilot was continued. The shots of the codes that
    count then have names of their own (`pdcd.recipes.parts`)."""

    @property
    def coded(self) -> int:
        """Codes that are left for the coded photo."""
        return self.codes - self.pilot


class ShotSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One exposure of a plan, or `exposures` equal ones that differ in their code only.

    name : that of its photo. codes : code pairs that each exposure shows. refreshes, exposure_s :
    how long each one lasts, in refreshes of the panels and in seconds.
    """

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
    `confidence`. `prior` says what the scene was taken to be, `iso` at which speed of the camera.
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
    whole capture has `stopped_raw_files` files and takes `stopped_seconds`. `raw_files` and
    `seconds` are those of the pilot's photos; seconds are those of exposures.
    """

    raw_files: int
    seconds: float
    scouts: int
    stopped_codes: int
    stopped_raw_files: int
    stopped_seconds: float


class LeakErrors(msgspec.Struct, frozen=True, kw_only=True):
    """What a dark photo showed, as RMS errors of the answer relative to its RMS (docs/planning.md).

    `ambient`: light that is not the projector's, and what a black projector lets out; `mask`: what
    a closed mask lets through; `both` together. A part that was not told from the other is None.
    """

    ambient: float | None
    mask: float | None
    both: float
    floor: float
    """The smallest error that would have stood out from the sensor's noise; smaller ones are given
    as 0."""
    limit: float
    """If the error exceeds this, black exposures are added."""
    raw: tuple[str, ...]
    """The dark photos, in the run folder."""
    noise: float | None = None
    """Predicted RMS noise of the finished picture with its black exposures, relative to its RMS;
    None where it was not predicted."""
    times: int = 1
    """How many times everything is shown because of that noise; `noise` is what then remains."""
    changed: float = 0.0
    """Like `ambient`, for the change of that light since a dark photo before all shots; 0 where no
    such photo was taken."""


class PlanSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a capture would do, without doing it (`pdcd plan`, `capture.plan`).

    goal, family, codes, p : the goal; how its codes are made, how many there are, the pilot's among
    them, and the share of codes in which a cell is lit. grid : rows and columns of code cells.
    window : the part of a mask cell that opens. passes : how often all codes are shown.

    shots : the exposures, in order. refreshes, seconds, raw_files : sums over them. light_share :
    that of the coded photo, 0..1. pilot, pilot_cost : how many of the codes are photographed one by
    one first, and what that costs. prediction : the error to be expected, where it was asked for.
    """

    goal: str
    family: str
    codes: int
    p: float
    grid: tuple[int, int]
    window: str
    guards: bool
    """Whether there are black refreshes between codes; `schedule` says which."""
    schedule: str = "full"
    """A name of `pdcd.panels.schedule.SLOTS`, which has the refreshes of a code."""
    dark_s: float = 0.0
    """How long both panels are black after each refresh."""
    passes: int
    parts: int = 1
    """Exposures of each coded photo; with `until_error`, at most that many."""
    shots: tuple[ShotSummary, ...]
    refreshes: int
    seconds: float
    light_share: float
    raw_files: int
    pilot: int = 0
    pilot_cost: PilotCost | None = None
    prediction: Prediction | None = None
    prior: str | None = None
    """What guided the codes, in words."""
    reasons: tuple[str, ...] = ()
    """Reasons, a line each: for cells, window and schedule on a bench that was measured; for black
    exposures; and for parts where the program chose them."""
    split: tuple[str, ...] = ()
    """How the matrix of the goal "relit" is split: a line for each part, with its share of the
    squared weights and how it is photographed."""
    black_level: BlackLevelName = "none"
    """Black exposures; "auto": decided after a dark photo."""
    leaks: LeakErrors | None = None
    """The results of that photo."""
