"""Receives frames: only the one that is due, and whole; then its samples.

The camera numbers its frames. A missing frame is noticed at the next one at the latest, so that no
frame is taken for that of another exposure.
"""

from __future__ import annotations

import logging

from pdcd.driver import ExposureError, Patience, PhotoError

from .aravis import STATUS_WORDS, RawBuffer
from .device import CAMERA_DEVICE, GenicamDevice
from .pixels import BY_CODE, Samples, unpack_samples

logger = logging.getLogger(__name__)

_SLICE_S = 0.1
"""How long a call waits inside the library before it checks for a cancel."""
_ASK_S = 1.5
"""Time without a frame after which the camera is asked whether it is still there."""
_MOST_STRAY = 100
"""Frames that are thrown away before an error says that the camera runs by itself."""
_LAST_ID = 65535
"""Last frame number of GigE Vision; after it, numbers start again."""


class FrameReceiver:
    """Receives the frames of one open camera."""

    def __init__(self, device: GenicamDevice, patience: Patience) -> None:
        self._device = device
        self._patience = patience
        self._last_id: int | None = None

    def forget(self, wait_s: float = 0.0) -> None:
        """Throw away frames of earlier exposures, until no more come for `wait_s`."""
        for _ in range(_MOST_STRAY):
            self._patience.look()
            buffer = self._device.pop(wait_s)
            if buffer is None:
                return
            self._last_id = None if buffer.status else buffer.frame_id
            logger.warning("frame of an earlier exposure thrown away id=%d", buffer.frame_id)
        raise ExposureError(
            "frames keep coming without a request",
            device=CAMERA_DEVICE,
            hint="see that no other program or line triggers the camera",
        )

    def wait(self, longest_s: float) -> RawBuffer:
        """The frame that is due, whole, and no other.

        Waits in slices, and checks for a cancel between them. Raises PhotoError, DeviceLost,
        Cancelled.
        """
        waited_s = asked_s = 0.0
        while waited_s < longest_s:
            buffer = self._device.pop(_SLICE_S)
            if buffer is not None:
                return self.check(buffer)
            waited_s += _SLICE_S
            self._patience.look()
            if waited_s - asked_s >= _ASK_S or self._device.lost:
                asked_s = waited_s
                self._device.record()  # raises if the camera is gone, or is another one
        self._last_id = None
        raise PhotoError(
            f"no frame came within {longest_s:g} s",
            device=CAMERA_DEVICE,
            hint="take it again; if that goes on, see docs/genicam.md about packets",
        )

    def check(self, buffer: RawBuffer) -> RawBuffer:
        """The buffer. Raises PhotoError for a frame that is not whole, or not the one due."""
        last, self._last_id = self._last_id, buffer.frame_id
        if buffer.status:
            self._last_id = None  # an incomplete frame may lack its number, too
            raise PhotoError(
                f"frame {buffer.frame_id} is not whole: {STATUS_WORDS.get(buffer.status, '?')}",
                device=CAMERA_DEVICE,
                hint="take it again; if that goes on, see docs/genicam.md about packets",
            )
        due = {(last or 0) + 1} | ({0, 1} if last is not None and last >= _LAST_ID else set())
        if last is not None and buffer.frame_id not in due:
            raise PhotoError(
                f"frame {buffer.frame_id} came where {min(due)} was due",
                device=CAMERA_DEVICE,
                hint="take it again; see that nothing else triggers the camera",
            )
        return buffer

    def unpack(self, buffer: RawBuffer) -> Samples:
        """Samples of a frame, whole quads of a mosaic."""
        device, (width, height) = self._device, self._device.size
        found = BY_CODE.get(buffer.pixel_format)
        if found is not device.pixel_format or (buffer.width, buffer.height) != (width, height):
            raise ExposureError(
                f"a frame of {buffer.width} x {buffer.height} pixels, format "
                f"{buffer.pixel_format:#x}, where {device.size} of {device.pixel_format.name} "
                "were set",
                device=CAMERA_DEVICE,
                hint="see that no other program sets the camera",
            )
        over = len(buffer.data) - found.count_bytes(width * height)
        if over >= height and not buffer.chunks:
            raise ExposureError(
                f"a frame of {width} x {height} pixels has {over} bytes too many, which may lie "
                "between its lines",
                device=CAMERA_DEVICE,
                hint="set camera.options.region to a width that is a multiple of 16",
            )
        try:
            samples = unpack_samples(buffer.data, found, buffer.height, buffer.width)
        except ValueError as err:
            raise PhotoError(f"{err}", device=CAMERA_DEVICE, hint="take it again") from err
        samples = device.levels.read(samples)
        if found.cfa is None:
            return samples
        return samples[: buffer.height // 2 * 2, : buffer.width // 2 * 2]
