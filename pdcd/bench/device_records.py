"""What crosses between a bench and its drivers: what devices are, settings of an exposure, photos,
and lines of a doctor.

`pdcd.bench.devices` has the Protocols that take and return them, and all of these names as well;
authors of drivers import them from `pdcd.driver`. What was added after the first drivers were
written has a default.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import PdcdError


@dataclass(frozen=True)
class DisplayInfo:
    """The two panels as found: size in pixels (width, height), refresh rate, identity.

    `mask_lag_s` is by how much the mask's light of a row of `Frames` follows the projector's of the
    same row (negative: it leads), own delays of both streams included; None: unknown, or drifting.

    `row_times` says that `load` takes rows with `Frames.dark_s` and `Frames.delay_s`, and that the
    log tells of them. The rig gives such frames to no other display. `waits_for_edge` says that the
    shutter's opening starts what was loaded, once: each exposure loads it anew.

    `warnings` are what the user must know of the panels, each with what to do, for the run.
    """

    primal_size_px: tuple[int, int]
    dual_size_px: tuple[int, int]
    refresh_hz: float
    identity: dict[str, str] = field(default_factory=dict)
    mask_lag_s: float | None = None
    row_times: bool = False
    waits_for_edge: bool = False
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraSettings:
    """Settings of one exposure. `f_number` None means: leave the aperture as it is.

    exposure_s : how long it is planned to be, from `Shutter.open` returning to `Shutter.close`
        being called, with the time on black before and after the frames; None: nobody said.
    longest_s : for how long it may go on, late refreshes and further passes included, with a
        margin: whoever guards a shutter ends it then, and not before. None: nobody said.
    """

    iso: int
    f_number: float | None
    exposure_s: float | None = None
    longest_s: float | None = None


@dataclass(frozen=True)
class CameraInfo:
    """What the camera is and how it answers to light.

    `responsivity_e` (3,) float64: electrons per scene unit per second, for R, G, B, at f/1, or (1,)
    without colours; the signal at aperture f is this divided by f squared; `camera.responsivity_e`
    of the configuration, typed or measured, takes its place. `profile` names the sensor profile.
    """

    model: str
    serial: str
    profile: str
    responsivity_e: NDArray[np.float64]
    isos: tuple[int, ...]
    f_numbers: tuple[float, ...]
    """Apertures that can be set from here; empty for a manual lens."""
    frame_quads: tuple[int, int] | None = None
    """Width and height of its photos in Bayer quads, where that is known before the first one."""
    readout_s: float | None = None
    """Seconds that a photo costs beside its exposure: getting ready, and until its file is stored.
    None where that is not known; the rig then learns it from the first photos."""
    cfa: str | None = "RGGB"
    """Colours of the quad at the upper left corner of its photos, row by row: "RGGB", "BGGR",
    "GRBG" or "GBRG"; None for a sensor without colours. Any other word is that of a mosaic that is
    not known here; the rig refuses it before there is light."""

    @property
    def colours(self) -> int:
        """Of its pictures: 3, or 1 of a sensor without."""
        return int(self.responsivity_e.size)


@dataclass(frozen=True)
class ShutterTiming:
    """A shutter that moves while the panels show their frames, so that a photo tells when it did:
    told to open once `after` rows were shown, and to close `open_s` after it was surely open."""

    after: int
    open_s: float


@dataclass(frozen=True)
class RawFile:
    """A RAW file on disk, as fetched: byte-for-byte the camera's own.

    second : of a sensor with two buckets, the file of the second one in the same exposure: light
        that the mask's patterns kept out of the first.
    """

    path: Path
    size_bytes: int
    sha256: str
    second: RawFile | None = None


@dataclass(frozen=True)
class PhotoFrame:
    """A photo in memory, from a camera that hands over samples: the rig writes it to disk as DNG.

    samples : (H, W) uint16
        In DN, as the sensor has them: black not taken off, nothing scaled, turned or mended.
    black : DN without light: one number, or one for each place of the quad, row by row.
    white : DN from which a sample is saturated.
    iso, f_number : what it was taken with; 0 and None where the camera does not tell.
    exposure_s : how long the camera says that it exposed.
    cfa : colours of the quad at the upper left corner, as of `CameraInfo.cfa`.
    date : when it was taken; None: just now.
    record : what the device says of this photo in its own words, pixel format, gain, number and
        temperature for example; kept in the file.
    second : as of `RawFile`.
    pulses : how many pulses of the projector's and of the mask's output the camera counted since it
        was armed; None where it counts none. Times of a display that says how many there are to be
        (`FrameLog.pulses`) are proven by them.
    pulses_hint : what to look at, of this camera, where it counted others than there were to be.
    """

    samples: NDArray[np.uint16]
    black: int | Sequence[int]
    white: int
    iso: int
    exposure_s: float
    f_number: float | None = None
    cfa: str | None = "RGGB"
    date: datetime | None = None
    record: Mapping[str, str] = field(default_factory=dict)
    second: PhotoFrame | None = None
    pulses: tuple[int, int] | None = None
    pulses_hint: str = ""


_State = Literal["good", "warning", "fault", "unknown"]


class Finding(msgspec.Struct, frozen=True):
    """One thing looked at. `state` "unknown" means that it could not be looked at."""

    what: str
    state: _State
    found: str
    hint: str | None = None


def fault(what: str, err: PdcdError, device: str | None = None) -> Finding:
    """What an error says, `device` being the one that this doctor is about."""
    where = f"{err.device}: " if err.device not in (None, device) else ""
    return Finding(what, "fault", where + err.message, err.hint)
