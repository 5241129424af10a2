"""Live view of a Canon EOS body over USB."""

from __future__ import annotations

import struct
import weakref
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import DriverContext, ExposureError, PdcdError, decode_jpeg

from .codes import (
    FINDER_JPEG,
    FINDER_OFF,
    FINDER_PC,
    FINDER_WHOLE,
    Operation,
    Property,
    ResponseCode,
    format_code,
)
from .eos import EosCamera
from .faults import DEVICE

_USER = "preview"
_PAUSE_S = 0.01
"""Pause before a finder without a new picture is asked again."""
_LATER = (ResponseCode.EOS_NOT_READY, ResponseCode.DEVICE_BUSY)


class PtpPreview:
    """Raises the mirror, and fetches the camera's live view. Never run on a real body so far."""

    maturity = "experimental"

    def __init__(self, camera: EosCamera) -> None:
        self._camera = camera
        self._session = 0
        weakref.finalize(self, camera.let_go, _USER)

    @classmethod
    def create(cls, context: DriverContext) -> PtpPreview:
        """The finder of this rig's camera."""
        return cls(EosCamera.of(context))

    def connect(self) -> dict[str, str]:
        """Switch live view on. Raises ExposureError if the body refuses."""
        identity = self._camera.open(_USER)
        self._switch_on()
        return identity

    def _switch_on(self) -> None:
        camera = self._camera
        with camera.in_time():
            camera.poll()
            if camera.values.get(Property.FINDER_MODE) == 0:
                camera.set_value(Property.FINDER_MODE, 1, "live view: allow it in its menu")
            camera.set_value(Property.FINDER_OUTPUT, FINDER_PC, "live view")
            self._session = camera.session.renewed

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next picture. Raises ExposureError if none comes, or the camera has no live view."""
        camera = self._camera

        def over() -> PdcdError:
            return ExposureError(
                f"no picture of the finder came within {timeout_s:g} s",
                device=DEVICE,
                hint="switch the camera off and on",
            )

        with camera.patience.within(timeout_s, over):
            while True:
                reply = camera.session.call(Operation.EOS_GET_VIEW_FINDER_DATA, FINDER_WHOLE)
                if camera.session.renewed != self._session:  # a new session begins with it off
                    self._switch_on()
                    continue
                picture = decode_jpeg(find_finder_jpeg(bytes(reply.data)))
                if reply.code == ResponseCode.OK and picture is not None:
                    return picture
                if reply.code not in (ResponseCode.OK, *_LATER):
                    raise ExposureError(
                        f"live view is refused: {format_code(reply.code, ResponseCode)}",
                        device=DEVICE,
                        hint="allow live view in the camera's menu",
                    )
                camera.pause(_PAUSE_S)

    def disconnect(self) -> None:
        """Switch live view off, and release the camera unless shutter or readout use it."""
        camera = self._camera
        try:
            with camera.patience.deaf(), suppress(PdcdError):
                if camera.session.is_open:
                    camera.set_value(Property.FINDER_OUTPUT, FINDER_OFF, "the end of live view")
        finally:
            camera.close(_USER)


def find_finder_jpeg(data: bytes) -> bytes:
    """The picture in a body's live-view data, which are blocks of length, type and content (the
    length covers all three); empty if there is none."""
    at = 0
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, at)
        if kind in FINDER_JPEG:
            return data[at + 8 : at + length]
        at += max(length, 8)
    return b""
