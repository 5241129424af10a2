"""The mock bench as a machine-vision camera sees it: its scene, by GigE Vision on this machine.

The driver is `drivers.genicam` unchanged; this module adds the camera that listens at 127.0.0.1.
"""

from __future__ import annotations

import math
from collections.abc import Generator

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.driver import ConfigError, DriverContext, Finding, PdcdError, fault

from ..genicam.camera import GenicamCamera, list_camera_parts
from ..genicam.device import GenicamDevice
from ..genicam.doctor import examine_genicam
from ..genicam.options import read_genicam_options
from ..genicam.pixels import BY_NAME
from ..genicam.roles import GenicamReadout, GenicamShutter
from ..mock.bench import MockBench
from ..mock.camera import BenchSensor
from .camera import VirtualExposure, VirtualGenicamCamera
from .description import CameraDescription
from .simulator import VIRTUAL_ADDRESS

_DARK_S = 1e-3
"""A shorter exposure only measures black. Panels are black then, and the bench's shutter is not
opened for it."""
_WAIT_S = 60.0
"""How long a frame may take: the light of the exposure is computed first."""
_PACKET_BYTES = 9000
"""The loopback takes more, but the simulator has no test packets to find that out."""
_SIDES = {"Line2": 0, "Line3": 1}
"""The panel whose pulses come to each input: the projector's and the mask's."""
_PLACES = {"R": ((0, 0),), "G": ((0, 1), (1, 0)), "B": ((1, 1),)}
"""Where the bench's sensor has a colour in its quads."""


class BenchLight:
    """The scene of the mock bench, with the sensor profile of [camera]; the lens is at
    `[camera] f_number`, or f/8 if that is auto."""

    def __init__(self, context: DriverContext) -> None:
        config = context.config
        self._bench = MockBench.of(context)
        context.shared.photographed = True
        self.sensor = BenchSensor(self._bench, config.camera)
        fixed = config.camera.f_number
        self._f_number = 8.0 if fixed == "auto" else float(fixed)

    def open(self, asked_ns: int, exposure_s: float | None) -> int:
        """Begin to expose the sensor."""
        if exposure_s is None or exposure_s >= _DARK_S:
            self._bench.open_shutter(asked_ns)
        return asked_ns

    def close(self, asked_ns: int) -> int:
        """End the exposure."""
        if self._bench.shutter_open:
            self._bench.close_shutter(asked_ns)
        return asked_ns

    def count_pulses(self, line: str, low_ns: int, high_ns: int) -> int:
        """Count pulses at an input (`_SIDES`) from panels other than the mock's."""
        panels = self._bench.panels
        return 0 if panels is None else panels.count_pulses(_SIDES[line], low_ns, high_ns)

    def make_samples(self, exposure: VirtualExposure) -> NDArray[np.uint16]:
        """The bench's photo, quads of a mosaic in the order of the format."""
        shape = (exposure.height, exposure.width)
        if exposure.exposure_s < _DARK_S:
            return np.full(shape, self.sensor.profile.black_dn, np.uint16)
        isos = self.sensor.profile.isos
        wanted = 100.0 * 10.0 ** (exposure.gain_db / 20.0)
        iso = min(isos, key=lambda known: abs(math.log(known / wanted)))
        ((samples, _),) = self.sensor.photos(iso, self._f_number, 1)
        cfa = exposure.pixel_format.cfa
        return samples if cfa is None else order_mosaic(samples, cfa)


def order_mosaic(samples: NDArray[np.uint16], cfa: str) -> NDArray[np.uint16]:
    """An RGGB mosaic with the samples of each quad in another order of colours."""
    turned, used = np.empty_like(samples), dict.fromkeys("RGB", 0)
    for place, colour in enumerate(cfa):
        row, column = _PLACES[colour][used[colour]]
        used[colour] += 1
        turned[place // 2 :: 2, place % 2 :: 2] = samples[row::2, column::2]
    return turned


class HostedCamera(GenicamCamera):
    """A camera of `drivers.genicam` that hosts the virtual camera which it opens."""

    def __init__(self, context: DriverContext) -> None:
        """Raises ConfigError for an impossible bench. Nothing listens before `open`."""
        config = context.config
        options = read_genicam_options(config)
        film = BenchLight(context)
        profile, mosaic = film.sensor.profile, film.sensor.cfa is not None
        kind, side = ("BayerRG", 2) if mosaic else ("Mono", 1)
        name = options.pixel_format or kind + ("12p" if profile.bits <= 12 else "16")
        if name not in BY_NAME or (BY_NAME[name].cfa is not None) is not mosaic:
            raise ConfigError(
                f"the virtual camera has no pixel format {name}",
                device="camera",
                hint=f"take {kind}12p or {kind}16; the sensor profile says whether there are "
                "colours",
            )
        width, height = (side * count for count in film.sensor.frame_quads)
        self.virtual = VirtualGenicamCamera(
            CameraDescription(
                width,
                height,
                (BY_NAME[name],),
                white=profile.white_dn,
                gain_db=20.0 * math.log10(profile.isos[-1] / 100.0),
            ),
            film,
            context.clock,
            count_pulses=film.count_pulses,
        )
        options = msgspec.structs.replace(
            options,
            camera=VIRTUAL_ADDRESS,
            resend=False,
            wait_s=max(options.wait_s, _WAIT_S),
            packet_bytes=options.packet_bytes or _PACKET_BYTES,
        )
        super().__init__(options, *list_camera_parts(context))

    def open(self, user: str) -> GenicamDevice:
        """Have the camera listen, and open it."""
        self.virtual.start()
        return super().open(user)

    def close(self, user: str) -> None:
        """Close it; after the last user it no longer listens."""
        super().close(user)
        if not self._users:
            self.virtual.stop()


def examine_virtual_genicam(
    context: DriverContext,
) -> Generator[Finding, None, tuple[int, int] | None]:
    """The findings of `examine_genicam` about the hosted camera, while it listens."""
    try:
        hosted = HostedCamera(context)
        hosted.virtual.start()
    except PdcdError as err:
        yield fault("camera", err, "camera")
        return None
    try:
        return (yield from examine_genicam(context, hosted.options))
    finally:
        hosted.virtual.stop()


def _host(context: DriverContext) -> DriverContext:
    """Make this the camera of the rig, before its driver looks for one."""
    context.the(GenicamCamera, lambda: HostedCamera(context))
    return context


class VirtualGenicamShutter(GenicamShutter):
    """The shutter of a camera of the mock bench."""

    maturity = "stable"

    @classmethod
    def create(cls, context: DriverContext) -> GenicamShutter:
        """As `GenicamShutter.create`."""
        return super().create(_host(context))


class VirtualGenicamReadout(GenicamReadout):
    """The readout of a camera of the mock bench."""

    maturity = "stable"

    @classmethod
    def create(cls, context: DriverContext) -> GenicamReadout:
        """As `GenicamReadout.create`."""
        return super().create(_host(context))
