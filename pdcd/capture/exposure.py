"""The result of one exposure of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pdcd.bench.devices import CameraSettings, DisplayInfo, PhotoFrame, RawFile
from pdcd.errors import PhotoError
from pdcd.panels.frames import FrameLog


@dataclass(frozen=True)
class RigExposure:
    """One finished exposure."""

    open_ns: int
    close_ns: int
    log: FrameLog
    raw: RawFile
    settings: CameraSettings
    held: Mapping[str, bytes] = field(default_factory=dict)
    """Contents of its RAW files, by name, where these are only in memory."""

    @property
    def planes(self) -> tuple[RawFile, ...]:
        """Its RAW files: two of a camera with two buckets."""
        return (self.raw,) if self.raw.second is None else (self.raw, self.raw.second)

    @property
    def open_s(self) -> float:
        """How long the shutter was surely open, by the rig's clock."""
        return (self.close_ns - self.open_ns) * 1e-9


def verify_times(log: FrameLog, photo: RawFile | PhotoFrame) -> FrameLog:
    """The log, with verified times where the camera counted every pulse that the panels were to
    give. Raises PhotoError where the numbers differ (codes were lost, or shown twice), with the
    hints of both drivers."""
    if log.pulses is None or not isinstance(photo, PhotoFrame) or photo.pulses is None:
        return log
    if photo.pulses != log.pulses:
        (primal, dual), (seen, other) = log.pulses, photo.pulses
        hints = [hint for hint in (log.pulses_hint, photo.pulses_hint) if hint]
        raise PhotoError(
            f"the camera counted {seen} pulses of the projector and {other} of the mask, "
            f"instead of {primal} and {dual}",
            device="display",
            hint="; ".join(hints) or "check the wires from the panels' outputs to the camera",
        )
    return replace(log, verified=True)


def with_row_times(log: FrameLog, info: DisplayInfo | None) -> FrameLog:
    """The log, with dark times of zero where the display could have had some: either all logs of a
    run have dark times, or none."""
    if info is None or not info.row_times or log.dark_s is not None:
        return log
    return replace(log, dark_s=np.zeros(len(log)))
