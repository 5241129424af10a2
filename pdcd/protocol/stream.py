"""A stream: its request, and the description of each of its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from pdcd.protocol.about import describe_field
from pdcd.protocol.request import CaptureRequest

MOST_DRAWN_PX = 800
"""Longest side of a picture that is drawn for people: its JPEG is then far shorter than a line."""


class StreamRequest(CaptureRequest, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a stream takes, as `stream.start` and `pdcd stream` have it: the fields of a photo,
    whose `codes` and `exposure_s` are those of one photo of the stream, and three of its own.

    `parts` are photos of a set, 4 where nobody says: each photo takes the codes of the next part,
    and from the last one on it begins again (`pdcd.planning.stream_set`).
    """

    over: Annotated[
        int,
        Meta(ge=1, le=64),
        describe_field("how many of the newest photos make a picture", "run", "N"),
    ] = 1
    rate_hz: Annotated[
        Annotated[float, Meta(gt=0.0, le=1000.0)] | None,
        describe_field("pictures a second at most; default: 30", "run", "HZ", option="rate"),
    ] = None
    for_s: Annotated[
        Annotated[float, Meta(gt=0.0, le=1e9)] | None,
        describe_field("end after so many seconds of pictures; default: never", "run", "S"),
    ] = None


class PackedArray(msgspec.Struct, frozen=True):
    """Where an array lies in the memory whose descriptor comes with a message.

    dtype, shape : as of numpy. offset : of its first byte.
    """

    dtype: str
    shape: tuple[int, ...]
    offset: int


class StreamFrame(msgspec.Struct, frozen=True, kw_only=True):
    """A picture of a stream, or a photo that was spoilt, which has no picture."""

    number: Annotated[int, Meta(ge=1, description="counts the pictures and spoilt photos")]
    t_mono_ns: Annotated[int, Meta(description="when it was there, as event times are")]
    goal: str
    """Which light the stream keeps."""
    spoilt: Annotated[str, Meta(description="why there is no picture; empty where there is")] = ""
    lost: Annotated[int, Meta(ge=0, description="photos of the stream spoilt so far")] = 0
    rate_hz: Annotated[float, Meta(ge=0.0, description="pictures a second, lately")] = 0.0
    latency_s: Annotated[
        float, Meta(description="from the end of the exposure until the picture was there")
    ] = 0.0
    part: Annotated[int, Meta(ge=0, description="part of the set that was photographed")] = 0
    over: Annotated[int, Meta(ge=0, description="photos that the picture is made of")] = 0
    late: Annotated[int, Meta(ge=0, description="refreshes that came late, without harm")] = 0
    rms_sigma: Annotated[
        float | None, Meta(description="RMS of the standard deviation over that of the picture")
    ] = None
    sigma_kind: Annotated[
        str, Meta(description='"measured" by the newest photos, or "sensor": without the codes')
    ] = "sensor"
    unknown: Annotated[float, Meta(description="share of the pixels of which nothing is known")] = (
        0.0
    )
    size_px: tuple[int, int] = (0, 0)
    """Width and height of `jpeg`."""
    jpeg: bytes = b""
    """The picture for people; empty where it was not asked for, or is not drawn yet."""
    arrays: dict[str, PackedArray] = {}
    """The picture in numbers: arrays in the memory that comes with the answer, where they were
    asked for."""


@dataclass(frozen=True, eq=False)
class StreamedPicture:
    """A picture of a stream: its description, and its numbers, which a spoilt photo does not have.

    frame : its figures.
    arrays : "image" and "sigma", (rows, cols, C), means over cells and their standard deviation, as
        `pdcd.api.run.Run` has them; "picture" and "picture_sigma", (h, w, C), of the camera's
        quads.
    """

    frame: StreamFrame
    arrays: Mapping[str, NDArray[np.floating]] = field(default_factory=dict)

    @property
    def number(self) -> int:
        """The number of its frame."""
        return self.frame.number


def to_stream_request(request: CaptureRequest, **own: Any) -> StreamRequest:
    """A request for a photo, converted to one for a stream with the fields that only a stream
    has."""
    same = {name: getattr(request, name) for name in CaptureRequest.__struct_fields__}
    return StreamRequest(**{**same, **own})
