"""The events of a job while it runs: one struct for each type of event. The structs are the schema.

::

    queued planning* started
        (learning | armed shutter_open progress* shutter_closed [discarded | converging])*
    decoding decoded* archived done

    At any place instead: failed | cancelled

The engine makes them and leaves the common fields at their defaults. The daemon numbers them, adds
the time, and sends them to its clients. log.jsonl of a run keeps all except `JobQueued`, the
thinned ones (`THINNED`) and `JobDone`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta

from pdcd.bench.calibration import FigureRecord
from pdcd.protocol.result import CaptureResult, SummaryValue
from pdcd.words import GoalName, VerdictName

EventCount = Annotated[int, Meta(ge=0)]
ShotName = Annotated[str, Meta(min_length=1, description="exposure, as its RAW file is called")]


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """What every event carries; filled in by the daemon.

    `seq` counts the events of one job from 0; a gap means that a thinned event was dropped for a
    slow client.
    """

    job: Annotated[str, Meta(description="name of the job")] = ""
    seq: Annotated[int, Meta(ge=0, description="number among the events of its job")] = 0
    t_mono_ns: Annotated[
        int, Meta(description="when it happened, ns of the clock that `hello` anchors")
    ] = 0

    @property
    def type(self) -> str:
        """Name of the event in messages."""
        return str(self.__struct_config__.tag)


class JobQueued(Event, frozen=True, kw_only=True, tag_field="type", tag="queued"):
    """Admitted; always the first."""

    ahead: Annotated[EventCount, Meta(description="jobs that wait before it")]


class PlanningProgress(Event, frozen=True, kw_only=True, tag_field="type", tag="planning"):
    """How far the plan is: codes are made, or candidates for a wanted error are looked at."""

    stage: Annotated[str, Meta(description="what is worked on, in words")]
    done: Annotated[float, Meta(ge=0.0, description="work done, in units of `total`")]
    total: Annotated[float, Meta(gt=0.0, description="all work known so far; it may grow")]


class JobStarted(Event, frozen=True, kw_only=True, tag_field="type", tag="started"):
    """The job has the rig."""

    goal: GoalName
    """What it photographs."""


class PilotLearning(Event, frozen=True, kw_only=True, tag_field="type", tag="learning"):
    """The photos of a pilot are looked at."""

    photos: Annotated[int, Meta(ge=1, description="how many there are so far")]


class ShotArmed(Event, frozen=True, kw_only=True, tag_field="type", tag="armed"):
    """Patterns are loaded, the camera is ready."""

    shot: ShotName
    frames: Annotated[EventCount, Meta(description="refreshes to be shown in one pass")]


class ShutterOpen(Event, frozen=True, kw_only=True, tag_field="type", tag="shutter_open"):
    """The shutter is open; both panels are black, unless the photo is to tell when it moves."""

    shot: ShotName


class Progress(Event, frozen=True, kw_only=True, tag_field="type", tag="progress"):
    """Codes are being shown."""

    shot: ShotName
    frame: Annotated[EventCount, Meta(description="refreshes shown")]
    frames: Annotated[EventCount, Meta(description="refreshes of the shot")]
    missed: Annotated[EventCount, Meta(description="refreshes that came late so far")]


class ShutterClosed(Event, frozen=True, kw_only=True, tag_field="type", tag="shutter_closed"):
    """The shutter is closed; both panels are black, unless the photo is to tell when it moves."""

    shot: ShotName


class ShotDiscarded(Event, frozen=True, kw_only=True, tag_field="type", tag="discarded"):
    """Codes got unequal light, its photo was lost, or the times of the exposure disagree: what
    there is of it is kept under another name, and it is taken again."""

    shot: ShotName
    name: Annotated[str, Meta(description="new name of the exposure")]
    cause: Annotated[str, Meta(description="in words")]


class PartCompleted(Event, frozen=True, kw_only=True, tag_field="type", tag="converging"):
    """With `until_error`: a part is complete, which leaves `rms_sigma`. `preview/running.png` is
    new."""

    part: Annotated[int, Meta(ge=1, description="parts taken so far")]
    rms_sigma: (
        Annotated[
            float, Meta(ge=0.0, description="RMS sigma over RMS image; null where no light is")
        ]
        | None
    )
    target: Annotated[float, Meta(gt=0.0, description="the RMS sigma over RMS image asked for")]


class Attention(Event, frozen=True, kw_only=True, tag_field="type", tag="attention"):
    """A calibration waits for somebody to do something, and say so (`calibrate.proceed`). `now` and
    `best` are the number that is to be made as large as it can be, where there is one."""

    text: Annotated[str, Meta(description="what is to be done, in one sentence")]
    now: (
        Annotated[float, Meta(description="the number to be made as large as it can be, as it is")]
        | None
    ) = None
    best: Annotated[float, Meta(description="the largest so far")] | None = None


class StepBegun(Event, frozen=True, kw_only=True, tag_field="type", tag="step_begun"):
    """A step of a calibration begins."""

    step: Annotated[str, Meta(description="name of the step")]
    number: Annotated[int, Meta(ge=1, description="its number among the steps of the job")]
    steps: Annotated[int, Meta(ge=1, description="how many steps the job has")]
    note: Annotated[str, Meta(description="what to know before it, where there is anything")] = ""


class StepEnded(Event, frozen=True, kw_only=True, tag_field="type", tag="step_ended"):
    """A step of a calibration is done: what it found.

    verdict : on the whole step. photos : how many it took. figures : what it measured. advice :
    what to do about figures that are not good, a sentence each.
    """

    step: str
    verdict: VerdictName
    photos: EventCount
    seconds: Annotated[float, Meta(ge=0.0, description="computing time")]
    figures: tuple[FigureRecord, ...]
    advice: tuple[str, ...]


class DecodingStarted(Event, frozen=True, kw_only=True, tag_field="type", tag="decoding"):
    """All shots are taken; pictures are made of them."""

    shots: Annotated[EventCount, Meta(description="how many there are")]


class DecodingProgress(Event, frozen=True, kw_only=True, tag_field="type", tag="decoded"):
    """How far the making of pictures is: at the end, after a part, or of a pilot."""

    done: Annotated[float, Meta(ge=0.0, description="work done, in units of `total`")]
    total: Annotated[
        float, Meta(gt=0.0, description="all work: about one unit for each refresh to look at")
    ]


class PicturesArchived(Event, frozen=True, kw_only=True, tag_field="type", tag="archived"):
    """The pictures are written; hashes, the manifest and the folder's final name follow."""


