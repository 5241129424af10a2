"""A camera that is not there: a Canon EOS 450D as seen over PTP, on the USB or on a network.

`CameraBody` is the camera, `VirtualUsb` puts it on a pyusb backend, `drivers.virtual_camera.ptpip`
on TCP. A `FaultScript` says what goes wrong with it.
"""

from __future__ import annotations

from dataclasses import replace

from pdcd.driver import DriverContext

from ..ptp.codes import APERTURE_CODES, ISO_CODES
from .body import CameraBody
from .develop import develop_after
from .faults import FaultScript, ScriptedFault
from .films import BenchFilm, PlainFilm, make_chart_film
from .model import (
    BULB_BODY,
    CABLE_BODY,
    RELEASE_BODY,
    THIRD_STOPS,
    CameraModel,
)
from .shutter import CameraExposure, ShutterFilm
from .usb_backend import VirtualUsb

__all__ = [
    "BULB_BODY",
    "CABLE_BODY",
    "RELEASE_BODY",
    "BenchFilm",
    "BenchUsb",
    "CameraBody",
    "CameraExposure",
    "CameraModel",
    "FaultScript",
    "PlainFilm",
    "ScriptedFault",
    "ShutterFilm",
    "VirtualUsb",
    "make_bench_backend",
    "make_chart_film",
]


def make_bench_backend(
    context: DriverContext, model: CameraModel = BULB_BODY, script: FaultScript | None = None
) -> VirtualUsb:
    """A pyusb backend with a camera that photographs the mock bench of this context.

    It offers those of its ISOs that the bench's sensor profile has. Its lens goes from f/1 to f/45
    if `[camera] f_number` is auto or a stop of that lens; otherwise it reports no aperture.
    """
    film = BenchFilm(context)
    isos = tuple(code for code in model.isos if ISO_CODES.get(code, 0) in (0, *film.isos))
    fixed = context.config.camera.f_number
    stops = tuple(code for code in APERTURE_CODES if code % 8 in THIRD_STOPS)
    if fixed != "auto" and float(fixed) not in {APERTURE_CODES[code] for code in stops}:
        stops = ()
    fitted = replace(model, isos=isos, apertures=stops)
    shared, on_mock = context.shared, context.config.display.driver == "mock"

    def shows() -> bool:
        """Whether panels other than the mock's are still showing during a moving shutter."""
        nothing = shared.played is None and shared.exposed_ns is None
        return shared.moving and nothing and not on_mock

    develop, finder = develop_after(shows), film.make_finder_jpeg
    body = CameraBody(context.clock, film, fitted, script, develop=develop, finder=finder)
    return VirtualUsb(body)


class BenchUsb:
    """The USB called "virtual": on it is a camera that photographs the mock bench."""

    maturity = "stable"

    @classmethod
    def create(cls, context: DriverContext) -> VirtualUsb:
        """`make_bench_backend` of the rig. Raises ConfigError for a bench that cannot be."""
        return make_bench_backend(context)
