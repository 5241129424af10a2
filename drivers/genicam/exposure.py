"""One exposure: when it began and ends, and its outcome."""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.driver import ExposureError, PhotoError

from .aravis import RawBuffer
from .device import CAMERA_DEVICE


@dataclass
class TimedExposure:
    """An exposure that was begun. `begun_ns` is before the trigger, `sure_ns` when it had surely
    begun; `time_s` is its length by the camera's clock, `spare_s` the margin in that."""

    begun_ns: int
    sure_ns: int
    time_s: float
    spare_s: float
    late_s: float = 0.0
    closed: bool = False
    aborted: bool = False
    came: RawBuffer | PhotoError | None = None
    """The frame, if only the frame shows that the exposure is over; or why there is none."""

    @property
    def ends_ns(self) -> int:
        """When it is over at the earliest."""
        return self.begun_ns + round(self.time_s * 1e9)

    @property
    def over_ns(self) -> int:
        """When it is surely over."""
        return self.sure_ns + round(self.time_s * 1e9)


def check_exposed(exposure: TimedExposure | None) -> None:
    """Raise an error if there is no photo to wait for."""
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
