"""Values that pass between a bench and its drivers: descriptions of devices, settings of an
exposure, photos, and findings of a doctor.

`pdcd.bench.devices` has the Protocols that take and return them, and also all of these names;
authors of drivers import them from `pdcd.driver`. Fields that were added after the first drivers
were written have defaults.
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

    exposure_s : planned duration, from `Shutter.open` returning to `Shutter.close` being called,
        with the time on black before and after the frames; None: unknown.
    longest_s : how long it may go on, late refreshes and further passes included, with a margin: a
        device that guards a shutter closes it then, and not before. None: unknown.
    """

    iso: int
    f_number: float | None
    exposure_s: float | None = None
    longest_s: float | None = None


@dataclass(frozen=True)
class CameraInfo:
    """The camera: what it is, and how it responds to light.

    `responsivity_e` (3,) float64: electrons per scene unit per second, for R, G, B, at f/1, or (1,)
    without colours; the signal at aperture f is this divided by f squared. `camera.responsivity_e`
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
    """Seconds that a photo takes beside its exposure: getting ready, and until its file is stored.
    None where that is unknown; the rig then learns it from the first photos."""
    cfa: str | None = "RGGB"
    """Colours of the quad at the upper left corner of its photos, row by row: "RGGB", "BGGR",
    "GRBG" or "GBRG"; None for a sensor without colours. Any other word stands for a mosaic that
    pdcd does not know, and the rig refuses it before there is light."""

    @property
    def colours(self) -> int:
        """Number of colours of its pictures: 3, or 1 for a sensor without colours."""
        return int(self.responsivity_e.size)


@dataclass(frozen=True)
class ShutterTiming:
    """A shutter movement while the panels show their frames, so that the photo shows when it moved.

    The shutter is told to open once `after` rows were shown, and to close `open_s` after it was
    surely open.
    """

    after: int
    open_s: float


@dataclass(frozen=True)
class RawFile:
    """A RAW file on disk, as fetched: byte-for-byte the camera's own.

    second : for a sensor with two buckets, the file of the second bucket in the same exposure: the
        light that the mask's patterns kept out of the first.
    """

    path: Path
    size_bytes: int
    sha256: str
    second: RawFile | None = None


@dataclass(frozen=True)
class PhotoFrame:
    """A photo in memory, from a camera that hands over samples: the rig writes it to disk as DNG.

    samples : (H, W) uint16
        In DN, as the sensor has them: black not subtracted, nothing scaled, rotated or corrected.
    black : DN without light: one number, or one for each place of the quad, row by row.
    white : DN from which a sample is saturated.
    iso, f_number : the settings it was taken with; 0 and None where the camera does not report
        them.
    exposure_s : exposure time that the camera reports.
    cfa : colours of the quad at the upper left corner, as in `CameraInfo.cfa`.
    date : when it was taken; None: just now.
    record : what the device reports about this photo in its own words, for example pixel format,
        gain, number and temperature; kept in the file.
    second : as in `RawFile`.
    pulses : number of pulses of the projector's and of the mask's output that the camera counted
        since it was armed; None where it counts none. They prove the times of a display that says
        how many there should be (`FrameLog.pulses`).
    pulses_hint : what to check on this camera where it counted another number.
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
    """The finding for an error; `device` is the device that this doctor examines."""
    where = f"{err.device}: " if err.device not in (None, device) else ""
    return Finding(what, "fault", where + err.message, err.hint)
