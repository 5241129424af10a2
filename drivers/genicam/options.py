"""[camera.options] and [trigger.options] of the `genicam` drivers."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from pdcd.driver import Config, merge_camera_options, read_options

GENICAM_DRIVERS = ("genicam", "virtual-genicam")
"""Drivers that have these options."""

_Line = Annotated[str, Meta(min_length=1)]
ExposureName = Literal["timed", "width", "edge"]


class GenicamOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which camera, and how it is used; all may be left out where there is one camera."""

    camera: str | None = None
    """Its address on the network, its serial number, or the name that `pdcd doctor camera` lists;
    None: the only one that is found."""
    exposure: ExposureName = "timed"
    """What begins and ends an exposure. "timed": a command begins it, the camera's clock ends it;
    "width": it lasts while the shutter's driver holds a line; "edge": an edge of that line begins
    it, the camera's clock ends it."""
    line: _Line = "Line1"
    """The camera's input for "width" and "edge"."""
    active_low: bool = False
    """Whether the camera exposes while that line is low, or from its falling edge on."""
    margin_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.1
    margin: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.1
    """How much longer than planned a timed exposure is, for panels that are late: this many
    seconds, plus this share of it. Panels are black meanwhile."""
    unplanned_s: Annotated[float, Meta(gt=0.0, le=600.0)] = 1.0
    """Length of a timed exposure whose length was not given."""
    pixel_format: str | None = None
    """Name of the pixel format in the camera; None: the best known one."""
    region: tuple[int, int, int, int] | None = None
    """Left, top, width and height of the picture in pixels of the sensor; None: all of it."""
    black_level: float | None = None
    """Value for the camera's `BlackLevel`; None: left as it is."""
    black_dn: Annotated[int, Meta(ge=0, le=65535)] | None = None
    """Level without light; None: measured by the shortest exposure, once for each ISO."""
    white_dn: Annotated[int, Meta(ge=1, le=65535)] | None = None
    """Level from which a sample is saturated; None: as the camera reports, by the number of bits,
    or as seen."""
    packet_bytes: Annotated[int, Meta(ge=576, le=16000)] | None = None
    """Packet size of a camera on the network; None: as large as the network allows."""
    resend: bool = True
    """Ask a camera on the network again for packets that did not come."""
    pulses: tuple[_Line, _Line] | None = None
    """Inputs that TRIG_OUT_2 of the projector's and of the mask's DMD are wired to, such as
    "Line3". The camera counts their pulses, which proves that every code was shown. None: nothing
    is counted."""
    wait_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 5.0
    """How long a frame may take to come after the end of its exposure."""


def read_genicam_options(config: Config) -> GenicamOptions:
    """The options of this rig's one camera, as `drivers.ptp.options` reads those of another.

    It is enough to give them in one of the two tables. Raises ConfigError if they are wrong or
    disagree.
    """
    merged, table = merge_camera_options(config, GENICAM_DRIVERS)
    return read_options(
        merged,
        GenicamOptions,
        table=table,
        device="camera",
        hint="docs/genicam.md lists the options of the driver genicam",
    )
