"""What `pdcd virtual-camera` runs: a body on a chart or a mock scene, behind PTP/IP."""

from __future__ import annotations

from collections.abc import Callable

from drivers.virtual_camera.body import Body
from drivers.virtual_camera.films import chart_film
from drivers.virtual_camera.ptpip import PtpIpServer
from pdcd.clock import RealClock


def serve(port: int, *, small: bool, say: Callable[[str], None]) -> None:
    """Serve until interrupted. `say` is given lines for the user, the port's first of all.

    `small` makes files of 96 x 64 samples instead of the 450D's 4272 x 2848.
    """
    film = chart_film((64, 96)) if small else chart_film()
    with PtpIpServer(Body(RealClock(), film), port) as server:
        say(f"virtual Canon EOS 450D on ptpip:{server.host}:{server.port}:{server.port}")
        say(
            'try: gphoto2 --camera "PTP/IP Camera" '
            f"--port ptpip:{server.host}:{server.port}:{server.port} "
            "--set-config shutterspeed=bulb --capture-image-and-download -B 1"
        )
        server.wait()
