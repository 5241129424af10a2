"""The virtual camera as a process of its own: ``python -m tests.virtual_eos_server``.

Prints its port; when its input ends, prints as JSON what the camera saw and made, and exits.
"""

from __future__ import annotations

import hashlib
import json
import sys

from drivers.virtual_camera import CameraExposure, PlainFilm, make_chart_film
from drivers.virtual_camera.command import make_real_time_body
from drivers.virtual_camera.develop import start_developer
from drivers.virtual_camera.ptpip import PtpIpServer


def main() -> None:
    chart = make_chart_film((480, 720))
    made: list[str] = []

    def make_raw(exposure: CameraExposure) -> bytes:
        data = chart.make_raw(exposure)
        made.append(hashlib.sha256(data).hexdigest())
        return data

    with start_developer() as develop:
        body = make_real_time_body(PlainFilm(make_raw), develop)
        with PtpIpServer(body, 0) as server:
            sys.stdout.write(f"{server.port}\n")
            sys.stdout.flush()
            sys.stdin.read()
    seen = [(e.close_ns - e.open_ns) * 1e-9 for e in body.shutter.exposures]
    left = len(body.store.files)
    told = {"seconds": seen, "sha256": made, "left": left, "session": body.session_open}
    sys.stdout.write(json.dumps(told) + "\n")


if __name__ == "__main__":
    main()
