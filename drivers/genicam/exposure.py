"""One exposure as it goes: when it began and ends, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.driver import ExposureError, PhotoError

from .aravis import RawBuffer
from .device import CAMERA_DEVICE


@dataclass
class TimedExposure:
    """One that was begun. `begun_ns` is before the trigger, `sure_ns` when it surely had begun;
    `time_s` is what the camera's clock gives it, `spare_s` what of it is margin."""

    begun_ns: int
    sure_ns: int
    time_s: float
    spare_s: float
    late_s: float = 0.0
    closed: bool = False
    aborted: bool = False
    came: RawBuffer | PhotoError | None = None
    """The frame, where it alone says that the exposure is over, or why there is none."""

    @property
    def ends_ns(self) -> int:
        """When it is over at the earliest."""
        return self.begun_ns + round(self.time_s * 1e9)

    @property
    def over_ns(self) -> int:
        """When it is surely over."""
        return self.sure_ns + round(self.time_s * 1e9)


def check_exposed(exposure: TimedExposure | None) -> None:
    """Raise where there is no photo to wait for."""
    if exposure is None:
        raise ExposureError(
            "nothing was exposed", device=CAMERA_DEVICE, hint="open and close the shutter first"
        )
    if not exposure.closed:
        raise ExposureError("the shutter is open", device=CAMERA_DEVICE, hint="close it first")
    if exposure.aborted:
        raise PhotoError(
            "the exposure was given up before its time, as the shutter was closed early",
            device=CAMERA_DEVICE,
            hint="take it again",
        )
