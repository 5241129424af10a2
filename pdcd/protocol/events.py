"""What a job tells while it runs: one struct for each type of event, and they are the schema.

::

    queued planning* started
        (learning | armed shutter_open progress* shutter_closed [discarded | converging])*
    decoding decoded* archived done

    At any place instead: failed | cancelled

The engine makes them and leaves the common fields at their defaults; the daemon numbers them, says
when they happened, and sends them to its clients. log.jsonl of a run keeps all but `Queued`, the
thinned ones (`THINNED`) and `Done`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta

from pdcd.bench.calibration import FigureRecord
from pdcd.protocol.result import CaptureResult, Figure
from pdcd.words import GoalName, VerdictName

Count = Annotated[int, Meta(ge=0)]
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
        """Name of the event, as the wire has it."""
        return str(self.__struct_config__.tag)


class Queued(Event, frozen=True, kw_only=True, tag_field="type", tag="queued"):
    """Admitted; always the first."""

    ahead: Annotated[Count, Meta(description="jobs that wait before it")]


class Planning(Event, frozen=True, kw_only=True, tag_field="type", tag="planning"):
    """How far the plan is: codes are made, or candidates for a wanted error are looked at."""

    stage: Annotated[str, Meta(description="what is worked on, in words")]
    done: Annotated[float, Meta(ge=0.0, description="work done, in units of `total`")]
    total: Annotated[float, Meta(gt=0.0, description="all work known so far; it may grow")]


class Started(Event, frozen=True, kw_only=True, tag_field="type", tag="started"):
    """The job has the rig."""

    goal: GoalName


class Learning(Event, frozen=True, kw_only=True, tag_field="type", tag="learning"):
    """The photos of a pilot are looked at."""

    photos: Annotated[int, Meta(ge=1, description="how many there are so far")]


class Armed(Event, frozen=True, kw_only=True, tag_field="type", tag="armed"):
    """Patterns are loaded, the camera is ready."""

    shot: ShotName
    frames: Annotated[Count, Meta(description="refreshes to be shown in one pass")]


class ShutterOpen(Event, frozen=True, kw_only=True, tag_field="type", tag="shutter_open"):
    """The shutter is open; both panels are black, unless the photo is to tell when it moves."""

    shot: ShotName


class Progress(Event, frozen=True, kw_only=True, tag_field="type", tag="progress"):
    """Codes are being shown."""

    shot: ShotName
    frame: Annotated[Count, Meta(description="refreshes shown")]
    frames: Annotated[Count, Meta(description="refreshes of the shot")]
    missed: Annotated[Count, Meta(description="refreshes that came late so far")]


class ShutterClosed(Event, frozen=True, kw_only=True, tag_field="type", tag="shutter_closed"):
    """The shutter is closed; both panels are black, unless the photo is to tell when it moves."""

    shot: ShotName


class Discarded(Event, frozen=True, kw_only=True, tag_field="type", tag="discarded"):
    """Codes got unequal light, or the times of the exposure disagree: it is kept under another name
    and taken again."""

    shot: ShotName
    name: Annotated[str, Meta(description="new name of the exposure")]
    cause: Annotated[str, Meta(description="in words")]


class Converging(Event, frozen=True, kw_only=True, tag_field="type", tag="converging"):
    """With `until_error`: a part is complete. `preview/running.png` is new."""

    part: Annotated[int, Meta(ge=1, description="parts taken so far")]
    rms_sigma: (
        Annotated[
            float, Meta(ge=0.0, description="RMS sigma over RMS image; null where no light is")
        ]
        | None
    )
    target: Annotated[float, Meta(gt=0.0, description="the RMS sigma over RMS image asked for")]


class Attention(Event, frozen=True, kw_only=True, tag_field="type", tag="attention"):
    """A calibration waits for somebody to do something, and say so (`calibrate.proceed`)."""

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
    """A step of a calibration is done: what it found."""

    step: str
    verdict: VerdictName
    photos: Count
    seconds: Annotated[float, Meta(ge=0.0, description="computing time")]
    figures: tuple[FigureRecord, ...]
    advice: tuple[str, ...]


class Decoding(Event, frozen=True, kw_only=True, tag_field="type", tag="decoding"):
    """All shots are taken; pictures are made of them."""

    shots: Annotated[Count, Meta(description="how many there are")]


class Decoded(Event, frozen=True, kw_only=True, tag_field="type", tag="decoded"):
    """How far the making of pictures is: at the end, after a part, or of a pilot."""

    done: Annotated[float, Meta(ge=0.0, description="work done, in units of `total`")]
    total: Annotated[
        float, Meta(gt=0.0, description="all work: about one unit for each refresh to look at")
    ]


class Archived(Event, frozen=True, kw_only=True, tag_field="type", tag="archived"):
    """The pictures are written; hashes, the manifest and the folder's final name follow."""


