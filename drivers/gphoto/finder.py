"""The preview of a camera that libgphoto2 knows."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import DriverContext, ExposureError, PdcdError, decode_jpeg

from .session import GphotoSession

_USER = "preview"


class GphotoPreview:
    """Pictures as `gphoto2 --capture-preview` has them. Never run on a real camera."""

    maturity = "experimental"

    def __init__(self, session: GphotoSession) -> None:
        self._session = session

    @classmethod
    def create(cls, context: DriverContext) -> GphotoPreview:
        """The finder of this rig's camera. Raises ConfigError."""
        return cls(GphotoSession.of(context))

    def connect(self) -> dict[str, str]:
        """Open the camera. Raises DeviceLost."""
        self._session.open(_USER)
        return {"model": "gphoto2 preview"}

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next picture; libgphoto2 decides how long it takes. Raises DeviceLost, and
        ExposureError if it is not a picture."""
        picture = decode_jpeg(self._session.see())
        if picture is None:
            raise ExposureError(
                "the camera's preview is no JPEG",
                device="camera",
                hint="see what gphoto2 --capture-preview makes of it",
            )
        return picture

    def disconnect(self) -> None:
        """Close the mirror if the camera can, and release it unless others use it."""
        session = self._session
        with session.patience.deaf(), suppress(PdcdError):
            session.set("viewfinder", 0)
        session.close(_USER)
