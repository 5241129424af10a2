"""What authors of drivers import from: the one module for them, whose names stay.

::

    from pdcd.driver import DriverContext, Frames, Shutter, read_options

These names stay here, whatever moves inside pdcd. Nothing inside pdcd imports from here; our own
drivers do. docs/new-driver.md explains how to write a driver.

Roles, each a Protocol that a class of yours implements (an entry point names it)
- `Display`            shows frames on projector and mask, in step, and logs when
- `Shutter`            opens and closes the exposure
- `TimedShutter`       the same, but must know how long the exposure will be
- `Readout`            sets the camera up and fetches its photo
- `RecheckingReadout`  the same, but finds its photos in files that others write
- `Preview`            the camera's finder; a bench may lack it

Values that pass between pdcd and a driver
- `DriverContext`      what `create` gets: configuration, clock, sign of life, the one camera
- `Patience`           one deadline and one cancel for every loop that waits for a device
- `Clock`              the only source of time; `RealClock` is the machine's
- `DisplayInfo`        the two panels as found
- `CameraInfo`         what the camera is, and how it responds to light
- `CameraSettings`     settings of one exposure
- `Frames`, `FrameLog` what both panels are asked to show row by row, and what they did
- `BLACK`, `WHITE`     pattern indices of a panel that is black, or fully lit
- `RawFile`            a photo on disk
- `PhotoFrame`         a photo in memory, which the rig writes to disk

Tools for displays
- `panels_of`          both panels as the configuration places them
- `draw`               the exact pixels that a panel must show for a row
- `draw_planes`        the RGB picture that carries 24 rows, for DLPs
- `draw_plane_words`   the same, as one word a pixel
- `check_fit`          for `load`: refuses what a panel cannot show
- `check_binary`       for `load`: refuses grey levels, which bit planes cannot show
- `check_row_times`    for `load`: refuses rows with dark time or a delay of their own
- `streams`            what each panel is sent when the mask is delayed
- `play_all`           plays frames, and repeats missed ones as the rig is configured
- `join_logs`          the log of several passes

Tools for cameras
- `write_dng`          samples -> a RAW file
- `read_raw`           a RAW file -> samples; `RAW_SUFFIXES` lists the suffixes of RAW files
- `read_tags`          the tags of a RAW file, and whether it is whole
- `find_gap`           the part of a RAW file that is still missing
- `WatchedFolder`, `WatchedFile`    a folder that others write into: listed, read and hashed
  with care; the status of one name in it
- `to_one_line`        text from outside, fit to show
- `decode_jpeg`        a picture that a finder sent
- `load_profile`       the sensor profile that [camera] names
- `responsivity_e`     what `CameraInfo` says about the response to light

Options, and findings of a doctor
- `read_options`       reads the `options` table of a role into a struct of yours
- `merge_camera_options`    the same for a camera that fills both roles, from either table
- `Config`, `CameraConfig`, `TriggerConfig`    tables of the configuration
- `Finding`, `fault`   one line of `pdcd doctor`; the line that an error makes

Errors: a driver raises these and no others
- `ConfigError`        a setting is wrong, or the device does not offer it
- `DriverUnavailable`  what the driver needs is not installed
- `DeviceLost`         the device does not answer
- `SyncError`          the panels missed refreshes, or cannot be kept in step
- `ExposureError`      the shutter or the exposure went wrong, or no photo came; `PhotoError`
  if only the photo was lost, and taking it again may help
- `DecodeError`        a file that the camera sent cannot be read
- `NoSpaceError`, `DiskError`    the disk; `disk_errors` turns OSError into them
- `Cancelled`          `cancelled()` was true while frames were shown
- `PdcdError`          the base of all

`pdcd.testing` tests a driver of yours against everything that these roles promise.

Each name loads what it needs when it is first used, so that a process that guards a shutter need
not load what reads photos.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pdcd.bench.clock import RealClock
    from pdcd.bench.devices import (
        CameraInfo,
        CameraSettings,
        Clock,
        Display,
        DisplayInfo,
        DriverContext,
        Finding,
        PhotoFrame,
        Preview,
        RawFile,
        Readout,
        RecheckingReadout,
        Shutter,
        TimedShutter,
        fault,
    )
    from pdcd.bench.patience import Patience
    from pdcd.bench.placed import panels_of
    from pdcd.bench.reading import merge_camera_options, read_options
    from pdcd.bench.tables import CameraConfig, Config, TriggerConfig
    from pdcd.errors import (
        Cancelled,
        ConfigError,
        DecodeError,
        DeviceLost,
        DiskError,
        DriverUnavailable,
        ExposureError,
        NoSpaceError,
        PdcdError,
        PhotoError,
        SyncError,
        disk_errors,
    )
    from pdcd.files.images import decode_jpeg
    from pdcd.files.watched import WatchedFile, WatchedFolder
    from pdcd.panels.balance import join_logs, play_all, streams
    from pdcd.panels.draw import check_fit, draw, draw_plane_words, draw_planes
    from pdcd.panels.frames import BLACK, WHITE, FrameLog, Frames, check_row_times
    from pdcd.panels.patterns import check_binary
    from pdcd.printable import to_one_line
    from pdcd.sensor.dng import write_dng
    from pdcd.sensor.profile import load_profile, responsivity_e
    from pdcd.sensor.raw import RAW_SUFFIXES, read_raw
    from pdcd.sensor.tiff import read_tags
    from pdcd.sensor.whole import find_gap

__all__ = [
    "BLACK",
    "RAW_SUFFIXES",
    "WHITE",
    "CameraConfig",
    "CameraInfo",
    "CameraSettings",
    "Cancelled",
    "Clock",
    "Config",
    "ConfigError",
    "DecodeError",
    "DeviceLost",
    "DiskError",
    "Display",
    "DisplayInfo",
    "DriverContext",
    "DriverUnavailable",
    "ExposureError",
    "Finding",
    "FrameLog",
    "Frames",
    "NoSpaceError",
    "Patience",
    "PdcdError",
    "PhotoError",
    "PhotoFrame",
    "Preview",
    "RawFile",
    "Readout",
    "RealClock",
    "RecheckingReadout",
    "Shutter",
    "SyncError",
    "TimedShutter",
    "TriggerConfig",
    "WatchedFile",
    "WatchedFolder",
    "check_binary",
    "check_fit",
    "check_row_times",
    "decode_jpeg",
    "disk_errors",
    "draw",
    "draw_plane_words",
    "draw_planes",
    "fault",
    "find_gap",
    "join_logs",
    "load_profile",
    "merge_camera_options",
    "panels_of",
    "play_all",
    "read_options",
    "read_raw",
    "read_tags",
    "responsivity_e",
    "streams",
    "to_one_line",
    "write_dng",
]

_ROOMS = {
    "pdcd.bench.clock": ("RealClock",),
    "pdcd.bench.devices": (
        "CameraInfo",
        "CameraSettings",
        "Clock",
        "Display",
        "DisplayInfo",
        "DriverContext",
        "PhotoFrame",
        "Preview",
        "RawFile",
        "Readout",
        "RecheckingReadout",
        "Shutter",
        "TimedShutter",
        "Finding",
        "fault",
    ),
    "pdcd.bench.reading": ("merge_camera_options", "read_options"),
    "pdcd.bench.patience": ("Patience",),
    "pdcd.bench.placed": ("panels_of",),
    "pdcd.bench.tables": ("CameraConfig", "Config", "TriggerConfig"),
    "pdcd.errors": (
        "Cancelled",
        "ConfigError",
        "DecodeError",
        "DeviceLost",
        "DiskError",
        "DriverUnavailable",
        "ExposureError",
        "NoSpaceError",
        "PdcdError",
        "PhotoError",
        "SyncError",
        "disk_errors",
    ),
    "pdcd.files.images": ("decode_jpeg",),
    "pdcd.files.watched": ("WatchedFile", "WatchedFolder"),
    "pdcd.printable": ("to_one_line",),
    "pdcd.panels.balance": ("join_logs", "play_all", "streams"),
    "pdcd.panels.patterns": ("check_binary",),
    "pdcd.panels.draw": ("check_fit", "draw", "draw_plane_words", "draw_planes"),
    "pdcd.panels.frames": ("BLACK", "WHITE", "FrameLog", "Frames", "check_row_times"),
    "pdcd.sensor.dng": ("write_dng",),
    "pdcd.sensor.profile": ("load_profile", "responsivity_e"),
    "pdcd.sensor.raw": ("RAW_SUFFIXES", "read_raw"),
    "pdcd.sensor.tiff": ("read_tags",),
    "pdcd.sensor.whole": ("find_gap",),
}
"""The module in which each name is defined."""


if not TYPE_CHECKING:  # so that a type checker knows which names do not exist

    def __getattr__(name: str) -> object:
        for module, names in _ROOMS.items():
            if name in names:
                found = globals()[name] = getattr(importlib.import_module(module), name)
                return found
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
