"""A process that holds a camera's shutter open, and its guardian.

``python -m tests.guarded_shutter ADDRESS`` opens the shutter of the camera that is lent there (see
`tests.remote_usb`) when told so on its input, or prints the guardian's process id; with options and
an end of a line it is the guardian of the camera behind the address.
"""

from __future__ import annotations

import sys
from pathlib import Path

from drivers.ptp import guardian
from drivers.ptp import shutter as shutter_module
from drivers.ptp.shutter import PtpShutter
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import DriverContext, SharedState
from pdcd.bench.tables import Config, TriggerConfig
from tests.remote_usb import RemoteUsb


def main(address: str, *guarding: str) -> int:
    backend = RemoteUsb(Path(address))
    if guarding:
        return guardian.run_ptp_guardian(guarding[0], int(guarding[1]), backend)
    shutter_module.PTP_GUARDIAN = (sys.executable, "-m", "tests.guarded_shutter", address)
    config = Config(trigger=TriggerConfig(driver="ptp"))
    shutter = PtpShutter.create(
        DriverContext(config, RealClock(), SharedState(usb_backend=backend))
    )
    shutter.connect()
    for line in sys.stdin:
        word = line.strip()
        if word == "pid":
            assert shutter._guard is not None
            sys.stdout.write(f"{shutter._guard.pid}\n")
        else:
            getattr(shutter, word)()
            sys.stdout.write(f"{word}\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
