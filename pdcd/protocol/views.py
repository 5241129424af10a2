"""Who sent a request, and what a rig reports about itself: answers of the socket that run folders
keep, too."""

from __future__ import annotations

import enum
from typing import Annotated

import msgspec
from msgspec import Meta

from pdcd.bench.devices import DisplayInfo


class OwnerView(msgspec.Struct, frozen=True, kw_only=True):
    """Who started a job, as the kernel vouches for it (SO_PEERCRED): `uid`, `pid`, and the name of
    the user."""

    uid: int
    pid: int
    user: str


class DriverView(msgspec.Struct, frozen=True, kw_only=True):
    """A driver in use: its `name`, and its `maturity`, how far it can be trusted: broken,
    experimental, beta or stable."""

    name: str
    maturity: str


class CameraView(msgspec.Struct, frozen=True, kw_only=True):
    """The camera as found (`pdcd.bench.devices.CameraInfo`): `model` and `serial` as it says them,
    `profile` of its sensor, and the `isos` and `f_numbers` that can be set."""

    model: str
    serial: str
    profile: str
    responsivity_e: tuple[float, ...]
    """Electrons per scene unit per second for R, G, B, or for grey, at f/1."""
    isos: tuple[int, ...]
    f_numbers: tuple[float, ...]


class RigView(msgspec.Struct, frozen=True, kw_only=True):
    """The bench as found; a device that is not open is null.

    name : as the configuration has it. display, camera : what their drivers found. scene : the
    virtual one, else null.
    """

    name: str
    mock: bool
    """Whether the photos come from a virtual scene."""
    grid: tuple[int, int]
    """Rows and columns of code cells."""
    drivers: dict[str, DriverView]
    """By role: display, shutter, readout."""
    display: DisplayInfo | None = None
    shutter: dict[str, str] = {}
    """Identity strings from its driver."""
    camera: CameraView | None = None
    scene: str | None = None


class PreviewView(msgspec.Struct, frozen=True, kw_only=True):
    """A quick photo on the daemon's disk: its `path`, and the `sha256` of that file."""

    path: str
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    shape: tuple[int, int, int]
    """Rows, columns, channels."""


class LiveFrame(msgspec.Struct, frozen=True, kw_only=True):
    """A picture of a live view, and what it tells; figures are of linear light, over the field
    where its place is known, else over all of the picture."""

    number: Annotated[int, Meta(ge=1, description="counts the pictures of the job")]
    t_mono_ns: Annotated[int, Meta(description="when the camera had given it, as event times are")]
    rate_hz: Annotated[float, Meta(ge=0.0, description="pictures a second, lately")]
    focus: Annotated[float, Meta(ge=0.0, description="depth of the finest detail, over the mean")]
    best: Annotated[float, Meta(ge=0.0, description="the deepest so far")]
    mean: Annotated[float, Meta(ge=0.0, le=1.0, description="mean light, as a share of white")]
    saturated: Annotated[float, Meta(ge=0.0, le=1.0, description="share of pixels that are white")]
    outline: tuple[tuple[float, float], ...] = ()
    """Edge of the field, 0..1 right and down; empty where the camera's place is not known."""
    size_px: tuple[int, int]
    """Width and height of `jpeg`."""
    jpeg: bytes = b""
    """The picture; empty where it was not asked for."""


class ClientRole(enum.IntEnum):
    """What a client may do; each role includes the ones below it."""

    LOOK = 1
    """See the rig, its jobs and their events."""
    SHOOT = 2
    """Take photos, and cancel jobs of the same user."""
    ADMINISTER = 3
    """Cancel everybody's jobs."""
