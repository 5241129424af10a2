"""The virtual camera as a process of its own: ``python -m tests.virtual_eos_server``.

Prints its port; when its input ends, prints as JSON what the camera saw and made, and exits.
"""

from __future__ import annotations

import hashlib
import json
import sys

from drivers.virtual_camera import Exposure, PlainFilm, chart_film
from drivers.virtual_camera.command import body_in_real_time
from drivers.virtual_camera.develop import meanwhile
from drivers.virtual_camera.ptpip import PtpIpServer


def main() -> None:
    chart = chart_film((480, 720))
    made: list[str] = []

    def make_raw(exposure: Exposure) -> bytes:
        data = chart.make_raw(exposure)
        made.append(hashlib.sha256(data).hexdigest())
        return data

    with meanwhile() as develop:
        body = body_in_real_time(PlainFilm(make_raw), develop)
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