class _End(Event, frozen=True, kw_only=True):
    """The end of a job: always the last event, with the fields of `CaptureResult`."""

    folder: str | None = None
    manifest_sha256: str | None = None
    error: dict[str, str | None] | None = None
    files: tuple[str, ...] = ()
    summary: dict[str, SummaryValue] = {}
    warnings: tuple[str, ...] = ()


class JobDone(_End, frozen=True, kw_only=True, tag_field="type", tag="done"):
    """The run folder is complete; `state` is that of the job."""

    state: Literal["done"] = "done"


class JobFailed(_End, frozen=True, kw_only=True, tag_field="type", tag="failed"):
    """The job ended by an error; panels are black and the shutter is closed. `state` is the
    job's."""

    state: Literal["failed"] = "failed"


class JobCancelled(_End, frozen=True, kw_only=True, tag_field="type", tag="cancelled"):
    """The job was ended by somebody; panels are black and the shutter is closed. `state` is the
    job's."""

    state: Literal["cancelled"] = "cancelled"


KnownEvent = (
    JobQueued
    | PlanningProgress
    | JobStarted
    | PilotLearning
    | ShotArmed
    | ShutterOpen
    | Progress
    | ShutterClosed
    | ShotDiscarded
    | PartCompleted
    | StepBegun
    | Attention
    | StepEnded
    | DecodingStarted
    | DecodingProgress
    | PicturesArchived
    | JobDone
    | JobFailed
    | JobCancelled
)
"""Every event that this version sends, in the order in which a job may send them."""

TYPES: Mapping[str, type[Event]] = MappingProxyType(
    {str(kind.__struct_config__.tag): kind for kind in get_args(KnownEvent)}
)
"""The structs by the names of their types."""

THINNED = (PlanningProgress, Progress, DecodingProgress)
"""Events that come many times a second. Only the newest one matters, so that any may be left
out."""

ENDS = (JobDone, JobFailed, JobCancelled)
"""The last event of a job is one of these."""

COMMON_FIELDS = frozenset(Event.__struct_fields__)
"""Names of the fields that every event has."""

Emit = Callable[[Event], None]
"""Takes one event of the engine; must not block."""


class UnknownEvent(Event, frozen=True, kw_only=True):
    """An event of a type that this version does not know, as a newer daemon may send it."""

    tag: str
    """Name of its type."""
    fields: dict[str, Any]
    """All fields except the common ones, in JSON types."""

    @property
    def type(self) -> str:
        """Name of the event in messages."""
        return self.tag


def make_end_event(result: CaptureResult) -> JobDone | JobFailed | JobCancelled:
    """The last event of the job with that result. Raises KeyError while it has not ended."""
    kinds: dict[str, type[JobDone | JobFailed | JobCancelled]] = {
        "done": JobDone,
        "failed": JobFailed,
        "cancelled": JobCancelled,
    }
    return kinds[result.state](
        job=result.job,
        folder=result.folder,
        manifest_sha256=result.manifest_sha256,
        error=result.error,
        files=result.files,
        summary=result.summary,
        warnings=result.warnings,
    )


def decode_event(wire: Mapping[str, Any]) -> Event:
    """The struct for an event in JSON types. Unknown fields are ignored; an unknown type becomes
    `UnknownEvent`."""
    kind = TYPES.get(str(wire.get("type")))
    if kind is not None:
        return msgspec.convert(wire, kind)
    common = {name: wire[name] for name in COMMON_FIELDS if name in wire}
    rest = {k: v for k, v in wire.items() if k not in COMMON_FIELDS and k != "type"}
    return msgspec.convert({**common, "tag": str(wire.get("type")), "fields": rest}, UnknownEvent)


def pick_event_fields(event: Event) -> dict[str, Any]:
    """The fields of an event except the common ones, in JSON types."""
    if isinstance(event, UnknownEvent):
        return event.fields
    told: dict[str, Any] = msgspec.to_builtins(event)
    return {key: value for key, value in told.items() if key not in COMMON_FIELDS and key != "type"}


def encode_event(event: Event) -> dict[str, Any]:
    """The event in JSON types, as it is sent over the socket."""
    head = {"job": event.job, "seq": event.seq, "type": event.type, "t_mono_ns": event.t_mono_ns}
    return {**head, **pick_event_fields(event)}


def to_log_entry(event: Event, now_ns: int) -> dict[str, Any]:
    """The event as in log.jsonl: its time is that of the event, or `now_ns` where it has none."""
    head: dict[str, Any] = {"t_mono_ns": event.t_mono_ns or now_ns, "event": event.type}
    if event.job:
        head["job"] = event.job
    return {**head, **pick_event_fields(event)}
