"""What `pdcd virtual-camera` runs: a body on a chart or a mock scene, behind PTP/IP."""

from __future__ import annotations

from collections.abc import Callable

from pdcd.driver import RealClock

from .body import CameraBody
from .develop import Develop, start_developer
from .films import SENSOR_450D, make_chart_film, make_chart_finder, make_scene_film
from .ptpip import PtpIpServer
from .shutter import ShutterFilm


def serve_virtual_camera(port: int, *, scene: str, small: bool, say: Callable[[str], None]) -> None:
    """Serve until interrupted. `say` is called with lines for the user, the port's line first.

    `scene` is "chart" or a preset of the mock bench. `small` makes files of 192 x 128 samples
    instead of the 450D's 4272 x 2848. Raises ConfigError when there is no such scene, and OSError
    when the port is taken.
    """
    shape = (128, 192) if small else SENSOR_450D
    film = make_chart_film(shape) if scene == "chart" else make_scene_film(scene, shape)
    with (
        start_developer() as develop,
        PtpIpServer(make_real_time_body(film, develop), port) as server,
    ):
        say(f"virtual Canon EOS 450D on ptpip:{server.host}:{server.port}:{server.port}")
        say(
            'try: gphoto2 --camera "PTP/IP Camera" '
            f"--port ptpip:{server.host}:{server.port}:{server.port} "
            "--set-config shutterspeed=bulb --capture-image-and-download -B 1"
        )
        server.wait()


def make_real_time_body(film: ShutterFilm, develop: Develop) -> CameraBody:
    """A 450D for clients in real time; `develop` makes its files."""
    return CameraBody(RealClock(), film, develop=develop, finder=make_chart_finder())