class _End(Event, frozen=True, kw_only=True):
    """The end of a job: always the last event, with the fields of `CaptureResult`."""

    folder: str | None = None
    manifest_sha256: str | None = None
    error: dict[str, str | None] | None = None
    files: tuple[str, ...] = ()
    summary: dict[str, Figure] = {}
    warnings: tuple[str, ...] = ()


class Done(_End, frozen=True, kw_only=True, tag_field="type", tag="done"):
    """The run folder is complete."""

    state: Literal["done"] = "done"


class Failed(_End, frozen=True, kw_only=True, tag_field="type", tag="failed"):
    """The job ended by an error; panels are black and the shutter is closed."""

    state: Literal["failed"] = "failed"


class Cancelled(_End, frozen=True, kw_only=True, tag_field="type", tag="cancelled"):
    """The job was ended by somebody; panels are black and the shutter is closed."""

    state: Literal["cancelled"] = "cancelled"


Known = (
    Queued
    | Planning
    | Started
    | Learning
    | Armed
    | ShutterOpen
    | Progress
    | ShutterClosed
    | Discarded
    | Converging
    | StepBegun
    | Attention
    | StepEnded
    | Decoding
    | Decoded
    | Archived
    | Done
    | Failed
    | Cancelled
)
"""Every event that this version sends, in the order in which a job may tell them."""

TYPES: Mapping[str, type[Event]] = MappingProxyType(
    {str(kind.__struct_config__.tag): kind for kind in get_args(Known)}
)
"""The structs by the name of their type."""

THINNED = (Planning, Progress, Decoded)
"""Come many times a second; of those the newest counts, so that any may be left out."""

ENDS = (Done, Failed, Cancelled)
"""The last event of a job is one of these."""

COMMON = frozenset(Event.__struct_fields__)

Emit = Callable[[Event], None]
"""Takes one event of the engine; must not block."""


class Unknown(Event, frozen=True, kw_only=True):
    """An event of a type that this version does not know, as a newer daemon may send it."""

    tag: str
    fields: dict[str, Any]
    """All beside the common ones, in JSON types."""

    @property
    def type(self) -> str:
        """Name of the event, as the wire has it."""
        return self.tag


def end_of(result: CaptureResult) -> Done | Failed | Cancelled:
    """The last event of the job with that result. Raises KeyError while it has not ended."""
    kinds: dict[str, type[Done | Failed | Cancelled]] = {
        "done": Done,
        "failed": Failed,
        "cancelled": Cancelled,
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


def read(wire: Mapping[str, Any]) -> Event:
    """The event in JSON types as a struct; unknown fields are ignored, unknown types `Unknown`."""
    kind = TYPES.get(str(wire.get("type")))
    if kind is not None:
        return msgspec.convert(wire, kind)
    common = {name: wire[name] for name in COMMON if name in wire}
    rest = {k: v for k, v in wire.items() if k not in COMMON and k != "type"}
    return msgspec.convert({**common, "tag": str(wire.get("type")), "fields": rest}, Unknown)


def fields(event: Event) -> dict[str, Any]:
    """What an event says beside the common fields, in JSON types."""
    if isinstance(event, Unknown):
        return event.fields
    told: dict[str, Any] = msgspec.to_builtins(event)
    return {key: value for key, value in told.items() if key not in COMMON and key != "type"}


def wire(event: Event) -> dict[str, Any]:
    """The event in JSON types, as it goes over the socket."""
    head = {"job": event.job, "seq": event.seq, "type": event.type, "t_mono_ns": event.t_mono_ns}
    return {**head, **fields(event)}


def logged(event: Event, now_ns: int) -> dict[str, Any]:
    """The event as log.jsonl has it: the time is what the event says, else `now_ns`."""
    head: dict[str, Any] = {"t_mono_ns": event.t_mono_ns or now_ns, "event": event.type}
    if event.job:
        head["job"] = event.job
    return {**head, **fields(event)}
