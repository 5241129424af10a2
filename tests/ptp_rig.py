"""A PTP camera on a virtual USB for tests: body, backend, both drivers, on a virtual clock."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.ptp.codes import Operation
from drivers.ptp.eos import EosCamera
from drivers.ptp.readout import PtpReadout
from drivers.ptp.shutter import PtpShutter
from drivers.ptp.transport import TransactionReply
from drivers.virtual_camera import (
    BULB_BODY,
    CameraBody,
    CameraExposure,
    CameraModel,
    FaultScript,
    PlainFilm,
    ShutterFilm,
    VirtualUsb,
)
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext, RawFile, SharedState
from pdcd.bench.tables import CameraConfig, Config, TriggerConfig
from pdcd.errors import PdcdError

SETTINGS = CameraSettings(iso=100, f_number=8.0)
PHOTO_B = (1 << 20) + 1234


def photo_of(exposure: CameraExposure) -> bytes:
    """Bytes that begin as a TIFF does and are different for every exposure."""
    seed = hashlib.sha256(repr(exposure).encode()).digest()
    return (b"II*\0" + seed * (PHOTO_B // len(seed) + 1))[:PHOTO_B]


@dataclass
class LookedAt:
    """What a driver that waits looks at."""

    on_look: Callable[[], object] = lambda: None
    cancelled: bool = False


class PtpRig:
    """One virtual camera and the drivers that use it; photos are of `photo_of`."""

    def __init__(
        self,
        script: FaultScript | None = None,
        model: CameraModel = BULB_BODY,
        *,
        film: ShutterFilm | None = None,
        camera: dict[str, Any] | None = None,
        trigger_driver: str = "ptp",
        camera_driver: str = "ptp",
        body: type[CameraBody] = CameraBody,
        usb: Callable[[Any], VirtualUsb] = VirtualUsb,
    ) -> None:
        self.clock = VirtualClock()
        self.body = body(self.clock, film or PlainFilm(photo_of), model, script)
        self.usb = usb(self.body)
        options = {"usb": "virtual", **(camera or {})}
        config = Config(
            camera=CameraConfig(
                driver=camera_driver, options=options if camera_driver == "ptp" else {}
            ),
            trigger=TriggerConfig(
                driver=trigger_driver, options=options if camera_driver != "ptp" else {}
            ),
        )
        job = self.job = LookedAt()
        self.context = DriverContext(
            config,
            self.clock,
            SharedState(usb_backend=self.usb),
            alive=lambda: job.on_look(),
            cancelled=lambda: job.cancelled,
        )
        self.camera = EosCamera.of(self.context)
        # Tests tick by themselves, so that nothing depends on how fast the machine is.
        self.camera.alive_period_s = 3600.0
        self.readout = PtpReadout.create(self.context)
        self.has_shutter = trigger_driver == "ptp"
        if self.has_shutter:
            self.shutter = PtpShutter.create(self.context)

    def connect(self) -> None:
        if self.has_shutter:
            self.shutter.connect()
        self.readout.connect()

    def disconnect(self) -> None:
        self.readout.disconnect()
        if self.has_shutter:
            self.shutter.disconnect()

    def disconnect_quietly(self) -> None:
        """What a rig does with devices that fail."""
        for device in (self.readout, self.shutter):
            with suppress(PdcdError):
                device.disconnect()

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def expose(self, seconds: float = 1.0) -> None:
        self.readout.arm(SETTINGS)
        self.shutter.open()
        self.wait(seconds)
        self.shutter.close()

    def photo(self, folder: Path, name: str, seconds: float = 1.0) -> RawFile:
        self.expose(seconds)
        return self.readout.fetch(folder, name, 600.0)

    def is_photo_of(self, raw: RawFile, exposure: CameraExposure) -> bool:
        """Whether the file is, byte for byte, that exposure's, and described truly."""
        data = raw.path.read_bytes()
        return (
            data == photo_of(exposure)
            and raw.size_bytes == len(data)
            and raw.sha256 == hashlib.sha256(data).hexdigest()
        )


def answer(code: int, data: bytes = b"") -> TransactionReply:
    """What a camera says to one operation."""
    return TransactionReply(code, (), memoryview(data))


class Calls:
    """Stands before the session of a camera: answers some operations itself, notes all."""

    def __init__(self, rig: PtpRig, answers: dict[Operation, list[Any]]) -> None:
        self.real = rig.camera.session.call
        self.answers = answers
        self.rig = rig
        rig.camera.session.call = self  # type: ignore[method-assign]
        self.done: list[tuple[int, Operation]] = []

    def __call__(self, code: Operation, *params: int, **more: Any) -> TransactionReply:
        self.done.append((self.rig.clock.now_ns(), code))
        if self.answers.get(code):
            found = self.answers[code].pop(0)
            if isinstance(found, Exception):
                raise found
            assert isinstance(found, TransactionReply)
            return found
        return self.real(code, *params, **more)

    def times(self, code: Operation) -> list[int]:
        return [at for at, one in self.done if one == code]
